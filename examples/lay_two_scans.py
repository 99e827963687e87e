"""Registration: two scans of one place, with and without a guess, and a scan of another place that is refused.

python examples/lay_two_scans.py
"""

import numpy as np

from registration import align, align_globally
from whereabouts.simulation import Lidar, random_floor

rng = np.random.default_rng(5)
floor, waypoints = random_floor(rng, rooms=2)
lidar = Lidar(beams=361)
here, there = np.array([*waypoints[0], 0.3]), np.array([*waypoints[0] + (0.4, 0.2), 1.2])
first, second = (lidar.scan(floor, pose, rng).scan for pose in (here, there))

near = align(second, first, guess=(0.3, 0.0, 0.8))
print(f"from a guess: {np.round(near.transform, 3)}, sigma {np.round(np.sqrt(np.diag(near.covariance)), 4)}")

anywhere = align_globally(second, first)
print(f"without one:  {np.round(anywhere.transform, 3)}, fitness {anywhere.fitness:.2f}")

elsewhere, _ = random_floor(np.random.default_rng(6), rooms=3)
other = align_globally(lidar.scan(elsewhere, here, rng).scan, first)
print(f"another place: {'believed' if other.converged else 'refused'} ({other.reason})")

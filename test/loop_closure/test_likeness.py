"""What looks like the newest keyframe: places of the round before, from either direction, and nothing just passed."""

from __future__ import annotations

import numpy as np

from loop_closure.keyframes import Keyframes
from loop_closure.slam.likeness import PlaceLikeness
from whereabouts.simulation import Drive, Lidar, box, joined

CORNERS = [(-6.8, -4.7), (6.8, -4.7), (6.8, 4.7), (-6.8, 4.7)]
APART = 10.0


def test_a_second_round_looks_like_the_first() -> None:
    rng = np.random.default_rng(3)
    furniture = [
        box(*rng.uniform(0.2, 1.0, 2), (x, y, rng.uniform(0.0, 3.0)))
        for x, y in [(-3.0, 5.5), (1.2, 5.3), (6.0, 5.4), (7.4, -3.0), (0.3, -5.4), (-4.4, -5.5), (-7.4, 2.2)]
    ]
    world, lidar = joined([box(16.0, 12.0), box(11.0, 7.0), *furniture]), Lidar(181)
    drive = Drive([*CORNERS, *CORNERS[:3]], speed=0.7, turn_rate=0.8)
    keyframes, likeness, found = Keyframes(), PlaceLikeness(), []
    poses = np.array([drive(float(time)) for time in np.arange(0.0, drive.duration, 1.0)])
    for k, pose in enumerate(poses):
        keyframes.add_scan(lidar.scan(world, pose, rng, float(k)).scan, pose, 25.0)
        # Asked for the second round only: what came before is read up on then.
        if keyframes.paths[k] > 50.0:
            likely = likeness.of(k, keyframes, APART)
            assert all(keyframes.paths[j] <= keyframes.paths[k] - APART for j in likely)
            if likely:
                best = max(likely, key=lambda j: likely[j])
                found.append(float(np.hypot(*(poses[best, :2] - pose[:2]))))
            assert likeness.of(k, keyframes, APART) == likely, "what was found is remembered"
            assert likeness.of(0, keyframes, APART) == {}, "nobody asked when it was the newest"
    assert len(found) > 15
    assert np.mean(np.array(found) < 2.0) > 0.8

"""SLAM: a map of a floor is made and saved, and another robot finds itself in it without being told where it is.

python examples/map_and_find_again.py
"""

import tempfile
from pathlib import Path

import numpy as np

from loop_closure import Localizer, Slam, read_map, write_map
from registration import Odometry
from whereabouts.simulation import Drive, Lidar, random_floor

rng = np.random.default_rng(1)
floor, waypoints = random_floor(rng, rooms=2)
lidar, drive = Lidar(beams=361), Drive(waypoints)

odometry, slam = Odometry(), Slam()
for stamp in np.arange(0.0, drive.duration, 0.1):
    scan = lidar.scan(floor, drive(stamp), rng, stamp).scan
    slam.process(scan, odometry.register(scan, stamp), odometry.covariance)
print(f"{len(slam.closures)} closures on {len(slam.trajectory())} keyframes")

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "floor.npz"
    with path.open("wb") as file:
        write_map(slam, file)
    known = read_map(path)

odometry, localizer = Odometry(), Localizer(known.keyframes, known.graph.poses)
for stamp in np.arange(10.0, drive.duration, 0.1):
    scan = lidar.scan(floor, drive(stamp), rng, stamp).scan
    found = localizer.process(scan, odometry.register(scan, stamp))
    if found.sure:
        break
print(f"found after {stamp - 10.0:.1f} s at {np.round(found.pose, 2)} in the map")

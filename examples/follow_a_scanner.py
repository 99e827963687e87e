"""Odometry: a scanner is carried through a simulated floor; the path it takes, and how sure that is.

python examples/follow_a_scanner.py
"""

import numpy as np

from registration import Odometry
from whereabouts.simulation import Drive, Lidar, random_floor

rng = np.random.default_rng(3)
floor, waypoints = random_floor(rng, rooms=2)
lidar, drive = Lidar(beams=361), Drive(waypoints)

odometry = Odometry()
start = drive(0.0)
for stamp in np.arange(0.0, drive.duration, 0.1):
    scan = lidar.scan(floor, drive(stamp), rng, stamp).scan  # use your own registration.Scan here
    pose = odometry.register(scan, stamp)  # x, y, yaw in the frame of the first scan; add guess= for wheels

turn = np.array([[np.cos(start[2]), np.sin(start[2])], [-np.sin(start[2]), np.cos(start[2])]])
truth = turn @ (drive(stamp)[:2] - start[:2])
sigma = np.sqrt(np.diag(odometry.covariance)[:2])
print(f"the robot is at {np.round(pose[:2], 3)} m, give or take {np.round(sigma, 3)} m")
print(f"the error is {np.hypot(*(pose[:2] - truth)):.3f} m after {drive.duration:.0f} s")

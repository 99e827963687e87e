"""People tracked through a recorded log, without ROS: the scanner is followed, then people are looked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray as Array
from estimation.geometry.poses import between, compound
from registration.laser.scan import Scan
from tracking.mixture.target import Target
from tracking.people.people_config import PeopleConfig
from tracking.people.people_tracker import PeopleTracker
from tracking.people.scan_filters import PointsTracker
from whereabouts.logs import Log, ScanRecord
from whereabouts.recorded.follow import follow


@dataclass(frozen=True, eq=False)
class TrackedScan:
    """People at one scan.

    stamp : seconds, of the scan's header. pose : (3,) of the scanner in the frame of the first robot pose.
    targets : in that frame, people, or all of any class. scan : what was seen.
    """

    stamp: float
    pose: Array
    targets: Sequence[Target]
    scan: Scan

    def in_laser(self, target: Target) -> Array:
        """(x, y, vx, vy) of a target in the scanner's frame; the velocity is over ground, along the scanner's axes."""
        c, s = np.cos(self.pose[2]), np.sin(self.pose[2])
        turn = np.array([[c, s], [-s, c]])
        return np.concatenate((turn @ (target.mean[:2] - self.pose[:2]), turn @ target.mean[2:]))


def track_people(
    log: Log,
    config: PeopleConfig | None = None,
    topic: str | None = None,
    use_wheels: bool = True,
    tracker: PeopleTracker | PointsTracker | None = None,
    every_class: bool = False,
) -> Iterator[TrackedScan]:
    """People in the scans of a log, one result per scan; with `every_class` targets of any class.

    Where the scans hardly ever tell how the robot moved, it is taken to stand still: a guess goes astray, and a person
    who walks ahead of the robot then looks like one who stands.

    topic : of the scans, the first one seen where None. use_wheels : wheel odometry as the first guess.
    tracker : one that has seen something before, instead of a new one with `config`.
    """
    tracker = tracker or PeopleTracker(config)
    pose = np.zeros(3)
    last: Array | None = None
    sure, trust = True, 1.0
    for followed in follow(log, use_wheels=use_wheels, topic=topic):
        record = followed.record
        if not isinstance(record, ScanRecord):
            continue
        # Among many scans that fit nowhere, one that does is a coincidence; among many that fit, a gap is bridged.
        trust += 0.1 * (followed.converged - trust)
        known = (followed.converged and sure) or trust > 0.8 or followed.wheels is not None
        if last is not None and known:
            pose = compound(pose, between(last, followed.pose))
        last, sure = followed.pose, followed.converged
        sensor = pose if record.sensor_pose is None else compound(pose, record.sensor_pose)
        targets = tracker.step(record.scan, sensor, record.stamp, pose_known=known)
        yield TrackedScan(record.stamp, sensor, tracker.targets if every_class else targets, record.scan)

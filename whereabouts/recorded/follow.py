"""Odometry over a recorded log, without ROS: one pose per scan or cloud."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray as Array
from estimation.geometry.poses import between, compound, inverse, pose_to_matrix
from registration.laser.scan import Scan
from registration.odometry.follower import Odometry
from registration.odometry.odometry_config import OdometryConfig
from registration.odometry.wheel_history import NANOSECONDS, WheelHistory
from whereabouts.logs import CloudRecord, OdometryRecord, Record, ScanRecord


@dataclass(frozen=True, eq=False)
class FollowedPose:
    """Where the robot was at one measurement, in the frame of the first.

    pose : (3,) x, y, yaw for scans, (4, 4) for clouds. wheels : (3,) by wheel odometry alone, None without.
    covariance : (3, 3) or (6, 6) of the sensor's pose since the first measurement.
    """

    stamp: float
    pose: Array
    converged: bool
    reason: str
    fitness: float
    wheels: Array | None
    record: ScanRecord | CloudRecord
    covariance: Array

    @property
    def view(self) -> Scan | Array:
        """What was seen: a scan, or points (N, 3)."""
        return self.record.scan if isinstance(self.record, ScanRecord) else self.record.points

    @property
    def mount(self) -> Array | None:
        """(3,) of the scanner on the robot; None for clouds, which are followed as they are."""
        if isinstance(self.record, CloudRecord):
            return None
        return np.zeros(3) if self.record.sensor_pose is None else np.asarray(self.record.sensor_pose)


class Follower:
    """Registers the scans or clouds of one topic of a log, with its wheel odometry as the first guess."""

    def __init__(self, config: OdometryConfig | None = None, use_wheels: bool = True) -> None:
        self._odometry = Odometry(config)
        self._use_wheels = use_wheels
        self._history = WheelHistory()
        self._wheels: Array | None = None
        self._last_stamp: int | None = None

    def add_wheels(self, record: OdometryRecord) -> None:
        self._history.insert(round(record.stamp * NANOSECONDS), np.asarray(record.pose))

    def add_scan(self, record: ScanRecord) -> FollowedPose:
        mount = np.zeros(3) if record.sensor_pose is None else np.asarray(record.sensor_pose)
        motion, wheels = self._motion(record)
        stamp = round(record.stamp * NANOSECONDS)
        swept = None if motion is None else self._history.sweep(stamp, record.scan)
        guess, sweep = (
            None if moved is None else compound(compound(inverse(mount), moved), mount)
            for moved in (motion, swept)
        )
        pose = self._odometry.register(record.scan, record.stamp, guess=guess, sweep=sweep)
        robot = compound(compound(mount, pose), inverse(mount))
        return self._followed(record, robot, wheels)

    def add_cloud(self, record: CloudRecord) -> FollowedPose:
        stamp = round(record.stamp * NANOSECONDS)
        motion = None if self._last_stamp is None else self._history.motion(self._last_stamp, stamp, 0.5)
        self._last_stamp = stamp
        guess = None
        if motion is not None and self._use_wheels:
            guess = pose_to_matrix(np.array([motion[0], motion[1], 0.0, 0.0, 0.0, motion[2]]))
        pose = self._odometry.register(record.points, record.stamp, guess=guess, times=record.times)
        return self._followed(record, pose, None)

    def _motion(self, record: ScanRecord) -> tuple[Array | None, Array | None]:
        """Wheel motion since the last scan, and the wheels' pose; from the record itself or from messages."""
        stamp = round(record.stamp * NANOSECONDS)
        last, self._last_stamp = self._last_stamp, stamp
        before = self._wheels
        if record.odometry is not None:
            self._wheels = np.asarray(record.odometry)
            motion = None if before is None else between(before, self._wheels)
        else:
            motion = None if last is None else self._history.motion(last, stamp, 0.5)
            self._wheels = motion if before is None or motion is None else compound(before, motion)
        return (motion if self._use_wheels else None), self._wheels

    def _followed(self, record: ScanRecord | CloudRecord, pose: Array, wheels: Array | None) -> FollowedPose:
        odometry = self._odometry
        return FollowedPose(
            record.stamp,
            pose,
            odometry.converged,
            odometry.reason,
            odometry.fitness,
            wheels,
            record,
            odometry.covariance.copy(),
        )


def follow(
    log: Iterable[Record],
    config: OdometryConfig | None = None,
    use_wheels: bool = True,
    topic: str | None = None,
) -> Iterator[FollowedPose]:
    """Odometry over a log.

    topic : of the scans or clouds to follow; the first one seen where None. Of several odometry topics the wheels' is
    taken, otherwise the first: a bag may carry the truth as well.
    """
    follower = Follower(config, use_wheels)
    wheels: str | None = None
    for record in log:
        if isinstance(record, OdometryRecord):
            of_wheels = record.topic.rpartition("/")[2] == "wheel_odom"
            wheels = record.topic if wheels is None or of_wheels else wheels
            if record.topic == wheels:
                follower.add_wheels(record)
        elif isinstance(record, ScanRecord | CloudRecord):
            topic = record.topic if topic is None else topic
            if record.topic.lstrip("/") != topic.lstrip("/"):
                continue
            yield follower.add_scan(record) if isinstance(record, ScanRecord) else follower.add_cloud(record)

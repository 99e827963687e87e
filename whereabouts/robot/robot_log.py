"""A recording as a robot's parameter file says: its scanner, its wheels, and how the scanner is mounted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from estimation.checks import FloatArray as Array
from estimation.geometry.frame_tree import FrameTree, TransformError
from estimation.geometry.poses import transform_points
from registration.laser.mounting import level_pose, seen_from_robot, upright
from whereabouts.logs import CloudRecord, OdometryRecord, Record, ScanRecord, TransformRecord
from whereabouts.messages.records import strip_slash
from whereabouts.parameter_file import settings_for


class RobotLog:
    """Records of a log for `follow` and what builds on it: of one scanner or cloud, and of the wheels.

    log : what is iterated. params : a parameter file with the settings of scan_registration.

    topic : of the scans or clouds, without a slash.
    settings : parameters of scan_registration.
    unmounted : scans of which tf did not say how the scanner is mounted; they are handed out as they are.
    tilted : scans of a scanner that is not level; they are projected to the floor, as scan_registration does.
    empty : scans without a reading within the scanner's range.
    Raises ParameterFileError: the file cannot be used.
    """

    def __init__(self, log: Any, params: Path, topic: str | None = None) -> None:
        self.settings = settings_for(params, "scan_registration")
        self._log = log
        named = self.settings.clouds or self.settings.scans
        self.topic = strip_slash(topic or (named[0] if named else ""))
        self._wheels = strip_slash(self.settings.wheel_topic)
        self._base = strip_slash(self.settings.base_frame)
        self._frames = FrameTree()
        self.unmounted = self.tilted = self.empty = self.count = 0
        self._frame = ""

    def __iter__(self) -> Iterator[Record]:
        for record in self._log:
            if isinstance(record, TransformRecord):
                self._frames.fix(record.child_frame_id, record.frame_id, record.transform)
            elif isinstance(record, OdometryRecord):
                if record.topic == self._wheels:
                    yield record
            elif isinstance(record, ScanRecord | CloudRecord) and record.topic == self.topic:
                yield self._mounted(record)

    def _mounted(self, record: ScanRecord | CloudRecord) -> ScanRecord | CloudRecord:
        mounting = self._place(record.frame_id)
        self.count, self._frame = self.count + 1, record.frame_id
        if isinstance(record, ScanRecord) and not record.scan.valid.any():
            self.empty += 1
        if mounting is None:
            # A log without tf may say it itself, as CARMEN's do.
            self.unmounted += isinstance(record, CloudRecord) or record.sensor_pose is None
            return record
        if isinstance(record, CloudRecord):
            return replace(record, points=transform_points(mounting, record.points))
        level = level_pose(mounting)
        if level is None:
            self.tilted += 1
            scan = seen_from_robot((record.scan, mounting))
            return replace(record, scan=scan, sensor_pose=np.zeros(3), frame_id=self._base)
        return replace(record, scan=upright(record.scan, mounting), sensor_pose=level)

    def lines(self) -> list[str]:
        """What is to be said of the scans so far, one sentence each."""
        of = f"of {self.count} messages on {self.topic}"
        said = {
            f"tf does not say how '{self._frame}' is mounted: taken as if it were the robot's frame": self.unmounted,
            f"'{self._frame}' is tilted: its scans are projected to the floor": self.tilted,
            "no reading lies between the scanner's range_min and range_max": self.empty,
        }
        return [f"{text} ({count} {of})" for text, count in said.items() if count]

    def _place(self, frame: str) -> Array | None:
        """Pose (4, 4) of a frame on the robot, as transforms up to now say; None where they do not."""
        if frame == self._base:
            return np.eye(4)
        try:
            return self._frames.lookup(self._base, frame)
        except TransformError:
            return None

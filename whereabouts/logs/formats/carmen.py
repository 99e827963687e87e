"""CARMEN logs: one message per line, plain or compressed.

Read are PARAM (maximum range and mounts of the lasers), ODOM, FLASER, RLASER, ROBOTLASER1 and ROBOTLASER2.

* Stamps are those of the sensor message (the first of the two on a line), as recorded: they may go backwards,
  be rounded or be zero. They are counted, never repaired.
* A log written by a mapper has NEFF lines. In those every pose is the mapper's, and ODOM lines restart at it:
  scans carry `pose` and no `odometry`, ODOM lines are skips.
* The scan topic is `scan` (frame `laser`), the rear laser's `rear_scan` (frame `rear_laser`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from estimation.errors import InputError
from estimation.geometry.poses import uncompound
from whereabouts.logs.formats.carmen_laser import (
    BadLineError,
    LaserLine,
    LaserParameters,
    numbers,
    parse_flaser,
    parse_robotlaser,
    usable_range,
)
from whereabouts.logs.formats.text import TextLog
from whereabouts.messages.records import Array, OdometryRecord, Record, ScanRecord
from whereabouts.system.log_errors import NothingRecognisedError

LaserParser = Callable[[Sequence[bytes], "float | None"], LaserLine]

LASERS: dict[bytes, tuple[str, LaserParser]] = {
    b"FLASER": ("front", parse_flaser),
    b"RLASER": ("rear", parse_flaser),
    b"ROBOTLASER1": ("front", parse_robotlaser),
    b"ROBOTLASER2": ("rear", parse_robotlaser),
}
TOPICS = {"front": ("scan", "laser"), "rear": ("rear_scan", "rear_laser")}
ODOMETRY_TOPIC = "wheel_odom"
FACING_TOLERANCE = 0.1
MOUNT_SETTINGS = ("offset", "side_offset", "angular_offset")  # x, y and yaw

# Messages of the format that carry nothing this reader hands out.
OTHER_MESSAGES = frozenset(
    b"SYNC NEFF TRUEPOS RAWLASER1 RAWLASER2 RAWLASER3 RAWLASER4 RAWLASER5 NMEA-GGA NMEA-RMC NMEAGGA NMEARMC "
    b"IMU SONAR BUMPER GPS MARKER POSITION POINTCLOUD ARM".split()
)
KEYWORDS = frozenset(LASERS) | {b"PARAM", b"ODOM"}
# A mapper's log is told by its first lines; they must reach past its first scan.
HEAD_BYTES = 1 << 18


class CarmenLog(TextLog):
    """A CARMEN log as a stream of ScanRecord and OdometryRecord, on the topics `scan`, `rear_scan`, `wheel_odom`."""

    format = "carmen"
    _lasers: dict[str, LaserParameters]
    _corrected = False

    @property
    def corrected(self) -> bool:
        """Whether a mapper wrote this log, so that its poses are no odometry."""
        # NEFF is a mapper's effective number of particles.
        head = self._source.head(HEAD_BYTES)
        return head.startswith(b"NEFF ") or b"\nNEFF " in head

    def _records(self) -> Iterator[Record]:
        self._lasers = {side: LaserParameters() for side in TOPICS}
        self._corrected = self.corrected
        recognised = number = 0
        for number, fields in self._source.fields(self.summary):
            try:
                record = self._parse(fields)
            except BadLineError as error:
                self.summary.skip(str(error), f"line {number}")
                continue
            except InputError as error:
                self.summary.skip(f"scan refused: {error}", f"line {number}")
                continue
            recognised += 1
            if record is not None and self.wants(record.topic):
                self.place = f"line {number}"
                yield record
        if not recognised:
            raise NothingRecognisedError(
                self.path, f"not one of {number} lines is a laser, ODOM or PARAM line; is it another format?"
            )

    def _parse(self, fields: list[bytes]) -> Record | None:
        keyword = fields[0]
        laser = LASERS.get(keyword)
        if laser is not None:
            side, parser = laser
            limit = self._lasers[side].max_range if self._max_range is None else self._max_range
            return self._scan(side, parser(fields, limit))
        if keyword == b"ODOM":
            return self._odometry(fields)
        if keyword == b"PARAM":
            self._parameter(fields)
            return None
        if keyword in OTHER_MESSAGES:
            raise BadLineError(f"{keyword.decode()} messages, not used")
        raise BadLineError("not a CARMEN message")

    def _scan(self, side: str, line: LaserLine) -> ScanRecord:
        topic, frame = TOPICS[side]
        laser = line.laser
        if side == "rear" and abs(math.remainder(laser[2] - line.robot[2], 2.0 * math.pi)) < FACING_TOLERANCE:
            laser = laser + np.array((0.0, 0.0, math.pi))  # some loggers left the half turn out
        mount, corrected = self._lasers[side].split(laser, line.robot)
        odometry: Array | None = line.robot
        pose: Array | None = None
        if self._corrected:
            odometry, pose = None, odometry
        elif corrected is not None:
            pose = uncompound(corrected, mount)
        return ScanRecord(line.scan, line.stamp, topic, frame, odometry, pose, mount)

    def _odometry(self, fields: list[bytes]) -> OdometryRecord:
        if len(fields) < 9:
            raise BadLineError("ODOM: fields missing")
        if self._corrected:
            raise BadLineError("ODOM in a mapper's log: restarts at its poses, is no odometry")
        x, y, yaw, speed, turn, _, stamp = numbers(fields[1:8], "a field of ODOM")
        return OdometryRecord(
            np.array((x, y, yaw)), stamp, ODOMETRY_TOPIC, twist=np.array((speed, 0.0, turn))
        )

    def _parameter(self, fields: list[bytes]) -> None:
        """Later values of a parameter replace earlier ones, as in the logger."""
        if len(fields) < 3:
            raise BadLineError("PARAM: value missing")
        name = fields[1].decode(errors="replace").replace("front_laser", "frontlaser")
        name = name.replace("rear_laser", "rearlaser").removeprefix("robot_").removeprefix("laser_")
        side, _, setting = name.partition("laser_")
        if side not in TOPICS or setting not in ("max", *MOUNT_SETTINGS):
            return
        value = numbers(fields[2:3], f"PARAM {fields[1].decode(errors='replace')}")[0]
        laser = self._lasers[side]
        if setting == "max":
            self._lasers[side] = LaserParameters(usable_range(value), laser.mount)
            return
        facing = np.array((0.0, 0.0, math.pi if side == "rear" else 0.0))
        mount = (facing if laser.mount is None else laser.mount).copy()
        axis = MOUNT_SETTINGS.index(setting)
        mount[axis] = value + facing[axis]
        self._lasers[side] = LaserParameters(laser.max_range, mount)

"""Laser lines of CARMEN logs: what FLASER leaves unsaid, and the fields of ROBOTLASER."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.geometry.poses import between
from registration.laser.scan import Scan
from whereabouts.messages.records import Array

# Where the log does not say what the scanner reports when nothing answers. The SICK scanners of these logs
# report 81.83 m and more in one mode and 51.05 m and more in another, and see walls at 30 m at most.
DEFAULT_MAX_RANGE = 50.0

# A SICK counts centimetres in 13 bits and keeps the last nine numbers for "nothing seen"; logs that state one
# of these as their maximum would make returns of the others.
SICK_NO_RETURN, SICK_LARGEST = 81.83, 82.0

# A laser is mounted within this distance of the robot's centre; farther apart, two poses are two estimates.
LARGEST_MOUNT = 1.5
# Poses are logged in millimetres or with six digits of a large number; a mount varies by that, a corrected
# pose drifts away from odometry by more within a few metres.
MOUNT_TOLERANCE = (0.1, 0.02)


class BadLineError(ValueError):
    """A line that cannot be used; the message is the reason that is counted."""


@dataclass
class LaserParameters:
    """What PARAM lines say about a laser.

    max_range : metres, None where nothing was said.
    mount : (3,) [x, y, yaw] of the laser on the robot, None where nothing was said.
    """

    max_range: float | None = None
    mount: Array | None = None
    first_relative: Array | None = field(default=None, repr=False)

    def split(self, laser: Array, robot: Array) -> tuple[Array, Array | None]:
        """(mount, corrected robot pose or None) from the two poses of a line.

        Loggers write the laser's pose and the robot's pose, both by odometry: their difference is the mount.
        Some mappers put their corrected pose into the first field; then the difference wanders, and only the
        mount that was stated or seen first is one.
        """
        found = between(robot, laser)
        if self.first_relative is None:
            near = math.hypot(found[0], found[1]) <= LARGEST_MOUNT
            self.first_relative = found if near else np.zeros(3)
        expected = self.first_relative if self.mount is None else self.mount
        distance = math.hypot(found[0] - expected[0], found[1] - expected[1])
        turned = abs(math.remainder(found[2] - expected[2], 2.0 * math.pi))
        if distance <= MOUNT_TOLERANCE[0] and turned <= MOUNT_TOLERANCE[1]:
            return found, None
        return expected, laser


def usable_range(stated: float) -> float | None:
    """Metres from which a reading is a no-return, by a maximum stated in the log; None where it states none."""
    if SICK_NO_RETURN < stated <= SICK_LARGEST:
        return SICK_NO_RETURN
    return stated if stated > 0.0 else None


def beam_angles(count: int) -> tuple[float, float]:
    """(angle_min, angle_increment) of a line that carries no angles, by its number of beams.

    The SICK scanners swept 180° in steps of 1° or 0.5°: 181 or 361 readings. Loggers that write 180 or 360
    dropped the last beam and kept the step, so the first beam is at -90° in all of them (CARMEN reads them
    so, and the Killian Court log states these very numbers for 180 beams). 400 and 401 readings are the mode
    of 100° in steps of 0.25°. For any other number the scan is taken to span 180°.
    """
    if count in (400, 401):
        return math.radians(-50.0), math.radians(0.25)
    for whole in (181, 361, 721):
        if count in (whole - 1, whole):
            return -math.pi / 2.0, math.pi / (whole - 1)
    return -math.pi / 2.0, math.pi / max(count - 1, 1)


def numbers(fields: Sequence[bytes], what: str) -> list[float]:
    """Fields as finite numbers.

    Raises BadLineError: one of them is not a number, or not finite.
    """
    try:
        values = list(map(float, fields))
    except ValueError:
        raise BadLineError(f"{what} is not a number") from None
    if not all(map(math.isfinite, values)):
        raise BadLineError(f"{what} is not finite")
    return values


def count_of(text: bytes, what: str = "number of readings") -> int:
    """A count: a whole number of at most 100,000.

    Raises BadLineError: it is none.
    """
    if not text.isdigit() or len(text) > 6 or int(text) > 100_000:
        raise BadLineError(f"{what} is not a count")
    return int(text)


def readings(fields: Sequence[bytes]) -> list[float]:
    """Ranges; NaN and infinities stay, they are no-returns.

    Raises BadLineError: one of them is not a number.
    """
    try:
        return list(map(float, fields))
    except ValueError:
        raise BadLineError("a range is not a number") from None


@dataclass(frozen=True)
class LaserLine:
    """One laser line: scan, poses of laser and robot by the log's odometry, and its stamp."""

    scan: Scan
    laser: Array
    robot: Array
    stamp: float


def parse_flaser(fields: Sequence[bytes], max_range: float | None) -> LaserLine:
    """`FLASER n r1..rn x y yaw odom_x odom_y odom_yaw stamp host logger_stamp` (RLASER alike).

    Raises BadLineError: fields missing, too many, or not numbers.
    """
    count = count_of(fields[1]) if len(fields) > 1 else 0
    if count < 1 or len(fields) != count + 11:
        raise BadLineError(f"{fields[0].decode()}: number of readings and number of fields disagree")
    ranges = readings(fields[2 : count + 2])
    poses = numbers(fields[count + 2 : count + 8], "a pose")
    stamp = numbers(fields[count + 8 : count + 9], "a stamp")[0]
    limit = DEFAULT_MAX_RANGE if max_range is None else max_range
    angle_min, increment = beam_angles(count)
    scan = Scan(np.array(ranges), angle_min, increment, range_max=limit, stamp=stamp)
    return LaserLine(scan, np.array(poses[:3]), np.array(poses[3:6]), stamp)


def parse_robotlaser(
    fields: Sequence[bytes], max_range: float | None, stamp: float | None = None
) -> LaserLine:
    """A line that describes itself; `stamp` replaces the recorded one.

    `ROBOTLASER1 type start fov step max accuracy remission_mode n r1..rn m i1..im laser_pose(3) robot_pose(3)
    tv rv forward_safety side_safety turn_axis stamp host logger_stamp`
    Raises BadLineError: fields missing, too many, or not numbers.
    """
    name = fields[0].decode()
    if len(fields) < 10:
        raise BadLineError(f"{name}: line too short")
    head = numbers(fields[1:8], "a laser setting")
    count = count_of(fields[8])
    if count < 1 or len(fields) <= 9 + count:
        raise BadLineError(f"{name}: number of readings and number of fields disagree")
    remissions = count_of(fields[9 + count], "number of remissions")
    rest = fields[10 + count + remissions :]
    if len(rest) != 14:
        raise BadLineError(f"{name}: number of readings and number of fields disagree")
    ranges = readings(fields[9 : 9 + count])
    poses = numbers(rest[:6], "a pose")
    recorded = numbers(rest[11:12], "a stamp")[0]
    stamp = recorded if stamp is None else stamp
    increment = head[3] if head[3] > 0.0 else beam_angles(count)[1]
    stated = usable_range(head[4]) if max_range is None else max_range
    limit = DEFAULT_MAX_RANGE if stated is None else stated
    scan = Scan(np.array(ranges), head[1], increment, range_max=limit, stamp=stamp)
    return LaserLine(scan, np.array(poses[:3]), np.array(poses[3:6]), stamp)

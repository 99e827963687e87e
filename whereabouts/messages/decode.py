"""ROS messages as records, by type."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from registration.laser.scan import FARTHEST, Scan
from whereabouts.messages.message_rotations import rotation_of, to_plane
from whereabouts.messages.records import (
    CloudRecord,
    MessageRecord,
    OdometryRecord,
    Record,
    ScanRecord,
    TransformRecord,
    strip_slash,
)
from whereabouts.messages.type_names import CLOUD, ODOMETRY, SCAN, TF
from whereabouts.system.clocks import NANOSECONDS

# sensor_msgs/PointField: number of a type to numpy's letter for it.
POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
COLOR_FIELDS = ("rgb", "rgba")
TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
SLOWEST = 10.0  # s between beams; more is not meant
PLANE = np.ix_((0, 1, 5), (0, 1, 5))


class UnusableMessageError(InputError):
    """A well-formed message with content that cannot be used; the message is the reason that is counted."""


def nanoseconds(stamp: Any) -> int:
    """builtin_interfaces/Time in nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def seconds(stamp: Any) -> float:
    """builtin_interfaces/Time as seconds, rounded once: a stamp that was a float is that float again."""
    return nanoseconds(stamp) / NANOSECONDS


def scans(message: Any, topic: str) -> Iterator[ScanRecord]:
    """sensor_msgs/LaserScan."""
    with np.errstate(invalid="ignore"):  # a signalling NaN is a no-return like any other
        ranges = np.asarray(message.ranges, dtype=np.float64)
    yield _scan(message, ranges, topic)


def first_echoes(message: Any, topic: str) -> Iterator[ScanRecord]:
    """sensor_msgs/MultiEchoLaserScan: the first echo of each beam, NaN where there is none."""
    ranges = [echo.echoes[0] if len(echo.echoes) else np.nan for echo in message.ranges]
    yield _scan(message, np.array(ranges, dtype=np.float64), topic)


def _scan(message: Any, ranges: Array, topic: str) -> ScanRecord:
    if not len(ranges):
        raise UnusableMessageError("scan without readings")
    stamp = seconds(message.header.stamp)
    step = float(message.time_increment)
    try:
        scan = Scan(
            ranges,
            float(message.angle_min),
            float(message.angle_increment),
            float(message.range_min),
            float(message.range_max),
            stamp,
            step if abs(step) <= SLOWEST else 0.0,
        )
    except InputError as error:
        raise UnusableMessageError(f"scan refused: {error}") from error
    return ScanRecord(scan, stamp, topic, strip_slash(message.header.frame_id))


def odometry(message: Any, topic: str) -> Iterator[OdometryRecord]:
    """nav_msgs/Odometry; a covariance or twist that is all zero was not filled in."""
    pose = pose_matrix(message.pose.pose.position, message.pose.pose.orientation)
    twist = message.twist.twist
    velocity = np.array((twist.linear.x, twist.linear.y, twist.angular.z))
    covariance = np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)[PLANE]
    if not np.isfinite(pose).all() or not np.isfinite(velocity).all():
        raise UnusableMessageError("odometry that is not finite")
    known = bool(np.isfinite(covariance).all() and covariance.any())
    yield OdometryRecord(
        to_plane(pose),
        seconds(message.header.stamp),
        topic,
        strip_slash(message.header.frame_id),
        strip_slash(message.child_frame_id),
        velocity,
        covariance if known else None,
        pose,
    )


def transforms(message: Any, topic: str) -> Iterator[TransformRecord]:
    """tf2_msgs/TFMessage, one record for each transform."""
    for stamped in message.transforms:
        matrix = pose_matrix(stamped.transform.translation, stamped.transform.rotation)
        if not np.isfinite(matrix).all():
            raise UnusableMessageError("transform that is not finite")
        child = strip_slash(stamped.child_frame_id)
        stamp = seconds(stamped.header.stamp)
        yield TransformRecord(matrix, stamp, strip_slash(stamped.header.frame_id), child, topic)


def pose_matrix(position: Any, orientation: Any) -> Array:
    """(4, 4) of a position and a quaternion. Raises UnusableMessageError for a quaternion that was never set."""
    matrix = np.eye(4)
    try:
        matrix[:3, :3] = rotation_of((orientation.x, orientation.y, orientation.z, orientation.w))
    except InputError as error:
        raise UnusableMessageError(str(error)) from error
    matrix[:3, 3] = position.x, position.y, position.z
    return matrix


def clouds(message: Any, topic: str) -> Iterator[CloudRecord]:
    """sensor_msgs/PointCloud2 of any layout that has x, y and z; organised clouds are flattened.

    Points that are not finite, or farther away than anything is, are left out, and so are those at the sensor itself:
    drivers send zeros for beams that met nothing, and moved to the robot's frame they would be a thing that it carries.
    """
    values = _rows(message)
    points = _positions(values)
    named = [name for name in TIME_FIELDS if name in (values.dtype.names or ())]
    times = values[named[0]].astype(np.float64) if named else None
    finite = _credible(points)
    if finite is not None:
        points = points[finite]
        times = None if times is None else times[finite]
    if times is not None and not np.isfinite(times).all():
        times = None  # a field that was never filled in
    stamp = seconds(message.header.stamp)
    yield CloudRecord(points, stamp, topic, strip_slash(message.header.frame_id), times)


def cloud_colors(message: Any) -> NDArray[Any] | None:
    """Red, green and blue (N, 3) in [0, 1] of the points that `clouds` gives; None where the cloud says none."""
    values = _rows(message, COLOR_FIELDS)
    named = [name for name in COLOR_FIELDS if name in (values.dtype.names or ())]
    if not named or values.dtype[named[0]].itemsize != 4:
        return None
    finite = _credible(_positions(values))
    raw = np.ascontiguousarray(values[named[0]] if finite is None else values[named[0]][finite])
    packed = raw.view(raw.dtype.str[0] + "u4").astype(np.uint32)
    return np.stack([(packed >> shift) & 255 for shift in (16, 8, 0)], axis=1) / 255.0


def _positions(values: NDArray[Any]) -> NDArray[np.float64]:
    points = np.empty((len(values), 3))
    for column, axis in enumerate("xyz"):
        points[:, column] = values[axis]
    return points


def _credible(points: NDArray[np.float64]) -> NDArray[np.bool_] | None:
    """Which points are finite, no farther away than anything is and not at the origin; None where all are."""
    zeros = np.flatnonzero(points[:, 0] == 0.0)
    zeros = zeros[~points[zeros, 1:].any(axis=1)]
    # Mostly all are, and two passes without a mask say so; NaN is neither above nor below anything.
    if not len(zeros) and (not len(points) or (points.min() >= -FARTHEST and points.max() <= FARTHEST)):
        return None
    credible = np.ones(len(points), dtype=bool)
    with np.errstate(invalid="ignore"):
        for along in points.T:
            credible &= np.abs(along) <= FARTHEST
    credible[zeros] = False
    return credible


def _rows(message: Any, more: tuple[str, ...] = ()) -> NDArray[Any]:
    """(height · width,) structured array over the fields that are read, in the machine's own layout."""
    order = ">" if message.is_bigendian else "<"
    layout = {
        field.name: (order + POINT_TYPES[field.datatype], int(field.offset))
        for field in message.fields
        if field.name in ("x", "y", "z", *TIME_FIELDS, *more) and field.datatype in POINT_TYPES
    }
    missing = [axis for axis in "xyz" if axis not in layout]
    if missing:
        raise UnusableMessageError(f"cloud without field {', '.join(missing)}")
    step, width, height = int(message.point_step), int(message.width), int(message.height)
    if any(offset + np.dtype(kind).itemsize > step for kind, offset in layout.values()):
        raise UnusableMessageError("cloud with a field outside its points")
    row = max(int(message.row_step), width * step)
    data = np.asarray(message.data, dtype=np.uint8)
    if height and len(data) < (height - 1) * row + width * step:
        raise UnusableMessageError("cloud with less data than its size says")
    kinds = {
        "names": list(layout),
        "formats": [kind for kind, _ in layout.values()],
        "offsets": [offset for _, offset in layout.values()],
        "itemsize": step,
    }
    lines = (
        [data[line * row : line * row + width * step] for line in range(height)] if row > width * step else []
    )
    packed = np.concatenate(lines) if lines else data[: height * width * step]
    return packed.view(np.dtype(kinds))  # type: ignore[call-overload]


def other(message: Any, topic: str, type_name: str, log_time: int) -> MessageRecord:
    """Any message, for those who asked for its topic."""
    header = getattr(message, "header", None)
    stamp = seconds(header.stamp) if header is not None else log_time / 1e9
    return MessageRecord(message, type_name, stamp, topic)


RECORDS: dict[str, Callable[[Any, str], Iterator[Record]]] = {
    SCAN: scans,
    "sensor_msgs/msg/MultiEchoLaserScan": first_echoes,
    CLOUD: clouds,
    ODOMETRY: odometry,
    TF: transforms,
}

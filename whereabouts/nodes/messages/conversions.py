"""Messages to library types and back; nothing here decides anything."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from std_msgs.msg import Header

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from estimation.geometry.poses import pose_from_quaternion, pose_to_quaternion
from registration import Scan
from registration.crf.online import Segmented
from whereabouts.messages import decode
from whereabouts.nodes.messages.envelopes import VARIANCE
from whereabouts.nodes.messages.markers import point
from whereabouts.nodes.messages.stamps import duration_message
from whereabouts_msgs.msg import ScanSegments, Segment

# Where x, y and yaw stand among x, y, z, roll, pitch, yaw.
PLANAR = np.array([0, 1, 5])
FREE = 1e6


def scan_from_message(message: LaserScan) -> Scan:
    """A LaserScan as `Scan`.

    Raises InputError: no ranges, or bounds and angles that make no sense.
    """
    return next(decode.scans(message, "")).scan


def points_from_message(message: PointCloud2) -> tuple[Array, Array | None]:
    """A PointCloud2 as finite points (N, 3) metres and, where it has a time field, times (N,).

    Raises InputError: no x, y, z fields, no points, or less data than its size claims.
    """
    record = next(decode.clouds(message, ""))
    if message.width * message.height == 0:
        raise InputError("cloud without points")
    return record.points, record.times


def cloud_message(header: Header, points: Array) -> PointCloud2:
    """Points (N, 2 | 3) metres as a PointCloud2 of float32 x, y, z."""
    cloud = np.zeros((len(points), 3), dtype=np.float32)
    cloud[:, : points.shape[1]] = points
    fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(("x", "y", "z"))
    ]
    message = PointCloud2(header=header, height=1, width=len(cloud), fields=fields, is_dense=True)
    message.point_step, message.row_step = 12, 12 * len(cloud)
    message.data = array_of("B", cloud)
    return message


def segments_message(header: Header, segmented: Segmented, mirrored: bool = False) -> ScanSegments:
    """Labels of a scan as ScanSegments; mirrored : the scanner is upside down, and its frame with it."""
    message = ScanSegments(header=header)
    message.labels = array_of("i", segmented.labels.astype(np.int32))
    message.probabilities = array_of("f", np.nan_to_num(segmented.probabilities).astype(np.float32))
    sign = np.array([1.0, -1.0, -1.0]) if mirrored else np.ones(3)
    for segment in segmented.segments:
        told = Segment(label=segment.label, probability=segment.probability)
        told.motion = sign * segment.motion
        told.covariance = (sign[:, None] * segment.covariance * sign).reshape(9)
        told.interval = duration_message(segment.interval)
        message.segments.append(told)
    return message


def array_of(code: str, values: NDArray[Any]) -> Any:
    """An array.array from numpy's memory: many times faster to assign to a message than an ndarray."""
    return array(code, values.tobytes())


def pose_from_message(pose: Any) -> Array:
    """A geometry_msgs Pose as (6,) x, y, z, roll, pitch, yaw.

    Raises InputError: numbers that are not finite, or a quaternion of length zero.
    """
    p, q = pose.position, pose.orientation
    return pose_from_quaternion([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])


def fill_pose(pose: Any, value: Array) -> None:
    """Write (6,) x, y, z, roll, pitch, yaw into a geometry_msgs Pose."""
    position, quaternion = pose_to_quaternion(value)
    pose.position = point(position)
    pose.orientation = Quaternion(**dict(zip("xyzw", map(float, quaternion), strict=True)))


def spatial(planar: Array) -> Array:
    """(..., 3) x, y, yaw as (..., 6)."""
    pose = np.zeros((*planar.shape[:-1], 6))
    pose[..., PLANAR] = planar
    return pose


def stated_covariance(values: ArrayLike, axes: ArrayLike = range(6)) -> Array | None:
    """Covariance of some of x, y, z and the rotations about them, of a message's 36 numbers.

    None where zeros, -1, NaN or whatever else is no covariance stand for one that nobody knows.
    """
    chosen = np.asarray(axes)
    stated = np.array(values, dtype=np.float64).reshape(6, 6)[np.ix_(chosen, chosen)]
    if not 0.0 < np.abs(stated).max() <= VARIANCE:
        return None
    try:
        return repair_covariance(stated, definite=False)
    except InputError:
        return None


def spatial_covariance(planar: Array) -> Array:
    """(3, 3) over x, y, yaw as row-major (36,); what a planar sensor cannot know gets a large variance."""
    covariance = np.diag(np.full(6, FREE))
    covariance[np.ix_(PLANAR, PLANAR)] = planar
    return covariance.reshape(36)

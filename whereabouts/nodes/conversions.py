"""Messages to library types and back; nothing here decides anything."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Quaternion
from nav_msgs.msg import Odometry as OdometryMessage
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from std_msgs.msg import Header

from estimation.errors import InputError
from estimation.poses import pose_from_quaternion, pose_to_quaternion
from registration import Scan
from whereabouts.nodes.stamps import seconds

Array = NDArray[np.float64]
# Where x, y and yaw stand among x, y, z, roll, pitch, yaw.
PLANAR = np.array([0, 1, 5])
FREE = 1e6
DATATYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}


def scan_from_message(message: LaserScan) -> Scan:
    """A LaserScan as `Scan`.

    Raises
    ------
    InputError : no ranges, or bounds and angles that make no sense.
    """
    if len(message.ranges) == 0:
        raise InputError("ranges: the scan is empty")
    return Scan(
        np.asarray(message.ranges, dtype=np.float64),
        message.angle_min,
        message.angle_increment,
        message.range_min,
        message.range_max,
        seconds(message.header.stamp),
        message.time_increment,
    )


def points_from_message(message: PointCloud2) -> tuple[Array, Array | None]:
    """A PointCloud2 as finite points (N, 3) metres and, where it has a time field, times (N,).

    Raises
    ------
    InputError : no x, y, z fields, or less data than its size claims.
    """
    fields = {field.name: field for field in message.fields}
    missing = [name for name in ("x", "y", "z") if name not in fields]
    if missing:
        raise InputError(f"fields: the cloud has no {', '.join(missing)}")
    rows, columns = int(message.height), int(message.width)
    if rows * columns == 0:
        raise InputError("data: the cloud is empty")
    row_step = int(message.row_step) or columns * int(message.point_step)
    if len(message.data) < rows * row_step or row_step < columns * message.point_step:
        wanted = f"{rows} rows of {columns} points of {message.point_step} bytes"
        raise InputError(f"data: {wanted} do not fit into {len(message.data)} bytes")
    names = ["x", "y", "z", *[name for name in ("t", "time", "timestamp") if name in fields][:1]]
    layout = np.dtype(
        {
            "names": names,
            "formats": [_format(fields[name], bool(message.is_bigendian)) for name in names],
            "offsets": [int(fields[name].offset) for name in names],
            "itemsize": int(message.point_step),
        }
    )
    raw = np.frombuffer(message.data, dtype=np.uint8)[: rows * row_step].reshape(rows, row_step)
    table = np.ascontiguousarray(raw[:, : columns * message.point_step]).view(layout).reshape(-1)
    points = np.column_stack([table[name] for name in ("x", "y", "z")]).astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    times = table[names[3]].astype(np.float64)[finite] if len(names) > 3 else None
    return points[finite], times


def _format(field: PointField, big_endian: bool) -> str:
    if field.datatype not in DATATYPES:
        raise InputError(f"fields: {field.name} has the unknown datatype {field.datatype}")
    return (">" if big_endian else "<") + DATATYPES[field.datatype]


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


def array_of(code: str, values: NDArray[Any]) -> Any:
    """An array.array from numpy's memory: many times faster to assign to a message than an ndarray."""
    from array import array

    return array(code, values.tobytes())


def pose_from_message(pose: Any) -> Array:
    """A geometry_msgs Pose as (6,) x, y, z, roll, pitch, yaw.

    Raises
    ------
    InputError : numbers that are not finite, or a quaternion of length zero.
    """
    p, q = pose.position, pose.orientation
    return pose_from_quaternion([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])


def wheel_pose(message: OdometryMessage) -> Array:
    """Planar pose (3,) x, y, yaw of an Odometry message."""
    return pose_from_message(message.pose.pose)[PLANAR]


def fill_pose(pose: Any, value: Array) -> None:
    """Write (6,) x, y, z, roll, pitch, yaw into a geometry_msgs Pose."""
    position, quaternion = pose_to_quaternion(value)
    pose.position = Point(**dict(zip("xyz", map(float, position), strict=True)))
    pose.orientation = Quaternion(**dict(zip("xyzw", map(float, quaternion), strict=True)))


def spatial(planar: Array) -> Array:
    """(3,) x, y, yaw as (6,)."""
    pose = np.zeros(6)
    pose[PLANAR] = planar
    return pose


def spatial_covariance(planar: Array) -> Array:
    """(3, 3) over x, y, yaw as row-major (36,); what a planar sensor cannot know gets a large variance."""
    covariance = np.diag(np.full(6, FREE))
    covariance[np.ix_(PLANAR, PLANAR)] = planar
    return covariance.reshape(36)

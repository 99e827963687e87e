"""Records as ROS 2 messages, without a ROS installation."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import ROUND_HALF_EVEN, Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.errors import InputError
from estimation.geometry.rotations import quaternion_from_rotation
from whereabouts.logs.bags.ros_types import standard_types
from whereabouts.messages.message_rotations import quaternion_of_yaw
from whereabouts.messages.records import Array, CloudRecord, OdometryRecord, ScanRecord, TransformRecord

SCAN_TYPE = "sensor_msgs/msg/LaserScan"
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
TF_TYPE = "tf2_msgs/msg/TFMessage"

# builtin_interfaces/Time counts seconds in an int32, and ROS clients refuse negative ones.
LATEST_STAMP = 2**31
FLOAT32, FLOAT64 = 7, 8


def nanoseconds(stamp: float) -> int:
    """Whole nanoseconds of a stamp in seconds, by its shortest decimal form: 976052857.337284 is a number of
    microseconds, which its binary value misses by 16 ns.

    Raises
    ------
    InputError : not in [0, 2³¹) seconds, which is what a ROS stamp can hold.
    """
    if not 0.0 <= stamp < LATEST_STAMP:
        raise InputError(f"stamp: a ROS time holds 0 to {LATEST_STAMP} s, got {stamp}")
    return int(Decimal(repr(float(stamp))).scaleb(9).to_integral_value(ROUND_HALF_EVEN))


def scan_message(record: ScanRecord) -> Any:
    """sensor_msgs/LaserScan; no-returns stay as recorded."""
    scan = record.scan
    count = len(scan)
    return _make(
        SCAN_TYPE,
        header=_header(record.stamp, record.frame_id),
        angle_min=scan.angle_min,
        angle_max=scan.angle_min + scan.angle_increment * max(count - 1, 0),
        angle_increment=scan.angle_increment,
        time_increment=scan.time_increment,
        scan_time=0.0,
        range_min=scan.range_min,
        range_max=scan.range_max,
        ranges=scan.ranges.astype(np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


def odometry_message(record: OdometryRecord) -> Any:
    """nav_msgs/Odometry; zeros where covariance or twist are unknown."""
    pose = _planar_pose(record.pose) if record.transform is None else _pose(record.transform)
    covariance = np.zeros((6, 6))
    if record.covariance is not None:
        covariance[np.ix_((0, 1, 5), (0, 1, 5))] = record.covariance
    vx, vy, turn = (0.0, 0.0, 0.0) if record.twist is None else (float(value) for value in record.twist)
    twist = _make("geometry_msgs/msg/Twist", linear=_vector(vx, vy, 0.0), angular=_vector(0.0, 0.0, turn))
    return _make(
        ODOMETRY_TYPE,
        header=_header(record.stamp, record.frame_id),
        child_frame_id=record.child_frame_id,
        pose=_make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.reshape(36)),
        twist=_make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def cloud_message(record: CloudRecord) -> Any:
    """sensor_msgs/PointCloud2: x, y, z as float32, then `timestamp` as float64 where times are known."""
    count = len(record.points)
    layout = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    if record.times is not None:
        layout.append(("timestamp", "<f8"))
    values = np.zeros(count, dtype=np.dtype(layout))
    for index, axis in enumerate("xyz"):
        values[axis] = record.points[:, index]
    if record.times is not None:
        values["timestamp"] = record.times
    return _make(
        CLOUD_TYPE,
        header=_header(record.stamp, record.frame_id),
        height=1,
        width=count,
        fields=_point_fields(values.dtype),
        is_bigendian=False,
        point_step=values.itemsize,
        row_step=values.itemsize * count,
        data=np.frombuffer(values.tobytes(), dtype=np.uint8),
        is_dense=True,
    )


def _point_fields(layout: np.dtype[Any]) -> list[Any]:
    fields = []
    assert layout.fields is not None
    for name in layout.names or ():
        kind, offset = layout.fields[name][:2]
        datatype = FLOAT32 if kind.itemsize == 4 else FLOAT64
        fields.append(
            _make("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1)
        )
    return fields


def transform_message(records: Sequence[TransformRecord]) -> Any:
    """tf2_msgs/TFMessage."""
    stamped = [
        _make(
            "geometry_msgs/msg/TransformStamped",
            header=_header(record.stamp, record.frame_id),
            child_frame_id=record.child_frame_id,
            transform=_make(
                "geometry_msgs/msg/Transform",
                translation=_vector(*_floats(record.transform[:3, 3])),
                rotation=_quaternion(record.transform),
            ),
        )
        for record in records
    ]
    return _make(TF_TYPE, transforms=stamped)


def _make(type_name: str, **fields: Any) -> Any:
    return standard_types().types[type_name](**fields)


def _header(stamp: float, frame_id: str) -> Any:
    whole, rest = divmod(nanoseconds(stamp), 1_000_000_000)
    time = _make("builtin_interfaces/msg/Time", sec=whole, nanosec=rest)
    return _make("std_msgs/msg/Header", stamp=time, frame_id=frame_id)


def _vector(x: float, y: float, z: float) -> Any:
    return _make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(matrix: Array) -> Any:
    x, y, z, w = quaternion_from_rotation(matrix[:3, :3]).tolist()
    return _make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _planar_pose(pose: Array) -> Any:
    x, y, z, w = quaternion_of_yaw(float(pose[2]))
    return _make(
        "geometry_msgs/msg/Pose",
        position=_make("geometry_msgs/msg/Point", x=float(pose[0]), y=float(pose[1]), z=0.0),
        orientation=_make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )


def _pose(matrix: Array) -> Any:
    x, y, z = _floats(matrix[:3, 3])
    return _make(
        "geometry_msgs/msg/Pose",
        position=_make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=_quaternion(matrix),
    )


def _floats(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])

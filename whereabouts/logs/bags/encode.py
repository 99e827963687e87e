"""Records as ROS 2 messages, without a ROS installation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from decimal import ROUND_HALF_EVEN, Decimal
from typing import Any

import numpy as np

from estimation.errors import InputError
from estimation.geometry.rotations import quaternion_from_rotation
from whereabouts.logs.bags.ros_types import standard_types
from whereabouts.messages.message_rotations import quaternion_of_yaw
from whereabouts.messages.records import CloudRecord, OdometryRecord, ScanRecord, TransformRecord

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
    Raises InputError: not in [0, 2³¹) seconds, which is what a ROS stamp can hold.
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
    if record.transform is None:
        x, y, yaw = record.pose
        position, turn = _xyz("Point", (x, y, 0.0)), _quaternion(quaternion_of_yaw(float(yaw)))
    else:
        position = _xyz("Point", record.transform[:3, 3])
        turn = _quaternion(quaternion_from_rotation(record.transform[:3, :3]))
    pose = _make("geometry_msgs/msg/Pose", position=position, orientation=turn)
    covariance = np.zeros((6, 6))
    if record.covariance is not None:
        covariance[np.ix_((0, 1, 5), (0, 1, 5))] = record.covariance
    vx, vy, rate = (0.0, 0.0, 0.0) if record.twist is None else record.twist
    linear, angular = _xyz("Vector3", (vx, vy, 0.0)), _xyz("Vector3", (0.0, 0.0, rate))
    twist = _make("geometry_msgs/msg/Twist", linear=linear, angular=angular)
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
    layout = [("x", "<f4", FLOAT32), ("y", "<f4", FLOAT32), ("z", "<f4", FLOAT32)]
    if record.times is not None:
        layout.append(("timestamp", "<f8", FLOAT64))
    values = np.zeros(count, dtype=np.dtype([(name, kind) for name, kind, _ in layout]))
    for index, axis in enumerate("xyz"):
        values[axis] = record.points[:, index]
    if record.times is not None:
        values["timestamp"] = record.times
    fields = [
        _make("sensor_msgs/msg/PointField", name=name, offset=4 * place, datatype=datatype, count=1)
        for place, (name, _, datatype) in enumerate(layout)
    ]
    return _make(
        CLOUD_TYPE,
        header=_header(record.stamp, record.frame_id),
        height=1,
        width=count,
        fields=fields,
        is_bigendian=False,
        point_step=values.itemsize,
        row_step=values.itemsize * count,
        data=np.frombuffer(values.tobytes(), dtype=np.uint8),
        is_dense=True,
    )


def transform_message(records: Sequence[TransformRecord]) -> Any:
    """tf2_msgs/TFMessage."""
    stamped = [
        _make(
            "geometry_msgs/msg/TransformStamped",
            header=_header(record.stamp, record.frame_id),
            child_frame_id=record.child_frame_id,
            transform=_make(
                "geometry_msgs/msg/Transform",
                translation=_xyz("Vector3", record.transform[:3, 3]),
                rotation=_quaternion(quaternion_from_rotation(record.transform[:3, :3])),
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


def _xyz(kind: str, values: Iterable[float]) -> Any:
    """geometry_msgs/Point or Vector3."""
    return _make(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", map(float, values), strict=True)))


def _quaternion(values: Iterable[float]) -> Any:
    return _make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, values), strict=True)))

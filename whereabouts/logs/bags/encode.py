"""Records and plain values as ROS 2 messages, without a ROS installation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from decimal import ROUND_HALF_EVEN, Decimal
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from estimation.errors import InputError
from estimation.geometry.rotations import quaternion_from_rotation
from whereabouts.logs.bags.ros_types import standard_types
from whereabouts.messages.message_rotations import quaternion_of_yaw
from whereabouts.messages.records import CloudRecord, OdometryRecord, ScanRecord, TransformRecord
from whereabouts.messages.type_names import CLOUD, ODOMETRY, SCAN, TF
from whereabouts.system.clocks import NANOSECONDS

# builtin_interfaces/Time counts seconds in an int32, and ROS clients refuse negative ones.
LATEST_STAMP = 2**31
FLOAT32, FLOAT64 = 7, 8
UNSET = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}
"""By type, of numbers 0 otherwise."""


def made(types: Typestore, type_name: str, given: Mapping[str, Any]) -> Any:
    """A message of plain values: mappings are messages within it. What is not given is empty, zero or false."""
    fields = types.fielddefs[type_name][1]
    return types.types[type_name](**{name: _value(types, kind, given.get(name)) for name, kind in fields})


def _value(types: Typestore, kind: Any, given: Any) -> Any:
    node, what = kind
    if node == Nodetype.BASE:
        return UNSET.get(what[0], 0) if given is None else given
    if node == Nodetype.NAME:
        return made(types, what, given or {}) if given is None or isinstance(given, Mapping) else given
    (inner, of), count = what
    if inner == Nodetype.BASE and of[0] != "string":
        return np.zeros(count, of[0]) if given is None else np.asarray(given, dtype=of[0])
    return [_value(types, (inner, of), item) for item in given or ()]


def header(total: int, frame_id: str) -> dict[str, Any]:
    """std_msgs/Header of nanoseconds and a frame."""
    return {"stamp": time(total), "frame_id": frame_id}


def time(total: int) -> dict[str, int]:
    """builtin_interfaces/Time of nanoseconds."""
    return dict(zip(("sec", "nanosec"), divmod(total, NANOSECONDS), strict=True))


def xyz(values: Iterable[float]) -> dict[str, float]:
    """geometry_msgs/Point or Vector3 of (3,)."""
    return dict(zip("xyz", map(float, values), strict=True))


def xyzw(values: Iterable[float]) -> dict[str, float]:
    """geometry_msgs/Quaternion of (4,)."""
    return dict(zip("xyzw", map(float, values), strict=True))


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
    fields = {
        "header": header(nanoseconds(record.stamp), record.frame_id),
        "angle_min": scan.angle_min,
        "angle_max": scan.angle_min + scan.angle_increment * max(len(scan) - 1, 0),
        "angle_increment": scan.angle_increment,
        "time_increment": scan.time_increment,
        "range_min": scan.range_min,
        "range_max": scan.range_max,
        "ranges": scan.ranges,
    }
    return made(standard_types(), SCAN, fields)


def odometry_message(record: OdometryRecord) -> Any:
    """nav_msgs/Odometry; zeros where covariance or twist are unknown."""
    if record.transform is None:
        x, y, yaw = record.pose
        pose = {"position": xyz((x, y, 0.0)), "orientation": xyzw(quaternion_of_yaw(float(yaw)))}
    else:
        turn = quaternion_from_rotation(record.transform[:3, :3])
        pose = {"position": xyz(record.transform[:3, 3]), "orientation": xyzw(turn)}
    covariance = np.zeros((6, 6))
    if record.covariance is not None:
        covariance[np.ix_((0, 1, 5), (0, 1, 5))] = record.covariance
    vx, vy, rate = (0.0, 0.0, 0.0) if record.twist is None else record.twist
    fields = {
        "header": header(nanoseconds(record.stamp), record.frame_id),
        "child_frame_id": record.child_frame_id,
        "pose": {"pose": pose, "covariance": covariance.reshape(36)},
        "twist": {"twist": {"linear": xyz((vx, vy, 0.0)), "angular": xyz((0.0, 0.0, rate))}},
    }
    return made(standard_types(), ODOMETRY, fields)


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
    fields = {
        "header": header(nanoseconds(record.stamp), record.frame_id),
        "height": 1,
        "width": count,
        "fields": [
            {"name": name, "offset": 4 * place, "datatype": datatype, "count": 1}
            for place, (name, _, datatype) in enumerate(layout)
        ],
        "point_step": values.itemsize,
        "row_step": values.itemsize * count,
        "data": np.frombuffer(values.tobytes(), dtype=np.uint8),
        "is_dense": True,
    }
    return made(standard_types(), CLOUD, fields)


def transform_message(records: Sequence[TransformRecord]) -> Any:
    """tf2_msgs/TFMessage."""
    stamped = [
        {
            "header": header(nanoseconds(record.stamp), record.frame_id),
            "child_frame_id": record.child_frame_id,
            "transform": {
                "translation": xyz(record.transform[:3, 3]),
                "rotation": xyzw(quaternion_from_rotation(record.transform[:3, :3])),
            },
        }
        for record in records
    ]
    return made(standard_types(), TF, {"transforms": stamped})

"""The records every log is read as. Frames and topics carry no leading slash, stamps are recorded seconds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from registration.laser.scan import Scan

Array = NDArray[np.float64]

BASE_FRAME = "base_link"
ODOM_FRAME = "odom"
MAP_FRAME = "map"
LASER_FRAME = "laser"


@dataclass(frozen=True, eq=False, slots=True)
class ScanRecord:
    """One planar scan.

    stamp : seconds, equal to scan.stamp.
    odometry : (3,) robot pose [x, y, yaw] by the wheels in the `odom` frame, None where the log has none.
    pose : (3,) robot pose [x, y, yaw] in the `map` frame by a mapper or a solved graph, None where unknown.
        It is for evaluation; an estimator must not look at it.
    sensor_pose : (3,) pose of the laser in `base_link`, None where the log does not carry it.
    """

    scan: Scan
    stamp: float
    topic: str = "scan"
    frame_id: str = LASER_FRAME
    odometry: Array | None = None
    pose: Array | None = None
    sensor_pose: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class OdometryRecord:
    """One reading of the wheels (or any nav_msgs/Odometry).

    pose : (3,) [x, y, yaw] of child_frame_id in frame_id, metres and radians.
    twist : (3,) [vx, vy, yaw rate] in child_frame_id, m/s and rad/s, None where unknown.
    covariance : (3, 3) of pose, None where unknown (all zeros in the message).
    transform : (4, 4) the full pose, None where the log is planar.
    """

    pose: Array
    stamp: float
    topic: str = "wheel_odom"
    frame_id: str = ODOM_FRAME
    child_frame_id: str = BASE_FRAME
    twist: Array | None = None
    covariance: Array | None = None
    transform: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class CloudRecord:
    """One point cloud, points with a NaN or infinite coordinate dropped.

    points : (N, 3) metres in frame_id.
    times : (N,) as recorded per point (unit and origin are the driver's), None where the cloud has none.
    """

    points: Array
    stamp: float
    topic: str = "points"
    frame_id: str = LASER_FRAME
    times: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class TransformRecord:
    """One transform of tf or tf_static: `transform` (4, 4) takes points of child_frame_id into frame_id."""

    transform: Array
    stamp: float
    frame_id: str
    child_frame_id: str
    topic: str = "tf"

    @property
    def static(self) -> bool:
        """Whether it holds for all times."""
        return self.topic.endswith("tf_static")


@dataclass(frozen=True, eq=False, slots=True)
class MessageRecord:
    """Any other ROS message, decoded by the definition in its bag; only on topics asked for by name.

    stamp : of the header where there is one, else the time of recording; seconds.
    message : fields as attributes, arrays as numpy arrays.
    """

    message: Any
    type_name: str
    stamp: float
    topic: str


Record = ScanRecord | OdometryRecord | CloudRecord | TransformRecord | MessageRecord


def strip_slash(name: str) -> str:
    """Frame or topic name without leading slashes: old bags mix both forms."""
    return name.lstrip("/")

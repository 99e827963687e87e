"""Rotations of single messages.

`estimation` has the same for arrays of any shape. A bag's tf comes one transform at a time, by the thousand per
second, and there the array forms cost forty times as much as plain floats.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from estimation.checks import FloatArray as Array
from estimation.errors import InputError

Quaternion = tuple[float, float, float, float]

SHORTEST_QUATERNION = 1e-6


def rotation_of(quaternion: Quaternion) -> Array:
    """(3, 3) rotation of (x, y, z, w), which is normalised first.

    Raises InputError: its norm is below 1e-6, as of a message field that was never set.
    """
    x, y, z, w = quaternion
    norm = x * x + y * y + z * z + w * w
    if norm < SHORTEST_QUATERNION**2:
        raise InputError("quaternion: unit length expected, got all zeros")
    s = 2.0 / norm
    return np.array(
        [
            [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)],
        ]
    )


def quaternion_of_yaw(yaw: float) -> Quaternion:
    """(x, y, z, w), w >= 0, of a turn about z."""
    half = math.remainder(yaw, 2.0 * math.pi) / 2.0
    return 0.0, 0.0, math.sin(half), math.cos(half)


def planar_matrix(pose: Sequence[float] | Array) -> Array:
    """(4, 4) matrix of [x, y, yaw]."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    matrix = np.eye(4)
    matrix[:2, :2] = (cosine, -sine), (sine, cosine)
    matrix[:2, 3] = pose[0], pose[1]
    return matrix


def pose_in_plane(pose: Any) -> Array:
    """[x, y, yaw] (3,) of a Pose or a Transform; one whose rotation was never set does not turn."""
    at, turn = (
        (pose.translation, pose.rotation) if hasattr(pose, "rotation") else (pose.position, pose.orientation)
    )
    x, y, z, w = (float(getattr(turn, name)) for name in "xyzw")
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)) if any((x, y, z, w)) else 0.0
    return np.array([float(at.x), float(at.y), yaw])


def to_plane(matrix: Array) -> Array:
    """[x, y, yaw] (..., 3) of poses (..., 4, 4); yaw is the heading of their x axis in the plane."""
    yaw = np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])
    return np.stack([matrix[..., 0, 3], matrix[..., 1, 3], yaw], axis=-1)

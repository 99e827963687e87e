"""The little planar geometry that reading a log needs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pose = tuple[float, float, float]


def wrap(angle: float) -> float:
    """The same angle in [-π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def compose(a: Pose, b: Pose) -> Pose:
    """Pose b, given in the frame of pose a, in the frame a is given in."""
    cosine, sine = math.cos(a[2]), math.sin(a[2])
    return a[0] + cosine * b[0] - sine * b[1], a[1] + sine * b[0] + cosine * b[1], wrap(a[2] + b[2])


def relative(a: Pose, b: Pose) -> Pose:
    """Pose b in the frame of pose a, both given in the same frame."""
    cosine, sine = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return cosine * dx + sine * dy, -sine * dx + cosine * dy, wrap(b[2] - a[2])


def invert(a: Pose) -> Pose:
    """Pose of the frame a is given in, in the frame of a."""
    return relative(a, (0.0, 0.0, 0.0))


def rotation_of(quaternion: tuple[float, float, float, float]) -> Array:
    """(3, 3) rotation of (x, y, z, w), which is normalised first; identity for the zero quaternion."""
    x, y, z, w = quaternion
    norm = x * x + y * y + z * z + w * w
    if norm < 1e-12:
        return np.eye(3)
    s = 2.0 / norm
    return np.array(
        [
            [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: Array) -> tuple[float, float, float, float]:
    """(x, y, z, w), w >= 0, of a (3, 3) rotation; by its largest component, which is never near zero."""
    m = rotation
    squares = np.array(
        [
            1.0 + m[0, 0] - m[1, 1] - m[2, 2],
            1.0 - m[0, 0] + m[1, 1] - m[2, 2],
            1.0 - m[0, 0] - m[1, 1] + m[2, 2],
            1.0 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    rows = np.array(
        [
            [squares[0], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[1, 0] + m[0, 1], squares[1], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], squares[2], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]],
        ]
    )
    q = rows[int(np.argmax(squares))]
    q = q / np.linalg.norm(q)
    if q[3] < 0.0:
        q = -q
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])


def matrix_of(pose: Pose | Array) -> Array:
    """(4, 4) matrix of a planar pose."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    matrix = np.eye(4)
    matrix[:2, :2] = (cosine, -sine), (sine, cosine)
    matrix[:2, 3] = pose[0], pose[1]
    return matrix


def yaw_of(rotation: Array) -> float:
    """Yaw of a (3, 3) rotation: the heading of its x axis in the plane."""
    return math.atan2(rotation[1, 0], rotation[0, 0])


def to_plane(matrix: Array) -> Array:
    """(3,) [x, y, yaw] of a (4, 4) pose."""
    return np.array([matrix[0, 3], matrix[1, 3], yaw_of(matrix)])

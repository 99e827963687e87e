"""Fields of messages as arrays; messages are rclpy's or those rosbags decodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from whereabouts.messages.message_rotations import rotation_of
from whereabouts.viewer.drawable import Array

ELLIPSE = np.linspace(0.0, 2.0 * np.pi, 25)


def xyz(point: Any) -> tuple[float, float, float]:
    """Point or Vector3."""
    return float(point.x), float(point.y), float(point.z)


def rows(points: list[tuple[float, float, float]]) -> Array:
    """(N, 3), also of none."""
    return np.array(points, dtype=np.float64).reshape(-1, 3)


def matrix_of(pose: Any) -> Array:
    """(4, 4) of a geometry_msgs/Pose; one whose orientation was never set does not turn."""
    matrix = np.eye(4)
    q = pose.orientation
    values = (float(q.x), float(q.y), float(q.z), float(q.w))
    if any(values):
        matrix[:3, :3] = rotation_of(values)
    matrix[:3, 3] = xyz(pose.position)
    return matrix


def ellipse(center: tuple[float, float, float], covariance: Any, sigmas: float = 1.0) -> Array:
    """Outline (25, 3) of a (2, 2) covariance around a point; the point itself where it is none."""
    matrix = np.asarray(covariance, dtype=np.float64).reshape(2, 2)
    if not np.isfinite(matrix).all():
        return np.tile(center, (len(ELLIPSE), 1))
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    axes = vectors * (sigmas * np.sqrt(np.maximum(values, 0.0)))
    ring = np.zeros((len(ELLIPSE), 3)) + center
    ring[:, :2] += np.column_stack((np.cos(ELLIPSE), np.sin(ELLIPSE))) @ axes.T
    return ring


def most_probable(distribution: Any) -> tuple[str, float]:
    """Name and probability of a DiscreteDistribution's best value; "" where it has none."""
    probabilities = np.asarray(distribution.probabilities, dtype=np.float64)
    if not len(probabilities):
        return "", 0.0
    best = int(np.argmax(probabilities))
    return str(distribution.values[best]), float(probabilities[best])

"""What one odometry step yields, and how the uncertainty of steps adds up along a path.

Covariances of a planar pose are of (x, y, yaw). Those of a spatial pose are of (x, y, z, rotation about x,
about y, about z): translation and small rotations both expressed in the frame the pose is given in, as ROS
has it. Compounding is App. A.B of Paper A.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import compound, compound_jacobians


@dataclass(frozen=True)
class Step:
    """One registered scan or cloud.

    increment : motion of the sensor since the last one, in the last sensor frame; (3,) or (4, 4).
    covariance : of the increment, (3, 3) or (6, 6).
    converged : False where the increment is only a prediction or contradicts the data; `reason` says why.
    fitness : 0 to 1, share of the points that agree with the map.
    static_points : (M, 2 | 3) metres, sensor frame, points judged not to move.
    drift : covariance that stays, of the increment; what is left of `covariance` is the measurement's own noise and
        gone with the next one. None where all of it stays.
    noise : (3, 3) or (6, 6) of the pose against the map it was registered to, odometry frame; None where there is none.
    """

    increment: FloatArray
    covariance: FloatArray
    converged: bool
    reason: str
    fitness: float
    static_points: FloatArray
    drift: FloatArray | None = None
    noise: FloatArray | None = None


def planar_to_matrix(pose: FloatArray) -> FloatArray:
    """(3,) x, y, yaw to the (4, 4) homogeneous matrix of a motion in the plane."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    matrix = np.eye(4)
    matrix[:2, :2] = [[cosine, -sine], [sine, cosine]]
    matrix[:2, 3] = pose[:2]
    return matrix


def matrix_to_planar(matrix: FloatArray) -> FloatArray:
    """(4, 4) homogeneous matrix to (3,) x, y, yaw; what leaves the plane is dropped."""
    return np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])


def accumulate(pose: FloatArray, covariance: FloatArray, step: Step) -> tuple[FloatArray, FloatArray]:
    """Pose and lasting covariance after one more step, (3,), (3, 3) or (4, 4), (6, 6)."""
    lasting = step.covariance if step.drift is None else step.drift
    if pose.shape == (3,):
        moved = compound(pose, step.increment)
        by_pose, by_step = compound_jacobians(pose, step.increment)
    else:
        moved, rotation = pose @ step.increment, pose[:3, :3]
        by_pose, by_step = np.eye(6), np.eye(6)
        x, y, z = rotation @ step.increment[:3, 3]
        by_pose[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        by_step[:3, :3] = by_step[3:, 3:] = rotation
    return moved, by_pose @ covariance @ by_pose.T + by_step @ lasting @ by_step.T

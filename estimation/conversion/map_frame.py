"""Measurements converted through an uncertain planar robot pose to the map frame: (6.4)-(6.6).

Mean and covariance are in the frame the robot pose is given in. The heading's variance adds to the bearing's
before the conversion, so that every conversion treats it exactly; the position's covariance is added after it.
A correlation of position and heading, which the text leaves out, enters by Stein's lemma:
cov(p, r u(θ)) = cov(p, θ) E[r u'(θ)].
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_vectors, require_count
from estimation.conversion.conversion_kernels import NO_COVARIANCE, NO_POSE, ucm_batch
from estimation.conversion.polar import (
    SIGMA_POINT,
    Method,
    check_angle,
    check_measurement,
    check_method,
    local_moments,
    moments_of_samples,
    rotate_local,
)
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance

__all__ = ["check_pose", "convert_to_map", "convert_with_ratio", "sample_in_map"]


def check_pose(robot_pose: npt.ArrayLike, robot_covariance: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """A planar pose (3,) with yaw within ±π and its covariance (3, 3), positive semi-definite (zero: exact).

    The deviation of yaw is up to π rad: of a heading that is unknown, conversions know nothing.
    """
    pose = as_vectors("robot_pose", robot_pose, 3)
    if pose.ndim != 1:
        raise InputError(f"robot_pose must have shape (3,), not {pose.shape}")
    check_angle("robot_pose yaw", pose[2])
    P = repair_covariance(robot_covariance, "robot_covariance", definite=False)
    if P.shape != (3, 3):
        raise InputError(f"robot_covariance must have shape (3, 3), not {P.shape}")
    check_angle("deviation of robot_pose yaw", np.sqrt(P[2, 2]))
    return pose, P


def convert_to_map(
    robot_pose: npt.ArrayLike,
    robot_covariance: npt.ArrayLike,
    range_: npt.ArrayLike,
    bearing: npt.ArrayLike,
    sigma_range: npt.ArrayLike,
    sigma_bearing: npt.ArrayLike,
    method: Method = "ucm",
    samples: int = 1000,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """Mean (..., 2) and covariance (..., 2, 2), m and m², in the map frame.

    robot_pose : (3,) [x, y, yaw] of the sensor in the map; robot_covariance : (3, 3), zero where the pose is
    exact. The rest as of `estimation.conversion.convert`. Raises InputError naming the argument.
    """
    check_method(method)
    pose, P = check_pose(robot_pose, robot_covariance)
    r, theta, sr, st = check_measurement(range_, bearing, sigma_range, sigma_bearing)
    if method == "sampled":
        return moments_of_samples(sample_in_map(pose, P, r, theta, sr, st, samples, seed))
    total = np.sqrt(st**2 + P[2, 2])
    mean, along, across = local_moments(r, sr, total, method)
    angle, radius = np.broadcast_arrays(theta + pose[2], mean)
    c, s = np.cos(angle), np.sin(angle)
    cov = rotate_local(angle, *np.broadcast_arrays(along, across)) + P[:2, :2]
    slope = np.asarray(r * _mean_slope(total, method))[..., None]
    cross = P[:2, 2, None] * (np.stack([-s, c], -1) * slope)[..., None, :]
    position = pose[:2] + np.stack([radius * c, radius * s], -1)
    return position, cov + cross + np.swapaxes(cross, -1, -2)


def _mean_slope(sigma: FloatArray, method: str) -> FloatArray:
    """E[u'(θ)] across the bearing: E[cos θ̃], to the accuracy of the method."""
    if method == "linear":
        return np.ones_like(sigma)
    if method == "unscented":
        return np.sin(SIGMA_POINT * sigma) / (SIGMA_POINT * sigma)
    return np.exp(-0.5 * sigma**2)


def sample_in_map(
    robot_pose: npt.ArrayLike,
    robot_covariance: npt.ArrayLike,
    range_: npt.ArrayLike,
    bearing: npt.ArrayLike,
    sigma_range: npt.ArrayLike,
    sigma_bearing: npt.ArrayLike,
    samples: int = 1000,
    seed: int | np.random.Generator = 0,
) -> FloatArray:
    """Samples (N, ..., 2), m, of where the measured object is in the map: robot pose and measurement drawn."""
    pose, P = check_pose(robot_pose, robot_covariance)
    samples = require_count("samples", samples, 2)
    rng = np.random.default_rng(seed)
    r, theta, sr, st = check_measurement(range_, bearing, sigma_range, sigma_bearing)
    shape = (samples, *np.broadcast_shapes(r.shape, theta.shape, sr.shape, st.shape))
    values, vectors = np.linalg.eigh(P)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    robots = pose + rng.standard_normal((*shape, 3)) @ root.T
    ranges = r + sr * rng.standard_normal(shape)
    angles = robots[..., 2] + theta + st * rng.standard_normal(shape)
    return robots[..., :2] + np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], -1)


def convert_with_ratio(
    range_: npt.ArrayLike,
    bearing: npt.ArrayLike,
    sigma_range: npt.ArrayLike,
    sigma_bearing: npt.ArrayLike,
    robot_pose: npt.ArrayLike | None = None,
    robot_covariance: npt.ArrayLike | None = None,
    position_in_ratio: bool = True,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """UCM mean (M, 2), covariance (M, 2, 2) and K (M,) of M measurements in one compiled pass.

    Arguments as of `convert_to_map`, (M,) or scalars; without a pose the result is in the sensor's frame.
    position_in_ratio : whether K compares the covariances in the map, with the robot's position covariance
    in both (True), or those of the polar measurement alone (False).
    """
    r, theta, sr, st = check_measurement(range_, bearing, sigma_range, sigma_bearing)
    pose, P = NO_POSE, NO_COVARIANCE
    if robot_pose is not None:
        pose, P = check_pose(robot_pose, NO_COVARIANCE if robot_covariance is None else robot_covariance)
    r, theta, sr, st = (a.copy() for a in np.broadcast_arrays(np.atleast_1d(r), theta, sr, st))
    if r.ndim != 1:
        raise InputError(f"range_ must have shape (M,), not {r.shape}")
    mean, cov, K = np.empty((r.size, 2)), np.empty((r.size, 2, 2)), np.empty(r.size)
    ucm_batch(r, theta, sr, st, pose, P, position_in_ratio, mean, cov, K)
    return mean, cov, K

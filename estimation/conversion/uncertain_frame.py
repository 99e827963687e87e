"""Gaussian positions and states seen from an uncertain planar robot pose: exact mean and covariance in the map.

What `estimation.conversion.map_frame` does for range and bearing, for detections that come as positions with a
covariance of their own, and for states with a velocity. The heading's error turns the lever arm from the robot
to the position into a banana; its first two moments follow from E[exp(iθ)] = exp(-σ²/2) and E[exp(2iθ)] = exp(-2σ²).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_shape, require_finite
from estimation.filters.gaussians import repair_covariance

_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])


def through_uncertain_pose(
    position: npt.ArrayLike, covariance: npt.ArrayLike, origin: npt.ArrayLike, pose_covariance: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3), m and m², map frame.

    position (3,), covariance (3, 3) : as converted through the mean pose, map frame. origin (2,) : of the robot in
    the map. pose_covariance (3, 3) : of its x, y, yaw. Height is untouched. Raises InputError naming the argument.
    """
    p = require_finite("position", as_shape("position", position, (3,)))
    R = require_finite("covariance", as_shape("covariance", covariance, (3, 3)))
    t, P = _checked(origin, pose_covariance)
    first = math.exp(-0.5 * P[2, 2])
    arm = p[:2] - t
    cross = np.outer(P[:2, 2], first * (_QUARTER @ arm))
    mean, cov = p.copy(), R.copy()
    mean[:2] = t + first * arm
    turned = _turned(R[:2, :2] + np.outer(arm, arm), P[2, 2])
    cov[:2, :2] = P[:2, :2] + turned - first * first * np.outer(arm, arm) + cross + cross.T
    cov[:2, 2] *= first
    cov[2, :2] *= first
    return mean, cov


def state_through_uncertain_pose(
    state: npt.ArrayLike, covariance: npt.ArrayLike, origin: npt.ArrayLike, pose_covariance: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Mean (4,) and covariance (4, 4) of x, y, vx, vy, m and m/s, map frame.

    The heading's error turns lever arm and velocity alike. Arguments as of `through_uncertain_pose`, for a state (4,)
    with covariance (4, 4). Raises InputError naming the argument.
    """
    x = require_finite("state", as_shape("state", state, (4,)))
    R = require_finite("covariance", as_shape("covariance", covariance, (4, 4)))
    t, P = _checked(origin, pose_covariance)
    first = math.exp(-0.5 * P[2, 2])
    relative = np.concatenate((x[:2] - t, x[2:]))
    moment = R + np.outer(relative, relative)
    cov = np.empty((4, 4))
    for a in (0, 2):
        for b in (0, 2):
            cov[a : a + 2, b : b + 2] = _turned(moment[a : a + 2, b : b + 2], P[2, 2])
    cov -= first * first * np.outer(relative, relative)
    # The robot's position and what its heading does to both vectors, by Stein's lemma.
    cross = np.outer(P[:2, 2], first * np.concatenate((_QUARTER @ relative[:2], _QUARTER @ relative[2:])))
    cov[:2] += cross
    cov[:, :2] += cross.T
    cov[:2, :2] += P[:2, :2]
    mean = first * relative
    mean[:2] += t
    return mean, cov


def _checked(origin: npt.ArrayLike, pose_covariance: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    t = require_finite("origin", as_shape("origin", origin, (2,)))
    P = as_shape("pose_covariance", pose_covariance, (3, 3))
    return t, repair_covariance(P, "pose_covariance", definite=False)


def _turned(moment: FloatArray, variance: float) -> FloatArray:
    """E[R M Rᵀ] (2, 2) over rotations by an angle of some variance: what a rotation changes fades, the rest stays."""
    still = 0.5 * (np.trace(moment) * np.eye(2) + (moment[1, 0] - moment[0, 1]) * _QUARTER)
    return np.asarray(still + math.exp(-2.0 * variance) * (moment - still))

"""A Gaussian position seen from an uncertain planar robot pose: its exact mean and covariance in the map.

What `estimation.map_frame` does for range and bearing, for detections that come as positions with a covariance of
their own. The heading's error turns the lever arm from the robot to the position into a banana; its first two moments
follow from E[exp(iθ)] = exp(-σ²/2) and E[exp(2iθ)] = exp(-2σ²).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_shape, require_finite
from estimation.gaussians import repair_covariance


def through_uncertain_pose(
    position: npt.ArrayLike, covariance: npt.ArrayLike, origin: npt.ArrayLike, pose_covariance: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3), m and m², map frame.

    position (3,), covariance (3, 3) : as converted through the mean pose, map frame. origin (2,) : of the robot in
    the map. pose_covariance (3, 3) : of its x, y, yaw. Height is untouched. Raises InputError naming the argument.
    """
    p = require_finite("position", as_shape("position", position, (3,)))
    R = as_shape("covariance", covariance, (3, 3))
    t = require_finite("origin", as_shape("origin", origin, (2,)))
    P = repair_covariance(
        as_shape("pose_covariance", pose_covariance, (3, 3)), "pose_covariance", definite=False
    )
    first, second = math.exp(-0.5 * P[2, 2]), math.exp(-2.0 * P[2, 2])
    arm = p[:2] - t
    moment = R[:2, :2] + np.outer(arm, arm)
    round_part = 0.5 * np.trace(moment) * np.eye(2)
    turned = round_part + second * (moment - round_part)
    cross = np.outer(P[:2, 2], first * np.array([-arm[1], arm[0]]))
    mean, cov = p.copy(), R.copy()
    mean[:2] = t + first * arm
    cov[:2, :2] = P[:2, :2] + turned - first * first * np.outer(arm, arm) + cross + cross.T
    cov[:2, 2] *= first
    cov[2, :2] *= first
    return mean, cov

"""Equation (6) in closed form: the rigid motion that takes one weighted set of points to another in the plane."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

SUMS = 9  # Σw, Σw x, Σw y, Σw u, Σw v, Σw (xu + yv), Σw (xv - yu), Σw (xx + yy), count


@njit(cache=True, inline="always")
def add_pair(sums, x, y, u, v, weight):  # type: ignore[no-untyped-def]
    """Add (x, y) → (u, v) to the sums (SUMS,) that determine the motion; a negative weight takes it out again."""
    sums[0] += weight
    sums[1] += weight * x
    sums[2] += weight * y
    sums[3] += weight * u
    sums[4] += weight * v
    sums[5] += weight * (x * u + y * v)
    sums[6] += weight * (x * v - y * u)
    sums[7] += weight * (x * x + y * y)
    sums[8] += 1.0 if weight > 0.0 else -1.0


@njit(cache=True)
def motion_of(sums, prior_yaw, stiffness, motion):  # type: ignore[no-untyped-def]
    """Write the motion (3,) of least weighted squares; False, and nothing written, without any pair.

    `stiffness` is the weight, in the sums' weight times m², of the belief that the rotation is `prior_yaw`.
    """
    if sums[0] <= 1e-9:
        return False
    mx, my, mu, mv = sums[1] / sums[0], sums[2] / sums[0], sums[3] / sums[0], sums[4] / sums[0]
    dot = sums[5] - sums[0] * (mx * mu + my * mv) + stiffness * math.cos(prior_yaw)
    cross = sums[6] - sums[0] * (mx * mv - my * mu) + stiffness * math.sin(prior_yaw)
    yaw = prior_yaw
    if dot * dot + cross * cross > 0.0:
        yaw = math.atan2(cross, dot)
    c, s = math.cos(yaw), math.sin(yaw)
    motion[0] = mu - c * mx + s * my
    motion[1] = mv - s * mx - c * my
    motion[2] = yaw
    return True


@njit(cache=True)
def rigid_motion(source, target, weights=None):  # type: ignore[no-untyped-def]
    """Motion (3,) x, y, yaw with the least Σ w |R a + t - b|² from `source` (n, 2) to `target` (n, 2), equation (6)."""
    sums, motion = np.zeros(SUMS), np.zeros(3)
    for k in range(len(source)):
        weight = 1.0
        if weights is not None:
            weight = weights[k]
        add_pair(sums, source[k, 0], source[k, 1], target[k, 0], target[k, 1], weight)
    motion_of(sums, 0.0, 0.0, motion)
    return motion

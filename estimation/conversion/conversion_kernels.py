"""Compiled scalar forms of the conversions of `estimation.conversion`, for loops over many targets."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True)
def ucm_local(r, sr, st):  # type: ignore[no-untyped-def]
    """UCM mean along the bearing, variances along and across."""
    v, s2, r2 = st * st, sr * sr, r * r
    q, p = math.exp(-v), -math.expm1(-v)
    along = 0.5 * r2 * p * p * (2.0 + q) / q + 0.5 * s2 * (1.0 + q * q)
    return r / math.sqrt(q), along, 0.5 * (r2 + s2) * p * (1.0 + q)


@numba.njit(cache=True)
def mucm_local(r, sr, st):  # type: ignore[no-untyped-def]
    """MUCM mean along the bearing, variances along and across."""
    v, s2, r2 = st * st, sr * sr, r * r
    q, p = math.exp(-v), -math.expm1(-v)
    along = 0.5 * r2 * p * p + 0.5 * s2 * (1.0 + q * q)
    return r * math.sqrt(q), along, 0.5 * (r2 + s2) * p * (1.0 + q)


@numba.njit(cache=True)
def shape_ratio(xx, xy, yy):  # type: ignore[no-untyped-def]
    """λmin / λmax of [[xx, xy], [xy, yy]]."""
    half = 0.5 * (xx - yy)
    largest = 0.5 * (xx + yy) + math.sqrt(half * half + xy * xy)
    return (xx * yy - xy * xy) / (largest * largest)


@numba.njit(cache=True)
def rotated(c, s, along, across):  # type: ignore[no-untyped-def]
    """xx, xy, yy of the covariance given along and across the direction (c, s)."""
    return c * c * along + s * s * across, c * s * (along - across), s * s * along + c * c * across


@numba.njit(cache=True)
def to_map_ucm(pose, P, r, bearing, sr, st, position_in_ratio, toward_x, toward_y):  # type: ignore[no-untyped-def]
    """UCM of (r, bearing) through the robot pose: x, y, xx, xy, yy and K of (6.12).

    toward_x, toward_y : direction the covariance is aligned with, of any length; (0, 0) for the measured one.
    """
    st = math.sqrt(st * st + P[2, 2])
    angle = pose[2] + bearing
    c, s = math.cos(angle), math.sin(angle)
    m, along, across = ucm_local(r, sr, st)
    x, y = pose[0] + m * c, pose[1] + m * s
    length = math.sqrt(toward_x * toward_x + toward_y * toward_y)
    if length > 0.0:
        c, s = toward_x / length, toward_y / length
    xx, xy, yy = rotated(c, s, along, across)
    lin_along, lin_across = sr * sr, r * r * st * st
    K = (min(along, across) / max(along, across)) / (min(lin_along, lin_across) / max(lin_along, lin_across))
    # cov(position, r u(θ)) = cov(position, heading) E[r u'(θ)]
    lever = r * math.exp(-0.5 * st * st)
    gx, gy = -s * lever, c * lever
    xx += P[0, 0] + 2.0 * P[0, 2] * gx
    yy += P[1, 1] + 2.0 * P[1, 2] * gy
    xy += P[0, 1] + P[0, 2] * gy + P[1, 2] * gx
    if position_in_ratio and P[0, 0] + P[1, 1] > 0.0:
        lxx, lxy, lyy = rotated(c, s, lin_along, lin_across)
        gx, gy = -s * r, c * r
        lxx += P[0, 0] + 2.0 * P[0, 2] * gx
        lyy += P[1, 1] + 2.0 * P[1, 2] * gy
        lxy += P[0, 1] + P[0, 2] * gy + P[1, 2] * gx
        K = shape_ratio(xx, xy, yy) / shape_ratio(lxx, lxy, lyy)
    return x, y, xx, xy, yy, K


@numba.njit(cache=True)
def ucm_batch(r, bearing, sr, st, pose, P, position_in_ratio, mean, cov, K):  # type: ignore[no-untyped-def]
    """`to_map_ucm` of flat arrays (M,) into mean (M, 2), cov (M, 2, 2), K (M,)."""
    for i in range(r.size):
        x, y, xx, xy, yy, K[i] = to_map_ucm(
            pose, P, r[i], bearing[i], sr[i], st[i], position_in_ratio, 0.0, 0.0
        )
        mean[i, 0], mean[i, 1] = x, y
        cov[i, 0, 0], cov[i, 1, 1] = xx, yy
        cov[i, 0, 1] = cov[i, 1, 0] = xy


NO_POSE = np.zeros(3)
NO_COVARIANCE = np.zeros((3, 3))

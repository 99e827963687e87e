"""Looking ahead along paths: what an object's covariance would be after driving there and looking on the way."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# mypy: disable-error-code="no-untyped-def"


@njit(cache=True)
def _log_det(P):
    """Log of the determinant of a symmetric (3, 3)."""
    a, b, c = P[0, 0], P[0, 1], P[0, 2]
    e, f, i = P[1, 1], P[1, 2], P[2, 2]
    return math.log(max(a * (e * i - f * f) - b * (b * i - f * c) + c * (b * f - e * c), 1e-300))


@njit(cache=True)
def _look(P, R):
    """One measurement of covariance R: P becomes R (P + R)⁻¹ P, in place."""
    a, b, c = P[0, 0] + R[0, 0], P[0, 1] + R[0, 1], P[0, 2] + R[0, 2]
    e, f, i = P[1, 1] + R[1, 1], P[1, 2] + R[1, 2], P[2, 2] + R[2, 2]
    S = np.empty((3, 3))
    S[0, 0], S[0, 1], S[0, 2] = e * i - f * f, c * f - b * i, b * f - c * e
    S[1, 1], S[1, 2], S[2, 2] = a * i - c * c, b * c - a * f, a * e - b * b
    S[1, 0], S[2, 0], S[2, 1] = S[0, 1], S[0, 2], S[1, 2]
    scale = 1.0 / (a * S[0, 0] + b * S[0, 1] + c * S[0, 2])
    half = np.empty((3, 3))
    for j in range(3):
        for k in range(3):
            half[j, k] = scale * (S[j, 0] * P[0, k] + S[j, 1] * P[1, k] + S[j, 2] * P[2, k])
    for j in range(3):
        for k in range(j, 3):
            value = R[j, 0] * half[0, k] + R[j, 1] * half[1, k] + R[j, 2] * half[2, k]
            P[j, k] = P[k, j] = value


@njit(cache=True)
def path_gain(own, path, positions, P, Q, R, low, high, opening, step, anticipation):
    """Expected gain of one way, nat: of the object it is for, of all together, and how many would be seen.

    own : index of that object. path : (K + 1, 3) x, y, heading: of the robot, then after each time step, with a look.
    positions : (N, 2). P, Q, R : (N, 3, 3) covariance now, growth per second, one look. low, high : m, range of the
    sensor. opening : full angle of view, rad. anticipation : share of what entropy grows by on the way that counts
    as gained where a look takes it off again.
    """
    gain_own = gain = 0.0
    seen = 0
    last = len(path) - 1
    x0, y0, x1, y1 = path[0, 0], path[0, 1], path[0, 0], path[0, 1]
    for k in range(1, last + 1):
        x0, x1 = min(x0, path[k, 0]), max(x1, path[k, 0])
        y0, y1 = min(y0, path[k, 1]), max(y1, path[k, 1])
    now = np.empty((3, 3))
    for n in range(len(positions)):
        x, y = positions[n, 0], positions[n, 1]
        if x < x0 - high or x > x1 + high or y < y0 - high or y > y1 + high:
            continue
        count, before = 0, -1
        for k in range(1, last + 1):
            dx, dy = x - path[k, 0], y - path[k, 1]
            away = math.hypot(dx, dy)
            if not low <= away <= high:
                continue
            if opening < 2.0 * math.pi:
                off = math.atan2(dy, dx) - path[k, 2]
                if abs(math.atan2(math.sin(off), math.cos(off))) > 0.5 * opening:
                    continue
            if count == 0:
                for i in range(3):
                    for j in range(3):
                        now[i, j] = P[n, i, j] + Q[n, i, j] * step * k
            else:
                for i in range(3):
                    for j in range(3):
                        now[i, j] += Q[n, i, j] * step * (k - before)
            _look(now, R[n])
            count, before = count + 1, k
        if count == 0:
            continue
        seen += 1
        for i in range(3):
            for j in range(3):
                now[i, j] += Q[n, i, j] * step * (last - before)
        unseen = _log_det(P[n] + Q[n] * (step * last))
        reference = anticipation * unseen + (1.0 - anticipation) * _log_det(P[n])
        share = 0.5 * (reference - _log_det(now))
        gain += share
        if n == own:
            gain_own = share
    return gain_own, gain, seen


@njit(cache=True)
def single_gains(distances, P, Q, R, speed, anticipation):
    """Gain (N,) of one look at each object after driving `distances` (N,) metres to it, nat."""
    gains = np.empty(len(P))
    for n in range(len(P)):
        later = P[n] + Q[n] * (distances[n] / speed)
        unseen = _log_det(later)
        _look(later, R[n])
        gains[n] = 0.5 * (anticipation * unseen + (1.0 - anticipation) * _log_det(P[n]) - _log_det(later))
    return gains

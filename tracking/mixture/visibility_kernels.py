"""Compiled loops over what hides what, on the bearings of a sensor."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

# Gauss-Hermite points of a standard normal bearing, and their weights.
_POINTS, _WEIGHTS = np.polynomial.hermite_e.hermegauss(11)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


@njit(cache=True)
def _normal(x: float) -> float:
    """Distribution function of the standard normal."""
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@njit(cache=True)
def polar(x: float, y: float, P: Any) -> tuple[float, float, float, float]:
    """Range, bearing, and variances of both, of a position with covariance P (2, 2) seen from the origin."""
    r = max(math.hypot(x, y), 1e-9)
    c, s = x / r, y / r
    along = c * c * P[0, 0] + 2.0 * c * s * P[0, 1] + s * s * P[1, 1]
    across = s * s * P[0, 0] - 2.0 * c * s * P[0, 1] + c * c * P[1, 1]
    return r, math.atan2(y, x), max(along, 0.0), max(across, 0.0) / (r * r)


@njit(cache=True)
def _wall(walls: Any, x: float, y: float, heading: float) -> float:
    """Distance of the nearest of the segments (M, 2, 2) along a ray, inf where there is none."""
    best = np.inf
    c, s = math.cos(heading), math.sin(heading)
    for w in range(len(walls)):
        ax, ay = walls[w, 0, 0] - x, walls[w, 0, 1] - y
        bx, by = walls[w, 1, 0] - walls[w, 0, 0], walls[w, 1, 1] - walls[w, 0, 1]
        size = c * by - s * bx
        if abs(size) < 1e-12:
            continue
        t = (ax * by - ay * bx) / size
        u = (ax * s - ay * c) / size
        if t > 0.0 and 0.0 <= u <= 1.0 and t < best:
            best = t
    return best


@njit(cache=True)
def visible(
    pose: Any,
    positions: Any,
    P: Any,
    extents: Any,
    labels: Any,
    others: Any,
    other_P: Any,
    other_extents: Any,
    other_labels: Any,
    other_weights: Any,
    walls: Any,
    width: float,
    reach: float,
    opening: float,
    rate: float,
    probability: float,
    wary: bool,
) -> tuple[Any, Any, Any]:
    """Chance (J,) that a target is in sight, and the share (J,) of its `rate` returns it then gives.

    chance · (1 - exp(-rate · share)) is the probability of any return, averaged over the uncertain bearing. Third
    (J, 2), for a target that is then not seen, where it rather is, for a detection `probability` in the open: how far
    to the left of its predicted bearing, m, and the variance there, m².

    pose (3,) of the sensor; positions (J, 2), P (J, 2, 2), extents (J, 2, 2) and labels (J,) of the targets; the
    same and weights of the L `others` that may hide them, except those of a target's own label; walls (M, 2, 2);
    width : half of a body, in standard deviations of its returns; reach, m, and opening, rad, of the sensor;
    wary : what is half covered may as well be hidden wholly, as outlines are not known that well.
    """
    J, L = len(positions), len(others)
    chance, share, unseen = np.empty(J), np.empty(J), np.empty((J, 2))
    aside = np.empty((L, 6))
    for o in range(L):
        x, y = others[o, 0] - pose[0], others[o, 1] - pose[1]
        r, bearing, along, across = polar(x, y, other_P[o])
        _, _, depth, body = polar(x, y, other_extents[o])
        aside[o, 0], aside[o, 1] = r, bearing
        aside[o, 2], aside[o, 3] = along, across
        aside[o, 4] = width * math.sqrt(body)
        aside[o, 5] = depth
    for j in range(J):
        x, y = positions[j, 0] - pose[0], positions[j, 1] - pose[1]
        r, bearing, along, across = polar(x, y, P[j])
        _, _, depth, body = polar(x, y, extents[j])
        # What is seen of a half-hidden target is not its middle: its bearing is no better known than its body is wide.
        total = across + body + 1e-18
        any_return, mean, square = 0.0, 0.0, 0.0
        missed, turned, turned_square = 0.0, 0.0, 0.0
        for q in range(len(_POINTS)):
            angle = bearing + _POINTS[q] * math.sqrt(total)
            away = math.sqrt(along + depth) + 1e-9
            seen = _normal((reach - r) / away)
            if opening < 2.0 * math.pi:
                turn = (angle - pose[2] + math.pi) % (2.0 * math.pi) - math.pi
                seen *= _normal((0.5 * opening - abs(turn)) / (math.sqrt(body) + 1e-9))
            if len(walls) > 0:
                # Three rays over the target: its middle and a standard deviation of its returns to both sides.
                blocked = 0.0
                for side in range(-1, 2):
                    wall = _wall(walls, pose[0], pose[1], angle + side * math.sqrt(body))
                    blocked += (0.5 if side == 0 else 0.25) * _normal((r - wall) / away)
                seen *= 1.0 - blocked
            for o in range(L):
                if other_labels[o] == labels[j]:
                    continue
                turn = (angle - aside[o, 1] + math.pi) % (2.0 * math.pi) - math.pi
                blur = math.sqrt(body + aside[o, 3]) + 1e-9
                if abs(turn) > aside[o, 4] + 5.0 * blur:
                    continue
                covered = _normal((aside[o, 4] - turn) / blur) - _normal((-aside[o, 4] - turn) / blur)
                # Bodies that touch stand side by side.
                gap = r - aside[o, 0] - 2.0 * math.sqrt(depth + aside[o, 5])
                behind = _normal(gap / math.sqrt(along + aside[o, 2] + 0.1 * (depth + aside[o, 5])))
                seen *= 1.0 - min(other_weights[o], 1.0) * covered * behind
            some = -math.expm1(-rate * seen)
            if wary:
                some *= seen
            any_return += _WEIGHTS[q] * some
            miss = _WEIGHTS[q] * (1.0 - probability * some)
            missed += miss
            turned += miss * _POINTS[q]
            turned_square += miss * _POINTS[q] * _POINTS[q]
            mean += _WEIGHTS[q] * seen
            square += _WEIGHTS[q] * seen * seen
        # The share where it is seen: one that is hidden or not by half a chance shows wholly or not at all.
        share[j] = min(max(square / max(mean, 1e-12), 1e-3), 1.0)
        chance[j] = min(any_return / -math.expm1(-rate * share[j]), 1.0)
        turned /= max(missed, 1e-300)
        spread = max(turned_square / max(missed, 1e-300) - turned * turned, 1e-3)
        unseen[j, 0] = r * across / math.sqrt(total) * turned
        unseen[j, 1] = r * r * (across - across * across / total * (1.0 - min(spread, 1.0)))
    return chance, share, unseen

"""Compiled loops over what hides what, on the bearings of a sensor."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

# Gauss-Hermite points of a standard normal bearing, and their weights.
_POINTS, _WEIGHTS = np.polynomial.hermite_e.hermegauss(11)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


@njit(cache=True)
def _normal(x: float) -> float:
    """Distribution function of the standard normal."""
    return 0.5 * math.erfc(-x * math.sqrt(0.5))


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


class PlacedBodies(NamedTuple):
    """positions (J, 2), their covariances P (J, 2, 2), extents (J, 2, 2), labels (J,) and weights (J,)."""

    positions: Any
    P: Any
    extents: Any
    labels: Any
    weights: Any


class SightSensor(NamedTuple):
    """pose (3,), walls (M, 2, 2) that it does not see through, its reach, m, and opening, rad."""

    pose: Any
    walls: Any
    reach: float
    opening: float


class Returns(NamedTuple):
    """width : half of a body, in standard deviations of its returns. rate : returns in the open, with `probability`.
    wary : what is half covered may as well be hidden wholly, as outlines are not known that well."""

    width: float
    rate: float
    probability: float
    wary: bool


@njit(cache=True)
def _shadows(others: Any, pose: Any, width: float) -> Any:
    """Range, bearing, variances of both, half width in bearing, and depth (m²) of bodies, (L, 6)."""
    aside = np.empty((len(others.positions), 6))
    for o in range(len(aside)):
        x, y = others.positions[o, 0] - pose[0], others.positions[o, 1] - pose[1]
        aside[o, 0], aside[o, 1], aside[o, 2], aside[o, 3] = polar(x, y, others.P[o])
        _, _, depth, body = polar(x, y, others.extents[o])
        aside[o, 4], aside[o, 5] = width * math.sqrt(body), depth
    return aside


@njit(cache=True)
def _in_reach(sensor: Any, r: float, angle: float, away: float, body: float) -> float:
    """Chance that a body of a variance in bearing, at a range with deviation `away`, is in view before all walls."""
    seen = _normal((sensor.reach - r) / away)
    if sensor.opening < 2.0 * math.pi:
        turn = (angle - sensor.pose[2] + math.pi) % (2.0 * math.pi) - math.pi
        seen *= _normal((0.5 * sensor.opening - abs(turn)) / (math.sqrt(body) + 1e-9))
    if len(sensor.walls) > 0:
        # Three rays over the target: its middle and a standard deviation of its returns to both sides.
        blocked = 0.0
        for side in range(-1, 2):
            wall = _wall(sensor.walls, sensor.pose[0], sensor.pose[1], angle + side * math.sqrt(body))
            blocked += 0.5 / (1 + abs(side)) * _normal((r - wall) / away)
        seen *= 1.0 - blocked
    return seen


@njit(cache=True)
def _uncovered(
    shadow: Any, weight: float, r: float, angle: float, along: float, depth: float, body: float
) -> float:
    """Share of a body that another one, of a row of `_shadows`, does not hide."""
    turn = (angle - shadow[1] + math.pi) % (2.0 * math.pi) - math.pi
    blur = math.sqrt(body + shadow[3]) + 1e-9
    if abs(turn) > shadow[4] + 5.0 * blur:
        return 1.0
    covered = _normal((shadow[4] - turn) / blur) - _normal((-shadow[4] - turn) / blur)
    # Bodies that touch stand side by side.
    gap = r - shadow[0] - 2.0 * math.sqrt(depth + shadow[5])
    behind = _normal(gap / math.sqrt(along + shadow[2] + 0.1 * (depth + shadow[5])))
    return 1.0 - min(weight, 1.0) * covered * behind


@njit(cache=True)
def visible(
    targets: PlacedBodies, others: PlacedBodies, sensor: SightSensor, returns: Returns
) -> tuple[Any, Any, Any]:
    """Chance (J,) that a target is in sight, and the share (J,) of its `rate` returns it then gives.

    chance · (1 - exp(-rate · share)) is the probability of any return, averaged over the uncertain bearing. Third
    (J, 2), for a target that is then not seen, where it rather is: how far to the left of its predicted bearing, m,
    and the variance there, m². `others` hide targets, but none of their own label.
    """
    J, rate = len(targets.positions), returns.rate
    chance, share, unseen = np.empty(J), np.empty(J), np.empty((J, 2))
    shadows = _shadows(others, sensor.pose, returns.width)
    for j in range(J):
        x, y = targets.positions[j, 0] - sensor.pose[0], targets.positions[j, 1] - sensor.pose[1]
        r, bearing, along, across = polar(x, y, targets.P[j])
        _, _, depth, body = polar(x, y, targets.extents[j])
        # What is seen of a half-hidden target is not its middle: its bearing is no better known than its body is wide.
        total = across + body + 1e-18
        any_return, mean, square = 0.0, 0.0, 0.0
        missed, turned, turned_square = 0.0, 0.0, 0.0
        for q in range(len(_POINTS)):
            angle = bearing + _POINTS[q] * math.sqrt(total)
            seen = _in_reach(sensor, r, angle, math.sqrt(along + depth) + 1e-9, body)
            for o in range(len(shadows)):
                if others.labels[o] != targets.labels[j]:
                    seen *= _uncovered(shadows[o], others.weights[o], r, angle, along, depth, body)
            some = -math.expm1(-rate * seen)
            if returns.wary:
                some *= seen
            any_return += _WEIGHTS[q] * some
            miss = _WEIGHTS[q] * (1.0 - returns.probability * some)
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

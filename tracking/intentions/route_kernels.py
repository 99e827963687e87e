"""Compiled loops over remembered walks: how well each explains a partial one, and where the explained ends gather."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray

IntArray = NDArray[np.int64]
# Twice the negative log-likelihood beyond which a walk explains nothing, and its past need not be looked at.
FAR = 80.0
# The edge of a goal is worn by this share of its radius, as people leave by one door some centimetres apart; ends up to
# NEAR_BY radii away count by NEARNESS.
EDGE, NEAR_BY, NEARNESS = 0.1, 3.0, 0.003


@njit(cache=True)
def match(
    points: FloatArray,
    directions: FloatArray,
    bounds: IntArray,
    reverse: bool,
    here: FloatArray,
    start: FloatArray,
    backs: FloatArray,
    heading: FloatArray,
    firmness: float,
    scales: FloatArray,
) -> tuple[FloatArray, IntArray]:
    """Log-likelihood (W,) of a partial walk under each remembered one, and the point (W,) where it has got to.

    points, directions (P, 2) of all walks, walk w rows bounds[w] to bounds[w + 1]; `reverse` walks them backwards.
    The partial walk is at `here`, began at `start`, was at `backs` (B, 2) before and goes along `heading` (2,), which
    counts by `firmness` in [0, 1]. Scales: m off the route, turn, m off the start, m off the past, turn to the goal.
    """
    count = len(bounds) - 1
    logs = np.empty(count)
    reached = np.empty(count, dtype=np.int64)
    sign = -1.0 if reverse else 1.0
    for w in range(count):
        low, high = bounds[w], bounds[w + 1]
        origin, end = (high - 1, low) if reverse else (low, high - 1)
        best, at = np.inf, low
        for p in range(low, high):
            x, y = points[p, 0] - here[0], points[p, 1] - here[1]
            cost = (x * x + y * y) / scales[0] ** 2
            if cost < best:
                against = 1.0 - sign * (directions[p, 0] * heading[0] + directions[p, 1] * heading[1])
                cost += firmness * against / scales[1]
                # The first of equals, in the direction of walking.
                if cost < best or (reverse and cost == best):
                    best, at = cost, p
        reached[w] = at
        total = best
        x, y = points[origin, 0] - start[0], points[origin, 1] - start[1]
        total += (x * x + y * y) / scales[2] ** 2
        first, last = (at, high) if reverse else (low, at + 1)
        past = 0.0
        for b in range(len(backs) if total < FAR else 0):
            nearest = np.inf
            for p in range(first, last):
                x, y = points[p, 0] - backs[b, 0], points[p, 1] - backs[b, 1]
                nearest = min(nearest, x * x + y * y)
            past += nearest
        if len(backs):
            total += past / len(backs) / scales[3] ** 2
        x, y = points[end, 0] - here[0], points[end, 1] - here[1]
        length = math.sqrt(x * x + y * y)
        if length > 0.0:
            total += firmness * (1.0 - (x * heading[0] + y * heading[1]) / length) / scales[4]
        logs[w] = -0.5 * total
    return logs, reached


@njit(cache=True)
def _worth(square: float, radius: float) -> float:
    """What an end at a squared distance adds to a goal: one within `radius`, nothing beyond, with a worn edge.

    A little is left for what is near by, so that among places that take in the same ends the one amid them is best.
    """
    wide = (NEAR_BY * radius) ** 2
    if square >= wide:
        return 0.0
    inside = 0.0
    if square <= ((1.0 - EDGE) * radius) ** 2:
        inside = 1.0
    elif square < ((1.0 + EDGE) * radius) ** 2:
        inside = 0.5 + (radius - math.sqrt(square)) / (2.0 * EDGE * radius)
    return inside + NEARNESS * (1.0 - square / wide)


@njit(cache=True)
def gather(ends: FloatArray, weights: FloatArray, radius: float, most: int) -> tuple[FloatArray, FloatArray]:
    """Places (G, 2) within `radius` m of which most of the weighted ends (W, 2) lie, and their share (G,).

    The first is the place that is most probably within `radius` of where the person goes, which is what it is judged
    by: the least expected loss, where the heaviest end or mode only is the most probable point. It takes all ends
    around it, then comes the next.
    """
    count = len(ends)
    worth, around = np.empty((count, count)), np.empty((count, count))
    for i in range(count):
        for j in range(i + 1):
            x, y = ends[j, 0] - ends[i, 0], ends[j, 1] - ends[i, 1]
            square = x * x + y * y
            worth[i, j] = worth[j, i] = _worth(square, radius)
            around[i, j] = around[j, i] = max(0.0, 1.0 - square / (2.0 * radius) ** 2)
    left = weights.copy()
    goals = np.empty((most, 2))
    shares = np.empty(most)
    found = 0
    while found < most:
        best, at = 0.0, -1
        widest, amid = 0.0, -1
        for i in range(count):
            if left[i] <= 0.0:
                continue
            mass, wide = 0.0, 0.0
            for j in range(count):
                mass += left[j] * worth[i, j]
                wide += left[j] * around[i, j]
            if mass > best:
                best, at = mass, i
            if wide > widest:
                widest, amid = wide, i
        if at < 0 or (found and best < 1e-4):
            break
        # The best place may lie between ends none of which is the best by itself.
        place, value = _refined(ends, left, ends[at], radius)
        goals[found, 0], goals[found, 1] = place
        if amid != at:
            place, other = _refined(ends, left, ends[amid], radius)
            if other > value:
                goals[found, 0], goals[found, 1] = place
        share = 0.0
        for j in range(count):
            x, y = ends[j, 0] - goals[found, 0], ends[j, 1] - goals[found, 1]
            if x * x + y * y <= ((1.0 + EDGE) * radius) ** 2:
                share += left[j]
                left[j] = 0.0
        if share <= 0.0:
            break
        shares[found] = share
        found += 1
    return goals[:found], shares[:found]


@njit(cache=True)
def _refined(
    ends: FloatArray, weights: FloatArray, first: FloatArray, radius: float
) -> tuple[FloatArray, float]:
    """The best place (2,) around an end `first`, and what it is worth: grids of 5 x 5, each half as wide."""
    near = np.empty(len(ends), dtype=np.int64)
    count = 0
    ux, uy = 0.0, 0.0
    for j in range(len(ends)):
        x, y = ends[j, 0] - first[0], ends[j, 1] - first[1]
        if weights[j] > 0.0 and x * x + y * y < ((NEAR_BY + 2.0) * radius) ** 2:
            near[count] = j
            count += 1
            ux, uy = ux + weights[j] * x, uy + weights[j] * y
    # The grids lie along the way to the middle of what is near, so that they turn with the frame.
    length = math.sqrt(ux * ux + uy * uy)
    ux, uy = (ux / length, uy / length) if length > 1e-12 else (1.0, 0.0)
    mine, left = ends[near[:count]], weights[near[:count]]
    place, best, step = first.copy(), _mass(mine, left, first[0], first[1], radius), 0.5 * radius
    while step > 0.05 * radius:
        cx, cy = place
        for i in range(-2, 3):
            for k in range(-2, 3):
                px, py = cx + step * (i * ux - k * uy), cy + step * (i * uy + k * ux)
                mass = _mass(mine, left, px, py, radius)
                if mass > best + 1e-9:
                    place[0], place[1], best = px, py, mass
        step *= 0.5
    return place, best


@njit(cache=True)
def _mass(ends: FloatArray, weights: FloatArray, x: float, y: float, radius: float) -> float:
    """What the weighted ends (W, 2) are worth to a goal at x, y."""
    mass = 0.0
    for j in range(len(ends)):
        mass += weights[j] * _worth((ends[j, 0] - x) ** 2 + (ends[j, 1] - y) ** 2, radius)
    return mass

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
        if length > 0.3:
            total += firmness * (1.0 - (x * heading[0] + y * heading[1]) / length) / scales[4]
        logs[w] = -0.5 * total
    return logs, reached


@njit(cache=True)
def gather(
    ends: FloatArray, weights: FloatArray, width: float, radius: float, most: int
) -> tuple[FloatArray, FloatArray]:
    """Places (G, 2) where weighted ends (W, 2) gather, and their share (G,), heaviest first.

    The heaviest mode of a Gaussian kernel of standard deviation `width` takes all ends within `radius`, then the next.
    """
    count = len(ends)
    kernel = np.empty((count, count))
    for i in range(count):
        kernel[i, i] = 1.0
        for j in range(i):
            x, y = ends[j, 0] - ends[i, 0], ends[j, 1] - ends[i, 1]
            kernel[i, j] = kernel[j, i] = math.exp(-0.5 * (x * x + y * y) / width**2)
    left = weights.copy()
    goals = np.empty((most, 2))
    shares = np.empty(most)
    found = 0
    while found < most:
        best, at = 0.0, -1
        for i in range(count):
            if left[i] <= 0.0:
                continue
            density = 0.0
            for j in range(count):
                density += left[j] * kernel[i, j]
            if density > best:
                best, at = density, i
        if at < 0 or (found and best < 1e-4):
            break
        mass, cx, cy = 0.0, 0.0, 0.0
        for j in range(count):
            near = left[j] * kernel[at, j]
            mass, cx, cy = mass + near, cx + near * ends[j, 0], cy + near * ends[j, 1]
        goals[found, 0], goals[found, 1] = cx / mass, cy / mass
        share = 0.0
        for j in range(count):
            x, y = ends[j, 0] - goals[found, 0], ends[j, 1] - goals[found, 1]
            if j == at or x * x + y * y <= radius * radius:
                share += left[j]
                left[j] = 0.0
        shares[found] = share
        found += 1
    return goals[:found], shares[:found]

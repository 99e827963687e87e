"""Compiled correction (10) of the tracks that gave returns, and the moments of tracks that are merged."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from tracking.mixture.association_kernels import SXX, SXY, SYY, UXX, UXY, UYY, XXX, XXY, XYY, ZX, ZY, N

# Returns, fractional ones, below which a target gave but one.
LONE = 1.5


class States(NamedTuple):
    """Means (J, 4), covariances (J, 4, 4), counts (J, 2), spread (J, 2, 2) and freedom (J,), as of `Components`."""

    means: Any
    covariances: Any
    counts: Any
    spread: Any
    freedom: Any


class Exactness(NamedTuple):
    """Returns (N, 2), and (N,) by how much the variance of each is smaller, if it is all there is of a target."""

    points: Any
    exactness: Any


@njit(cache=True)
def correct(
    states: States, rows: Any, cells: Any, table: Any, shares: Any, returns: Exactness, correlation: float
) -> None:
    """Corrects the `rows` (n,) of states, in place, by cells (n, 9) of sources (n, 13) seen by `shares` (n,)."""
    for t in range(len(rows)):
        row, n = rows[t], cells[t, N]
        # The mean of returns that lie to either side of the middle, as legs do, is nearer to it than by chance.
        spread = max(1.0 + (n - 1.0) * correlation, 0.1) / n
        if n < LONE:
            spread /= returns.exactness[_nearest(returns.points, cells[t, ZX], cells[t, ZY])]
        scale = spread + 1.0 - shares[t]
        noise = np.array([table[t, XXX] * scale, table[t, XXY] * scale, table[t, XYY] * scale])
        # What returns are whose is itself uncertain: the spread of the mean over the associations.
        doubt = np.array([cells[t, UXX], cells[t, UXY], cells[t, UYY]]) / (n * n)
        _correct_one(states.means[row], states.covariances[row], cells[t, ZX], cells[t, ZY], noise, doubt)
        states.counts[row, 0] += n
        states.counts[row, 1] += shares[t]
        states.spread[row, 0, 0] += cells[t, SXX]
        states.spread[row, 0, 1] += cells[t, SXY]
        states.spread[row, 1, 0] += cells[t, SXY]
        states.spread[row, 1, 1] += cells[t, SYY]
        states.freedom[row] += max(n - 1.0, 0.0)


@njit(cache=True)
def _nearest(points: Any, x: float, y: float) -> int:
    """Index of the point (N, 2) nearest to (x, y)."""
    best, least = 0, math.inf
    for i in range(len(points)):
        square = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
        if square < least:
            best, least = i, square
    return best


@njit(cache=True)
def _correct_one(mean: Any, P: Any, x: float, y: float, noise: Any, doubt: Any) -> None:
    """State (4,), (4, 4) by a place whose noise is (3,) xx, xy, yy; `doubt` (3,) spreads it, but for the gain."""
    a, b, d = P[0, 0] + noise[0], P[0, 1] + noise[1], P[1, 1] + noise[2]
    determinant = a * d - b * b
    gain = np.empty((4, 2))
    for i in range(4):
        gain[i, 0] = (P[i, 0] * d - P[i, 1] * b) / determinant
        gain[i, 1] = (P[i, 1] * a - P[i, 0] * b) / determinant
    dx, dy = x - mean[0], y - mean[1]
    for i in range(4):
        mean[i] += gain[i, 0] * dx + gain[i, 1] * dy
    # (I - K H) P (I - K H)' + K R K'.
    left = np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            left[i, j] = P[i, j] - gain[i, 0] * P[0, j] - gain[i, 1] * P[1, j]
    xx, xy, yy = noise[0] + doubt[0], noise[1] + doubt[1], noise[2] + doubt[2]
    for i in range(4):
        u, v = gain[i, 0] * xx + gain[i, 1] * xy, gain[i, 0] * xy + gain[i, 1] * yy
        for j in range(4):
            kept = left[i, j] - left[i, 0] * gain[j, 0] - left[i, 1] * gain[j, 1]
            P[i, j] = kept + u * gain[j, 0] + v * gain[j, 1]


@njit(cache=True)
def moments(states: States, weights: Any, target: Any) -> tuple[Any, States]:
    """Total weights (J,) of the rows that each takes up, and their moments; all 0 where a row takes up none.

    weights (J,), target (J,) : the row each is taken up by.
    """
    J = len(target)
    totals = np.zeros(J)
    for r in range(J):
        totals[target[r]] += weights[r]
    merged = States(
        np.zeros_like(states.means),
        np.zeros_like(states.covariances),
        np.zeros_like(states.counts),
        np.zeros_like(states.spread),
        np.zeros_like(states.freedom),
    )
    for r in range(J):
        t = target[r]
        share = weights[r] / max(totals[t], 1e-300)
        for i in range(4):
            merged.means[t, i] += share * states.means[r, i]
        for i in range(2):
            merged.counts[t, i] += share * states.counts[r, i]
            for j in range(2):
                merged.spread[t, i, j] += share * states.spread[r, i, j]
        merged.freedom[t] += share * states.freedom[r]
    for r in range(J):
        t = target[r]
        share = weights[r] / max(totals[t], 1e-300)
        for i in range(4):
            x = states.means[r, i] - merged.means[t, i]
            for j in range(4):
                spread = x * (states.means[r, j] - merged.means[t, j])
                merged.covariances[t, i, j] += share * (states.covariances[r, i, j] + spread)
    return totals, merged

"""Correlative search: which motions lay one scan's points on the other's, without following a gradient.

Every rotation and translation of a window is scored on a raster of the target; blocks of translations are
bounded from above on rasters of block-wise maxima and opened only where they can still win (branch and bound).
Several separate maxima are returned: the highest is not always the right one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from registration.laser.submap import CELL, FAR

ROUGH = 0.2  # metres that points may be off where a candidate puts them
DONE = 1 << 40  # above all scores
WIDE = 2.5  # metres from which on a window is searched by larger blocks, each twice as wide as the one below
SLOPE = np.array([16, 10, 3], dtype=np.uint8)  # score of a point by its distance from a target's, in cells


@njit(cache=True)
def _rasters(points, origin, width, height, levels):  # type: ignore[no-untyped-def]
    """Score of each cell, and for level l the maximum over the 2^l cells to the right and above; flattened."""
    rasters = np.zeros((levels + 1, height, width), dtype=np.uint8)
    finest = rasters[0]
    for k in range(len(points)):
        i = math.floor((points[k, 0] - origin[0]) / CELL)
        j = math.floor((points[k, 1] - origin[1]) / CELL)
        for b in range(max(j - 2, 0), min(j + 3, height)):
            for a in range(max(i - 2, 0), min(i + 3, width)):
                finest[b, a] = max(finest[b, a], SLOPE[max(abs(a - i), abs(b - j))])
    for level in range(1, levels + 1):
        half = 1 << (level - 1)
        finer, coarser = rasters[level - 1], rasters[level]
        for b in range(height):
            for a in range(width):
                coarser[b, a] = finer[b, a]
            _larger(finer[b, : width - half], finer[b, half:], coarser[b])
        for b in range(height - half):
            _larger(coarser[b], coarser[b + half], coarser[b])
    return rasters.reshape(levels + 1, height * width)


@njit(cache=True)
def _larger(a, b, out):  # type: ignore[no-untyped-def]
    for k in range(len(a)):
        out[k] = max(a[k], b[k])


@njit(cache=True, inline="always")
def _score(raster, cells, count, shift):  # type: ignore[no-untyped-def]
    total = 0
    for k in range(count):
        # Signed numbers would be looked at for being counted from the end, which takes as long again.
        total += raster[np.uint64(cells[k] + shift)]
    return total


@njit(cache=True, inline="always")
def _four_scores(raster, cells, count, shift, right, up, scores):  # type: ignore[no-untyped-def]
    """`_score` of four shifts: each cell is read once."""
    s0 = s1 = s2 = s3 = 0
    for k in range(count):
        at = cells[k] + shift
        s0 += raster[np.uint64(at)]
        s1 += raster[np.uint64(at + right)]
        s2 += raster[np.uint64(at + up)]
        s3 += raster[np.uint64(at + up + right)]
    scores[0], scores[1], scores[2], scores[3] = s0, s1, s2, s3


@njit(cache=True)
def _descend(rasters, cells, count, width, level, i, j, bound, least):  # type: ignore[no-untyped-def]
    """Best leaf below block (i, j) of `level`, whose score is `bound`, above `least`: score, i, j."""
    best, best_i, best_j = least, i, j
    stack = np.empty((4 * (level + 1), 4), dtype=np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = level, i, j, bound
    size = 1
    scores = np.empty(4, dtype=np.int64)
    while size:
        size -= 1
        at, x, y, score = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
        if score <= best:
            continue
        if at == 0:
            best, best_i, best_j = score, x, y
            continue
        half = 1 << (at - 1)
        _four_scores(rasters[at - 1], cells, count, y * width + x, half, half * width, scores)
        for _ in range(4):
            # Lowest first, so that the most promising child ends on top of the stack.
            child = 0
            for other in range(1, 4):
                if scores[other] < scores[child]:
                    child = other
            if scores[child] > best:
                stack[size, 0], stack[size, 3] = at - 1, scores[child]
                stack[size, 1] = x + half * (child & 1)
                stack[size, 2] = y + half * (child >> 1)
                size += 1
            scores[child] = DONE
    return best, best_i, best_j


@njit(cache=True)
def _project(points, origin, width, height, margin, x0, y0, turn, cells):  # type: ignore[no-untyped-def]
    """Raster cells of the turned points that stay inside for every translation; returns how many."""
    c, s = math.cos(turn), math.sin(turn)
    count = 0
    for k in range(len(points)):
        x = x0 + c * points[k, 0] - s * points[k, 1]
        y = y0 + s * points[k, 0] + c * points[k, 1]
        i = math.floor((x - origin[0]) / CELL)
        j = math.floor((y - origin[1]) / CELL)
        if margin <= i < width - margin and margin <= j < height - margin:
            cells[count] = j * width + i
            count += 1
    return count


@njit(cache=True)
def _search(points, rasters, width, height, origin, centre, half, turns, keep, most):  # type: ignore[no-untyped-def]
    """Best pose of each promising block: rows of score, x, y, yaw, unordered."""
    levels = len(rasters) - 1
    size = 1 << levels
    blocks = (2 * half) // size + 1
    margin = half + size
    cells = np.empty((len(turns), len(points)), dtype=np.int32)
    counts = np.empty(len(turns), dtype=np.int64)
    bounds = np.empty(len(turns) * blocks * blocks, dtype=np.int64)
    at = 0
    for t in range(len(turns)):
        counts[t] = _project(points, origin, width, height, margin, centre[0], centre[1], turns[t], cells[t])
        for u in range(blocks):
            for v in range(blocks):
                shift = (v * size - half) * width + u * size - half
                bounds[at] = _score(rasters[levels], cells[t], counts[t], shift)
                at += 1
    found = np.empty((most, 4))
    count = best = 0
    # Only blocks that can still win are put in order: what has no chance is most of them.
    least = int(keep * keep * np.max(bounds))
    worth = np.flatnonzero(bounds > least)
    for rank in np.argsort(-bounds[worth]):
        b = worth[rank]
        least = int(keep * best)
        if bounds[b] <= least or count == most:
            break
        t, rest = b // (blocks * blocks), b % (blocks * blocks)
        i, j = (rest // blocks) * size - half, (rest % blocks) * size - half
        score, x, y = _descend(rasters, cells[t], counts[t], width, levels, i, j, bounds[b], least)
        if score > least:
            found[count, 0], found[count, 3] = score, turns[t]
            found[count, 1], found[count, 2] = centre[0] + x * CELL, centre[1] + y * CELL
            count += 1
            best = max(best, score)
    return found[:count]


@njit(cache=True)
def _separate(found, apart, turned, most):  # type: ignore[no-untyped-def]
    """The highest of each group of neighbouring poses, best first."""
    order = np.argsort(-found[:, 0])
    chosen = np.empty(most, dtype=np.int64)
    count = 0
    for rank in order:
        lone = True
        for k in range(count):
            other = chosen[k]
            turn = found[rank, 3] - found[other, 3]
            turn = abs(math.atan2(math.sin(turn), math.cos(turn)))
            away = math.hypot(found[rank, 1] - found[other, 1], found[rank, 2] - found[other, 2])
            if turn < turned and away < apart:
                lone = False
                break
        if lone:
            chosen[count] = rank
            count += 1
            if count == most:
                break
    return found[chosen[:count]]


@njit(cache=True)
def thinned(points, count):  # type: ignore[no-untyped-def]
    """At most about `count` of `points` (N, 2) in beam order, evenly spread along the outline, not over beams."""
    n = len(points)
    if n <= count:
        return points.copy()
    along = np.zeros(n)
    for k in range(1, n):
        # A jump between objects is no outline.
        step = math.hypot(points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1])
        along[k] = along[k - 1] + min(step, 0.25)
    chosen = np.empty((n, 2))
    kept, slot = 0, -1
    for k in range(n):
        at = int(along[k] / max(along[n - 1], 1e-9) * count)
        if at > slot:
            chosen[kept, 0], chosen[kept, 1] = points[k, 0], points[k, 1]
            kept, slot = kept + 1, at
    return chosen[:kept].copy()


@njit(cache=True)
def _candidates(source, target, centre, reach, turn, levels, keep, most, count):  # type: ignore[no-untyped-def]
    half = math.ceil(reach / CELL)
    margin = half + 2 * (1 << levels) + 3
    low, high = np.full(2, math.inf), np.full(2, -math.inf)
    near = np.empty((len(target), 2))
    kept = 0
    for k in range(len(target)):
        if target[k, 0] * target[k, 0] + target[k, 1] * target[k, 1] <= FAR * FAR:
            for a in range(2):
                near[kept, a] = target[k, a]
                low[a], high[a] = min(low[a], target[k, a]), max(high[a], target[k, a])
            kept += 1
    if len(source) < 5 or kept < 5:
        return np.zeros((0, 4))
    thin = thinned(source, count)
    far = np.empty(len(thin))
    for k in range(len(thin)):
        far[k] = math.hypot(thin[k, 0], thin[k, 1])
    arm = max(np.median(far), 0.5)
    origin = low - margin * CELL
    width = int((high[0] - origin[0]) / CELL) + margin + 1
    height = int((high[1] - origin[1]) / CELL) + margin + 1
    rasters = _rasters(near[:kept], origin, width, height, levels)
    step = min(max(1.5 * CELL / arm, math.radians(1.0)), math.radians(4.0))
    sides = math.ceil(turn / step)
    turns = np.empty(2 * sides + 1)
    for t in range(2 * sides + 1):
        turns[t] = centre[2] + (t - sides) * turn / max(sides, 1)
    found = _search(thin, rasters, width, height, origin, centre, half, turns, keep, 400)
    chosen = _separate(found, 0.3, math.radians(8.0), most)
    for k in range(len(chosen)):
        chosen[k, 0] /= SLOPE[0] * len(thin)
    return chosen


class Wanted(NamedTuple):
    """keep : share of the best score that another candidate needs. most : candidates. points : of the source, used."""

    keep: float = 0.85
    most: int = 4
    points: int = 80


USUAL = Wanted()


def candidates(
    source: FloatArray,
    target: FloatArray,
    centre: FloatArray,
    reach: float,
    turn: float,
    wanted: Wanted = USUAL,
) -> NDArray[np.float64]:
    """Motions that lay `source` (N, 2) on `target` (M, 2), sensor frames, points in beam order.

    centre : (3,) x, y, yaw the search is centred on. reach : metres to either side in x and y.
    turn : radians to either side.

    Returns
    -------
    (K, 4) : score in [0, 1], x, y, yaw; best first, K <= `wanted.most`, apart by 0.3 m or 8 degrees at least.
    """
    levels = 2 if reach < WIDE else 4
    return np.asarray(_candidates(source, target, centre, reach, turn, levels, *wanted))

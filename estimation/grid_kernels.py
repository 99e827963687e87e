"""Compiled walks through a grid of cells. Positions are in cells: cell (j, i) spans i to i + 1 in x, j in y."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def _setup(x, d):  # type: ignore[no-untyped-def]
    """First cell, step, way to the first border and between borders along one axis."""
    i = math.floor(x)
    if d > 0.0:
        return i, 1, (i + 1.0 - x) / d, 1.0 / d
    if d < 0.0:
        return i, -1, (i - x) / d, -1.0 / d
    return i, 0, math.inf, math.inf


@njit(cache=True)
def _mark_ray(marks, touched, count, x, y, ex, ey):  # type: ignore[no-untyped-def]
    """Mark the cells from (x, y) up to, without, that of (ex, ey); both inside."""
    i, step_i, next_i, per_i = _setup(x, ex - x)
    j, step_j, next_j, per_j = _setup(y, ey - y)
    last_i, last_j = math.floor(ex), math.floor(ey)
    for _ in range(abs(last_i - i) + abs(last_j - j)):
        if marks[j, i] == 0:
            marks[j, i] = 1
            touched[count, 0], touched[count, 1] = j, i
            count += 1
        if next_i < next_j:
            i += step_i
            next_i += per_i
        else:
            j += step_j
            next_j += per_j
        if i < 0 or j < 0 or i >= marks.shape[1] or j >= marks.shape[0]:
            break
    return count


@njit(cache=True)
def mark_scan(log_odds, start, ends, hit, miss, most):  # type: ignore[no-untyped-def]
    """Add one scan from `start` (2,) to `ends` (N, 2); each cell changes once, a hit outweighs a pass.

    ValueError, and nothing is changed, where one of them is not inside the grid.
    """
    height, width = log_odds.shape
    inside = 0.0 <= start[0] < width and 0.0 <= start[1] < height
    for k in range(len(ends)):
        inside &= 0.0 <= ends[k, 0] < width and 0.0 <= ends[k, 1] < height
    if not inside:
        raise ValueError("a scan that ends outside of the grid")
    low_i = high_i = math.floor(start[0])
    low_j = high_j = math.floor(start[1])
    for k in range(len(ends)):
        i, j = math.floor(ends[k, 0]), math.floor(ends[k, 1])
        low_i, high_i = min(low_i, i), max(high_i, i)
        low_j, high_j = min(low_j, j), max(high_j, j)
    # Marks of the scan's own window only: the map may be many times larger.
    marks = np.zeros((high_j - low_j + 1, high_i - low_i + 1), dtype=np.uint8)
    touched = np.empty((marks.size, 2), dtype=np.int32)
    count = 0
    for k in range(len(ends)):
        count = _mark_ray(
            marks,
            touched,
            count,
            start[0] - low_i,
            start[1] - low_j,
            ends[k, 0] - low_i,
            ends[k, 1] - low_j,
        )
    for k in range(len(ends)):
        i, j = math.floor(ends[k, 0]) - low_i, math.floor(ends[k, 1]) - low_j
        if marks[j, i] == 0:
            touched[count, 0], touched[count, 1] = j, i
            count += 1
        marks[j, i] = 2
    for k in range(count):
        j, i = touched[k, 0], touched[k, 1]
        change = hit if marks[j, i] == 2 else miss
        value = log_odds[j + low_j, i + low_i] + change
        log_odds[j + low_j, i + low_i] = min(max(value, -most), most)


@njit(cache=True)
def cast_rays(log_odds, start, angles, reach, occupied, free, through):  # type: ignore[no-untyped-def]
    """Cells to the border of the first blocking cell along each angle, inf without one within `reach`."""
    height, width = log_odds.shape
    found = np.full(len(angles), math.inf)
    for k in range(len(angles)):
        i, step_i, next_i, per_i = _setup(start[0], math.cos(angles[k]))
        j, step_j, next_j, per_j = _setup(start[1], math.sin(angles[k]))
        away = 0.0
        while away <= reach:
            inside = 0 <= i < width and 0 <= j < height
            value = log_odds[j, i] if inside else 0.0
            if value > occupied or (not through and value >= free):
                found[k] = away
                break
            if not inside and (
                (i < 0 and step_i <= 0)
                or (j < 0 and step_j <= 0)
                or (i >= width and step_i >= 0)
                or (j >= height and step_j >= 0)
            ):
                break
            if next_i < next_j:
                away = next_i
                i += step_i
                next_i += per_i
            else:
                away = next_j
                j += step_j
                next_j += per_j
    return found


@njit(cache=True)
def mark_visible(log_odds, seen, start, angles, reach, free, margin):  # type: ignore[no-untyped-def]
    """Mark the cells along each angle up to and with the first that is not free."""
    height, width = log_odds.shape
    for k in range(len(angles)):
        i, step_i, next_i, per_i = _setup(start[0], math.cos(angles[k]))
        j, step_j, next_j, per_j = _setup(start[1], math.sin(angles[k]))
        away = 0.0
        while away <= reach and 0 <= i < width and 0 <= j < height:
            if away >= margin:
                seen[j, i] = True
            if log_odds[j, i] >= free and away > 0.0:
                break
            if next_i < next_j:
                away = next_i
                i += step_i
                next_i += per_i
            else:
                away = next_j
                j += step_j
                next_j += per_j

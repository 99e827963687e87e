"""Compiled walks through a grid of cells. Positions are in cells: cell (j, i) spans i to i + 1 in x, j in y."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

TILE = 64  # cells along an edge of a tile
MOST_TILES = 1 << 22  # in the box around one scan: 6 km at 5 cm
# Steps to the cells around one: along the axes first, then across.
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


@njit(cache=True, inline="always")
def _setup(x, d):  # type: ignore[no-untyped-def]
    """First cell, step, way to the first border and between borders along one axis."""
    i = math.floor(x)
    if d > 0.0:
        return i, 1, (i + 1.0 - x) / d, 1.0 / d
    if d < 0.0:
        return i, -1, (i - x) / d, -1.0 / d
    return i, 0, math.inf, math.inf


@njit(cache=True, inline="always")
def _next(i, step_i, next_i, per_i, j, step_j, next_j, per_j):  # type: ignore[no-untyped-def]
    """The cell over the nearer border and its next borders along both axes, and how far the one crossed is."""
    if next_i < next_j:
        return i + step_i, next_i + per_i, j, next_j, next_i
    return i, next_i, j + step_j, next_j + per_j, next_j


@njit(cache=True)
def _mark_ray(table, tiles, marks, count, x, y, ex, ey):  # type: ignore[no-untyped-def]
    """Mark the cells from (x, y) up to, without, that of (ex, ey); returns the number of tiles there are then."""
    i, step_i, next_i, per_i = _setup(x, ex - x)
    j, step_j, next_j, per_j = _setup(y, ey - y)
    height, width = table.shape[0] * TILE, table.shape[1] * TILE
    here_j = here_i = at = -1
    for _ in range(abs(math.floor(ex) - i) + abs(math.floor(ey) - j)):
        if j // TILE != here_j or i // TILE != here_i:
            here_j, here_i = j // TILE, i // TILE
            at, count = _tile(table, tiles, count, here_j, here_i)
        marks[at, j % TILE, i % TILE] = 1
        i, next_i, j, next_j, _ = _next(i, step_i, next_i, per_i, j, step_j, next_j, per_j)
        if i < 0 or j < 0 or i >= width or j >= height:
            break
    return count


@njit(cache=True, inline="always")
def _tile(table, tiles, count, j, i):  # type: ignore[no-untyped-def]
    """Number of a tile of the scan, a new one where there is none yet; and how many there are then."""
    at = table[j, i]
    if at < 0:
        at = count
        table[j, i] = at
        tiles[at, 0], tiles[at, 1] = j, i
        count += 1
    return at, count


@njit(cache=True, inline="always")
def _inside(value, low, tiles):  # type: ignore[no-untyped-def]
    """A coordinate from the first cell of tile `low` on, below the end of so many tiles."""
    return min(value - low * TILE, tiles * TILE - 1e-6)


@njit(cache=True)
def _more(tiles, marks, count, need):  # type: ignore[no-untyped-def]
    """Room for at least `need` tiles; the first `count` stay."""
    room = max(need, 2 * len(marks))
    longer = np.empty((room, 2), dtype=np.int64)
    wider = np.zeros((room, TILE, TILE), dtype=np.uint8)
    for k in range(count):
        longer[k, 0], longer[k, 1] = tiles[k, 0], tiles[k, 1]
        for j in range(TILE):
            for i in range(TILE):
                wider[k, j, i] = marks[k, j, i]
    return longer, wider


@njit(cache=True)
def mark_scan(start, ends):  # type: ignore[no-untyped-def]
    """What a scan from `start` (2,) to `ends` (N, 2) says of the cells of each tile it touches.

    Returns tiles (T, 2), row and column of each in the lattice of tiles, and marks (T, TILE, TILE): 0 nothing, 1 seen
    through, 2 something is there. Coordinates are finite and within 2**31, their box has at most MOST_TILES tiles:
    the caller looks after that.
    """
    low_i = high_i = math.floor(start[0]) // TILE
    low_j = high_j = math.floor(start[1]) // TILE
    for k in range(len(ends)):
        i, j = math.floor(ends[k, 0]) // TILE, math.floor(ends[k, 1]) // TILE
        low_i, high_i = min(low_i, i), max(high_i, i)
        low_j, high_j = min(low_j, j), max(high_j, j)
    rows, columns = high_j - low_j + 1, high_i - low_i + 1
    if rows * columns > MOST_TILES:
        raise ValueError("points: the scan is too wide for a map")
    # In the scan's own box. Rounding may lift what lies just below a border onto it, and out of the box.
    x, y = _inside(start[0], low_i, columns), _inside(start[1], low_j, rows)
    placed = np.empty((len(ends), 2))
    for k in range(len(ends)):
        placed[k, 0], placed[k, 1] = _inside(ends[k, 0], low_i, columns), _inside(ends[k, 1], low_j, rows)
    table = np.full((rows, columns), -1, dtype=np.int32)
    tiles = np.empty((16, 2), dtype=np.int64)
    marks = np.zeros((16, TILE, TILE), dtype=np.uint8)
    # As a literal, what takes it would be compiled for it and again for any other.
    count: Any = np.int64(0)
    for k in range(len(placed)):
        ex, ey = placed[k]
        # A way of n steps crosses no more than n / TILE + 2 borders between tiles, and has an end.
        steps = abs(math.floor(ex) - math.floor(x)) + abs(math.floor(ey) - math.floor(y))
        need = min(count + int(steps) // TILE + 4, table.size)
        if need > len(marks):
            tiles, marks = _more(tiles, marks, count, need)
        count = _mark_ray(table, tiles, marks, count, x, y, ex, ey)
        # The end has a tile; that it is occupied is said when all ways have been walked.
        _, count = _tile(table, tiles, count, math.floor(ey) // TILE, math.floor(ex) // TILE)
    for k in range(len(placed)):
        i, j = math.floor(placed[k, 0]), math.floor(placed[k, 1])
        marks[table[j // TILE, i // TILE], j % TILE, i % TILE] = 2
    for k in range(count):
        tiles[k, 0] += low_j
        tiles[k, 1] += low_i
    return tiles[:count].copy(), marks[:count].copy()


@njit(cache=True)
def add_marks(cells, numbers, marks, hit, miss, most):  # type: ignore[no-untyped-def]
    """Change tiles `cells` (C, TILE, TILE) by a scan's `marks` (T, TILE, TILE); `numbers` (T,) -1 : left alone."""
    for k in range(len(numbers)):
        at = numbers[k]
        if at < 0 or at >= len(cells):
            continue
        for j in range(TILE):
            for i in range(TILE):
                if marks[k, j, i] > 0:
                    value = cells[at, j, i] + (hit if marks[k, j, i] == 2 else miss)
                    cells[at, j, i] = min(max(value, -most), most)


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
            i, next_i, j, next_j, away = _next(i, step_i, next_i, per_i, j, step_j, next_j, per_j)
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
            i, next_i, j, next_j, away = _next(i, step_i, next_i, per_i, j, step_j, next_j, per_j)


@njit(cache=True)
def close_around(open_cells, occupied, clearance):  # type: ignore[no-untyped-def]
    """Close the open cells (H, W) whose middles are nearer than `clearance` cells to that of one that is occupied."""
    height, width = open_cells.shape
    reach = math.ceil(clearance)
    for j in range(height):
        for i in range(width):
            if not occupied[j, i]:
                continue
            edge = False  # what lies inside of something is the nearest to no cell outside
            for n in range(4):
                v, u = j + NEIGHBOURS[n][0], i + NEIGHBOURS[n][1]
                edge |= 0 <= v < height and 0 <= u < width and not occupied[v, u]
            open_cells[j, i] = False
            if not edge:
                continue
            for v in range(max(j - reach, 0), min(j + reach + 1, height)):
                for u in range(max(i - reach, 0), min(i + reach + 1, width)):
                    if math.hypot(v - j, u - i) < clearance:
                        open_cells[v, u] = False


@njit(cache=True)
def way_lengths(open_cells, row, column, resolution):  # type: ignore[no-untyped-def]
    """Metres (H, W) of the shortest ways over open cells from one of them, inf where there is none, and the steps
    (H, W) that they end with, as numbers of NEIGHBOURS, -1 at the start. row : -1 where there is no start.

    Dijkstra's algorithm with a queue for each of the two lengths of a step: what enters one of them comes in order.
    """
    height, width = open_cells.shape
    lengths, steps = np.full((height, width), np.inf), np.full((height, width), -1, np.int8)
    if row < 0:
        return lengths, steps
    reached, last = lengths.ravel(), steps.ravel()
    costs = (resolution, math.hypot(1.0, 1.0) * resolution)
    queues = np.empty((2, height * width + 1), np.int64)
    heads, ends = np.zeros(2, np.int64), np.zeros(2, np.int64)
    lengths[row, column] = 0.0
    queues[0, 0], ends[0] = row * width + column, 1
    while True:
        best, nearest = -1, np.inf
        for kind in range(2):
            # What has been reached by a shorter way since, over a step of the other length, stands in the other queue.
            while heads[kind] < ends[kind] and last[queues[kind, heads[kind]]] // 4 == 1 - kind:
                heads[kind] += 1
            if heads[kind] < ends[kind] and reached[queues[kind, heads[kind]]] < nearest:
                best, nearest = kind, reached[queues[kind, heads[kind]]]
        if best < 0:
            return lengths, steps
        j, i = divmod(queues[best, heads[best]], width)
        heads[best] += 1
        for n in range(8):
            v, u = j + NEIGHBOURS[n][0], i + NEIGHBOURS[n][1]
            if not (0 <= v < height and 0 <= u < width and open_cells[v, u]):
                continue
            kind = n // 4
            length = nearest + costs[kind]
            if length < lengths[v, u]:
                lengths[v, u], steps[v, u] = length, n
                queues[kind, ends[kind]] = v * width + u
                ends[kind] += 1

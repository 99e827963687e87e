"""The compiled loops of `places.outlines` and `places.matching`: grids, and laying one outline on another.

A grid is (N, N) int8 around the place, x along the first axis: above 0 an obstacle is near (up to 100 on it), -1 is
observed free, 0 unknown. It has a margin of MARGIN unknown cells, so that a window around a point needs no check.
"""

from __future__ import annotations

import math

import numba
import numpy as np

RADIUS = 16.0
CELL = 0.25
CELLS = 128
MARGIN = 16
# Obstacles once more, finer: what tells one corridor from another is a few centimetres deep.
SHARP, SHARP_CELLS, SHARP_MARGIN = 0.125, 256, 2
# A wall where the other saw free floor counts this much against a hit of 100.
VIOLATION = 40

# Directions are told apart by y / (|x| + |y|), in so many steps around the circle.
BINS = 4096

ROTATIONS = 40
# Coarse translations: window of cells of 2 CELL; rows in steps of two cells, columns of one.
COARSE_ROWS, COARSE_COLUMNS = 7, 13
HYPOTHESES = 4
COARSE_POINTS, FINE_POINTS = 64, 128


@numba.njit(cache=True)
def thin(points, cell, limit):  # type: ignore[no-untyped-def]
    """One point per occupied cell, the mean of those in it: (K, 2) of points (N, 2) within limit."""
    side = int(2.0 * limit / cell) + 1
    index = np.full(side * side, -1, dtype=np.int32)
    sums = np.zeros((len(points), 3))
    found = 0
    for p in range(len(points)):
        x, y = points[p, 0], points[p, 1]
        if not (abs(x) < limit and abs(y) < limit):
            continue
        k = int((x + limit) / cell) * side + int((y + limit) / cell)
        if index[k] < 0:
            index[k] = found
            found += 1
        at = index[k]
        sums[at, 0] += x
        sums[at, 1] += y
        sums[at, 2] += 1.0
    # In steps of the golden section, so that any first part is spread over the whole.
    order = np.argsort((np.arange(found) * 0.6180339887498949) % 1.0)
    kept = np.empty((found, 2), dtype=np.float32)
    for k in range(found):
        at = order[k]
        kept[k, 0], kept[k, 1] = sums[at, 0] / sums[at, 2], sums[at, 1] / sums[at, 2]
    return kept


@numba.njit(cache=True)
def reach(ranges, valid, first, step, sectors):  # type: ignore[no-untyped-def]
    """How far each of `sectors` directions is seen to be free: the nearest return of the beams around it, else 0."""
    out = np.zeros(sectors)
    half = math.ceil(0.5 * abs(step) / (2.0 * math.pi) * sectors + 0.5)
    for i in range(len(ranges)):
        if not valid[i]:
            continue
        centre = math.floor((first + i * step + math.pi) / (2.0 * math.pi) * sectors)
        for k in range(centre - half, centre + half + 1):
            sector = k % sectors
            if out[sector] == 0.0 or ranges[i] < out[sector]:
                out[sector] = ranges[i]
    return out


def _angles():  # type: ignore[no-untyped-def]
    """Angle of the directions of each of BINS, (BINS,) radians: `mark_free` looks it up, as arctan2 takes long."""
    u = 4.0 * (np.arange(BINS) + 0.5) / BINS - 1.0
    x = np.where(u < 1.0, 1.0 - np.abs(u), np.abs(u - 2.0) - 1.0)
    return np.arctan2(np.where(u < 1.0, u, 2.0 - u), x)


ANGLES = _angles()


@numba.njit(cache=True)
def mark_free(free, seen, x, y, yaw):  # type: ignore[no-untyped-def]
    """Mark cells (CELLS, CELLS) that a scan at pose x, y, yaw saw through: 0.3 m short of its `reach` (sectors,)."""
    sectors = len(seen)
    squares = np.empty(BINS)
    for b in range(BINS):
        limit = max(seen[int(ANGLES[b] / (2.0 * math.pi) * sectors + 0.5 * sectors) % sectors] - 0.3, 0.0)
        squares[b] = limit * limit
    furthest = min(seen.max(), 3.0 * RADIUS)
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(CELLS):
        dx = (i + 0.5) * CELL - RADIUS - x
        if abs(dx) > furthest:
            continue
        for j in range(CELLS):
            dy = (j + 0.5) * CELL - RADIUS - y
            a, b = c * dx + s * dy, c * dy - s * dx
            u = b / max(abs(a) + abs(b), 1e-9)
            if a < 0.0:
                u = 2.0 - u
            if a * a + b * b < squares[int((u + 1.0) * (0.25 * BINS)) % BINS]:
                free[i, j] = 1


def _stamp(reach, square, cell, spread):  # type: ignore[no-untyped-def]
    """Offsets in cells around an obstacle, (K,) and (K,), and values there: a Gaussian, cut at √`square` cells."""
    offsets = [
        (a, b) for a in range(-reach, reach + 1) for b in range(-reach, reach + 1) if a * a + b * b <= square
    ]
    values = [round(100.0 * math.exp(-(a * a + b * b) * cell**2 / spread)) for a, b in offsets]
    return (*np.array(offsets, dtype=np.int64).T.copy(), np.array(values, dtype=np.int64))


# Deviations of 0.3 m and of 0.126 m.
WIDE, NARROW = _stamp(3, 9, CELL, 0.18), _stamp(2, 5, SHARP, 0.032)


@numba.njit(cache=True)
def _mark(grid, points, cell, margin, stamp):  # type: ignore[no-untyped-def]
    """Raise the cells around points (K, 2) to the values of a stamp; points outside of RADIUS are left out."""
    rows, columns, values = stamp
    for p in range(len(points)):
        if not (abs(points[p, 0]) < RADIUS and abs(points[p, 1]) < RADIUS):
            continue
        i = int((points[p, 0] + RADIUS) / cell) + margin
        j = int((points[p, 1] + RADIUS) / cell) + margin
        for k in range(len(values)):
            a, b = i + rows[k], j + columns[k]
            if grid[a, b] < values[k]:
                grid[a, b] = values[k]


@numba.njit(cache=True)
def grids(points, packed):  # type: ignore[no-untyped-def]
    """Fine grid (CELLS + 2 MARGIN, ..) and one of double cells, of outline points (K, 2) and packed free cells.

    Points outside of RADIUS are left out. ValueError where there are fewer packed cells than the grid has.
    """
    if 8 * len(packed) < CELLS * CELLS:
        raise ValueError("packed: too few free cells")
    fine = np.zeros((CELLS + 2 * MARGIN, CELLS + 2 * MARGIN), dtype=np.int8)
    for i in range(CELLS):
        for j in range(CELLS):
            k = i * CELLS + j
            if (packed[k >> 3] >> (7 - (k & 7))) & 1:
                fine[i + MARGIN, j + MARGIN] = -1
    _mark(fine, points, CELL, MARGIN, WIDE)
    half = CELLS // 2
    coarse = np.zeros((half + 2 * MARGIN, half + 2 * MARGIN), dtype=np.int8)
    for i in range(-1, half + 1):
        for j in range(-1, half + 1):
            most, free = 0, 0
            for a in range(2 * i - 1 + MARGIN, 2 * i + 3 + MARGIN):
                for b in range(2 * j - 1 + MARGIN, 2 * j + 3 + MARGIN):
                    value = fine[a, b]
                    if value > most:
                        most = value
                    elif value < 0:
                        free += 1
            # Three quarters of what a hit counts against.
            coarse[i + MARGIN, j + MARGIN] = most if most > 0 else (-30 if free >= 12 else 0)
    return fine, coarse


@numba.njit(cache=True)
def sharp_grid(points):  # type: ignore[no-untyped-def]
    """Obstacles of outline points (K, 2) in cells of SHARP, with its margin: up to 100 on a point, else 0."""
    sharp = np.zeros((SHARP_CELLS + 2 * SHARP_MARGIN, SHARP_CELLS + 2 * SHARP_MARGIN), dtype=np.int8)
    _mark(sharp, points, SHARP, SHARP_MARGIN, NARROW)
    return sharp


@numba.njit(cache=True, fastmath=True)
def _overlay(points, count, grid, cell, margin, unit, x, y, c, s):  # type: ignore[no-untyped-def]
    """Mean of a grid's cells, times `unit`, under the first `count` points, turned by (c, s) and moved by (x, y).

    Free floor counts against.
    """
    total = 0
    side = len(grid)
    ox, oy = (x + RADIUS) / cell + margin, (y + RADIUS) / cell + margin
    c, s = c / cell, s / cell
    for k in range(count):
        a = int(c * points[k, 0] - s * points[k, 1] + ox)
        b = int(s * points[k, 0] + c * points[k, 1] + oy)
        if 0 <= a < side and 0 <= b < side:
            value = grid[a, b]
            total += value if value >= 0 else -VIOLATION
    return unit * total / max(count, 1)


@numba.njit(cache=True, fastmath=True)
def _closeness(points, sharp, x, y, c, s):  # type: ignore[no-untyped-def]
    """Mean closeness of all points, turned by (c, s) and moved by (x, y), to obstacles, in [0, 1]."""
    return _overlay(points, len(points), sharp, SHARP, SHARP_MARGIN, 0.01, x, y, c, s)


@numba.njit(cache=True, fastmath=True)
def _coarse_search(points, count, coarse, poses, scores):  # type: ignore[no-untyped-def]
    """The best translation of each of the HYPOTHESES best rotations: poses (H, 3), scores (H,)."""
    cell = 2.0 * CELL
    side = CELLS // 2 + 2 * MARGIN
    window = np.zeros((COARSE_ROWS, 16), dtype=np.int32)
    scores[:] = -1e9
    for rotation in range(ROTATIONS):
        angle = 2.0 * math.pi * rotation / ROTATIONS
        c, s = math.cos(angle) / cell, math.sin(angle) / cell
        window[:] = 0
        for k in range(count):
            a = int(c * points[k, 0] - s * points[k, 1] + RADIUS / cell + MARGIN) - COARSE_ROWS + 1
            b = int(s * points[k, 0] + c * points[k, 1] + RADIUS / cell + MARGIN) - COARSE_COLUMNS // 2
            if a < 0 or b < 0 or a + 2 * COARSE_ROWS >= side or b + 16 >= side:
                continue
            for row in range(COARSE_ROWS):
                for column in range(16):
                    window[row, column] += coarse[a + 2 * row, b + column]
        most, at_row, at_column = -(2**30), 0, 0
        for row in range(COARSE_ROWS):
            for column in range(COARSE_COLUMNS):
                if window[row, column] > most:
                    most, at_row, at_column = window[row, column], row, column
        worst = 0
        for h in range(1, len(scores)):
            if scores[h] < scores[worst]:
                worst = h
        if most > scores[worst]:
            scores[worst] = most
            poses[worst, 0] = (2 * at_row - COARSE_ROWS + 1) * cell
            poses[worst, 1] = (at_column - COARSE_COLUMNS // 2) * cell
            poses[worst, 2] = angle


@numba.njit(cache=True, fastmath=True)
def _climb(points, count, grid, cell, margin, unit, pose, best, sides, step, turning):  # type: ignore[no-untyped-def]
    """Move `pose` to the best within `sides` steps of metres and radians, if above `best`; returns its `_overlay`."""
    x0, y0, t0 = pose[0], pose[1], pose[2]
    for turn in range(-sides, sides + 1):
        angle = t0 + turn * turning
        c, s = math.cos(angle), math.sin(angle)
        for i in range(-sides, sides + 1):
            for j in range(-sides, sides + 1):
                x, y = x0 + i * step, y0 + j * step
                value = _overlay(points, count, grid, cell, margin, unit, x, y, c, s)
                if value > best:
                    best = value
                    pose[0], pose[1], pose[2] = x, y, angle
    return best


@numba.njit(cache=True, fastmath=True)
def _refine(points, count, fine, pose):  # type: ignore[no-untyped-def]
    """Improve a coarse pose in place; returns its score."""
    step, turning = CELL, math.pi / ROTATIONS / 2.0
    best = _climb(points, count, fine, CELL, MARGIN, 1.0, pose, -1e9, 2, step, turning)
    for _ in range(2):
        step, turning = 0.5 * step, 0.5 * turning
        best = _climb(points, count, fine, CELL, MARGIN, 1.0, pose, best, 1, step, turning)
    return best


@numba.njit(cache=True, fastmath=True)
def _agreement(points, fine, x, y, c, s, out):  # type: ignore[no-untyped-def]
    """Of all points: mean hit, share on an obstacle, on free floor, on anything known."""
    side = CELLS + 2 * MARGIN
    hit, near, free, known = 0.0, 0, 0, 0
    for k in range(len(points)):
        a = int((c * points[k, 0] - s * points[k, 1] + x + RADIUS) / CELL + MARGIN)
        b = int((s * points[k, 0] + c * points[k, 1] + y + RADIUS) / CELL + MARGIN)
        if 0 <= a < side and 0 <= b < side:
            value = fine[a, b]
            if value > 0:
                hit += 0.01 * value
                near += value >= 40
                known += 1
            elif value < 0:
                free += 1
                known += 1
    count = max(len(points), 1)
    out[0], out[1], out[2], out[3] = hit / count, near / count, free / count, known / count


@numba.njit(cache=True, fastmath=True)
def _sharpen(points, sharp, pose):  # type: ignore[no-untyped-def]
    """Improve a pose in place by closeness in the sharp grid; returns it."""
    best, step, turning = -1.0, 0.1, math.radians(1.0)
    for _ in range(3):
        best = _climb(points, len(points), sharp, SHARP, SHARP_MARGIN, 0.01, pose, best, 1, step, turning)
        step, turning = 0.6 * step, 0.6 * turning
    return best


MATCH_FEATURES = 28


@numba.njit(cache=True, fastmath=True)
def match(pa, fa, sa, pb, fb, cb, sb, out, pose):  # type: ignore[no-untyped-def]
    """Lay outline a (points, fine and sharp grid) on b (points, fine, coarse and sharp grid).

    Fills `out` (MATCH_FEATURES,) and `pose` (3,), that of a in the frame of b.
    """
    poses, scores = np.zeros((HYPOTHESES, 3)), np.empty(HYPOTHESES)
    _coarse_search(pa, min(len(pa), COARSE_POINTS), cb, poses, scores)
    count = min(len(pa), FINE_POINTS)
    best = 0
    for h in range(HYPOTHESES):
        scores[h] = _refine(pa, count, fb, poses[h])
        if scores[h] > scores[best]:
            best = h
    x, y, t = poses[best, 0], poses[best, 1], poses[best, 2]
    second = -100.0
    for h in range(HYPOTHESES):
        turn = poses[h, 2] - t
        turn = abs(math.atan2(math.sin(turn), math.cos(turn)))
        if turn > 0.5 or (poses[h, 0] - x) ** 2 + (poses[h, 1] - y) ** 2 > 1.0:
            second = max(second, scores[h])
    pose[0], pose[1], pose[2] = x, y, t
    close = _sharpen(pa, sb, pose)
    x, y, t = pose[0], pose[1], math.atan2(math.sin(pose[2]), math.cos(pose[2]))
    pose[2] = t
    c, s = math.cos(t), math.sin(t)
    out[0], out[1] = scores[best], second
    _agreement(pa, fb, x, y, c, s, out[2:6])
    _agreement(pb, fa, -(c * x + s * y), s * x - c * y, c, -s, out[6:10])
    out[10], out[11] = min(out[3], out[7]), max(out[4], out[8])
    out[12] = math.sqrt(x * x + y * y)
    # How fast agreement is lost when sliding: a corridor is lost only across it, and its doors along it.
    for far in range(2):
        least, most = 1e9, -1e9
        for k in range(8):
            dx, dy = math.cos(math.pi * k / 8.0), math.sin(math.pi * k / 8.0)
            if far:
                ahead = _overlay(pa, count, fb, CELL, MARGIN, 1.0, x + dx, y + dy, c, s)
                behind = _overlay(pa, count, fb, CELL, MARGIN, 1.0, x - dx, y - dy, c, s)
                lost = scores[best] - 0.5 * (ahead + behind)
            else:
                ahead = _closeness(pa, sb, x + 0.4 * dx, y + 0.4 * dy, c, s)
                behind = _closeness(pa, sb, x - 0.4 * dx, y - 0.4 * dy, c, s)
                lost = close - max(ahead, behind)
            least, most = min(least, lost), max(most, lost)
        out[13 + 2 * far], out[14 + 2 * far] = least, most
    out[17], out[18] = min(len(pa), len(pb)), max(len(pa), len(pb))
    out[19], out[20] = out[3] / (out[5] + 1e-3), out[7] / (out[9] + 1e-3)
    out[21], out[22] = out[4] / (out[5] + 1e-3), out[8] / (out[9] + 1e-3)
    out[23] = abs(t)
    other = _closeness(pb, sa, -(c * x + s * y), s * x - c * y, c, -s)
    out[24], out[25] = close, other
    out[26], out[27] = close / (out[5] + 1e-3), other / (out[9] + 1e-3)

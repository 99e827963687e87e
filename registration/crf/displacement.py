"""The motion of a group of points that explains most of what a second scan saw: votes and refinement."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from estimation.geometry.sight import AGREES, THROUGH, UNSEEN, beam_at
from registration.laser.outline import length, sight
from registration.laser.rigid import SUMS, add_pair, motion_of

CELL = 0.1  # metres of the grid of displacements
PER_METRE = 1.0 / CELL
PEAKS = 4  # displacements that are refined
MANY = 240  # points of a group that are looked at
HIT = 0.7  # points of evidence that something new in the second scan is, where a motion takes a point to it
DISTANCE_COST = 4.0  # points of evidence a metre of displacement needs


class Group(NamedTuple):
    """points (n, 2) of the first scan. near, spacing (n,) : metres, see `nearness` and `Beams`. standing (n,) : whether
    each agrees with the background's motion."""

    points: Any
    near: Any
    spacing: Any
    standing: Any


class Goals(NamedTuple):
    """points (m, 2) of the second scan where a group may have gone, their weights (m,), and those that are new."""

    points: Any
    weights: Any
    fresh: Any


class Views(NamedTuple):
    """Beams (B,) of the second scan, see `Beams`. worth (B,) : of a point that is moved to where one ended."""

    xy: Any
    ranges: Any
    clear: Any
    worth: Any
    angle_min: float
    step: float


@njit(cache=True)
def _votes(moved, targets, weights, reach, votes):  # type: ignore[no-untyped-def]
    """Displacement histogram: each point of the group votes once per cell in which a target lies.

    targets : (m, 2), by ascending x.
    """
    side = votes.shape[0]
    # With a border for what is too far: cheaper than to ask of each.
    padded = np.zeros((side + 2) * (side + 2))
    last = np.full(len(padded), -1, dtype=np.int64)
    most = reach + 2.0 * CELL
    for i in range(len(moved)):
        for j in range(np.searchsorted(targets[:, 0], moved[i, 0] - most), len(targets)):
            dx, dy = targets[j, 0] - moved[i, 0], targets[j, 1] - moved[i, 1]
            if dx > most:
                break
            u = min(max(int((dx + reach) * PER_METRE), -1), side)
            v = min(max(int((dy + reach) * PER_METRE), -1), side)
            cell = (u + 1) * (side + 2) + v + 1
            padded[cell] += weights[j] * (last[cell] != i)
            last[cell] = i
    for u in range(side):
        for v in range(side):
            votes[u, v] = padded[(u + 1) * (side + 2) + v + 1]


@njit(cache=True)
def _peaks(votes, reach, most):  # type: ignore[no-untyped-def]
    """Displacements (most, 2) of the highest 3 × 3 sums, short ones preferred, apart from each other."""
    side = votes.shape[0]
    smooth = np.zeros_like(votes)
    for u in range(1, side - 1):
        for v in range(1, side - 1):
            total = 0.0
            for p in range(-1, 2):
                for q in range(-1, 2):
                    total += votes[u + p, v + q] * (1.0 if p == 0 and q == 0 else 0.5)
            away = length((u + 0.5) * CELL - reach, (v + 0.5) * CELL - reach)
            smooth[u, v] = total * (1.0 - 0.3 * away / reach)
    found = np.zeros((most, 2))
    count = 0
    for _ in range(most):
        best, bu, bv = 0.0, -1, -1
        for u in range(side):
            for v in range(side):
                if smooth[u, v] > best:
                    best, bu, bv = smooth[u, v], u, v
        if bu < 0:
            break
        found[count, 0], found[count, 1] = (bu + 0.5) * CELL - reach, (bv + 0.5) * CELL - reach
        count += 1
        smooth[max(bu - 2, 0) : bu + 3, max(bv - 2, 0) : bv + 3] = 0.0
    return found[:count]


@njit(cache=True, inline="always")
def _nearest(x, y, reach, targets):  # type: ignore[no-untyped-def]
    """Squared distance to the nearest of targets (m, 2), by ascending x, within reach, and its number, -1 for none."""
    best, found = reach * reach, -1
    middle = np.searchsorted(targets[:, 0], x)
    for side in range(2):
        j, step = (middle, 1) if side == 0 else (middle - 1, -1)
        while 0 <= j < len(targets) and (x - targets[j, 0]) ** 2 < best:
            square = (x - targets[j, 0]) ** 2 + (y - targets[j, 1]) ** 2
            if square < best:
                best, found = square, j
            j += step
    return best, found


@njit(cache=True)
def fit_group(points, spacing, background, targets, weights, sigma, motion):  # type: ignore[no-untyped-def]
    """Iterated closest points of a group, begun with and written to `motion` (3,); the rotation is held by a prior.

    targets (m, 2) : by ascending x, with their weights (m,).
    """
    sums = np.empty(SUMS)
    radius = 0.4
    for _ in range(6):
        c, s = math.cos(motion[2]), math.sin(motion[2])
        sums[:] = 0.0
        for i in range(len(points)):
            x = motion[0] + c * points[i, 0] - s * points[i, 1]
            y = motion[1] + s * points[i, 0] + c * points[i, 1]
            best, found = _nearest(x, y, max(radius, 1.5 * spacing[i]), targets)
            if found >= 0:
                width = 0.05 + spacing[i]
                weight = weights[found] / (1.0 + best / (width * width))
                add_pair(sums, points[i, 0], points[i, 1], targets[found, 0], targets[found, 1], weight)
        stiffness = 0.05 * 0.05 / (sigma * sigma)
        if not motion_of(sums, background[2], stiffness, motion):
            return False
        radius = max(0.75 * radius, 0.12)
    return True


@njit(cache=True, inline="always")
def _worth_at(x, y, centre, xy, ranges, worth):  # type: ignore[no-untyped-def]
    """Worth of the beam that saw what is at (x, y), or next to it; `centre` looks there."""
    best, found = math.inf, 1.0
    for j in range(max(centre - 2, 0), min(centre + 3, len(ranges))):
        if ranges[j] < math.inf:
            square = (x - xy[j, 0]) ** 2 + (y - xy[j, 1]) ** 2
            if square < best:
                best, found = square, worth[j]
    return found


@njit(cache=True)
def claim(points, near, motion, targets, claimed):  # type: ignore[no-untyped-def]
    """Mark in `claimed` (m,) the targets (m, 2), by ascending x, that points (n, 2) hit under `motion`; how many."""
    c, s = math.cos(motion[2]), math.sin(motion[2])
    claimed[:] = False
    hits = 0
    if len(targets) == 0:
        return hits
    for i in range(len(points)):
        x = motion[0] + c * points[i, 0] - s * points[i, 1]
        reach = 1.5 * near[i]
        if x + reach < targets[0, 0] or x - reach > targets[-1, 0]:
            continue
        y = motion[1] + s * points[i, 0] + c * points[i, 1]
        for j in range(np.searchsorted(targets[:, 0], x - reach), len(targets)):
            dx = targets[j, 0] - x
            if dx > reach:
                break
            if not claimed[j] and dx * dx + (y - targets[j, 1]) ** 2 < reach * reach:
                claimed[j] = True
                hits += 1
    return hits


@njit(cache=True)
def _explained(group, motion, bonus, least, views):  # type: ignore[no-untyped-def]
    """What points on b's outline are worth under `motion`, less those where b saw through, and the `bonus`.

    A point that stood and is out of view under `motion` speaks neither for nor against it. A point counts as much as
    what the beam there saw is worth. -inf as soon as it cannot be more than `least`.
    """
    points, near, _, standing = group
    xy, ranges, clear, worth, angle_min, step = views
    c, s = math.cos(motion[2]), math.sin(motion[2])
    on, through, n = 0.0, 0, len(points)
    # Every few points of what has many are enough.
    stride = max(1, n // MANY)
    for i in range(0, n, stride):
        # No point is worth more than one.
        if on + (n + stride - 1 - i) // stride * stride - through + bonus < least - 1e-6:
            return -math.inf
        x = motion[0] + c * points[i, 0] - s * points[i, 1]
        y = motion[1] + s * points[i, 0] + c * points[i, 1]
        beam = beam_at(x, y, angle_min, step)
        label = sight(x, y, near[i], xy, ranges, clear, angle_min, step)
        if label == AGREES:
            on += stride * _worth_at(x, y, beam, xy, ranges, worth)
        elif label == THROUGH:
            through += stride
        elif standing[i] and label == UNSEEN:
            on += stride * (beam < 0 or beam >= len(ranges))
    return on - through + bonus


@njit(cache=True)
def best_motion(group, goals, views, background, reach, sigma, least, motion):  # type: ignore[no-untyped-def]
    """Write the motion that explains most and return how much: points on the outline, less those seen through.

    reach : metres, of a displacement beside the `background`'s motion (3,). sigma : radians beside its rotation. -inf
    where no motion explains at least `least`.
    """
    points, near, spacing, _ = group
    c, s = math.cos(background[2]), math.sin(background[2])
    order = np.argsort(goals.points[:, 0])
    targets, weights = goals.points[order], goals.weights[order]
    fresh = goals.fresh[np.argsort(goals.fresh[:, 0])]
    moved = np.empty_like(points)
    for i in range(len(points)):
        moved[i, 0] = background[0] + c * points[i, 0] - s * points[i, 1]
        moved[i, 1] = background[1] + s * points[i, 0] + c * points[i, 1]
    side = int(2.0 * reach / CELL) + 1
    votes = np.empty((side, side))
    stride = max(1, len(points) // 40)
    _votes(moved[::stride], targets, weights, reach, votes)
    peaks = _peaks(votes, reach, PEAKS)
    trial = np.empty(3)
    claimed = np.zeros(len(fresh), dtype=np.bool_)
    best = least - 1e-6
    for k in range(len(peaks)):
        dx, dy = peaks[k]
        trial[0], trial[1], trial[2] = background[0] + dx, background[1] + dy, background[2]
        if not fit_group(points[::stride], spacing[::stride], background, targets, weights, sigma, trial):
            continue
        bonus = HIT * claim(points, near, trial, fresh, claimed) - DISTANCE_COST * length(dx, dy)
        score = _explained(group, trial, bonus, best, views)
        if score > best:
            best = score
            motion[0], motion[1], motion[2] = trial
    return best if best >= least else -math.inf

"""The motion of a group of points that explains most of what a second scan saw: votes, sliding, and refinement."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from registration.crf.beams import AGREES, FREE, TOUCHING, UNSEEN, beam_at, length, sight
from registration.crf.rigid import SUMS, add_pair, motion_of

CELL = 0.1  # metres of the grid of displacements
PEAKS = 4  # displacements that are refined
LONG = 1.2  # metres, extent from which a thing may slide along itself unseen
MANY = 240  # points of a group that are looked at
DISTANCE_COST = 4.0  # points of evidence a metre of displacement needs


@njit(cache=True)
def _votes(moved, targets, weights, reach, votes, last):  # type: ignore[no-untyped-def]
    """Displacement histogram: each point of the group votes once per cell in which a target lies."""
    side = votes.shape[0]
    votes[:, :] = 0.0
    last[:, :] = -1
    for i in range(len(moved)):
        for j in range(len(targets)):
            u = int((targets[j, 0] - moved[i, 0] + reach) / CELL)
            v = int((targets[j, 1] - moved[i, 1] + reach) / CELL)
            if 0 <= u < side and 0 <= v < side and last[u, v] != i:
                last[u, v] = i
                votes[u, v] += weights[j]


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


@njit(cache=True)
def fit_group(points, spacing, start, background, targets, weights, sigma, motion):  # type: ignore[no-untyped-def]
    """Iterated closest points of a group from `start` (3,), written to `motion`; the rotation is held by a prior.

    targets : (m, 2), by ascending x.
    """
    motion[:] = start
    sums = np.empty(SUMS)
    radius = 0.4
    for _ in range(6):
        c, s = math.cos(motion[2]), math.sin(motion[2])
        sums[:] = 0.0
        for i in range(len(points)):
            x = motion[0] + c * points[i, 0] - s * points[i, 1]
            y = motion[1] + s * points[i, 0] + c * points[i, 1]
            reach = max(radius, 1.5 * spacing[i])
            best, found = reach * reach, -1
            for j in range(np.searchsorted(targets[:, 0], x - reach), len(targets)):
                dx = targets[j, 0] - x
                if dx > reach:
                    break
                square = dx**2 + (y - targets[j, 1]) ** 2
                if square < best:
                    best, found = square, j
            if found >= 0:
                width = 0.05 + spacing[i]
                weight = weights[found] / (1.0 + best / (width * width))
                add_pair(sums, points[i, 0], points[i, 1], targets[found, 0], targets[found, 1], weight)
        stiffness = 0.05 * 0.05 / (sigma * sigma)
        if not motion_of(sums, background[2], stiffness, motion):
            return False
        radius = max(0.75 * radius, 0.12)
    return True


@njit(cache=True)
def _worth_at(x, y, xy, ranges, worth, angle_min, step):  # type: ignore[no-untyped-def]
    """Worth of the beam that saw what is at (x, y), or next to it."""
    centre = beam_at(x, y, angle_min, step)
    best, found = math.inf, 1.0
    for j in range(max(centre - 2, 0), min(centre + 3, len(ranges))):
        if ranges[j] < math.inf:
            square = (x - xy[j, 0]) ** 2 + (y - xy[j, 1]) ** 2
            if square < best:
                best, found = square, worth[j]
    return found


@njit(cache=True)
def explained(points, near, standing, motion, targets, claimed, xy, ranges, clear, worth, angle_min, step):  # type: ignore[no-untyped-def]
    """(points on b's outline, points where b saw through, targets hit) under `motion`.

    A point that stood, `standing` (n,), and is out of view under `motion` speaks neither for nor against it. A point
    counts as much as what the beam there saw is `worth` (B,). targets : (m, 2), by ascending x.
    """
    c, s = math.cos(motion[2]), math.sin(motion[2])
    on, through, hits = 0.0, 0, 0
    claimed[:] = False
    # Every few points of what has many are enough.
    stride = max(1, len(points) // MANY)
    for i in range(len(points)):
        x = motion[0] + c * points[i, 0] - s * points[i, 1]
        y = motion[1] + s * points[i, 0] + c * points[i, 1]
        if i % stride == 0:
            label, _ = sight(x, y, near[i], xy, ranges, clear, angle_min, step, TOUCHING)
            if label == AGREES:
                on += stride * _worth_at(x, y, xy, ranges, worth, angle_min, step)
            if standing[i] and label == UNSEEN:
                beam = beam_at(x, y, angle_min, step)
                on += stride * (beam < 0 or beam >= len(ranges))
            through += stride * (label == FREE)
        reach = 1.5 * near[i]
        for j in range(np.searchsorted(targets[:, 0], x - reach), len(targets)):
            dx = targets[j, 0] - x
            if dx > reach:
                break
            if not claimed[j] and dx**2 + (y - targets[j, 1]) ** 2 < reach * reach:
                claimed[j] = True
    for j in range(len(targets)):
        hits += claimed[j]
    return on, through, hits


@njit(cache=True)
def _slide(  # type: ignore[no-untyped-def]
    moved,
    points,
    near,
    standing,
    background,
    fresh,
    claimed,
    reach,
    xy,
    ranges,
    clear,
    worth,
    angle_min,
    step,
    start,
):
    """Write the best displacement along the longer axis of a group and return what it explains; -inf if it has none."""
    n = len(moved)
    mx, my = moved[:, 0].mean(), moved[:, 1].mean()
    xx, yy, xy_ = 0.0, 0.0, 0.0
    for i in range(n):
        dx, dy = moved[i, 0] - mx, moved[i, 1] - my
        xx += dx * dx
        yy += dy * dy
        xy_ += dx * dy
    half = math.sqrt(0.25 * (xx - yy) ** 2 + xy_ * xy_)
    if math.sqrt(12.0 * (0.5 * (xx + yy) + half) / n) < LONG:
        return -math.inf
    angle = 0.5 * math.atan2(2.0 * xy_, xx - yy)
    # Every few points are enough to choose by.
    stride = max(1, n // 40)
    few, few_near, few_standing = points[::stride], near[::stride] * 1.0, standing[::stride]
    best, chosen = -math.inf, 0
    trial = background.copy()
    for k in range(-int(reach / CELL), int(reach / CELL) + 1):
        trial[0] = background[0] + k * CELL * math.cos(angle)
        trial[1] = background[1] + k * CELL * math.sin(angle)
        on, through, hits = explained(
            few, few_near, few_standing, trial, fresh, claimed, xy, ranges, clear, worth, angle_min, step
        )
        score = stride * (on - through) + 0.7 * hits - DISTANCE_COST * abs(k) * CELL
        if score > best:
            best, chosen = score, k
            start[:] = trial
    on, through, hits = explained(
        points, near, standing, start, fresh, claimed, xy, ranges, clear, worth, angle_min, step
    )
    return on - through + 0.7 * hits - DISTANCE_COST * abs(chosen) * CELL


@njit(cache=True)
def best_motion(  # type: ignore[no-untyped-def]
    points, near, standing, spacing, background, targets, weights, fresh, reach, sigma, xy, ranges, clear,
    worth, angle_min, step, motion,
):  # fmt: skip
    """Write the motion that explains most and return how much: points on the outline, less those seen through."""
    c, s = math.cos(background[2]), math.sin(background[2])
    order = np.argsort(targets[:, 0])
    targets, weights = targets[order], weights[order]
    fresh = fresh[np.argsort(fresh[:, 0])]
    moved = np.empty_like(points)
    for i in range(len(points)):
        moved[i, 0] = background[0] + c * points[i, 0] - s * points[i, 1]
        moved[i, 1] = background[1] + s * points[i, 0] + c * points[i, 1]
    side = int(2.0 * reach / CELL) + 1
    votes, last = np.empty((side, side)), np.empty((side, side), dtype=np.int64)
    stride = max(1, len(points) // 40)
    _votes(moved[::stride], targets, weights, reach, votes, last)
    peaks = _peaks(votes, reach, PEAKS)
    start, trial = np.empty(3), np.empty(3)
    claimed = np.zeros(len(fresh), dtype=np.bool_)
    best = -math.inf
    for k in range(len(peaks) + 1):
        start[:] = background
        if k < len(peaks):
            start[0] += peaks[k, 0]
            start[1] += peaks[k, 1]
        else:
            # A flank slides along itself, which its end alone tells: every displacement along it gets as many votes.
            score = _slide(
                moved, points, near, standing, background, fresh, claimed, reach, xy, ranges, clear, worth,
                angle_min, step, start,
            )  # fmt: skip
            if score > best:
                best = score
                motion[:] = start
            elif score == -math.inf:
                continue
        if not fit_group(
            points[::stride], spacing[::stride], start, background, targets, weights, sigma, trial
        ):
            continue
        on, through, hits = explained(
            points, near, standing, trial, fresh, claimed, xy, ranges, clear, worth, angle_min, step
        )
        away = (
            length(trial[0] - background[0], trial[1] - background[1])
            if k == len(peaks)
            else length(peaks[k, 0], peaks[k, 1])
        )
        score = on - through + 0.7 * hits - DISTANCE_COST * away
        if score > best:
            best = score
            motion[:] = trial
    return best

"""Trajectories as they come from trackers and recordings, made fit for learning: bad rows out, even spacing in."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from estimation.checks import FloatArray, as_floats
from estimation.errors import InputError

# Nobody walks faster; a step beyond it is the tracker's mistake, unless the person stays where the step led.
FASTEST = 12.0
# m/s; who gets anywhere is faster than that at some time.
SLOWEST = 0.01


@dataclass(frozen=True)
class Cleaned:
    """`rows` (N, 3) x, y, t in m and s with rising t, and how many were left out to get there, by reason."""

    rows: FloatArray
    dropped: dict[str, int] = field(default_factory=dict)


def clean(name: str, trajectory: ArrayLike) -> Cleaned:
    """Check and repair a trajectory (N, 3) of x, y, t.

    Rows that are not finite, repeat a time, run back in time, or are single jumps away and back are left out. A loop,
    a gap and a jump that lasts stay.
    Raises InputError: not (N, 3), or no row is left.
    """
    given = as_floats(name, trajectory)
    if given.ndim != 2 or given.shape[1] != 3:
        raise InputError(f"{name} must have shape (N, 3) of x, y, t, not {given.shape}")
    finite = np.isfinite(given).all(axis=1)
    rows = given[finite]
    if not len(rows):
        raise InputError(f"{name} has no row of finite x, y, t ({len(given)} given)")
    newest = np.maximum.accumulate(rows[:, 2])
    rising = np.concatenate(([True], rows[1:, 2] > newest[:-1]))
    same = np.concatenate(([False], rows[1:, 2] == newest[:-1]))
    kept = rows[rising]
    single = _single_jumps(kept)
    left_out = {
        "not finite": ~finite,
        "duplicate time": same,
        "time goes backwards": ~rising & ~same,
        "jump away and back": single,
    }
    dropped = {reason: int(which.sum()) for reason, which in left_out.items() if which.any()}
    return Cleaned(np.ascontiguousarray(kept[~single]), dropped)


def _single_jumps(rows: FloatArray) -> np.ndarray:
    """Rows that are too far from both neighbours while these are near each other, (N,)."""
    single = np.zeros(len(rows), dtype=bool)
    if len(rows) < 3:
        return single
    steps = np.diff(rows, axis=0)
    speed = np.hypot(steps[:, 0], steps[:, 1]) / steps[:, 2]
    across = rows[2:] - rows[:-2]
    calm = np.hypot(across[:, 0], across[:, 1]) / across[:, 2] <= FASTEST
    single[1:-1] = (speed[:-1] > FASTEST) & (speed[1:] > FASTEST) & calm
    return single


def spaced(points: FloatArray, step: float) -> FloatArray:
    """Points (M, 2) of a path (N, 2), each at least `step` m from the one before; the last is always kept.

    Standing still and jitter add nothing; a walk of 10 m has some 10 / step points whatever the sensor's rate.
    """
    kept = [0]
    x, y = points[:, 0].tolist(), points[:, 1].tolist()
    at_x, at_y, least = x[0], y[0], step * step
    for k in range(1, len(x)):
        if (x[k] - at_x) ** 2 + (y[k] - at_y) ** 2 >= least:
            kept.append(k)
            at_x, at_y = x[k], y[k]
    if kept[-1] != len(x) - 1 and (x[-1], y[-1]) != (at_x, at_y):
        kept.append(len(x) - 1)
    return np.ascontiguousarray(points[kept])


def at_times(rows: FloatArray, times: FloatArray) -> FloatArray:
    """Positions (T, 2) of a track (N, 3) x, y, t at times (T,), straight in between."""
    return np.column_stack([np.interp(times, rows[:, 2], rows[:, axis]) for axis in (0, 1)])


def filled(points: FloatArray, step: float) -> FloatArray:
    """The path (N, 2) with points put into gaps wider than `step` m, evenly along the straight line."""
    if len(points) < 2:
        return points
    gaps = np.hypot(*np.diff(points, axis=0).T)
    parts = [points[:1]]
    for k, gap in enumerate(gaps):
        count = max(1, int(np.ceil(gap / step)))
        share = np.arange(1, count + 1)[:, None] / count
        parts.append(points[k] + share * (points[k + 1] - points[k]))
    return np.concatenate(parts)


def directions(points: FloatArray, span: int) -> FloatArray:
    """Unit direction (N, 2) of a path at each point, from `span` points before to `span` after."""
    index = np.arange(len(points))
    ahead = points[np.minimum(index + span, len(points) - 1)] - points[np.maximum(index - span, 0)]
    length = np.hypot(ahead[:, 0], ahead[:, 1])[:, None]
    return np.asarray(ahead / np.maximum(length, 1e-9))


def heading(points: FloatArray, span: float) -> tuple[FloatArray, float]:
    """Direction (2,) of the way to the last point from the latest one at least `span` m away, and its length, m."""
    away = points[-1] - points
    distance = np.hypot(away[:, 0], away[:, 1])
    far = np.flatnonzero(distance >= span)
    start = int(far[-1]) if len(far) else 0
    length = float(distance[start])
    return (away[start] / length if length > 1e-9 else np.zeros(2)), length

"""Looking ahead along paths: what an object's covariance would be after driving there and looking on the way."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# mypy: disable-error-code="no-untyped-def"


@njit(cache=True)
def _log_det(P):
    """Log of the determinant of a symmetric (3, 3)."""
    a, b, c = P[0, 0], P[0, 1], P[0, 2]
    e, f, i = P[1, 1], P[1, 2], P[2, 2]
    return math.log(max(a * (e * i - f * f) - b * (b * i - f * c) + c * (b * f - e * c), 1e-300))


@njit(cache=True)
def _look(P, R, S, half):
    """One measurement of covariance R: P becomes R (P + R)⁻¹ P, in place. S, half : (3, 3) to work in."""
    a, b, c = P[0, 0] + R[0, 0], P[0, 1] + R[0, 1], P[0, 2] + R[0, 2]
    e, f, i = P[1, 1] + R[1, 1], P[1, 2] + R[1, 2], P[2, 2] + R[2, 2]
    S[0, 0], S[0, 1], S[0, 2] = e * i - f * f, c * f - b * i, b * f - c * e
    S[1, 1], S[1, 2], S[2, 2] = a * i - c * c, b * c - a * f, a * e - b * b
    S[1, 0], S[2, 0], S[2, 1] = S[0, 1], S[0, 2], S[1, 2]
    scale = 1.0 / (a * S[0, 0] + b * S[0, 1] + c * S[0, 2])
    for j in range(3):
        for k in range(3):
            half[j, k] = scale * (S[j, 0] * P[0, k] + S[j, 1] * P[1, k] + S[j, 2] * P[2, k])
    for j in range(3):
        for k in range(j, 3):
            value = R[j, 0] * half[0, k] + R[j, 1] * half[1, k] + R[j, 2] * half[2, k]
            P[j, k] = P[k, j] = value


@njit(cache=True)
def path_gain(own, path, positions, P, Q, R, low, high, opening, step, anticipation):
    """Expected gain of one way, nat: of the object it is for, of all together, and how many would be seen.

    own : index of that object. path : (K + 1, 3) x, y, heading: of the robot, then after each time step, with a look.
    positions : (N, 2). P, Q, R : (N, 3, 3) covariance now, growth per second, one look. low, high : m, range of the
    sensor. opening : full angle of view, rad. anticipation : share of what entropy grows by on the way that counts
    as gained where a look takes it off again.
    """
    gain_own = gain = 0.0
    seen = 0
    last = len(path) - 1
    x0, y0, x1, y1 = path[0, 0], path[0, 1], path[0, 0], path[0, 1]
    for k in range(1, last + 1):
        x0, x1 = min(x0, path[k, 0]), max(x1, path[k, 0])
        y0, y1 = min(y0, path[k, 1]), max(y1, path[k, 1])
    now, S, half = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for n in range(len(positions)):
        x, y = positions[n, 0], positions[n, 1]
        if x < x0 - high or x > x1 + high or y < y0 - high or y > y1 + high:
            continue
        count, before = 0, 0
        now[:] = P[n]
        for k in range(1, last + 1):
            dx, dy = x - path[k, 0], y - path[k, 1]
            away = math.hypot(dx, dy)
            if not low <= away <= high:
                continue
            if opening < 2.0 * math.pi:
                off = math.atan2(dy, dx) - path[k, 2]
                if abs(math.atan2(math.sin(off), math.cos(off))) > 0.5 * opening:
                    continue
            now += step * (k - before) * Q[n]
            _look(now, R[n], S, half)
            count, before = count + 1, k
        if count == 0:
            continue
        seen += 1
        now += step * (last - before) * Q[n]
        unseen = _log_det(P[n] + step * last * Q[n])
        reference = anticipation * unseen + (1.0 - anticipation) * _log_det(P[n])
        share = 0.5 * (reference - _log_det(now))
        gain += share
        if n == own:
            gain_own = share
    return gain_own, gain, seen


@njit(cache=True)
def single_gains(distances, P, Q, R, speed, anticipation):
    """Gain (N,) of one look at each object after driving `distances` (N,) metres to it, nat."""
    gains = np.empty(len(P))
    now, S, half = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for n in range(len(P)):
        now[:] = P[n] + distances[n] / speed * Q[n]
        unseen = _log_det(now)
        _look(now, R[n], S, half)
        gains[n] = 0.5 * (anticipation * unseen + (1.0 - anticipation) * _log_det(P[n]) - _log_det(now))
    return gains


@njit(cache=True)
def straight_stop(pose, x, y, low, high, share, aside):
    """Where to look at (x, y) from after a straight drive: x, y, heading, metres.

    pose : (3,). low, high : m, range of the sensor. share : of `high` to stop at. aside : a quarter to the left of
    the straight way: what hid the target from here does not hide it from there.
    """
    dx, dy = x - pose[0], y - pose[1]
    away = math.hypot(dx, dy)
    ahead_x, ahead_y = math.cos(pose[2]), math.sin(pose[2])
    if away > 1e-9:
        ahead_x, ahead_y = dx / away, dy / away
    nearest = min(low + 0.05, 0.5 * (low + high))
    reach = max(share * high, nearest)
    if aside:
        ahead_x, ahead_y = ahead_y, -ahead_x
    heading = math.atan2(ahead_y, ahead_x)
    if nearest <= away <= reach and not aside:
        return pose[0], pose[1], heading, 0.0
    back = reach if away > reach else nearest
    stop_x, stop_y = x - ahead_x * back, y - ahead_y * back
    return stop_x, stop_y, heading, math.hypot(stop_x - pose[0], stop_y - pose[1])


@njit(cache=True)
def resampled(points, step):
    """Places (S, 2), the first and the last among them, at most `step` m apart along a line through points (K, 2)."""
    along = np.zeros(len(points))
    for k in range(1, len(points)):
        along[k] = along[k - 1] + math.hypot(points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1])
    marks = np.linspace(0.0, along[-1], max(math.ceil(along[-1] / step - 1e-9), 1) + 1)
    places = np.empty((len(marks), 2))
    for axis in range(2):
        places[:, axis] = np.interp(marks, along, points[:, axis])
    return places


@njit(cache=True)
def looks_along(points, heading, step):
    """(S, 3) x, y and heading after each `step` metres along points (K, 2), the goal last, with its own heading."""
    places = resampled(points, step)
    path = np.full((len(places), 3), heading)
    path[:, :2] = places
    for k in range(1, len(places)):
        dx, dy = places[k, 0] - places[k - 1, 0], places[k, 1] - places[k - 1, 1]
        if math.hypot(dx, dy) > 1e-9:
            path[k, 2] = math.atan2(dy, dx)
    path[0, 2], path[-1, 2] = path[1, 2], heading
    return path


@njit(cache=True)
def shortest_way(x, y, spots, last=-1):
    """Order (M,) of the shortest way from (x, y) through all of `spots` (M, 2), exact; for some ten of them.

    last : index of the spot to end at, -1 for any.
    """
    count = len(spots)
    full = (1 << count) - 1
    apart = np.empty((count, count))
    for j in range(count):
        for k in range(count):
            apart[j, k] = math.hypot(spots[j, 0] - spots[k, 0], spots[j, 1] - spots[k, 1])
    # rest[S, j] : the shortest way through all of the set S that begins at j.
    rest = np.full((1 << count, count), np.inf)
    after = np.full((1 << count, count), -1)
    for j in range(count):
        if last < 0 or j == last:
            rest[1 << j, j] = 0.0
    for S in range(1, full + 1):
        for j in range(count):
            if not (S >> j) & 1 or rest[S, j] == np.inf:
                continue
            for k in range(count):
                if (S >> k) & 1:
                    continue
                length = rest[S, j] + apart[j, k]
                if length < rest[S | (1 << k), k]:
                    rest[S | (1 << k), k], after[S | (1 << k), k] = length, j
    order = np.empty(count, np.int64)
    if count == 0:
        return order
    best = np.inf
    for k in range(count):
        length = rest[full, k] + math.hypot(spots[k, 0] - x, spots[k, 1] - y)
        if length < best:
            best, order[0] = length, k
    S = full
    for n in range(1, count):
        order[n] = after[S, order[n - 1]]
        S ^= 1 << order[n - 1]
    return order

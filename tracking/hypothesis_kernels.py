"""Compiled reduction of global hypotheses: those that say nearly the same of every target become one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit


@njit(cache=True)
def squares(points: Any, means: Any, xx: Any, xy: Any, yy: Any) -> Any:
    """Squared Mahalanobis distances (K, N) of points (N, 2) from positions (K, 2) with covariances (K,)."""
    out = np.empty((len(means), len(points)))
    for k in range(len(means)):
        determinant = xx[k] * yy[k] - xy[k] * xy[k]
        a, b, d = yy[k] / determinant, -xy[k] / determinant, xx[k] / determinant
        for i in range(len(points)):
            x, y = points[i, 0] - means[k, 0], points[i, 1] - means[k, 1]
            out[k, i] = a * x * x + 2.0 * b * x * y + d * y * y
    return out


@njit(cache=True)
def _root(parent: Any, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def connected(rows: Any, label: Any, labels: int, births: Any, narrow: Any, points: Any, link: float) -> Any:
    """Groups (labels + N,) of targets and returns that may have to do with each other.

    rows (K, N) : which returns each track gates, `label` (K,) its target in range(labels); births (B, N) : which
    returns each place for new targets gates. Returns of a `narrow` (B,) place belong together, others where they
    are closer than `link`.
    """
    n = len(points)
    parent = np.arange(labels + n)
    for k in range(len(rows)):
        for i in range(n):
            if rows[k, i]:
                a, b = _root(parent, label[k]), _root(parent, labels + i)
                parent[b] = a
    born = np.zeros(n, np.bool_)
    for k in range(len(births)):
        first = -1
        for i in range(n):
            if births[k, i]:
                born[i] = True
                if narrow[k]:
                    if first >= 0:
                        a, b = _root(parent, labels + first), _root(parent, labels + i)
                        parent[b] = a
                    first = i
    square = link * link
    for i in range(n):
        if born[i]:
            for j in range(n):
                if (j < i or not born[j]) and j != i:
                    x, y = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
                    if x * x + y * y < square:
                        a, b = _root(parent, labels + i), _root(parent, labels + j)
                        parent[b] = a
    for i in range(labels + n):
        parent[i] = _root(parent, i)
    return parent


@njit(cache=True)
def single_linkage(points: Any, distance: float) -> Any:
    """Names (N,) of the groups of points (N, 2) that steps of at most `distance` join, from 0 on."""
    n = len(points)
    parent = np.arange(n)
    square = distance * distance
    for i in range(n):
        for j in range(i):
            x, y = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
            if x * x + y * y <= square:
                a, b = _root(parent, i), _root(parent, j)
                parent[max(a, b)] = min(a, b)
    names = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        # The root of a group is its first point.
        root = _root(parent, i)
        if root == i:
            names[i] = count
            count += 1
        else:
            names[i] = names[root]
    return names


@njit(cache=True)
def _distance(a: Any, b: Any, P: Any, limit: float) -> float:
    """Squared Mahalanobis distance of states (4,) under P (4, 4), by Gaussian elimination; stops above `limit`."""
    d = b - a
    # x' P^-1 x by Cholesky, forward substitution only.
    L = np.empty((4, 4))
    total = 0.0
    y = np.empty(4)
    for i in range(4):
        for j in range(i + 1):
            value = P[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = math.sqrt(max(value, 1e-12))
            else:
                L[i, j] = value / L[j, j]
        value = d[i]
        for k in range(i):
            value -= L[i, k] * y[k]
        y[i] = value / L[i, i]
        total += y[i] * y[i]
        if total > limit:
            return total
    return total


@njit(cache=True)
def merge_plan(
    group: Any, log_weights: Any, starts: Any, labels: Any, means: Any, covariances: Any, limit: float
) -> tuple[Any, Any]:
    """Which hypothesis each is merged into, (H,), and which row takes up each row, (N,).

    Hypotheses are ordered by group and by falling weight within; hypothesis h has the rows starts[h] to
    starts[h + 1]. Two become one where every target of the same label, and every pair of targets without, that can be
    matched are within `limit`, in squared Mahalanobis distance; targets only one of them has are kept.
    """
    H, n = len(group), len(labels)
    leader = np.arange(H)
    target = np.arange(n)
    # Rows of a leader grow by those only its followers have.
    extra = np.full(n, -1)
    for h in range(H):
        if leader[h] != h:
            continue
        for other in range(h + 1, H):
            if group[other] != group[h]:
                break
            if leader[other] != other:
                continue
            match = np.full(starts[other + 1] - starts[other], -1)
            fine = True
            for r in range(starts[other], starts[other + 1]):
                for q in range(n):
                    if not (starts[h] <= q < starts[h + 1]) and extra[q] != h:
                        continue
                    if labels[q] == labels[r]:
                        if _distance(means[q], means[r], covariances[q], limit) > limit:
                            fine = False
                        match[r - starts[other]] = q
                        break
                if not fine:
                    break
            if not fine:
                continue
            for r in range(starts[other], starts[other + 1]):
                if match[r - starts[other]] >= 0:
                    continue
                # The same target under another label?
                for q in range(starts[h], starts[h + 1]):
                    taken = False
                    for s in range(len(match)):
                        if match[s] == q:
                            taken = True
                    if not taken and _distance(means[q], means[r], covariances[q], limit) <= limit:
                        match[r - starts[other]] = q
                        break
            leader[other] = h
            for r in range(starts[other], starts[other + 1]):
                q = match[r - starts[other]]
                if q >= 0:
                    target[r] = q
                else:
                    extra[r] = h
    return leader, target

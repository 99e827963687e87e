"""Compiled reduction of global hypotheses: those that say nearly the same of every target become one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

# Two places of one target tell hypotheses apart where it exists at both at least this probably.
LIKELY = 0.5


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
def root_of(parent: Any, i: int) -> int:
    """The first of those that are joined with i, of a forest of parents (N,); paths to it become shorter."""
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
                a, b = root_of(parent, label[k]), root_of(parent, labels + i)
                parent[b] = a
    born = np.zeros(n, np.bool_)
    for k in range(len(births)):
        first = -1
        for i in range(n):
            if births[k, i]:
                born[i] = True
                if narrow[k]:
                    if first >= 0:
                        a, b = root_of(parent, labels + first), root_of(parent, labels + i)
                        parent[b] = a
                    first = i
    square = link * link
    for i in range(n):
        if born[i]:
            for j in range(n):
                if (j < i or not born[j]) and j != i:
                    x, y = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
                    if x * x + y * y < square:
                        a, b = root_of(parent, labels + i), root_of(parent, labels + j)
                        parent[b] = a
    for i in range(labels + n):
        parent[i] = root_of(parent, i)
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
                a, b = root_of(parent, i), root_of(parent, j)
                parent[max(a, b)] = min(a, b)
    names = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        # The root of a group is its first point.
        root = root_of(parent, i)
        if root == i:
            names[i] = count
            count += 1
        else:
            names[i] = names[root]
    return names


@njit(cache=True)
def _distance(means: Any, q: int, r: int, P: Any, p: int, limit: float) -> float:
    """Squared Mahalanobis distance of rows q and r of states (N, 4) under row p of P (N, 4, 4).

    By Cholesky and forward substitution, without room of its own; stops above `limit`, mostly at once.
    """
    a = math.sqrt(max(P[p, 0, 0], 1e-12))
    t = (means[r, 0] - means[q, 0]) / a
    total: float = t * t
    if total > limit:
        return total
    b = P[p, 1, 0] / a
    c = math.sqrt(max(P[p, 1, 1] - b * b, 1e-12))
    u = (means[r, 1] - means[q, 1] - b * t) / c
    total += u * u
    if total > limit:
        return total
    d = P[p, 2, 0] / a
    e = (P[p, 2, 1] - d * b) / c
    f = math.sqrt(max(P[p, 2, 2] - d * d - e * e, 1e-12))
    v = (means[r, 2] - means[q, 2] - d * t - e * u) / f
    total += v * v
    if total > limit:
        return total
    g = P[p, 3, 0] / a
    h = (P[p, 3, 1] - g * b) / c
    k = (P[p, 3, 2] - g * d - h * e) / f
    m = math.sqrt(max(P[p, 3, 3] - g * g - h * h - k * k, 1e-12))
    w = (means[r, 3] - means[q, 3] - g * t - h * u - k * v) / m
    return total + w * w


@njit(cache=True)
def _matched(labels: Any, means: Any, covariances: Any, ours: Any, theirs: Any, limit: float) -> Any:
    """Index into the rows `ours` of the one nearest in state to each of the rows `theirs`, -1 where none is.

    Nearest by the larger of the squared Mahalanobis distances under either's covariance, up to `limit`; those that
    bear the same label are paired first.
    """
    match = np.full(len(theirs), -1)
    taken = np.zeros(len(ours), np.bool_)
    for anybody in range(2):
        for i in range(len(theirs)):
            r = theirs[i]
            nearest, best = limit, -1
            for j in range(len(ours)):
                q = ours[j]
                if match[i] >= 0 or taken[j] or (anybody == 0 and labels[q] != labels[r]):
                    continue
                gap = _distance(means, q, r, covariances, q, nearest)
                if gap <= nearest:
                    gap = max(gap, _distance(means, q, r, covariances, r, nearest))
                if gap <= nearest:
                    nearest, best = gap, j
            if best >= 0:
                taken[best] = True
                match[i] = best
    return match


@njit(cache=True)
def _renamed(name: int, labels: Any, ours: Any, theirs: Any, match: Any) -> tuple[int, int]:
    """The label of a target that only `theirs` have in the names of `ours`, and the row there that bears it, or -1.

    Where the one of ours who bears its label is somebody else of theirs, it bears the label of that one.
    """
    for _ in range(len(theirs) + 1):
        bearer = -1
        for j in range(len(ours)):
            if labels[ours[j]] == name:
                bearer = j
        if bearer < 0:
            return name, -1
        partner = -1
        for i in range(len(theirs)):
            if match[i] == bearer:
                partner = i
        if partner < 0:
            return name, ours[bearer]
        name = labels[theirs[partner]]
    return name, -1


@njit(cache=True)
def merge_plan(
    group: Any,
    log_weights: Any,
    starts: Any,
    labels: Any,
    existence: Any,
    means: Any,
    covariances: Any,
    limit: float,
) -> tuple[Any, Any, Any]:
    """Which hypothesis each is merged into, (H,), which row takes up each row, (N,), -1 for none, and labels (N,).

    Hypotheses are ordered by group and by falling weight within; hypothesis h has the rows starts[h] to
    starts[h + 1]. Two say the same where their targets, paired by state whatever their labels, are within `limit`;
    targets that only one of them has are kept, by the names of the likelier. They say different things where both
    have a target of that name, at places of its own, that rather exists at both; else the first place stays.
    """
    H, n = len(group), len(labels)
    leader = np.arange(H)
    target = np.arange(n)
    named = labels.copy()
    # Rows of a leader grow by those only its followers have.
    extra = np.full(n, -1)
    for h in range(H):
        if leader[h] != h:
            continue
        ours = np.arange(starts[h], starts[h + 1])
        for other in range(h + 1, H):
            if group[other] != group[h]:
                break
            if leader[other] != other:
                continue
            theirs = np.arange(starts[other], starts[other + 1])
            match = _matched(named, means, covariances, ours, theirs, limit)
            names, rivals = np.full(len(theirs), -1), np.full(len(theirs), -1)
            fine = True
            for i in range(len(theirs)):
                if match[i] < 0:
                    names[i], rivals[i] = _renamed(labels[theirs[i]], named, ours, theirs, match)
                    if rivals[i] >= 0 and min(existence[theirs[i]], existence[rivals[i]]) >= LIKELY:
                        fine = False
            if not fine:
                continue
            leader[other] = h
            grown = False
            for i in range(len(theirs)):
                r = theirs[i]
                if match[i] >= 0:
                    target[r] = ours[match[i]]
                elif rivals[i] >= 0:
                    target[r] = -1
                else:
                    extra[r] = h
                    named[r] = names[i]
                    grown = True
            if grown:
                inside = extra == h
                inside[starts[h] : starts[h + 1]] = True
                ours = np.flatnonzero(inside)
    return leader, target, named


@njit(cache=True)
def count_probabilities(existence: Any) -> Any:
    """Probabilities (n + 1,) of 0 to n of n independent targets existing, by the probabilities (n,) of each."""
    count = np.zeros(len(existence) + 1)
    count[0] = 1.0
    for i in range(len(existence)):
        for k in range(i + 1, 0, -1):
            count[k] = count[k] * (1.0 - existence[i]) + count[k - 1] * existence[i]
        count[0] *= 1.0 - existence[i]
    return count

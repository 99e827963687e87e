"""Which points may have moved together: pieces of a scan that another scan contradicts."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from registration.crf.beams import AGREES, CLEAR, FREE, HIDDEN


@njit(cache=True)
def _root(parents, k):  # type: ignore[no-untyped-def]
    while parents[k] != k:
        parents[k] = parents[parents[k]]
        k = parents[k]
    return k


@njit(cache=True)
def groups_of(points, pieces, labels, spacing, ranges, link, small, largest):  # type: ignore[no-untyped-def]
    """Number of the group of each point, -1 for the background.

    A piece may have moved where part of it stands in what the other scan saw through, or where it is hidden from
    it and stands before what is beside it: what is behind its neighbours is what a mover hides.
    """
    n = len(points)
    groups = np.full(n, -1, dtype=np.int64)
    parents = np.arange(n)
    compact = np.zeros(n, dtype=np.bool_)
    count = pieces.max() + 1 if n else 0
    first, last = np.full(count, -1, dtype=np.int64), np.zeros(count, dtype=np.int64)
    size, free, hidden = np.zeros(count), np.zeros(count), np.zeros(count)
    for k in range(n):
        p = pieces[k]
        if first[p] < 0:
            first[p] = k
        last[p] = k
        size[p] += 1.0
        free[p] += labels[k] == FREE or labels[k] == CLEAR
        hidden[p] += labels[k] == HIDDEN
    for p in range(count):
        f, l = first[p], last[p]
        length = math.hypot(points[l, 0] - points[f, 0], points[l, 1] - points[f, 1])
        # Single readings beside it are no edge of anything.
        before, beyond = f - 1, l + 1
        while before > 0 and size[pieces[before]] == 1.0:
            before -= 1
        while beyond < n - 1 and size[pieces[beyond]] == 1.0:
            beyond += 1
        stands_out = (before < 0 or ranges[before] > ranges[f]) and (
            beyond >= n or ranges[beyond] > ranges[l]
        )
        least = max(2.0, 0.06 * size[p])
        # A single reading between others is more often false than it is a thing.
        if size[p] < 2.0:
            continue
        whole = length < largest and (free[p] >= least or (stands_out and free[p] + hidden[p] >= least))
        for k in range(f, l + 1):
            if pieces[k] == p:
                compact[k] = length < small
                if whole or labels[k] == FREE or labels[k] == CLEAR:
                    groups[k] = f
    # Legs of one person.
    for i in range(n):
        if groups[i] < 0 or not compact[i] or labels[i] == AGREES:
            continue
        for j in range(i + 1, n):
            if groups[j] < 0 or groups[j] == groups[i] or not compact[j] or labels[j] == AGREES:
                continue
            away = math.hypot(points[i, 0] - points[j, 0], points[i, 1] - points[j, 1])
            if away < link:
                low, high = _root(parents, groups[i]), _root(parents, groups[j])
                parents[max(low, high)] = min(low, high)
    for i in range(n):
        if groups[i] >= 0:
            groups[i] = _root(parents, groups[i])
    return groups

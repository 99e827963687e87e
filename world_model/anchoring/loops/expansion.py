"""Children of a group of hypotheses: the k best associations over all parents (2.4) to (2.9), compiled.

A group has T tracks and H hypotheses; `rows` (H, T) holds the leaf of each track, -1 where a track does not exist.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from estimation.checks import FloatArray
from estimation.filters.murty import k_best_full
from world_model.anchoring.loops.contacts import (
    AT_ONCE,
    MOST_COMBINATIONS,
    MOST_MEMBERS,
    combinations,
    contacts,
    merge_events,
    resolved_weight,
    same,
)
from world_model.anchoring.loops.leaves import IntArray

MOST_GROUPS = 256  # different groups of touching movers in the children of one look


class Children(NamedTuple):
    """parents (C,); choice (C, T) : detection of each track, -1 missed, -2 no such track, at least M for one shared by
    group (choice // M - 1); weights (C,), log; groups (G, MOST_MEMBERS) of leaves, filled up with -1."""

    parents: IntArray
    choice: IntArray
    weights: FloatArray
    groups: IntArray


class Parent(NamedTuple):
    """One hypothesis: its number, the most children it may have, its log weight if everything is missed or new, its
    leaves (n,) and their columns (n,), the detections (m,) that they can explain and the costs (m, n) of that,
    probabilities (n, n) of being in contact."""

    number: int
    most: int
    weight: float
    local: IntArray
    columns: IntArray
    used: IntArray
    costs: FloatArray
    touching: FloatArray


@numba.njit(cache=True)
def expand(rows, log_weights, matrix, missing, seen, movers, keep, threshold):  # type: ignore[no-untyped-def]
    """The `keep` best children of all parents, those within `threshold` of the best, as `Children`.

    rows (H, T) : indices into matrix (n, M), log weights of being a detection, and missing (n,), of being missed.
    seen : `look.Detections`. movers : `contacts.Movers`, those that may share a detection (Assumption II dropped).
    """
    H, T = rows.shape
    everything_new = seen.log_new.sum()
    ratio = matrix - missing.reshape(-1, 1) - seen.log_new
    gains = np.zeros(seen.log_new.size)  # at the most, of each detection over being new or clutter
    for row in ratio:
        gains = np.maximum(gains, row)
    order = np.argsort(-log_weights)
    share = np.exp(log_weights - log_weights.max())
    share /= share.sum()
    sharing = movers.present.size > 0 and movers.present.max() > 0.0
    room = 4 * keep + (MOST_COMBINATIONS if sharing else 1) * H
    children = Children(
        np.empty(room, np.int64),
        np.full((room, T), -2),
        np.full(room, -np.inf),
        np.full((MOST_GROUPS if sharing else 0, MOST_MEMBERS), -1),
    )
    counts = np.zeros(2, np.int64)
    best = -np.inf
    for h in order:
        # The parents are sorted: no child of this one or a later one is among the best. Groups that share a detection
        # may gain a little more.
        if log_weights[h] + everything_new + gains.sum() < best - (3.0 if sharing else 1.0) * threshold:
            break
        columns = np.flatnonzero(rows[h] >= 0)
        local = rows[h][columns]
        weight = log_weights[h] + everything_new + missing[local].sum()
        touching = np.zeros((0, 0))
        if sharing and local.size > 1:
            touching = contacts(local, movers)
            if touching.max() <= 0.0:
                touching = np.zeros((0, 0))
        used, costs = _explained(ratio[local], threshold, touching.size > 0)
        k = min(max(1, int(np.ceil(keep * share[h]))), keep)
        parent = Parent(h, k, weight, local, columns, used, costs, touching)
        best = _add_children(parent, missing, seen, movers, threshold, children, counts, best)
    weights = children.weights
    ranked = np.argsort(-weights[: counts[0]])[:keep]
    ranked = ranked[weights[ranked] >= best - threshold]
    return Children(
        children.parents[ranked], children.choice[ranked], weights[ranked], children.groups[: counts[1]]
    )


@numba.njit(cache=True)
def _explained(ratio, threshold, every):  # type: ignore[no-untyped-def]
    """Detections (m,) that some of n leaves can explain, or `every` one, and the costs (m, n) of that.

    ratio (n, M) : log weights of being a detection against being missed and the detection new.
    """
    costs = np.where(ratio > -threshold, -ratio, np.inf).T
    gated = np.full(len(costs), every)
    for j in range(len(costs)):
        gated[j] |= (costs[j] < np.inf).any()
    used = np.flatnonzero(gated)
    return used, costs[used]


@numba.njit(cache=True)
def _add_children(parent, missing, seen, movers, threshold, children, counts, best):  # type: ignore[no-untyped-def]
    """The best children of a parent, in each set of groups that share a detection; returns the best weight so far.

    counts (2,) : of children and of groups, both kept up to date.
    """
    M, m, n = seen.log_new.size, parent.used.size, parent.local.size
    touch = parent.touching.size > 0
    room = children.weights.size
    sets = np.full((1, AT_ONCE), -1)
    events = np.empty((0, MOST_MEMBERS), np.int64)
    event_row, gains = np.empty(0, np.int64), np.empty(0)
    if m > 0 and touch:
        events, event_row, gains = merge_events(
            parent.local, parent.touching, parent.used, missing, seen, movers, threshold
        )
        sets = combinations(events, event_row, gains)
    for number in range(sets.shape[0]):
        start = parent.weight
        row_free, column_free = np.ones(m, np.bool_), np.ones(n, np.bool_)
        for event in sets[number]:
            if event >= 0:
                start += gains[event]
                row_free[event_row[event]] = False
                for member in events[event]:
                    if member >= 0:
                        column_free[member] = False
        rest_rows, rest_columns = np.flatnonzero(row_free), np.flatnonzero(column_free)
        small, bound = _square(parent.costs, rest_rows, rest_columns, start)
        if number > 0 and bound < best - threshold:
            continue
        solutions = np.empty((1, 0), np.int64)
        if rest_rows.size > 0:
            solutions = k_best_full(small, min(parent.most, room - counts[0]))
        for solution in solutions:
            weight = start
            for r in range(rest_rows.size):
                weight -= small[r, solution[r]]
            if counts[0] >= room or (weight < best - threshold and not touch):
                break
            chosen = np.full(n, -1)
            for r in range(rest_rows.size):
                if solution[r] < rest_columns.size:
                    chosen[rest_columns[solution[r]]] = parent.used[rest_rows[r]]
            if touch:
                _share(parent, sets[number], events, event_row, M, children.groups, counts, chosen)
                weight += resolved_weight(parent.touching, chosen, parent.local, missing)
                if weight < best - threshold:
                    continue
            best = max(best, weight)
            at = counts[0]
            children.parents[at], children.weights[at] = parent.number, weight
            children.choice[at, parent.columns] = chosen
            counts[0] += 1
    return best


@numba.njit(cache=True)
def _square(costs, rows, columns, start):  # type: ignore[no-untyped-def]
    """Costs of these detections, of these tracks or new (r, c + r), and the best weight of any assignment."""
    small, bound = np.full((rows.size, columns.size + rows.size), np.inf), start
    for r in range(rows.size):
        least = 0.0
        for c in range(columns.size):
            small[r, c] = costs[rows[r], columns[c]]
            least = min(least, small[r, c])
        small[r, columns.size + r] = 0.0
        bound -= least
    return small, bound


@numba.njit(cache=True)
def _share(parent, events_chosen, events, event_row, M, groups, counts, chosen):  # type: ignore[no-untyped-def]
    """Write into chosen (n,) who shares which detection; a group that is not known yet goes into `groups`."""
    member = np.empty(MOST_MEMBERS, np.int64)
    for event in events_chosen:
        if event < 0:
            continue
        own = events[event][events[event] >= 0]
        member[:] = -1
        member[: own.size] = parent.local[own]
        code = -1
        for g in range(counts[1]):
            if same(groups[g], member):
                code = g
                break
        if code < 0:
            code = min(counts[1], groups.shape[0] - 1)
            groups[code] = member
            counts[1] = code + 1
        chosen[own] = M * (1 + code) + parent.used[event_row[event]]


@numba.njit(cache=True)
def components(rows, log_weights, tolerance):  # type: ignore[no-untyped-def]
    """Labels (T,) of groups of tracks that are independent given these hypotheses.

    Two tracks belong together where their joint distribution over leaves differs from the product of its
    marginals by more than `tolerance` (total variation).
    """
    H, T = rows.shape
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    # Leaves renumbered per track.
    label, kinds = np.empty((H, T), np.int64), np.empty(T, np.int64)
    for t in range(T):
        known = np.unique(rows[:, t])
        label[:, t], kinds[t] = np.searchsorted(known, rows[:, t]), known.size
    group = np.arange(T)
    for a in range(T):
        if kinds[a] < 2:
            continue
        for b in range(a + 1, T):
            if kinds[b] < 2 or group[a] == group[b]:
                continue
            joint = np.zeros((kinds[a], kinds[b]))
            for h in range(H):
                joint[label[h, a], label[h, b]] += weights[h]
            one, other, apart = joint.sum(1), joint.sum(0), 0.0
            for p in range(kinds[a]):
                for q in range(kinds[b]):
                    apart += abs(joint[p, q] - one[p] * other[q])
            if 0.5 * apart > tolerance:
                group[group == group[b]] = group[a]
    return group


@numba.njit(cache=True)
def unify(rows, log_weights):  # type: ignore[no-untyped-def]
    """Join hypotheses with the same leaves; returns rows and weights, the most probable first, sum one."""
    H = len(rows)
    order = np.argsort(-log_weights)
    kept = np.empty(H, np.int64)
    mass = np.empty(H)
    count = 0
    top = log_weights[order[0]]
    for at in range(H):
        h = order[at]
        known = -1
        for k in range(count):
            if same(rows[kept[k]], rows[h]):
                known = k
                break
        if known < 0:
            kept[count] = h
            mass[count] = np.exp(log_weights[h] - top)
            count += 1
        else:
            mass[known] += np.exp(log_weights[h] - top)
    mass = mass[:count]
    ranked = np.argsort(-mass)
    return rows[kept[:count][ranked]], np.log(mass[ranked] / mass.sum())

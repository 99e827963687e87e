"""Children of a group of hypotheses: the k best associations over all parents (2.4) to (2.9), compiled.

A group has T tracks and H hypotheses; `rows` (H, T) holds the leaf of each track, -1 where a track does not exist.
Variants of a leaf are coded as leaf index times (M + 1) plus detection + 1, with 0 for missed.
"""

from __future__ import annotations

import numba
import numpy as np

from estimation.murty import k_best_full
from world_model.anchoring.contacts import (
    MOST_COMBINATIONS,
    MOST_MEMBERS,
    combinations,
    contacts,
    merge_events,
    resolved_weight,
)

MOST_GROUPS = 256  # different groups of touching movers in the children of one look


@numba.njit(cache=True)
def expand(  # type: ignore[no-untyped-def]
    rows,
    log_weights,
    matrix,
    missing,
    log_new,
    keep,
    threshold,
    present,
    centres,
    spreads,
    together,
    common,
    positions,
    covariances,
    reach,
):
    """The `keep` best children of all parents, those within `threshold` of the best.

    rows (H, T) : indices into matrix (n, M), log weights of being a detection, and missing (n,), of being missed.
    log_new (M,) : log density of a detection being clutter or an object not known yet. present (n,) : probability
    of a leaf being there that may share a detection with others (Assumption II dropped), else 0.
    Returns parents (C,), choice (C, T) : detection of each track, -1 missed, -2 no such track, at least M for one
    shared by group (choice // M - 1); weights (C,); and groups (G, MOST_MEMBERS) of leaves, filled up with -1.
    """
    H, T = rows.shape
    M = log_new.size
    everything_new = log_new.sum()
    # What all detections can gain at the most over being new or clutter.
    most = 0.0
    for j in range(M):
        gain = 0.0
        for i in range(matrix.shape[0]):
            gain = max(gain, matrix[i, j] - missing[i] - log_new[j])
        most += gain
    order = np.argsort(-log_weights)
    share = np.exp(log_weights - log_weights.max())
    share /= share.sum()
    sharing = present.size > 0 and present.max() > 0.0
    room = 4 * keep + (MOST_COMBINATIONS if sharing else 1) * H
    parents = np.empty(room, np.int64)
    choice = np.full((room, T), -2)
    weights = np.full(room, -np.inf)
    groups = np.full((MOST_GROUPS if sharing else 0, MOST_MEMBERS), -1)
    known = 0
    count = 0
    best = -np.inf
    columns_of = np.empty(T, np.int64)
    local = np.empty(T, np.int64)
    chosen = np.empty(T, np.int64)
    member = np.empty(MOST_MEMBERS, np.int64)
    costs = np.full((M, T + M), np.inf)
    used = np.empty(M, np.int64)
    no_events = np.full((1, 3), -1)
    for at in range(H):
        h = order[at]
        base = log_weights[h] + everything_new
        # The parents are sorted: no child of this one or a later one is among the best. Groups that share a detection
        # may gain a little more.
        if base + most < best - (3.0 if sharing else 1.0) * threshold:
            break
        n = 0
        for t in range(T):
            if rows[h, t] >= 0:
                base += missing[rows[h, t]]
                columns_of[n] = t
                local[n] = rows[h, t]
                n += 1
        touching = np.zeros((0, 0))
        touch = False
        if sharing and n > 1:
            touching = contacts(local[:n], present, centres, spreads, together, reach)
            touch = touching.max() > 0.0
        # Only detections that some leaf of this parent can explain take part.
        m = 0
        for j in range(M):
            gated = False
            for c in range(n):
                costs[m, c] = np.inf
                value = matrix[local[c], j]
                if value > -np.inf:
                    ratio = value - missing[local[c]] - log_new[j]
                    if ratio > -threshold:
                        costs[m, c] = -ratio
                        gated = True
            if gated or touch:
                used[m] = j
                m += 1
        k = min(max(1, int(np.ceil(keep * share[h]))), keep)
        sets = no_events
        events = np.empty((0, MOST_MEMBERS), np.int64)
        event_row = np.empty(0, np.int64)
        gains = np.empty(0)
        if m > 0 and touch:
            events, event_row, gains = merge_events(
                local[:n],
                touching,
                used[:m],
                missing,
                log_new,
                present,
                centres,
                spreads,
                common,
                positions,
                covariances,
                threshold,
            )
            sets = combinations(events, event_row, gains)
        for number in range(sets.shape[0]):
            start = base
            row_free = np.ones(m, np.bool_)
            column_free = np.ones(n, np.bool_)
            for p in range(3):
                event = sets[number, p]
                if event >= 0:
                    start += gains[event]
                    row_free[event_row[event]] = False
                    for q in range(MOST_MEMBERS):
                        if events[event, q] >= 0:
                            column_free[events[event, q]] = False
            rest_rows = np.flatnonzero(row_free)
            rest_columns = np.flatnonzero(column_free)
            mm, nn = rest_rows.size, rest_columns.size
            small = np.full((mm, nn + mm), np.inf)
            bound = start
            for r in range(mm):
                least = 0.0
                for c in range(nn):
                    small[r, c] = costs[rest_rows[r], rest_columns[c]]
                    least = min(least, small[r, c])
                small[r, nn + r] = 0.0
                bound -= least
            if number > 0 and bound < best - threshold:
                continue
            solutions = np.empty((1, 0), np.int64)
            if mm > 0:
                solutions = k_best_full(small, min(k, room - count))
            for s in range(solutions.shape[0]):
                weight = start
                for r in range(mm):
                    weight -= small[r, solutions[s, r]]
                if count >= room or (weight < best - threshold and not touch):
                    break
                for c in range(n):
                    chosen[c] = -1
                for r in range(mm):
                    if solutions[s, r] < nn:
                        chosen[rest_columns[solutions[s, r]]] = used[rest_rows[r]]
                for p in range(3):
                    event = sets[number, p]
                    if event < 0:
                        continue
                    for q in range(MOST_MEMBERS):
                        member[q] = -1
                        if events[event, q] >= 0:
                            member[q] = local[events[event, q]]
                    code = -1
                    for g in range(known):
                        if (groups[g] == member).all():
                            code = g
                            break
                    if code < 0:
                        code = min(known, groups.shape[0] - 1)
                        groups[code] = member
                        known = code + 1
                    for q in range(MOST_MEMBERS):
                        if events[event, q] >= 0:
                            chosen[events[event, q]] = M * (1 + code) + used[event_row[event]]
                if touch:
                    weight += resolved_weight(
                        touching,
                        chosen[:n],
                        local[:n],
                        missing,
                        centres,
                        spreads,
                        together,
                        common,
                        positions,
                        covariances,
                    )
                    if weight < best - threshold:
                        continue
                best = max(best, weight)
                parents[count] = h
                weights[count] = weight
                for c in range(n):
                    choice[count, columns_of[c]] = chosen[c]
                count += 1
    ranked = np.argsort(-weights[:count])
    kept = 0
    while kept < min(keep, count) and weights[ranked[kept]] >= best - threshold:
        kept += 1
    ranked = ranked[:kept]
    return parents[ranked], choice[ranked], weights[ranked], groups[:known]


@numba.njit(cache=True)
def product(rows_a, log_a, rows_b, log_b, keep, threshold):  # type: ignore[no-untyped-def]
    """The best combinations of the hypotheses of two independent groups."""
    A, B = log_a.size, log_b.size
    sums = np.empty(A * B)
    for a in range(A):
        for b in range(B):
            sums[a * B + b] = log_a[a] + log_b[b]
    ranked = np.argsort(-sums)
    kept = 0
    while kept < min(keep, A * B) and sums[ranked[kept]] >= sums[ranked[0]] - threshold:
        kept += 1
    rows = np.empty((kept, rows_a.shape[1] + rows_b.shape[1]), np.int64)
    weights = np.empty(kept)
    for k in range(kept):
        a, b = ranked[k] // B, ranked[k] % B
        rows[k, : rows_a.shape[1]] = rows_a[a]
        rows[k, rows_a.shape[1] :] = rows_b[b]
        weights[k] = sums[ranked[k]]
    return rows, weights


@numba.njit(cache=True)
def components(rows, log_weights, tolerance):  # type: ignore[no-untyped-def]
    """Labels (T,) of groups of tracks that are independent given these hypotheses.

    Two tracks belong together where their joint distribution over leaves differs from the product of its
    marginals by more than `tolerance` (total variation).
    """
    H, T = rows.shape
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    # Leaves renumbered per track, and their marginal probabilities.
    label = np.empty((H, T), np.int64)
    marginal = np.zeros((T, H))
    kinds = np.zeros(T, np.int64)
    for t in range(T):
        for h in range(H):
            known = -1
            for g in range(h):
                if rows[g, t] == rows[h, t]:
                    known = label[g, t]
                    break
            if known < 0:
                known = kinds[t]
                kinds[t] += 1
            label[h, t] = known
            marginal[t, known] += weights[h]
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
            apart = 0.0
            for p in range(kinds[a]):
                for q in range(kinds[b]):
                    apart += abs(joint[p, q] - marginal[a, p] * marginal[b, q])
            if 0.5 * apart > tolerance:
                old, new = group[b], group[a]
                for c in range(T):
                    if group[c] == old:
                        group[c] = new
    return group


@numba.njit(cache=True)
def unify(rows, log_weights):  # type: ignore[no-untyped-def]
    """Join hypotheses with the same leaves; returns rows and weights, the most probable first, sum one."""
    H, T = rows.shape
    order = np.argsort(-log_weights)
    kept = np.empty(H, np.int64)
    mass = np.empty(H)
    count = 0
    top = log_weights[order[0]]
    for at in range(H):
        h = order[at]
        same = -1
        for k in range(count):
            equal = True
            for t in range(T):
                if rows[kept[k], t] != rows[h, t]:
                    equal = False
                    break
            if equal:
                same = k
                break
        if same < 0:
            kept[count] = h
            mass[count] = np.exp(log_weights[h] - top)
            count += 1
        else:
            mass[same] += np.exp(log_weights[h] - top)
    mass = mass[:count]
    ranked = np.argsort(-mass)
    return rows[kept[:count][ranked]], np.log(mass[ranked] / mass.sum())

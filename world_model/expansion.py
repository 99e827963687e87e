"""Children of a group of hypotheses: the k best associations over all parents (2.4) to (2.9), compiled.

A group has T tracks and H hypotheses; `rows` (H, T) holds the leaf of each track, -1 where a track does not exist.
Variants of a leaf are coded as leaf index times (M + 1) plus detection + 1, with 0 for missed.
"""

from __future__ import annotations

import numba
import numpy as np

from estimation.murty import k_best_full
from world_model.kernels import log_gauss

MERGED = 0.3  # that two movers at the same place are detected as one, per look
MOST_EVENTS = 8  # combinations of merged detections that are tried per parent


@numba.njit(cache=True)
def merged_weight(a, b, j, centres, spreads, positions, covariances, reach):  # type: ignore[no-untyped-def]
    """Log weight of detection j stemming from two touching movers a and b at once: it lies between them.

    centres (n, 3), spreads (n, 3, 3) : predicted positions of leaves. reach (M,) : distance, m, at which a detector
    ceases to tell two objects apart.
    """
    S, inverse = np.empty((3, 3)), np.empty((3, 3))
    apart, variance = 0.0, 0.0
    for k in range(3):
        apart += (centres[a, k] - centres[b, k]) ** 2
        variance += (spreads[a, k, k] + spreads[b, k, k]) / 3.0
    touching = apart / (reach[j] ** 2 + variance)
    if touching > 16.0:
        return -np.inf
    for p in range(3):
        for q in range(3):
            S[p, q] = 0.25 * (spreads[a, p, q] + spreads[b, p, q]) + covariances[j, p, q]
    z = positions[j]
    return (
        np.log(MERGED * reach[j] ** 2 / (reach[j] ** 2 + variance))
        - 0.5 * touching
        + log_gauss(
            z[0] - 0.5 * (centres[a, 0] + centres[b, 0]),
            z[1] - 0.5 * (centres[a, 1] + centres[b, 1]),
            z[2] - 0.5 * (centres[a, 2] + centres[b, 2]),
            S,
            inverse,
        )
    )


@numba.njit(cache=True)
def merge_events(  # type: ignore[no-untyped-def]
    local, used, missing, log_new, present, centres, spreads, positions, covariances, reach, threshold
):
    """Pairs of leaves and a detection that may be both: columns and row (E, 3), log ratio to both missed (E,)."""
    events = np.empty((MOST_EVENTS, 3), np.int64)
    gains = np.full(MOST_EVENTS, -np.inf)
    for x in range(local.size):
        if present[local[x]] <= 0.0:
            continue
        for y in range(x + 1, local.size):
            if present[local[y]] <= 0.0:
                continue
            for r in range(used.size):
                gain = merged_weight(
                    local[x], local[y], used[r], centres, spreads, positions, covariances, reach
                )
                gain += np.log(present[local[x]] * present[local[y]])
                gain -= missing[local[x]] + missing[local[y]] + log_new[used[r]]
                worst = np.argmin(gains)
                if gain > -threshold and gain > gains[worst]:
                    gains[worst] = gain
                    events[worst, 0], events[worst, 1], events[worst, 2] = x, y, r
    kept = np.flatnonzero(gains > -np.inf)
    return events[kept], gains[kept]


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
    positions,
    covariances,
    reach,
):
    """The `keep` best children of all parents, those within `threshold` of the best.

    rows (H, T) : indices into matrix (n, M), log weights of being a detection, and missing (n,), of being missed.
    log_new (M,) : log density of a detection being clutter or an object not known yet. present (n,) : probability
    of a leaf being there that may share a detection with another (Assumption II dropped), else 0.
    Returns parents (C,), choice (C, T) : detection of each track, -1 missed, -2 no such track, at least M for one
    shared with leaf (choice // M - 1); and weights (C,).
    """
    H, T = rows.shape
    M = log_new.size
    everything_new = log_new.sum()
    order = np.argsort(-log_weights)
    share = np.exp(log_weights - log_weights.max())
    share /= share.sum()
    room = 4 * keep + (MOST_EVENTS + 1) * H
    parents = np.empty(room, np.int64)
    choice = np.full((room, T), -2)
    weights = np.full(room, -np.inf)
    count = 0
    best = -np.inf
    columns_of = np.empty(T, np.int64)
    local = np.empty(T, np.int64)
    costs = np.full((M, T + M), np.inf)
    used = np.empty(M, np.int64)
    for at in range(H):
        h = order[at]
        base = log_weights[h] + everything_new
        if base < best - 3.0 * threshold:
            break
        n = 0
        for t in range(T):
            if rows[h, t] >= 0:
                base += missing[rows[h, t]]
                columns_of[n] = t
                local[n] = rows[h, t]
                n += 1
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
            if gated:
                used[m] = j
                m += 1
        k = min(max(1, int(np.ceil(keep * share[h]))), keep)
        events = np.empty((0, 3), np.int64)
        gains = np.empty(0)
        if m > 0 and n > 1:
            events, gains = merge_events(
                local[:n],
                used[:m],
                missing,
                log_new,
                present,
                centres,
                spreads,
                positions,
                covariances,
                reach,
                threshold,
            )
        for event in range(-1, gains.size):
            x, y, row, start = -1, -1, -1, base
            if event >= 0:
                x, y, row = events[event, 0], events[event, 1], events[event, 2]
                start = base + gains[event]
            rest_rows = np.empty(m, np.int64)
            rest_columns = np.empty(n, np.int64)
            mm, nn = 0, 0
            for r in range(m):
                if r != row:
                    rest_rows[mm] = r
                    mm += 1
            for c in range(n):
                if c != x and c != y:
                    rest_columns[nn] = c
                    nn += 1
            small = np.full((mm, nn + mm), np.inf)
            for r in range(mm):
                for c in range(nn):
                    small[r, c] = costs[rest_rows[r], rest_columns[c]]
                small[r, nn + r] = 0.0
            solutions = np.empty((1, 0), np.int64)
            if mm > 0:
                solutions = k_best_full(small, min(k, room - count))
            for s in range(solutions.shape[0]):
                weight = start
                for r in range(mm):
                    weight -= small[r, solutions[s, r]]
                if weight < best - threshold or count >= room:
                    break
                best = max(best, weight)
                parents[count] = h
                weights[count] = weight
                for c in range(n):
                    choice[count, columns_of[c]] = -1
                for r in range(mm):
                    if solutions[s, r] < nn:
                        choice[count, columns_of[rest_columns[solutions[s, r]]]] = used[rest_rows[r]]
                if event >= 0:
                    choice[count, columns_of[x]] = M * (1 + local[y]) + used[row]
                    choice[count, columns_of[y]] = M * (1 + local[x]) + used[row]
                count += 1
    ranked = np.argsort(-weights[:count])
    kept = 0
    while kept < min(keep, count) and weights[ranked[kept]] >= best - threshold:
        kept += 1
    ranked = ranked[:kept]
    return parents[ranked], choice[ranked], weights[ranked]


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

"""Leaves of children: variants shared by hypotheses, and leaves that have become alike joined; compiled."""

from __future__ import annotations

import numba
import numpy as np

from world_model.anchoring.loops.contacts import correct_shared
from world_model.anchoring.loops.kernels import copy_leaf, correct, create, miss
from world_model.anchoring.loops.leaves import MOVING, REST, claim, release

SAME = 0.1  # difference of two distributions that no later detection would tell; of attributes twice that
SPREAD, APART = 1.5, 0.15
"""The same of two Gaussians: ratio of variances, squared distance in standard deviations."""
GONE = 0.05  # an anchor less probably there than this makes no difference between two worlds


@numba.njit(cache=True)
def settle(leaves, chosen, detection, seen, blocks, missing, clear):  # type: ignore[no-untyped-def]
    """Correct lonely leaves in place: chosen (n,) rows, detection (n,) index or -1 for missed."""
    stamp = seen.stamp - seen.lag
    for k in range(chosen.size):
        i, j = chosen[k], detection[k]
        if j >= 0:
            z, R = seen.positions[j], seen.covariances[j]
            correct(leaves, i, z, R, seen.lag, seen.likelihood[j], blocks, stamp)
            leaves.said[i] = seen.indices[j]
        else:
            miss(leaves, i, missing[k], clear[k])


@numba.njit(cache=True)
def begin(rows, tracks, which, seen, classes):  # type: ignore[no-untyped-def]
    """New leaves for detections `which` (n,) of new tracks (n,); returns their rows (n,)."""
    slots = np.empty(which.size, np.int64)
    for k in range(which.size):
        slots[k] = claim(rows.free, rows.top)
        create(rows.leaves, slots[k], tracks[k], which[k], seen, classes)
    return slots


@numba.njit(cache=True)
def realise(rows, slots, local, children, missing, clear, seen, tracks, classes):  # type: ignore[no-untyped-def]
    """Leaves (C, T + M) of the children that `expand` chose, and those of the M tracks they begin.

    slots (n,) : rows of the parents' leaves, used again for those that were missed, else given back. local (H, T) :
    indices into them. missing (n,) : probability of a detection that did not come.
    """
    C, T = children.choice.shape
    M = tracks.size
    found = {np.int64(-1): np.int64(-1)}  # row of each variant of a leaf
    missed = np.zeros(slots.size, np.bool_)
    begun = np.full(M, -1)
    out = np.full((C, T + M), -1)
    taken = np.zeros(M, np.bool_)
    for c in range(C):
        taken[:] = False
        for t in range(T):
            j = children.choice[c, t]
            if j == -2:
                continue
            at = local[children.parents[c], t]
            if j == -1:
                missed[at] = True
                out[c, t] = slots[at]
                continue
            taken[j % M] = True
            # A leaf has a variant per detection, and one per group that it may be in.
            key = np.int64(at * M * (children.groups.shape[0] + 1) + j)
            if key not in found:
                found[key] = _variant(rows, slots, at, j, children.groups, seen, classes.blocks)
            out[c, t] = found[key]
        for j in range(M):
            if taken[j]:
                continue
            if begun[j] < 0:
                begun[j] = claim(rows.free, rows.top)
                create(rows.leaves, begun[j], tracks[j], j, seen, classes)
            out[c, T + j] = begun[j]
    for k in range(slots.size):
        if missed[k]:
            miss(rows.leaves, slots[k], missing[k], clear[k])
        else:
            release(rows.leaves.track, rows.free, rows.top, slots[k])
    return out


@numba.njit(cache=True)
def _variant(rows, slots, at, j, groups, seen, blocks):  # type: ignore[no-untyped-def]
    """A leaf with a detection of its own, or with that of the group j // M - 1; its row."""
    leaves, M = rows.leaves, seen.log_new.size
    slot, d, stamp = claim(rows.free, rows.top), j % M, seen.stamp - seen.lag
    copy_leaf(leaves, slots[at], slot)
    z, R = seen.positions[d], seen.covariances[d]
    if j < M:
        correct(leaves, slot, z, R, seen.lag, seen.likelihood[d], blocks, stamp)
        leaves.said[slot] = seen.indices[d]
    else:
        correct_shared(leaves, slot, slots, groups[j // M - 1], z, R, stamp)
    return slot


@numba.njit(cache=True)
def alike(leaves, a, b, persistence, attributes):  # type: ignore[no-untyped-def]
    """Whether two leaves of a track say the same: no later detection could tell them apart.

    persistence (2,) : of runs of misses, of what rests and of what moves by itself.
    """
    if (leaves.together[a] > 0) != (leaves.together[b] > 0):
        return False
    runs = persistence[int(leaves.behavior[a, REST] <= 0.0)]
    if abs(leaves.visible[a] - leaves.visible[b]) * runs > SAME:
        return False
    apart = 0.0
    for m in range(4):
        apart += abs(leaves.behavior[a, m] - leaves.behavior[b, m])
    if apart > SAME:
        return False
    apart = 0.0
    for c in range(attributes):
        apart += abs(leaves.attributes[a, c] - leaves.attributes[b, c])
    if apart > 2.0 * SAME:
        return False
    x, P = leaves.rest, leaves.rest_cov
    if leaves.behavior[a, REST] < leaves.behavior[a, MOVING]:
        x, P = leaves.moving, leaves.moving_cov
    away = 0.0
    for k in range(x.shape[1]):
        p, q = P[a, k, k], P[b, k, k]
        if max(p, q) > SPREAD * min(p, q):
            return False
        away += (x[a, k] - x[b, k]) ** 2 / max(min(p, q), 1e-12)
    return away < APART


@numba.njit(cache=True)
def join(pool, rows, log_weights, persistence, attributes):  # type: ignore[no-untyped-def]
    """Replace leaves by a more probable one that says the same, in `rows` (H, T)."""
    leaves, T = pool.leaves, rows.shape[1]
    weights = np.exp(log_weights - log_weights.max())
    for t in range(T):
        column = rows[:, t]
        slots = np.unique(column[column >= 0])
        mass = np.zeros(slots.size)
        for h in range(len(rows)):
            if column[h] >= 0:
                mass[np.searchsorted(slots, column[h])] += weights[h]
        slots = slots[np.argsort(-mass)]
        for x in range(slots.size):
            for y in range(x + 1, slots.size):
                a, b = slots[x], slots[y]
                if a >= 0 and b >= 0 and alike(leaves, a, b, persistence, attributes):
                    column[column == b] = a
                    release(leaves.track, pool.free, pool.top, b)
                    slots[y] = -1


@numba.njit(cache=True)
def here(leaves, slot):  # type: ignore[no-untyped-def]
    """Probability that the object of a leaf is where it says; 0 for no leaf, -1."""
    return leaves.behavior[slot, REST] + leaves.behavior[slot, MOVING] if slot >= 0 else 0.0


@numba.njit(cache=True)
def same_worlds(leaves, rows, log_weights, persistence, attributes):  # type: ignore[no-untyped-def]
    """Join hypotheses with the same objects under other names: rows (H, T) and weights, most probable first.

    The more probable naming stays.
    """
    H = len(rows)
    alive = np.ones(H, np.bool_)
    mass = np.exp(log_weights - log_weights[0])
    for a in range(H):
        for b in range(a + 1, H):
            if alive[a] and alive[b] and _same_objects(leaves, rows[a], rows[b], persistence, attributes):
                alive[b] = False
                mass[a] += mass[b]
    kept = np.flatnonzero(alive)
    share = mass[kept]
    order = np.argsort(-share)
    return rows[kept[order]], np.log(share[order] / share.sum())


@numba.njit(cache=True)
def _same_objects(leaves, one, other, persistence, attributes):  # type: ignore[no-untyped-def]
    """Whether each object present in one hypothesis (T,) has a counterpart in another that says the same, and none is
    left over there; what is most probably gone does not count."""
    T = one.size
    taken = np.zeros(T, np.bool_)
    for t in range(T):
        if here(leaves, one[t]) < GONE:
            continue
        partner = -1
        for u in range(t, t + T):
            slot = other[u % T]
            if slot < 0 or taken[u % T]:
                continue
            if slot == one[t] or alike(leaves, one[t], slot, persistence, attributes):
                partner = u % T
                break
        if partner < 0:
            return False
        taken[partner] = True
    left = 0
    for t in range(T):
        left += not taken[t] and here(leaves, other[t]) >= GONE
    return left == 0


@numba.njit(cache=True)
def same_spot(leaves, a, b):  # type: ignore[no-untyped-def]
    """Whether two leaves are where one object could be."""
    away, spread = 0.0, 0.0
    a_moves = leaves.behavior[a, MOVING] > leaves.behavior[a, REST]
    b_moves = leaves.behavior[b, MOVING] > leaves.behavior[b, REST]
    for k in range(3):
        x = leaves.moving[a, k] if a_moves else leaves.rest[a, k]
        y = leaves.moving[b, k] if b_moves else leaves.rest[b, k]
        away += (x - y) ** 2
        spread += leaves.moving_cov[a, k, k] if a_moves else leaves.rest_cov[a, k, k]
        spread += leaves.moving_cov[b, k, k] if b_moves else leaves.rest_cov[b, k, k]
    return away < 9.0 * spread / 3.0 + 1e-4


@numba.njit(cache=True)
def other_names(leaves, rows, log_weights):  # type: ignore[no-untyped-def]
    """Probability (T, T) that what the best hypothesis takes for the first track is the second one instead."""
    H, T = rows.shape
    out = np.zeros((T, T))
    for c in range(T):
        spot = rows[0, c]
        if here(leaves, spot) < 0.5:
            continue
        for h in range(1, H):
            own = rows[h, c]
            if own == spot or (here(leaves, own) >= 0.5 and same_spot(leaves, own, spot)):
                continue
            for d in range(T):
                other = rows[h, d]
                if d == c or other == rows[0, d] or here(leaves, other) < 0.5:
                    continue
                if same_spot(leaves, other, spot):
                    out[c, d] += np.exp(log_weights[h])
    return out


@numba.njit(cache=True)
def presence(leaves, rows, log_weights):  # type: ignore[no-untyped-def]
    """Probability (T,) of each track being there, over all hypotheses of a cluster."""
    H, T = rows.shape
    out = np.zeros(T)
    for h in range(H):
        weight = np.exp(log_weights[h])
        for t in range(T):
            out[t] += weight * here(leaves, rows[h, t])
    return out

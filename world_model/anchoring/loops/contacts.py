"""Movers that touch: one detection of several (Assumption II of section 2.5 dropped), compiled.

Two movers nearer than the detector can tell apart are seen as one, in the middle or at either of them. For as long as
that lasts the detection speaks of the whole group; when they part, who is who is decided on how each went before.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.loops.kernels import inverse_3x3, log_gauss
from world_model.anchoring.loops.leaves import AWAY, NONE, IntArray

MERGED = 0.3  # that two movers at the same place, told apart at the last look, are detected as one
STILL = 0.95  # that they are, if they were at the last look
LEAST = 0.01  # probability of being detected as one from which two movers are in contact
SCATTER = 0.15  # variance of where in a group its one detection is, of the variance of its members' places
MOST_EVENTS = 12  # groups and detections that are tried per parent
MOST_COMBINATIONS = 24
MOST_MEMBERS = 4
MOST_TRIED = 64
AT_ONCE = 3  # events in one child


class Movers(NamedTuple):
    """N leaves that may be detected as one. present (N,) : probability of being there, 0 of what never shares; centres
    (N, 3), spreads (N, 3, 3) : predicted positions; together (N,) : looks for which they have been detected with
    another. reach : distance, m, at which a detector ceases to tell two objects apart."""

    present: FloatArray
    centres: FloatArray
    spreads: FloatArray
    together: IntArray
    reach: float


@numba.njit(cache=True)
def contacts(local, movers):  # type: ignore[no-untyped-def]
    """Probability (n, n) that two of the leaves `local` (n,) are detected as one, 0 where that cannot be."""
    present, centres, spreads = movers.present, movers.centres, movers.spreads
    together, reach = movers.together, movers.reach
    n = local.size
    out = np.zeros((n, n))
    for x in range(n):
        a = local[x]
        if present[a] <= 0.0:
            continue
        for y in range(x + 1, n):
            b = local[y]
            if present[b] <= 0.0:
                continue
            off = centres[a] - centres[b]
            # Planar movers have no spread in height.
            square, variance = off @ off, 0.5 * (np.trace(spreads[a]) + np.trace(spreads[b]))
            near = reach * reach / (reach * reach + variance)
            # Of two that were one at the last look it is known that they are near.
            scale = MERGED * near
            if together[a] > 0 and together[b] > 0:
                scale = STILL * 9.0 * reach**2 / (9.0 * reach**2 + variance)
            value = scale * np.exp(-0.5 * square / (reach * reach + variance))
            if value > LEAST:
                out[x, y] = value
                out[y, x] = value
    return out


@numba.njit(cache=True)
def group_weight(members, size, j, local, touching, seen, movers):  # type: ignore[no-untyped-def]
    """Log weight of detection j being of all `members` (size,) of `local` at once: it lies among them."""
    # A tree of contacts that spans the group, the strongest first.
    joined = np.zeros(size, np.bool_)
    joined[0] = True
    weight = 0.0
    for _ in range(size - 1):
        best, at = 0.0, -1
        for p in range(size):
            if not joined[p]:
                continue
            for q in range(size):
                if not joined[q] and touching[members[p], members[q]] > best:
                    best, at = touching[members[p], members[q]], q
        if at < 0:
            return -np.inf
        joined[at] = True
        weight += np.log(best)
    centres = movers.centres
    centre = np.zeros(3)
    S, inverse = seen.covariances[j].copy(), np.empty((3, 3))
    for p in range(size):
        for a in range(3):
            centre[a] += centres[local[members[p]], a] / size
            for b in range(3):
                S[a, b] += movers.spreads[local[members[p]], a, b] / size**2
    for p in range(size):
        x = centres[local[members[p]]]
        for a in range(3):
            for b in range(3):
                S[a, b] += (x[a] - centre[a]) * (x[b] - centre[b]) * SCATTER / size
    z = seen.positions[j]
    return weight + log_gauss(z[0] - centre[0], z[1] - centre[1], z[2] - centre[2], S, inverse)


@numba.njit(cache=True)
def touching_groups(touching):  # type: ignore[no-untyped-def]
    """Groups of two to MOST_MEMBERS that hang together by contacts (G, MOST_MEMBERS), ascending, filled up with -1; and
    their number."""
    n = touching.shape[0]
    groups = np.full((MOST_TRIED, MOST_MEMBERS), -1)
    count = 0
    for x in range(n):
        for y in range(x + 1, n):
            if touching[x, y] > 0.0 and count < MOST_TRIED:
                groups[count, 0], groups[count, 1] = x, y
                count += 1
    begin, size = 0, 2
    while size < MOST_MEMBERS:
        end = count
        for g in range(begin, end):
            for w in range(n):
                near, inside = False, False
                for p in range(size):
                    inside = inside or groups[g, p] == w
                    near = near or touching[groups[g, p], w] > 0.0
                if inside or not near or count >= MOST_TRIED:
                    continue
                groups[count, :size] = groups[g, :size]
                groups[count, size] = w
                groups[count, : size + 1].sort()
                for other in range(end, count):
                    if same(groups[other], groups[count]):
                        groups[count] = -1
                        break
                if groups[count, 0] >= 0:
                    count += 1
        begin = end
        size += 1
    return groups, count


@numba.njit(cache=True)
def same(one, other):  # type: ignore[no-untyped-def]
    """Whether two rows (N,) of indices are the same."""
    alike = True
    for k in range(one.size):
        alike = alike and one[k] == other[k]
    return alike


@numba.njit(cache=True)
def merge_events(local, touching, used, missing, seen, movers, threshold):  # type: ignore[no-untyped-def]
    """Groups and the detection that may be of them: members (E, MOST_MEMBERS) filled up with -1, row (E,), log ratio to
    all missed (E,); the best first."""
    members = np.full((MOST_EVENTS, MOST_MEMBERS), -1)
    row = np.empty(MOST_EVENTS, np.int64)
    gains = np.full(MOST_EVENTS, -np.inf)
    groups, count = touching_groups(touching)
    for r in range(used.size):
        for g in range(count):
            size = 0
            while size < MOST_MEMBERS and groups[g, size] >= 0:
                size += 1
            gain = group_weight(groups[g], size, used[r], local, touching, seen, movers)
            if gain == -np.inf:
                continue
            gain -= seen.log_new[used[r]]
            for p in range(size):
                gain += np.log(movers.present[local[groups[g, p]]]) - missing[local[groups[g, p]]]
            worst = np.argmin(gains)
            if gain > -threshold and gain > gains[worst]:
                gains[worst], row[worst], members[worst] = gain, r, groups[g]
    order = np.argsort(-gains)[: (gains > -np.inf).sum()]
    return members[order], row[order], gains[order]


@numba.njit(cache=True)
def _apart(members, row, a, b):  # type: ignore[no-untyped-def]
    if row[a] == row[b]:
        return False
    for p in range(MOST_MEMBERS):
        for q in range(MOST_MEMBERS):
            if members[a, p] >= 0 and members[a, p] == members[b, q]:
                return False
    return True


@numba.njit(cache=True)
def combinations(members, row, gains):  # type: ignore[no-untyped-def]
    """Sets of one to three events that do not exclude each other (C, 3), filled up with -1; the first set is empty."""
    out = np.full((MOST_COMBINATIONS, AT_ONCE), -1)
    count = 1
    E = gains.size
    for a in range(E):
        if count < MOST_COMBINATIONS:
            out[count, 0] = a
            count += 1
    for a in range(E):
        for b in range(a + 1, E):
            if not _apart(members, row, a, b):
                continue
            if count < MOST_COMBINATIONS:
                out[count, 0], out[count, 1] = a, b
                count += 1
            for c in range(b + 1, E):
                if count < MOST_COMBINATIONS and _apart(members, row, a, c) and _apart(members, row, b, c):
                    out[count, 0], out[count, 1], out[count, 2] = a, b, c
                    count += 1
    return out[:count]


@numba.njit(cache=True)
def resolved_weight(touching, chosen, local, missing):  # type: ignore[no-untyped-def]
    """Log weight of how leaves in contact were told apart; chosen (n,) : detection, -1 missed, or alike for a group.

    Those detected as one have it in the weight of their group. Of two that are missed only one may have been there to
    see.
    """
    total = 0.0
    n = local.size
    for x in range(n):
        for y in range(x + 1, n):
            value = touching[x, y]
            if value <= 0.0 or (chosen[x] >= 0 and chosen[x] == chosen[y]):
                continue
            if chosen[x] < 0 and chosen[y] < 0:
                lower = min(missing[local[x]], missing[local[y]])
                total += np.log(value * np.exp(-lower) + 1.0 - value)
                continue
            total += np.log(1.0 - value)
    return total


@numba.njit(cache=True)
def correct_shared(leaves, i, slots, group, z, R, stamp):  # type: ignore[no-untyped-def]
    """Correct a mover with a detection of the whole group that it is in, in place.

    group : indices of slots (not changed yet), filled up with -1. The detection says where the group is and nothing
    about who is where in it: all are moved alike, by the gain of their centre, and their covariances stay as they are.
    So the covariance of the difference of two, the sum of theirs, is what it is without these detections, and who is
    who when they part is decided on what is known.
    """
    own = slots[group[group >= 0]]
    size, P, inverse = own.size, leaves.moving_cov[i], np.empty((3, 3))
    centre = leaves.moving[own, :3].sum(0) / size
    off = leaves.moving[own, :3] - centre
    CH = leaves.moving_cov[own, :, :3].sum(0) / size**2
    S = R + CH[:3] + SCATTER / size * off.T @ off
    inverse_3x3(S, inverse)
    # Who is known less well is moved more.
    share = np.trace(P[:3, :3]) / (size * np.trace(CH[:3]))
    leaves.moving[i] += share * (CH @ inverse @ (z - centre))
    leaves.together[i] += 1
    pi = leaves.behavior[i]
    pi[AWAY] = pi[NONE] = 0.0
    if pi.sum() > 0.0:
        pi /= pi.sum()
    leaves.visible[i] = 1.0
    leaves.last[i] = max(stamp, leaves.last[i])
    leaves.missed[i] = 0.0

"""Algorithm 1 of the text: flooding max-product messages with x^RT recomputed after every node.

Log domain: a product of messages is a sum, and a message is known up to a constant. The local features of a node are
recomputed whenever it is visited, from x^RT and from the present state of the other node of its point, which is how the
two chains hear of each other; no edge joins them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from registration.laser.rigid import SUMS, add_pair, motion_of

# f_c of equation (1), section IV.C: seven of association, then nine of clustering. Where the text gives no formula, a
# distance d counts as min(d / scale, CUT) / CUT.
FEATURES = (
    "data boosting", "outlier boosting", "sequence", "pairwise outlier", "outlier sequence", "pairwise distance",
    "pairwise translation",
    "cluster distance", "outlier", "cluster inlier", "cluster sequence", "neighbour weight", "neighbour stiffness",
    "neighbour distance", "cluster pairwise outlier", "cluster outlier sequence",
)  # fmt: skip
DATA, OUTLIER, SEQUENCE, PAIRWISE_OUTLIER, OUTLIERS, PAIRWISE_DISTANCE, PAIRWISE_TRANSLATION = range(7)
CLUSTER_DISTANCE, CLUSTER_OUTLIER, CLUSTER_INLIER, CLUSTER_SEQUENCE, NEIGHBOUR_WEIGHT = range(7, 12)
NEIGHBOUR_STIFFNESS, NEIGHBOUR_DISTANCE, CLUSTER_PAIRWISE_OUTLIER, CLUSTER_OUTLIERS = range(12, 16)
SCALE = 0.1  # metres
CUT = 3.0  # scales from which a distance is no worse
LEAST_PAIRS = 3  # of a cluster, to move its motion
SETTLED = 1e-3  # metres and radians


class Inferred(NamedTuple):
    """What is inferred: the chain x^A, the chain x^C and x^RT. The others stay as they are."""

    association: bool
    clustering: bool
    motions: bool


@njit(cache=True, inline="always")
def cost(distance):  # type: ignore[no-untyped-def]
    """Share in [0, 1] of the worst that a distance can say."""
    return min(distance / (SCALE * CUT), 1.0)


@njit(cache=True)
def association_edge(w, p, q, u, v, j, k):  # type: ignore[no-untyped-def]
    """w · f of neighbours at p and q, (2,), of the first scan that are points j and k of the second, at u and v."""
    dx, dy, ex, ey = q[0] - p[0], q[1] - p[1], v[0] - u[0], v[1] - u[1]
    value = w[SEQUENCE] if k == j + 1 else 0.0
    value -= w[PAIRWISE_DISTANCE] * cost(abs(math.sqrt(dx * dx + dy * dy) - math.sqrt(ex * ex + ey * ey)))
    fx, fy = ex - dx, ey - dy
    return value - w[PAIRWISE_TRANSLATION] * cost(math.sqrt(fx * fx + fy * fy))


@njit(cache=True, inline="always")
def association_state(w, static, outlier, stumps, x, y, others, states, k):  # type: ignore[no-untyped-def]
    """w · f of state k of x^A_i, K the outlier, of a point that its cluster's motion takes to (x, y).

    states (K,) : the points of the second scan that it may be: all M, or as many as are looked at.
    static (K,) : data boosting but for its stumps on registered translation, which are `stumps` (T, 3): threshold,
    polarity, share of the vote.
    """
    if k == len(states):
        return w[OUTLIER] * outlier
    dx, dy = x - others[states[k], 0], y - others[states[k], 1]
    away = min(math.sqrt(dx * dx + dy * dy), CUT)
    score = static[k]
    for t in range(len(stumps)):
        if stumps[t, 1] * away < stumps[t, 1] * stumps[t, 0]:
            score += stumps[t, 2]
    return w[DATA] * (score - 0.5)


@njit(cache=True, inline="always")
def moved_by(motions, d, point):  # type: ignore[no-untyped-def]
    """Where cluster d takes a point (2,); the outliers stay with the first."""
    motion = motions[d if d < len(motions) else 0]
    c, s = math.cos(motion[2]), math.sin(motion[2])
    return motion[0] + c * point[0] - s * point[1], motion[1] + s * point[0] + c * point[1]


@njit(cache=True)
def association_local(w, static, outlier, stumps, x, y, others, states, local):  # type: ignore[no-untyped-def]
    """Write `association_state` of all states, (K + 1,)."""
    for k in range(len(states) + 1):
        local[k] = association_state(w, static, outlier, stumps, x, y, others, states, k)


@njit(cache=True)
def clustering_local(w, point, motions, partner, told, local):  # type: ignore[no-untyped-def]
    """Write w · f of the states of x^C_i, (D,), the last one the outlier; `partner` (2,) where one is `told`."""
    count = len(motions)
    for d in range(count):
        local[d] = -w[CLUSTER_INLIER]
        if told:
            x, y = moved_by(motions, d, point)
            dx, dy = x - partner[0], y - partner[1]
            local[d] = w[CLUSTER_INLIER] - w[CLUSTER_DISTANCE] * cost(math.sqrt(dx * dx + dy * dy))
    local[count] = w[CLUSTER_OUTLIER] + (-w[CLUSTER_INLIER] if told else w[CLUSTER_INLIER])


@njit(cache=True)
def clustering_edges(w, p, q, u, v, told, motions, edges):  # type: ignore[no-untyped-def]
    """Write w · f of the states of neighbours at p and q, (D, D); u and v, (2,): partners, where both are `told`."""
    count = len(motions)
    gap = math.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2)
    same = w[CLUSTER_SEQUENCE] + w[NEIGHBOUR_WEIGHT] * math.exp(-gap)
    if told:
        other = math.sqrt((v[0] - u[0]) ** 2 + (v[1] - u[1]) ** 2)
        same += w[NEIGHBOUR_STIFFNESS] * math.exp(-abs(other - gap) / SCALE)
    for d in range(count):
        px, py = moved_by(motions, d, p)
        for e in range(count):
            qx, qy = moved_by(motions, e, q)
            dx, dy = qx - px, qy - py
            apart = cost(abs(math.sqrt(dx * dx + dy * dy) - gap))
            edges[d, e] = (same if d == e else 0.0) - w[NEIGHBOUR_DISTANCE] * apart
        edges[d, count] = edges[count, d] = -w[CLUSTER_PAIRWISE_OUTLIER]
    edges[count, count] = w[CLUSTER_OUTLIERS]


@njit(cache=True)
def _replace(message, made):  # type: ignore[no-untyped-def]
    """Write `made`, its best state at 0, to `message`; returns the greatest difference."""
    made -= made.max()
    change = np.abs(made - message).max()
    message[:] = made
    return change


@njit(cache=True)
def _send_association(w, belief, p, q, others, own, theirs, ahead, message):  # type: ignore[no-untyped-def]
    """Equation (2) from a node at p, belief (K + 1,) in states `own`, to its neighbour at q in states `theirs` (K,).

    ahead : whether q comes after p. Returns by how much the message changed.
    """
    m = len(own)
    made = np.empty(m + 1)
    most = max(w[SEQUENCE], 0.0)
    for t in range(m):
        value = belief[m] - w[PAIRWISE_OUTLIER]
        for turn in range(m):
            # First what follows in sequence, which wins most often.
            s = (t + turn + (m - 1 if ahead else 1)) % m
            # No edge is worth more than `most`: what cannot win is not looked at.
            if belief[s] + most <= value:
                continue
            u, v = others[own[s]], others[theirs[t]]
            if ahead:
                edge = association_edge(w, p, q, u, v, own[s], theirs[t])
            else:
                edge = association_edge(w, q, p, v, u, theirs[t], own[s])
            value = max(value, belief[s] + edge)
        made[t] = value
    made[m] = max(belief[m] + w[OUTLIERS], belief[:m].max() - w[PAIRWISE_OUTLIER])
    return _replace(message, made)


@njit(cache=True)
def _send_clustering(belief, edges, ahead, message):  # type: ignore[no-untyped-def]
    made = np.empty(len(belief))
    for t in range(len(belief)):
        value = -math.inf
        for s in range(len(belief)):
            value = max(value, belief[s] + (edges[s, t] if ahead else edges[t, s]))
        made[t] = value
    return _replace(message, made)


@njit(cache=True)
def _count(sums, d, k, point, others, states, weight):  # type: ignore[no-untyped-def]
    """Take the pair of a point into the sums of equation (6), or out of them."""
    if d < len(sums) and k < len(states):
        add_pair(sums[d], point[0], point[1], others[states[k], 0], others[states[k], 1], weight)


@njit(cache=True, inline="always")
def _partner(others, states, k):  # type: ignore[no-untyped-def]
    """The point that a state stands for, any where it is the outlier."""
    return others[states[min(k, len(states) - 1)]]


@njit(cache=True)
def _compute_rt(sums, d, motions):  # type: ignore[no-untyped-def]
    """ComputeRT of Algorithm 1, equation (6), for one cluster."""
    if d < len(sums) and sums[d, 8] >= LEAST_PAIRS - 0.5:
        motion_of(sums[d], 0.0, 0.0, motions[d])


@njit(cache=True)
def _visit_association(  # type: ignore[no-untyped-def]
    w, points, others, states, static, outlier, stumps, motions, d, i, messages, last
):  # fmt: skip
    """Visit node i of x^A, whose point is in cluster d: send messages unless it is the `last` time.

    messages (2, n, K + 1) : to the nodes from those before and from those after them. Returns the greatest change of a
    message, and the node's best state.
    """
    local = np.empty(states.shape[1] + 1)
    x, y = moved_by(motions, d, points[i])
    association_local(w, static[i], outlier[i], stumps, x, y, others, states[i], local)
    change = 0.0
    for side in range(0 if last else 2):
        j = i + 1 if side == 0 else i - 1
        if 0 <= j < len(points):
            sent = _send_association(
                w, local + messages[side, i], points[i], points[j], others, states[i], states[j], side == 0,
                messages[side, j],
            )  # fmt: skip
            change = max(change, sent)
    return change, int((local + messages[0, i] + messages[1, i]).argmax())


@njit(cache=True)
def _visit_clustering(w, points, others, states, motions, x_a, i, messages, last):  # type: ignore[no-untyped-def]
    """As `_visit_association`, of node i of x^C; messages (2, n, D)."""
    m, count = states.shape[1], len(motions)
    local, edges = np.empty(count + 1), np.empty((count + 1, count + 1))
    clustering_local(w, points[i], motions, _partner(others, states[i], x_a[i]), x_a[i] < m, local)
    change = 0.0
    for side in range(0 if last else 2):
        j = i + 1 if side == 0 else i - 1
        if 0 <= j < len(points):
            f, g = min(i, j), max(i, j)
            u, v = _partner(others, states[f], x_a[f]), _partner(others, states[g], x_a[g])
            told = x_a[f] < m and x_a[g] < m
            clustering_edges(w, points[f], points[g], u, v, told, motions, edges)
            sent = _send_clustering(local + messages[side, i], edges, side == 0, messages[side, j])
            change = max(change, sent)
    return change, int((local + messages[0, i] + messages[1, i]).argmax())


@njit(cache=True)
def algorithm_1(  # type: ignore[no-untyped-def]
    w, points, others, states, static, outlier, stumps, motions, x_a, x_c, iterations, inferred
):  # fmt: skip
    """MAP states, written to x_a (n,) in 0..K and x_c (n,) in 0..D - 1, and motions (D - 1, 3): equation (5).

    states (n, K) : points of the second scan that each of the first may be. Returns the iterations taken.
    """
    n, m, count = len(points), states.shape[1], len(motions)
    to_association, to_clustering = np.zeros((2, n, m + 1)), np.zeros((2, n, count + 1))
    sums = np.zeros((count, SUMS))
    for i in range(n):
        _count(sums, x_c[i], x_a[i], points[i], others, states[i], 1.0)
    taken = 0
    # Lines 2 to 15, and once more without messages for lines 16 to 21.
    for turn in range(iterations + 1):
        before, change, last = motions.copy(), 0.0, turn == iterations
        for i in range(n):
            d = x_c[i]
            if inferred.association:
                sent, state = _visit_association(
                    w, points, others, states, static, outlier, stumps, motions, d, i, to_association, last
                )
                change = max(change, sent)
                _count(sums, d, x_a[i], points[i], others, states[i], -1.0)
                _count(sums, d, state, points[i], others, states[i], 1.0)
                x_a[i] = state
                if inferred.motions:
                    _compute_rt(sums, d, motions)
            if inferred.clustering:
                sent, state = _visit_clustering(
                    w, points, others, states, motions, x_a, i, to_clustering, last
                )
                change = max(change, sent)
                _count(sums, d, x_a[i], points[i], others, states[i], -1.0)
                _count(sums, state, x_a[i], points[i], others, states[i], 1.0)
                x_c[i] = state
                if inferred.motions:
                    _compute_rt(sums, d, motions)
                    _compute_rt(sums, state, motions)
        taken = turn + 1
        if change < SETTLED and np.abs(motions - before).max() < SETTLED:
            break
    return taken


@njit(cache=True)
def log_score(w, points, others, states, static, outlier, stumps, motions, x_a, x_c):  # type: ignore[no-untyped-def]
    """The exponent of equation (1): w · f over all cliques."""
    n, m, count = len(points), states.shape[1], len(motions)
    c_local, edges = np.empty(count + 1), np.empty((count + 1, count + 1))
    total = 0.0
    for i in range(n):
        x, y = moved_by(motions, x_c[i], points[i])
        own = _partner(others, states[i], x_a[i])
        clustering_local(w, points[i], motions, own, x_a[i] < m, c_local)
        total += association_state(w, static[i], outlier[i], stumps, x, y, others, states[i], x_a[i])
        total += c_local[x_c[i]]
        if i + 1 == n:
            break
        inside = int(x_a[i] < m) + int(x_a[i + 1] < m)
        after = _partner(others, states[i + 1], x_a[i + 1])
        if inside == 2:
            j, k = states[i, x_a[i]], states[i + 1, x_a[i + 1]]
            total += association_edge(w, points[i], points[i + 1], own, after, j, k)
        else:
            total += w[OUTLIERS] if inside == 0 else -w[PAIRWISE_OUTLIER]
        clustering_edges(w, points[i], points[i + 1], own, after, inside == 2, motions, edges)
        total += edges[x_c[i], x_c[i + 1]]
    return total

"""The two linked chains as one: exact MAP and exact marginals for given motions.

With a handful of candidates per point, the two nodes of a point make one node of a chain, and the edges factor into
those of association and of clustering: a step costs A C (A + C) instead of (A C)². This replaces loopy messages where
the text could not afford to (a chain of 361 × 5 states), and makes the likelihood's gradient exact as well.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from registration.crf.potentials import OUT_OF_REACH, Potentials
from registration.motion import Array

NEVER = -1e30


@njit(cache=True)
def _viterbi(association, clustering, links, association_edges, clustering_edges):  # type: ignore[no-untyped-def]
    n, a_count, c_count = len(association), association.shape[1], clustering.shape[1]
    from_a = np.empty((n, c_count, a_count), dtype=np.int64)
    from_c = np.empty((n, c_count, a_count), dtype=np.int64)
    best = np.empty((c_count, a_count))
    half, source = np.empty((c_count, a_count)), np.empty((c_count, a_count), dtype=np.int64)
    for c in range(c_count):
        for k in range(a_count):
            best[c, k] = clustering[0, c] + association[0, k] + links[0, c, k]
    # What a motion that is out of reach would explain is not looked at.
    here, count = np.empty(c_count, dtype=np.int64), 0
    before, known = np.empty(c_count, dtype=np.int64), 0
    for c in range(c_count):
        if clustering[0, c] > OUT_OF_REACH:
            before[known] = c
            known += 1
    for i in range(1, n):
        count = 0
        for c in range(c_count):
            if clustering[i, c] > OUT_OF_REACH:
                here[count] = c
                count += 1
        # First the best cluster before for every (cluster now, association before), then the best association.
        for c in here[:count]:
            for k in range(a_count):
                top, at = -np.inf, 0
                for e in before[:known]:
                    value = best[e, k] + clustering_edges[i - 1, e, c]
                    if value > top:
                        top, at = value, e
                half[c, k], source[c, k] = top, at
        for k in range(a_count):
            if association[i, k] <= NEVER:
                best[:, k] = NEVER
                from_a[i, :, k] = 0
                from_c[i, :, k] = 0
                continue
            for c in here[:count]:
                top, at = -np.inf, 0
                for m in range(a_count):
                    value = half[c, m] + association_edges[i - 1, m, k]
                    if value > top:
                        top, at = value, m
                best[c, k] = top + clustering[i, c] + association[i, k] + links[i, c, k]
                from_a[i, c, k], from_c[i, c, k] = at, source[c, at]
        before, here, known = here, before, count
    associations, clusters = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    top = -np.inf
    for c in before[:known]:
        for k in range(a_count):
            if best[c, k] > top:
                top = best[c, k]
                associations[n - 1], clusters[n - 1] = k, c
    for i in range(n - 1, 0, -1):
        k, c = associations[i], clusters[i]
        associations[i - 1], clusters[i - 1] = from_a[i, c, k], from_c[i, c, k]
    return associations, clusters


def map_states(potentials: Potentials) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """States (n,) and (n,) of the greatest score, exact."""
    p = potentials
    association = np.where(np.isfinite(p.association), p.association, 2.0 * NEVER)
    found: tuple[NDArray[np.int64], NDArray[np.int64]] = _viterbi(
        association, p.clustering, p.links, p.association_edges, p.clustering_edges
    )
    return found


@njit(cache=True)
def _forward(local, of_a, of_c, ahead, half):  # type: ignore[no-untyped-def]
    """Filtered probabilities of every point, written to `ahead` like `local`; returns the log of what they sum to."""
    n, c_count, a_count = local.shape
    total = 0.0
    for i in range(n):
        scale = 0.0
        for c in range(c_count):
            if i > 0:
                for k in range(a_count):
                    half[c, k] = 0.0
                for e in range(c_count):
                    for k in range(a_count):
                        half[c, k] += of_c[i - 1, e, c] * ahead[i - 1, e, k]
            for k in range(a_count):
                ahead[i, c, k] = 0.0
                # Most states of a labelled point are impossible.
                if local[i, c, k] == 0.0:
                    continue
                value = 1.0
                if i > 0:
                    value = 0.0
                    for m in range(a_count):
                        value += half[c, m] * of_a[i - 1, m, k]
                ahead[i, c, k] = value * local[i, c, k]
                scale += ahead[i, c, k]
        total += math.log(scale)
        for c in range(c_count):
            for k in range(a_count):
                ahead[i, c, k] /= scale
    return total


@njit(cache=True)
def _marginals(local, of_a, of_c):  # type: ignore[no-untyped-def]
    n, c_count, a_count = local.shape
    nodes = np.empty((n, c_count, a_count))
    half, after = np.empty((c_count, a_count)), np.empty((c_count, a_count))
    a_pairs, c_pairs = np.zeros_like(of_a), np.zeros_like(of_c)
    total = _forward(local, of_a, of_c, nodes, half)
    back = np.ones((c_count, a_count))
    left, right = np.empty((c_count, a_count)), np.empty((c_count, a_count))
    for i in range(n - 1, -1, -1):
        if i + 1 < n:
            # What comes after, by this point's association and the next one's cluster.
            left[:, :] = 0.0
            right[:, :] = 0.0
            for c in range(c_count):
                for k in range(a_count):
                    value = after[c, k]
                    if value == 0.0:
                        continue
                    for m in range(a_count):
                        right[c, m] += of_a[i, m, k] * value
            scale = 0.0
            for e in range(c_count):
                for m in range(a_count):
                    value = 0.0
                    for c in range(c_count):
                        value += of_c[i, e, c] * right[c, m]
                    back[e, m] = value
                    scale += value * nodes[i, e, m]
            for e in range(c_count):
                for m in range(a_count):
                    weight = nodes[i, e, m] / scale
                    if weight == 0.0:
                        continue
                    for c in range(c_count):
                        left[c, m] += weight * of_c[i, e, c]
                        c_pairs[i, e, c] += weight * of_c[i, e, c] * right[c, m]
            for c in range(c_count):
                for m in range(a_count):
                    weight = left[c, m]
                    if weight == 0.0:
                        continue
                    for k in range(a_count):
                        a_pairs[i, m, k] += weight * of_a[i, m, k] * after[c, k]
        scale = 0.0
        for c in range(c_count):
            for k in range(a_count):
                after[c, k] = back[c, k] * local[i, c, k]
                nodes[i, c, k] *= back[c, k]
                scale += nodes[i, c, k]
        size = 0.0
        for c in range(c_count):
            for k in range(a_count):
                nodes[i, c, k] /= scale
                size += after[c, k]
        for c in range(c_count):
            for k in range(a_count):
                after[c, k] /= size
    return nodes, a_pairs, c_pairs, total


def edge_factors(potentials: Potentials) -> tuple[Array, Array]:
    """Exponentials of both kinds of edges, which labelled and unlabelled points share."""
    return np.exp(potentials.association_edges), np.exp(potentials.clustering_edges)


def marginals(
    potentials: Potentials, factors: tuple[Array, Array] | None = None
) -> tuple[Array, Array, Array, float]:
    """Probabilities of the nodes of each point (n, D + 1, K + 1), of neighbours' associations (n - 1, K + 1, K + 1) and
    clusters (n - 1, D + 1, D + 1), and the log partition function. factors : `edge_factors`, where they are known."""
    p = potentials
    local = p.links + p.association[:, None, :] + p.clustering[:, :, None]
    tops = local.max(axis=(1, 2))
    found = _marginals(np.exp(local - tops[:, None, None]), *(factors or edge_factors(p)))
    nodes, a_pairs, c_pairs, total = found
    return nodes, a_pairs, c_pairs, float(total + tops.sum())

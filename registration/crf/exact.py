"""The two linked chains as one: exact MAP and exact marginals for given motions.

With a handful of candidates per point, the two nodes of a point make one node of a chain, and the edges factor into
those of association and of clustering: a step costs A C (A + C) instead of (A C)². This replaces loopy messages where
the text could not afford to (a chain of 361 × 5 states), and makes the likelihood's gradient exact as well.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from registration.crf.potentials import Potentials
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
    for i in range(1, n):
        # First the best cluster before for every (cluster now, association before), then the best association.
        for c in range(c_count):
            for k in range(a_count):
                top, at = -np.inf, 0
                for e in range(c_count):
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
            for c in range(c_count):
                top, at = -np.inf, 0
                for m in range(a_count):
                    value = half[c, m] + association_edges[i - 1, m, k]
                    if value > top:
                        top, at = value, m
                best[c, k] = top + clustering[i, c] + association[i, k] + links[i, c, k]
                from_a[i, c, k], from_c[i, c, k] = at, source[c, at]
    associations, clusters = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    top = -np.inf
    for c in range(c_count):
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
def _marginals(association, clustering, links, association_edges, clustering_edges):  # type: ignore[no-untyped-def]
    n, a_count, c_count = len(association), association.shape[1], clustering.shape[1]
    local = np.empty((n, c_count, a_count))
    total = 0.0
    for i in range(n):
        top = -np.inf
        for c in range(c_count):
            for k in range(a_count):
                local[i, c, k] = clustering[i, c] + association[i, k] + links[i, c, k]
                top = max(top, local[i, c, k])
        local[i] = np.exp(local[i] - top)
        total += top
    ahead, back = np.empty((n, c_count, a_count)), np.empty((n, c_count, a_count))
    ahead[0] = local[0]
    scale = ahead[0].sum()
    ahead[0] /= scale
    total += np.log(scale)
    of_a, of_c = np.exp(association_edges), np.exp(clustering_edges)
    for i in range(1, n):
        step = np.dot(np.dot(np.ascontiguousarray(of_c[i - 1].T), ahead[i - 1]), of_a[i - 1])
        ahead[i] = local[i] * step
        scale = ahead[i].sum()
        ahead[i] /= scale
        total += np.log(scale)
    back[n - 1] = 1.0
    for i in range(n - 2, -1, -1):
        after = local[i + 1] * back[i + 1]
        step = np.dot(np.dot(of_c[i], after), np.ascontiguousarray(of_a[i].T))
        back[i] = step / step.sum()
    nodes = ahead * back
    a_pairs, c_pairs = np.empty_like(association_edges), np.empty_like(clustering_edges)
    for i in range(n):
        nodes[i] /= nodes[i].sum()
        if i + 1 < n:
            after = local[i + 1] * back[i + 1]
            left = np.dot(np.ascontiguousarray(ahead[i].T), of_c[i])
            a_pairs[i] = of_a[i] * np.dot(left, after)
            a_pairs[i] /= a_pairs[i].sum()
            right = np.dot(ahead[i], of_a[i])
            c_pairs[i] = of_c[i] * np.dot(right, np.ascontiguousarray(after.T))
            c_pairs[i] /= c_pairs[i].sum()
    return nodes, a_pairs, c_pairs, total


def marginals(potentials: Potentials) -> tuple[Array, Array, Array, float]:
    """Probabilities of the nodes of each point (n, D + 1, K + 1), of neighbours' associations (n - 1, K + 1, K + 1) and
    clusters (n - 1, D + 1, D + 1), and the log partition function."""
    p = potentials
    association = np.where(np.isfinite(p.association), p.association, -1e4)
    found: tuple[Array, Array, Array, float] = _marginals(
        association, p.clustering, p.links, p.association_edges, p.clustering_edges
    )
    return found

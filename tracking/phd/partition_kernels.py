"""Compiled loops of the partitioning: the single-linkage tree and K-means."""

from __future__ import annotations

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from tracking.mixture.components import IntArray
from tracking.mixture.hypothesis_kernels import root_of


@njit(cache=True)
def single_linkage(count: int, first: IntArray, second: IntArray) -> tuple[IntArray, IntArray]:
    """Kruskal's algorithm over pairs in ascending order of distance.

    Returns merges (M, 2), the tree nodes joined (a leaf i < count, or count + index of an earlier merge), and
    the pair (M,) that joined them.
    """
    parent = np.arange(count)
    node = np.arange(count)
    merges = np.empty((max(count - 1, 0), 2), np.int64)
    joined = np.empty(max(count - 1, 0), np.int64)
    total = 0
    for k in range(len(first)):
        a, b = root_of(parent, first[k]), root_of(parent, second[k])
        if a == b:
            continue
        merges[total, 0], merges[total, 1] = node[a], node[b]
        joined[total] = k
        parent[b] = a
        node[a] = count + total
        total += 1
        if total == count - 1:
            break
    return merges[:total], joined[:total]


@njit(cache=True)
def k_means(points: FloatArray, k: int, iterations: int) -> tuple[IntArray, FloatArray]:
    """Lloyd's algorithm from mutually distant points: cluster (N,) of each point and centres (k, 2).

    The first centre is the point farthest from the mean, each next one the farthest from those before, so the
    result depends on the points alone.
    """
    n = len(points)
    centres = np.empty((k, 2))
    middle = np.array([points[:, 0].mean(), points[:, 1].mean()])
    nearest = np.full(n, np.inf)
    chosen = 0
    best = -1.0
    for i in range(n):
        d = (points[i, 0] - middle[0]) ** 2 + (points[i, 1] - middle[1]) ** 2
        if d > best:
            best, chosen = d, i
    for c in range(k):
        centres[c] = points[chosen]
        best = -1.0
        for i in range(n):
            d = (points[i, 0] - centres[c, 0]) ** 2 + (points[i, 1] - centres[c, 1]) ** 2
            nearest[i] = min(nearest[i], d)
            if nearest[i] > best:
                best, chosen = nearest[i], i
    cluster = np.zeros(n, np.int64)
    for _ in range(iterations):
        changed = False
        for i in range(n):
            best, chosen = np.inf, 0
            for c in range(k):
                d = (points[i, 0] - centres[c, 0]) ** 2 + (points[i, 1] - centres[c, 1]) ** 2
                if d < best:
                    best, chosen = d, c
            changed = changed or cluster[i] != chosen
            cluster[i] = chosen
        for c in range(k):
            size, x, y = 0, 0.0, 0.0
            for i in range(n):
                if cluster[i] == c:
                    size += 1
                    x += points[i, 0]
                    y += points[i, 1]
            if size > 0:
                centres[c, 0], centres[c, 1] = x / size, y / size
        if not changed:
            break
    return cluster, centres


@njit(cache=True)
def assign_to_targets(
    z: FloatArray, means: FloatArray, P: FloatArray, variance: float, rate: float, clutter: float, sweeps: int
) -> tuple[IntArray, FloatArray]:
    """Likeliest origin of each return (n,), 0 for clutter and k + 1 for target k, and its probability (n,).

    z (n, 2); predicted positions means (K, 2), P (K, 2, 2); variance of a return about its target, m²; expected
    returns per target; clutter density, 1/m². Between sweeps the positions are corrected by their shares of returns.
    """
    n, K = len(z), len(means)
    x, S, scale = means.copy(), np.empty((K, 2, 2)), np.empty(K)
    for k in range(K):
        S[k] = P[k] + variance * np.eye(2)
    owner, best, shares = np.zeros(n, np.int64), np.zeros(n), np.empty((n, K + 1))
    for sweep in range(sweeps):
        for k in range(K):
            scale[k] = rate / (2.0 * np.pi * np.sqrt(S[k, 0, 0] * S[k, 1, 1] - S[k, 0, 1] ** 2))
            S[k] = np.linalg.inv(S[k])
        for i in range(n):
            shares[i, 0] = clutter
            for k in range(K):
                a, b = z[i, 0] - x[k, 0], z[i, 1] - x[k, 1]
                square = S[k, 0, 0] * a * a + 2.0 * S[k, 0, 1] * a * b + S[k, 1, 1] * b * b
                shares[i, k + 1] = scale[k] * np.exp(-0.5 * square)
            shares[i] /= shares[i].sum()
            owner[i] = shares[i].argmax()
            best[i] = shares[i, owner[i]]
        if sweep == sweeps - 1:
            break
        for k in range(K):
            amount = max(shares[:, k + 1].sum(), 1e-6)
            offset = np.zeros(2)
            for i in range(n):
                offset += shares[i, k + 1] / amount * (z[i] - means[k])
            noise = variance / amount * np.eye(2)
            gain = P[k] @ np.linalg.inv(P[k] + noise)
            x[k] = means[k] + gain @ offset
            S[k] = gain @ noise + variance * np.eye(2)
    return owner, best

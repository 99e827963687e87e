"""The compiled loops of `learning.gradient_boosting`: growing one tree on binned features, and the sum of trees.

A tree of depth D is complete: node k has the children 2 k + 1 and 2 k + 2, the nodes of the last level are leaves.
A node that is not split sends everything to the left (threshold infinity).
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def grow(bins, chosen, gradient, curvature, depth, bin_count, least_curvature, l2):  # type: ignore[no-untyped-def]
    """One regression tree by second-order gain: (features (2^D - 1,), cuts (2^D - 1,), leaves (2^D,)).

    bins : (n, M) bin of every value, in 0 to bin_count - 1;  chosen : (K,) features that may split;
    gradient, curvature : (M,) of the loss, zero for a row left out. A row goes left where its bin is at most the cut.
    Of equal gains the first feature, then the lowest cut wins. Cut -1: the node is not split.
    """
    samples = bins.shape[1]
    inner = 2**depth - 1
    features = np.zeros(inner, dtype=np.int64)
    cuts = np.full(inner, -1, dtype=np.int64)
    node = np.zeros(samples, dtype=np.int64)
    for level in range(depth):
        first, count = 2**level - 1, 2**level
        best = np.zeros(count)
        sums = np.zeros((count, bin_count, 2))
        total = np.zeros((count, 2))
        for i in range(samples):
            total[node[i] - first, 0] += gradient[i]
            total[node[i] - first, 1] += curvature[i]
        for feature in chosen:
            sums[:] = 0.0
            column = bins[feature]
            for i in range(samples):
                cell = sums[node[i] - first, column[i]]
                cell[0] += gradient[i]
                cell[1] += curvature[i]
            for k in range(count):
                g, h = 0.0, 0.0
                whole = total[k, 0] * total[k, 0] / (total[k, 1] + l2)
                for b in range(bin_count - 1):
                    g += sums[k, b, 0]
                    h += sums[k, b, 1]
                    rest = total[k, 1] - h
                    if h < least_curvature:
                        continue
                    if rest < least_curvature:
                        break
                    other = total[k, 0] - g
                    gain = g * g / (h + l2) + other * other / (rest + l2) - whole
                    if gain > best[k] + 1e-12:
                        best[k] = gain
                        features[first + k], cuts[first + k] = feature, b
        for i in range(samples):
            k = node[i]
            right = cuts[k] >= 0 and bins[features[k], i] > cuts[k]
            node[i] = 2 * k + (2 if right else 1)
    leaves = np.zeros((2**depth, 2))
    for i in range(samples):
        leaves[node[i] - inner, 0] += gradient[i]
        leaves[node[i] - inner, 1] += curvature[i]
    return features, cuts, -leaves[:, 0] / (leaves[:, 1] + l2)


@numba.njit(cache=True)
def sum_trees(F, features, thresholds, leaves, depth):  # type: ignore[no-untyped-def]
    """Log odds (M,), the leaf values of all trees, for rows of F (M, n): features (T, 2^D - 1), leaves (T, 2^D).

    All rows go down a level together, as none has to wait for the other then; numbers of nodes and rows have no sign,
    as indices that have one are looked at for being below zero.
    """
    rows, inner = len(F), features.shape[1]
    columns = np.ascontiguousarray(F.T)
    sums, nodes = np.zeros(rows), np.zeros(rows, dtype=np.uint32)
    for t in range(len(features)):
        feature, threshold, leaf = features[t], thresholds[t], leaves[t]
        root, cut = columns[feature[0]], threshold[0]
        for i in range(rows):
            nodes[i] = np.uint32(1 + np.uint32(root[i] > cut))
        for _ in range(depth - 1):
            for i in range(rows):
                k = nodes[i]
                nodes[i] = np.uint32(2 * k + 1 + np.uint32(columns[feature[k], np.uint32(i)] > threshold[k]))
        for i in range(rows):
            sums[i] += leaf[nodes[i] - inner]
    return sums

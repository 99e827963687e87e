"""The compiled loops of `estimation.learning.boosting`: the search for the best stump, and the vote."""

from __future__ import annotations

import numba
import numpy as np

# Weighted errors closer than this are equal: initial weights are the same within a class, so exact ties are common
# and must not be decided by the order of a sum. Weights sum to one.
TIE = 1e-12


@numba.njit(cache=True)
def best_stump(columns, order, labels, weights):  # type: ignore[no-untyped-def]
    """Algorithm 4: the stump of least weighted error as (feature, threshold, polarity); feature -1 where none exists.

    columns : (n, M) each feature's values, ascending;  order : (n, M) the samples they belong to;
    labels : (M,) 0 or 1;  weights : (M,) summing to one.
    A cut between equal values is no cut (no threshold realises it), nor is one after the last value. Of equal errors
    the first feature, then the lowest cut, then polarity -1 wins.
    """
    features, samples = columns.shape
    total_negative, total_positive = 0.0, 0.0
    for i in range(samples):
        if labels[i] == 1:
            total_positive += weights[i]
        else:
            total_negative += weights[i]
    best_error, best_feature, best_cut, best_polarity = np.inf, -1, -1, 0
    for feature in range(features):
        negative, positive = 0.0, 0.0
        for j in range(samples - 1):
            sample = order[feature, j]
            if labels[sample] == 1:
                positive += weights[sample]
            else:
                negative += weights[sample]
            if columns[feature, j] == columns[feature, j + 1]:
                continue
            above = positive + total_negative - negative
            below = negative + total_positive - positive
            if above < best_error - TIE:
                best_error, best_feature, best_cut, best_polarity = above, feature, j, -1
            if below < best_error - TIE:
                best_error, best_feature, best_cut, best_polarity = below, feature, j, 1
    if best_feature < 0:
        return -1, 0.0, 0
    low, high = columns[best_feature, best_cut], columns[best_feature, best_cut + 1]
    threshold = 0.5 * low + 0.5 * high
    # Between neighbouring floats the midpoint is one of them, and only one of the two separates under a strict <.
    if not low < threshold < high:
        threshold = high if best_polarity == 1 else low
    return best_feature, threshold, best_polarity


@numba.njit(cache=True)
def vote(F, features, thresholds, polarities, weights):  # type: ignore[no-untyped-def]
    """Share of the weighted vote for class 1, (M,) in [0, 1]: equation (12) for every row of F (M, n)."""
    total = 0.0
    for t in range(len(weights)):
        total += weights[t]
    shares = np.empty(len(F))
    for i in range(len(F)):
        share = 0.0
        for t in range(len(weights)):
            polarity = polarities[t]
            share += weights[t] * (polarity * F[i, features[t]] < polarity * thresholds[t])
        # Summed in the order of `total`: a unanimous vote is exactly one.
        shares[i] = share / total
    return shares

"""Compiled loop of the correction: the likelihood of every centroid under every component."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from estimation.filters.gaussians import LOG_TWO_PI


@njit(cache=True)
def centroid_log_likelihood(
    centroids: FloatArray, counts: FloatArray, means: FloatArray, P: FloatArray, R: FloatArray
) -> FloatArray:
    """log N(z̄_c; m_j, P_j + R / n_c) (C, J) of centroids (C, 2) under positions (J, 2), (J, 2, 2)."""
    out = np.empty((len(centroids), len(means)))
    for c in range(len(centroids)):
        share = 1.0 / counts[c]
        for j in range(len(means)):
            a = P[j, 0, 0] + R[0, 0] * share
            b = P[j, 0, 1] + R[0, 1] * share
            d = P[j, 1, 1] + R[1, 1] * share
            determinant = a * d - b * b
            x, y = centroids[c, 0] - means[j, 0], centroids[c, 1] - means[j, 1]
            square = (d * x * x - 2.0 * b * x * y + a * y * y) / determinant
            out[c, j] = -0.5 * (square + math.log(determinant)) - LOG_TWO_PI
    return out

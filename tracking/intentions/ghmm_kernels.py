"""Compiled loops of the growing hidden Markov model: scaled forward and backward passes over sparse transitions.

States have at most K successors: `successors` (S, K) int64, -1 where there is none, `transitions` (S, K). Every step is
scaled by its sum, so that trajectories of any length stay in range; the logarithms of the scales add up to the
likelihood of the trajectory.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.filters.gaussians import LOG_TWO_PI

IntArray = NDArray[np.int64]
NOTHING = 1e-100


@njit(cache=True)
def log_observation(points: FloatArray, means: FloatArray, precisions: FloatArray) -> FloatArray:
    """log N(O_k; μ_i, Σ_i) (T, N) of points (T, 2); precisions (N, 4) are a, b, c of Σ⁻¹ and log |Σ|."""
    out = np.empty((len(points), len(means)))
    for k in range(len(points)):
        for i in range(len(means)):
            x, y = points[k, 0] - means[i, 0], points[k, 1] - means[i, 1]
            square = precisions[i, 0] * x * x + 2.0 * precisions[i, 1] * x * y + precisions[i, 2] * y * y
            out[k, i] = -0.5 * (square + precisions[i, 3]) - LOG_TWO_PI
    return out


@njit(cache=True)
def propagate(belief: FloatArray, successors: IntArray, transitions: FloatArray) -> FloatArray:
    """One step ahead: the sum in (4.11), (S,)."""
    out = np.zeros_like(belief)
    for i in range(len(belief)):
        weight = belief[i]
        if weight > 0.0:
            for e in range(successors.shape[1]):
                j = successors[i, e]
                if j < 0:
                    break
                out[j] += weight * transitions[i, e]
    return out


@njit(cache=True)
def weigh(predicted: FloatArray, log_b: FloatArray, nodes: IntArray) -> tuple[FloatArray, float]:
    """Bayes' rule of (4.11): normalised product of prediction (S,) and observation (N,), and log Z.

    An observation that no reachable state explains gives log Z = -inf and the prediction back.
    """
    top = -np.inf
    for s in range(len(predicted)):
        if predicted[s] > 0.0 and log_b[nodes[s]] > top:
            top = log_b[nodes[s]]
    out = np.zeros_like(predicted)
    total = 0.0
    if top > -np.inf:
        for s in range(len(predicted)):
            if predicted[s] > 0.0:
                weight = predicted[s] * math.exp(log_b[nodes[s]] - top)
                # Less than this is nothing; dividing by it in the backward pass would overflow.
                if weight > NOTHING:
                    out[s] = weight
                    total += weight
    if not total > 0.0:
        return predicted.copy(), -np.inf
    return out / total, top + math.log(total)


@njit(cache=True)
def forward(
    prior: FloatArray, successors: IntArray, transitions: FloatArray, log_b: FloatArray, nodes: IntArray
) -> tuple[FloatArray, FloatArray]:
    """(4.2), scaled: p(S_k | O_1:k) (T, S), and log p(O_k | O_1:k-1) (T,)."""
    alpha = np.empty((len(log_b), len(prior)))
    scales = np.empty(len(log_b))
    predicted = prior
    for k in range(len(log_b)):
        if k:
            predicted = propagate(alpha[k - 1], successors, transitions)
        row, scales[k] = weigh(predicted, log_b[k], nodes)
        alpha[k] = row
    return alpha, scales


@njit(cache=True)
def expected_counts(
    alpha: FloatArray,
    scales: FloatArray,
    successors: IntArray,
    transitions: FloatArray,
    log_b: FloatArray,
    nodes: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """(4.3) to (4.5) in one backward sweep.

    Returns the first state's posterior (S,) and the expected transitions Σ_k ξ_k (S, K); the last state's is alpha's.
    """
    steps, count = alpha.shape
    width = successors.shape[1]
    xi = np.zeros((count, width))
    beta = np.ones(count)
    for k in range(steps - 2, -1, -1):
        seen = np.empty(count)
        for s in range(count):
            seen[s] = 0.0
            if alpha[k + 1, s] > 0.0:
                seen[s] = beta[s] * math.exp(log_b[k + 1, nodes[s]] - scales[k + 1])
        beta = np.zeros(count)
        for i in range(count):
            for e in range(width):
                j = successors[i, e]
                if j < 0:
                    break
                step = transitions[i, e] * seen[j]
                beta[i] += step
                xi[i, e] += alpha[k, i] * step
    return alpha[0] * beta, xi

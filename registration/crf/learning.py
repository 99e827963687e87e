"""Learning from labelled pairs: boosting of the local features, weights by maximum pseudo-likelihood (section III.B).

The potentials are linear in the weights, so the features of every node are its potentials under unit weights. The
pseudo-likelihood of a pair is the product over nodes of each node's probability given its true neighbours; it is
concave, with a Gaussian prior on the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from estimation.boosting import AdaBoost
from registration.crf.exact import edge_factors, marginals
from registration.crf.potentials import OUT_OF_REACH, SIGNED, WEIGHTS, Potentials, Problem
from registration.motion import Array

ROUNDS = 50
ITERATIONS = 150  # of the search for the weights, which settles after 70 to 100
REGULARISATION = 1e-5  # of the squared weights, per node
BOUNDS = [(None, None) if name in SIGNED else (0.0, None) for name in WEIGHTS]


@dataclass(eq=False)
class Labels:
    """Truth of a problem as states: associations (n,), K is outlier, -1 unknown; clusters (n,), D is outlier."""

    associations: NDArray[np.int64]
    clusters: NDArray[np.int64]


@dataclass(eq=False)
class NodeFeatures:
    """Features of the states of many nodes: (m, S, F), -inf mask (m, S) of states that do not exist, truth (m,)."""

    values: Array
    missing: NDArray[np.bool_]
    truth: NDArray[np.int64]


def node_features(problem: Problem, labels: Labels) -> list[NodeFeatures]:
    """Features of each node given its true neighbours, association nodes first."""
    n, k = problem.states.shape
    known = np.where(labels.associations >= 0, labels.associations, k)
    clusters = labels.clusters
    count = len(WEIGHTS)
    association = np.zeros((n, k + 1, count))
    clustering = np.zeros((n, len(problem.motions) + 1, count))
    i = np.arange(n)
    missing = np.zeros((n, k + 1), dtype=bool)
    away = np.zeros(clustering.shape[:2], dtype=bool)
    for f in range(count):
        made = problem.potentials(np.eye(count)[f])
        missing[:, :k] = problem.states < 0
        association[:, :, f] = np.where(missing, 0.0, made.association) + made.links[i, clusters]
        away[:, :-1] = ~problem.active
        clustering[:, :, f] = np.where(away, 0.0, made.clustering) + made.links[i, :, known]
        if n > 1:
            e = np.arange(n - 1)
            association[1:, :, f] += made.association_edges[e, known[:-1], :]
            association[:-1, :, f] += made.association_edges[e, :, known[1:]]
            clustering[1:, :, f] += made.clustering_edges[e, clusters[:-1], :]
            clustering[:-1, :, f] += made.clustering_edges[e, :, clusters[1:]]
    told = labels.associations >= 0
    near = ~away[i, clusters]
    return [
        NodeFeatures(association[told], missing[told], labels.associations[told]),
        NodeFeatures(clustering[near], away[near], clusters[near]),
    ]


def negative_pseudo_likelihood(
    weights: Array, nodes: Sequence[NodeFeatures], regularisation: float = REGULARISATION
) -> tuple[float, Array]:
    """Mean negative log pseudo-likelihood with the prior, and its gradient (F,)."""
    value, gradient, count = 0.0, np.zeros(len(weights)), 0
    for group in nodes:
        m = np.arange(len(group.truth))
        scores = np.where(group.missing, -np.inf, group.values @ weights)
        scores = scores - scores.max(axis=1, keepdims=True)
        probability = np.exp(scores)
        total = probability.sum(axis=1)
        probability /= total[:, None]
        value -= float((scores[m, group.truth] - np.log(total)).sum())
        expected = np.einsum("ms,msf->f", probability, group.values)
        gradient -= group.values[m, group.truth].sum(axis=0) - expected
        count += len(m)
    count = max(count, 1)
    value = value / count + regularisation * float(weights @ weights)
    return value, gradient / count + 2.0 * regularisation * weights


def learn_weights(nodes: Sequence[NodeFeatures], regularisation: float = REGULARISATION) -> Array:
    """Weights (23,) of the greatest pseudo-likelihood, order of `WEIGHTS`."""
    found = minimize(
        negative_pseudo_likelihood,
        np.ones(len(WEIGHTS)),
        (nodes, regularisation),
        jac=True,
        method="L-BFGS-B",
    )
    return np.asarray(found.x)


@dataclass(eq=False)
class _Part:
    """One kind of potentials as features: which are ever other than zero, (f,), and their values (f, everything)."""

    features: NDArray[np.int64]
    values: Array
    shape: tuple[int, ...]

    @classmethod
    def of(cls, units: Sequence[Array]) -> _Part:
        """From the potentials under each unit weight."""
        used = [k for k, unit in enumerate(units) if unit.any()]
        values = np.array([units[k].ravel() for k in used]).reshape(len(used), units[0].size)
        return cls(np.array(used, dtype=np.int64), values, units[0].shape)

    def under(self, weights: Array) -> Array:
        """The potentials under `weights` (F,)."""
        return np.asarray(weights[self.features] @ self.values).reshape(self.shape)

    def add_gradient(self, difference: Array, gradient: Array) -> None:
        """Add the features' sums weighted by `difference`, of this part's shape, to `gradient` (F,)."""
        gradient[self.features] += self.values @ difference.ravel()


class Likelihood:
    """Exact log likelihood of labelled problems: what pseudo-likelihood stands in for where it cannot be afforded.

    Given its true neighbours a node is nearly known, so pseudo-likelihood leaves little for the local features to say;
    the likelihood does not have that bias. Each problem is held as its potentials under unit weights.
    """

    def __init__(self, cases: Sequence[tuple[Problem, Labels]]) -> None:
        self._cases: list[tuple[list[_Part], Labels, Potentials]] = []
        for problem, labels in cases:
            k = problem.states.shape[1]
            units = [problem.potentials(row) for row in np.eye(len(WEIGHTS))]
            # A state that does not exist has -inf under every weight: kept apart from what is weighted.
            mask = Potentials(*(np.zeros_like(part) for part in _parts(units[0])))
            mask.association[:, :k] = np.where(problem.states < 0, -np.inf, 0.0)
            mask.clustering[:, :-1] = np.where(problem.active, 0.0, OUT_OF_REACH)
            for unit in units:
                unit.association[:, :k][problem.states < 0] = 0.0
                unit.clustering[:, :-1][~problem.active] = 0.0
            parts = [_Part.of(kind) for kind in zip(*(_parts(unit) for unit in units), strict=True)]
            self._cases.append((parts, labels, mask))
        self._count = sum(len(labels.clusters) for _, labels, _ in self._cases)

    def negative(self, weights: Array, regularisation: float = REGULARISATION) -> tuple[float, Array]:
        """Mean negative log likelihood per point with the prior, and its gradient (F,).

        A point whose true association is no candidate may be any of those it has; one without candidates is an outlier,
        and one whose true cluster is out of reach may be in any.
        """
        value, gradient = 0.0, np.zeros(len(weights))
        for parts, labels, mask in self._cases:
            free = Potentials(*(part.under(weights) for part in parts))
            free.association += mask.association
            free.clustering += mask.clustering
            factors = edge_factors(free)
            clamped = replace(free)
            clamped.association, clamped.clustering = _clamped(free, labels, mask)
            nodes, a_pairs, c_pairs, normaliser = marginals(free, factors)
            true_nodes, true_a, true_c, score = marginals(clamped, factors)
            value -= score - normaliser
            nodes -= true_nodes
            differences = (nodes.sum(axis=1), nodes.sum(axis=2), nodes, a_pairs - true_a, c_pairs - true_c)
            for part, difference in zip(parts, differences, strict=True):
                part.add_gradient(difference, gradient)
        value = value / self._count + regularisation * float(weights @ weights)
        return value, gradient / self._count + 2.0 * regularisation * weights

    def learn(self, start: Array, regularisation: float = REGULARISATION, most: int = ITERATIONS) -> Array:
        """Weights of the greatest likelihood, from `start` (those of the pseudo-likelihood)."""
        found = minimize(
            self.negative, start, (regularisation,), jac=True, method="L-BFGS-B", bounds=BOUNDS,
            options={"maxiter": most},
        )  # fmt: skip
        return np.asarray(found.x)


def _parts(potentials: Potentials) -> tuple[Array, ...]:
    p = potentials
    return p.association, p.clustering, p.links, p.association_edges, p.clustering_edges


def _clamped(free: Potentials, labels: Labels, mask: Potentials) -> tuple[Array, Array]:
    """Local potentials with all but the true states forbidden."""
    association, clustering = free.association.copy(), free.clustering.copy()
    n, k = association.shape
    i = np.arange(n)
    told = labels.associations >= 0
    wrong = told[:, None] & (np.arange(k)[None] != labels.associations[:, None])
    # With candidates, but not the true one, it is some candidate; without any it can only be an outlier.
    wrong[:, k - 1] |= ~told & np.isfinite(association[:, : k - 1]).any(axis=1)
    association[wrong] = -np.inf
    other = np.ones_like(clustering, dtype=bool)
    other[i, labels.clusters] = False
    other[mask.clustering[i, labels.clusters] < 0.0] = False
    clustering[other] = -1e4
    return association, clustering


def learn_boosting(
    pairs: Sequence[tuple[Array, NDArray[np.int64], Array, NDArray[np.int64]]],
) -> tuple[AdaBoost, AdaBoost]:
    """Data and outlier boosting from (features (n, K, 12), states (n, K), hints (n, 20), truth (n,)) of pairs.

    truth : state of the true association, K for an outlier, -1 where it is no candidate.
    """
    rows, marks, hints, outliers = [], [], [], []
    for features, states, hint, truth in pairs:
        k = states.shape[1]
        told = (truth >= 0) & (truth < k)
        there = (states >= 0) & told[:, None]
        rows.append(features[there])
        marks.append((np.arange(k)[None] == truth[:, None])[there])
        hints.append(hint[truth >= 0])
        outliers.append(truth[truth >= 0] == k)
    data = AdaBoost(ROUNDS).fit(np.concatenate(rows), np.concatenate(marks).astype(int))
    outlier = AdaBoost(ROUNDS).fit(np.concatenate(hints), np.concatenate(outliers).astype(int))
    return data, outlier

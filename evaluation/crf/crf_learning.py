"""Learning of the joint models from labelled pairs: the text's by boosting and pseudo-likelihood, ours by trees."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import minimize

from estimation.checks import FloatArray
from estimation.learning.boosting import AdaBoost
from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.scenes.labelled_pairs import LabelledPair
from registration.crf.as_printed import PrintedCrf, all_states, least_of
from registration.crf.as_printed_messages import FEATURES, log_score
from registration.crf.beam_evidence import evidence
from registration.crf.beams import Beams, beams_of
from registration.crf.labels import groups_as_labels
from registration.crf.setup import start
from registration.crf.shape_features import pair_features

TREES, DEPTH = 150, 6
MOST_POINTS = 100  # of a pair, that the trees learn from
ROUNDS = 50  # decision stumps (IV.C.1)
AROUND = (
    4  # beams to either side of the true one, and as many drawn ones, that boosting learns to tell from it
)
NODES = 3  # every so many nodes the weights are learned from
ASSOCIATION = 7  # the first features of FEATURES are the association chain's


def learned_trees(pairs: Iterable[LabelledPair], trees: int = TREES) -> GradientBoosting:
    """The trees learned from what the groups of labelled pairs show."""
    features, truth = [], []
    for pair in pairs:
        begun = start(pair.scan_a, pair.scan_b)
        if not begun.registration.converged:
            continue
        every = max(1, round(len(begun.a) / MOST_POINTS))
        # In single precision: there are millions of them.
        features.append(evidence(begun, groups_as_labels(begun))[::every].astype(np.float32))
        truth.append(pair.moving[begun.a.beams][::every])
    rows, labels = np.concatenate(features), np.concatenate(truth).astype(np.int64)
    return GradientBoosting(trees, DEPTH).fit(rows, labels)


@dataclass(eq=False)
class PairTruth:
    """A labelled pair as states: x_a (n,), M outlier; x_c (n,), D - 1 outlier; motions (D - 1, 3)."""

    a: Beams
    b: Beams
    x_a: NDArray[np.int64]
    x_c: NDArray[np.int64]
    motions: FloatArray

    @classmethod
    def of(cls, pair: LabelledPair) -> PairTruth:
        a, b = beams_of(pair.scan_a), beams_of(pair.scan_b)
        partners, clusters = pair.associations[a.beams], pair.clusters[a.beams]
        x_a = np.where(partners >= 0, b.number[np.maximum(partners, 0)], len(b))
        return cls(a, b, x_a, np.where(clusters < 0, len(pair.motions), clusters), np.array(pair.motions))


def learned_printed(
    pairs: Sequence[LabelledPair], card: dict[str, Any] | None = None, seed: int = 0
) -> PrintedCrf:
    """Boosting first, then the weights by maximum pseudo-likelihood (III.B)."""
    rng = np.random.default_rng(seed)
    truths = [PairTruth.of(pair) for pair in pairs]
    rows, marks, hints, outliers = [], [], [], []
    for truth in truths:
        m = len(truth.b)
        chosen = truth.motions[np.where(truth.x_c < len(truth.motions), truth.x_c, 0)]
        features = pair_features(truth.a, truth.b, all_states(truth.a, truth.b), chosen)
        for i in np.flatnonzero(truth.x_a < m):
            near = truth.x_a[i] + np.delete(np.arange(-AROUND, AROUND + 1), AROUND)
            others = np.concatenate((near[(near >= 0) & (near < m)], rng.integers(m, size=AROUND)))
            states = np.concatenate(([truth.x_a[i]], others[others != truth.x_a[i]]))
            rows.append(features[i, states])
            marks.append(states == truth.x_a[i])
        hints.append(least_of(features))
        outliers.append(truth.x_a == m)
    data = AdaBoost(ROUNDS).fit(np.concatenate(rows), np.concatenate(marks).astype(int))
    outlier = AdaBoost(ROUNDS).fit(np.concatenate(hints), np.concatenate(outliers).astype(int))
    model = PrintedCrf(np.zeros(len(FEATURES)), data, outlier, dict(card or {}))
    nodes = [group for truth in truths for group in node_features(model, truth)]
    found = minimize(
        negative_pseudo_likelihood, np.ones(len(FEATURES)), (nodes,), jac=True, method="L-BFGS-B"
    )
    model.weights = np.asarray(found.x)
    return model


def node_features(model: PrintedCrf, truth: PairTruth) -> list[tuple[FloatArray, NDArray[np.int64], int]]:
    """Of every third node of both chains its features (m, S, F) given its Markov blanket, true states (m,), and the
    number of its first feature in FEATURES."""
    states, index = all_states(truth.a, truth.b), np.arange(0, len(truth.a), NODES)
    local = model.boosted(truth.a, truth.b, states)
    association = np.zeros((len(index), len(truth.b) + 1, ASSOCIATION))
    clustering = np.zeros((len(index), len(truth.motions) + 1, len(FEATURES) - ASSOCIATION))
    for first, features in ((0, association), (ASSOCIATION, clustering)):
        _blankets(
            index, truth.a.points, truth.b.points, states, *local, truth.motions, truth.x_a, truth.x_c, first,
            features,
        )  # fmt: skip
    return [(association, truth.x_a[index], 0), (clustering, truth.x_c[index], ASSOCIATION)]


@njit(cache=True)
def _blankets(index, points, others, states, static, outlier, stumps, motions, x_a, x_c, first, features):  # type: ignore[no-untyped-def]
    """Write what each state of the nodes `index` (m,) is worth, given its Markov blanket, to `features` (m, S, F).

    They are linear in the weights: each is the worth under its own unit weight, up to a constant. first : the number
    of the first of these F features, which are of one chain.
    """
    w = np.zeros(len(FEATURES))
    for row in range(len(index)):
        low, high = max(index[row] - 1, 0), min(index[row] + 2, len(points))
        a, c = x_a[low:high].copy(), x_c[low:high].copy()
        own = a if first == 0 else c
        for f in range(features.shape[2]):
            w[:] = 0.0
            w[first + f] = 1.0
            for t in range(features.shape[1]):
                own[index[row] - low] = t
                features[row, t, f] = log_score(
                    w, points[low:high], others, states[low:high], static[low:high], outlier[low:high], stumps,
                    motions, a, c,
                )  # fmt: skip


def negative_pseudo_likelihood(
    weights: FloatArray,
    nodes: Sequence[tuple[FloatArray, NDArray[np.int64], int]],
    regularisation: float = 1e-5,
) -> tuple[float, FloatArray]:
    """Mean negative log pseudo-likelihood with a Gaussian prior, and its gradient (F,)."""
    value, gradient, count = 0.0, np.zeros(len(weights)), 0
    for features, truth, first in nodes:
        own = slice(first, first + features.shape[2])
        scores = features @ weights[own]
        scores -= scores.max(axis=1, keepdims=True)
        probability = np.exp(scores)
        total = probability.sum(axis=1)
        m = np.arange(len(truth))
        value -= float((scores[m, truth] - np.log(total)).sum())
        probability /= total[:, None]
        gradient[own] += np.tensordot(probability, features, 2) - features[m, truth].sum(axis=0)
        count += len(m)
    value = value / count + regularisation * float(weights @ weights)
    return value, gradient / count + 2.0 * regularisation * weights

"""The joint CRF as the text prints it, in its notation: p(x^A, x^C, x^RT | z), equation (4).

x^A_i is one of the M points of the second scan or an outlier, x^C_i one of D clusters, the last one the outliers, and
x^RT the motion of every cluster. Two chains, joined only through x^RT (figure 1); Algorithm 1 in `as_printed_messages`;
weights by maximum pseudo-likelihood (III.B). It begins blind, or where `start` is given, with its motions.

What the text leaves open: formulas of the features, so that there are 16 weights here for its 30; InitialiseRT, here
K-means over the displacements of the likeliest associations; MaxIterations.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from estimation.boosting import AdaBoost
from estimation.errors import InputError
from registration.crf.as_printed_messages import (
    FEATURES,
    algorithm_1,
    association_edge,
    association_local,
    clustering_edges,
    clustering_local,
    log_score,
)
from registration.crf.beams import Beams, beams_of, moved
from registration.crf.estimate import UNKNOWN, JointEstimate, nothing
from registration.crf.rigid import rigid_motion
from registration.crf.setup import Start
from registration.crf.shape_features import NAMES, pair_features
from registration.motion import Array
from registration.scan import Scan

FORMAT, VERSION = "whereabouts.printed_crf", 1
CLUSTERS = 4  # and the outliers: D = 5 in section V
ITERATIONS = 15  # MaxIterations
LEAST_MEMBERS = 3  # of a cluster that is not vacuous
ROUNDS = 50  # decision stumps (IV.C.1)
AROUND = (
    4  # beams to either side of the true one, and as many drawn ones, that boosting learns to tell from it
)
NODES = 3  # every so many nodes the weights are learned from
REGISTERED = NAMES.index("registered translation")
ASSOCIATION = 7  # the first features of FEATURES are the association chain's


class Labelled(Protocol):
    """A pair of scans with truth in the conventions of `JointEstimate`."""

    @property
    def scan_a(self) -> Scan: ...
    @property
    def scan_b(self) -> Scan: ...
    @property
    def associations(self) -> NDArray[np.int64]: ...
    @property
    def clusters(self) -> NDArray[np.int64]: ...
    @property
    def motions(self) -> Array: ...


@dataclass(eq=False)
class PrintedCrf:
    """Weights (16,) in the order of `FEATURES`, and the boosted classifiers of the association's local features."""

    weights: Array
    data: AdaBoost
    outlier: AdaBoost
    card: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path | None = None) -> PrintedCrf:
        """The model of `path`, or the one that is shipped; InputError if the file is none."""
        if path is None:
            text = resources.files("registration.crf").joinpath("models/as_printed.json").read_text("utf-8")
        else:
            text = Path(path).read_text(encoding="utf-8")
        try:
            content = json.loads(text)
            if (content["format"], content["version"]) != (FORMAT, VERSION):
                raise InputError(f"path: {path} holds no {FORMAT} model of version {VERSION}")
            weights = np.array([content["weights"][name] for name in FEATURES])
            data, outlier = (AdaBoost.from_dict(content[name]) for name in ("data", "outlier"))
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"path: {path} is no complete {FORMAT} model: {error}") from error
        return cls(weights, data, outlier, content.get("card", {}))

    def save(self, path: str | Path) -> None:
        """Write the model as JSON."""
        content = {"format": FORMAT, "version": VERSION, "card": self.card}
        content["weights"] = dict(zip(FEATURES, map(float, self.weights), strict=True))
        content |= {"data": self.data.to_dict(), "outlier": self.outlier.to_dict()}
        Path(path).write_text(json.dumps(content) + "\n", encoding="utf-8")

    def infer(
        self, scan_a: Scan, scan_b: Scan, start: Start | None = None, joined: bool = True, nearest: int | None = None
    ) -> JointEstimate:  # fmt: skip
        """MAP labelling and motions, equation (5).

        start : what `registration.crf.setup.start` found, to begin with its motions and groups; else blind.
        joined : False for the chains one after the other, the links to x^RT removed: CRF-Matching, CRF-Clustering.
        nearest : so many states of x^A_i, those nearest to begin with (section VI), instead of all M.
        """
        a, b = beams_of(scan_a), beams_of(scan_b)
        if min(len(a), len(b)) < LEAST_MEMBERS:
            return nothing(len(scan_a), f"{min(len(a), len(b))} returns, {LEAST_MEMBERS} are needed")
        chains = _Chains(self, a, b, start, nearest)
        if joined:
            chains.run(True, True, True)
        else:
            chains.run(True, False, False)
            if start is None:
                chains.x_c, chains.motions = initialise_rt(a, b, chains.partners)
            chains.run(False, True, True)
        return _estimate(a, b, chains, start is None)

    def match(
        self, scan_a: Scan, scan_b: Scan, start: Start | None = None, nearest: int | None = None
    ) -> NDArray[np.int64]:
        """CRF-Matching: (n,) point of scan_b of every point of scan_a, -1 outlier."""
        chains = _Chains(self, beams_of(scan_a), beams_of(scan_b), start, nearest)
        chains.run(True, False, False)
        return chains.partners

    def boosted(self, a: Beams, b: Beams, states: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Data boosting (n, K) without its stumps on x^RT, outlier boosting (n,), and those stumps (T, 3)."""
        features = pair_features(a, b, states, np.zeros((len(a), 3)))
        total = sum(stump.weight for stump in self.data.stumps)
        static, stumps = np.zeros(states.shape), []
        for stump in self.data.stumps:
            share = stump.weight / total
            if stump.feature == REGISTERED:
                stumps.append((stump.threshold, stump.polarity, share))
            else:
                static += share * (
                    stump.polarity * features[:, :, stump.feature] < stump.polarity * stump.threshold
                )
        outlier = self.outlier.score(_least(features)) - 0.5
        return static, outlier, np.array(stumps, dtype=np.float64).reshape(-1, 3)


class _Chains:
    """Both chains of a pair of scans: x_a (n,) states of association, K outlier; x_c (n,); motions (D - 1, 3)."""

    def __init__(
        self, model: PrintedCrf, a: Beams, b: Beams, start: Start | None, nearest: int | None
    ) -> None:
        """Line 1 of Algorithm 1."""
        self._model, self._a, self._b = model, a, b
        self.x_c, self.motions = np.zeros(len(a), dtype=np.int64), np.zeros((1, 3))
        if start is not None:
            self.motions = start.motions.copy()
            for number, group in enumerate(start.found, start=1):
                self.x_c[group.members] = number
        chosen = self.motions[self.x_c]
        if nearest is None or nearest >= len(b):
            self._states = all_states(a, b)
        else:
            there = np.array([moved(point, own) for point, own in zip(a.points, chosen, strict=True)])
            self._states = np.sort(cKDTree(b.points).query(there, nearest)[1].reshape(len(a), -1), axis=1)
        self._local = model.boosted(a, b, self._states)
        self.x_a = np.empty(len(a), dtype=np.int64)
        static, outlier, stumps = self._local
        local = np.empty(self._states.shape[1] + 1)
        for i in range(len(a)):
            association_local(
                model.weights, static[i], outlier[i], stumps, a.points[i], chosen[i], b.points, self._states[i], local
            )  # fmt: skip
            self.x_a[i] = local.argmax()
        if start is None:
            self.x_c, self.motions = initialise_rt(a, b, self.partners)

    @property
    def partners(self) -> NDArray[np.int64]:
        """(n,) point of b, -1 outlier."""
        most = self._states.shape[1]
        chosen = self._states[np.arange(len(self.x_a)), np.minimum(self.x_a, most - 1)]
        return np.where(self.x_a < most, chosen, -1)

    def log_score(self) -> float:
        """The exponent of equation (1)."""
        return float(
            log_score(
                self._model.weights, self._a.points, self._b.points, self._states, *self._local, self.motions,
                self.x_a, self.x_c,
            )
        )  # fmt: skip

    def run(self, associate: bool, cluster: bool, moving: bool) -> None:
        """Algorithm 1 on the chains that are asked for; moving : x^RT as well."""
        algorithm_1(
            self._model.weights, self._a.points, self._b.points, self._states, *self._local, self.motions,
            self.x_a, self.x_c, ITERATIONS, associate, cluster, moving,
        )  # fmt: skip


def all_states(a: Beams, b: Beams) -> NDArray[np.int64]:
    """(n, M) every point of the second scan, for every point of the first."""
    return np.ascontiguousarray(np.broadcast_to(np.arange(len(b)), (len(a), len(b))))


def _least(features: Array) -> Array:
    """(n, 11) least of each feature over all states, but for the registered one: inputs of outlier boosting."""
    return np.asarray(np.delete(features, REGISTERED, axis=2).min(axis=1))


def initialise_rt(a: Beams, b: Beams, partners: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """InitialiseRT without any knowledge: K-means over the displacements of the associations (n,)."""
    found = k_means(b.points[partners] - a.points, partners >= 0)
    motions = np.zeros((CLUSTERS, 3))
    for d in range(CLUSTERS):
        members = found == d
        if members.sum() >= LEAST_MEMBERS:
            motions[d] = rigid_motion(a.points[members], b.points[partners[members]])
    return np.where(found >= 0, found, CLUSTERS), motions


def k_means(
    displacements: Array, told: NDArray[np.bool_], centres: Array | None = None, clusters: int = CLUSTERS
) -> NDArray[np.int64]:
    """Clusters (n,) by displacement (n, 2), -1 where none is `told`; without `centres` the largest is 0.

    centres : (K, 2) to begin with; else as far apart as there are.
    """
    found = np.full(len(displacements), -1, dtype=np.int64)
    points = displacements[told]
    if not len(points):
        return found
    if centres is None:
        begin = [np.median(points, axis=0)]
        for _ in range(min(clusters, len(points)) - 1):
            away = np.min([np.hypot(*(points - centre).T) for centre in begin], axis=0)
            begin.append(points[int(away.argmax())])
    middle = np.array(begin if centres is None else centres)
    for _ in range(50):
        near = np.hypot(*(points[:, None] - middle[None]).transpose(2, 0, 1)).argmin(axis=1)
        again = np.array(
            [points[near == k].mean(axis=0) if (near == k).any() else middle[k] for k in range(len(middle))]
        )
        if np.allclose(again, middle):
            break
        middle = again
    if centres is None:
        order = np.argsort(-np.bincount(near, minlength=len(middle)), kind="stable")
        near = np.argsort(order)[near]
    found[told] = near
    return found


def _estimate(a: Beams, b: Beams, chains: _Chains, blind: bool) -> JointEstimate:
    """Lines 16 to 21: states per beam, vacuous clusters dropped, where it began blind the largest the background."""
    x_c, motions, partners = chains.x_c, chains.motions, chains.partners
    size = np.bincount(x_c, minlength=len(motions) + 1)[: len(motions)]
    order = np.argsort(-size, kind="stable") if blind else np.arange(len(motions))
    kept = [d for k, d in enumerate(order) if k == 0 or size[d] >= LEAST_MEMBERS]
    numbers = np.full(len(motions) + 1, -1)
    numbers[kept] = np.arange(len(kept))
    clusters = numbers[x_c]
    count = len(a.ranges)
    associations, labels = np.full(count, -1, dtype=np.int64), np.full(count, -1, dtype=np.int64)
    probabilities = np.full(count, np.nan)
    associations[a.beams] = np.where(partners >= 0, b.beams[partners], -1)
    labels[a.beams] = clusters
    probabilities[a.beams] = clusters > 0
    covariances = np.repeat(UNKNOWN[None], len(kept), axis=0)
    return JointEstimate(associations, labels, motions[kept], chains.log_score(), covariances, probabilities)


@dataclass(eq=False)
class _Truth:
    """A labelled pair as states: x_a (n,), M outlier; x_c (n,), D - 1 outlier; motions (D - 1, 3)."""

    a: Beams
    b: Beams
    x_a: NDArray[np.int64]
    x_c: NDArray[np.int64]
    motions: Array

    @classmethod
    def of(cls, pair: Labelled) -> _Truth:
        a, b = beams_of(pair.scan_a), beams_of(pair.scan_b)
        partners, clusters = pair.associations[a.beams], pair.clusters[a.beams]
        x_a = np.where(partners >= 0, b.number[np.maximum(partners, 0)], len(b))
        return cls(a, b, x_a, np.where(clusters < 0, len(pair.motions), clusters), np.array(pair.motions))


def train(pairs: Sequence[Labelled], card: dict[str, Any] | None = None, seed: int = 0) -> PrintedCrf:
    """Boosting first, then the weights by maximum pseudo-likelihood (III.B)."""
    rng = np.random.default_rng(seed)
    truths = [_Truth.of(pair) for pair in pairs]
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
        hints.append(_least(features))
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


def node_features(model: PrintedCrf, truth: _Truth) -> list[tuple[Array, NDArray[np.int64], int]]:
    """Of every third node of both chains its features (m, S, F) given its Markov blanket, true states (m,), and the
    number of its first feature in FEATURES."""
    static, outlier, stumps = model.boosted(truth.a, truth.b, all_states(truth.a, truth.b))
    index = np.arange(0, len(truth.a), NODES)
    association = np.zeros((len(index), len(truth.b) + 1, ASSOCIATION))
    clustering = np.zeros((len(index), len(truth.motions) + 1, len(FEATURES) - ASSOCIATION))
    _node_features(
        index, truth.a.points, truth.b.points, static, outlier, stumps, truth.motions, truth.x_a, truth.x_c,
        association, clustering,
    )  # fmt: skip
    return [(association, truth.x_a[index], 0), (clustering, truth.x_c[index], ASSOCIATION)]


@njit(cache=True)
def _node_features(  # type: ignore[no-untyped-def]
    index, points, others, static, outlier, stumps, motions, x_a, x_c, association, clustering
):  # fmt: skip
    """The features are linear in the weights: each is what the node is worth under its own unit weight."""
    n, m, count = len(points), len(others), len(motions)
    first, features = association.shape[2], association.shape[2] + clustering.shape[2]
    a_local, c_local, edges = np.empty(m + 1), np.empty(count + 1), np.empty((count + 1, count + 1))
    states = np.arange(m)
    for row in range(len(index)):
        i = index[row]
        for f in range(features):
            w = np.zeros(features)
            w[f] = 1.0
            if f < first:
                d = x_c[i] if x_c[i] < count else 0
                association_local(
                    w, static[i], outlier[i], stumps, points[i], motions[d], others, states, a_local
                )
                association[row, :, f] = a_local
            else:
                k = x_a[i]
                clustering_local(w, points[i], motions, others[min(k, m - 1)], k < m, c_local)
                clustering[row, :, f - first] = c_local
            for j in (i - 1, i + 1):
                if j < 0 or j >= n:
                    continue
                low, high = min(i, j), max(i, j)
                if f < first:
                    for t in range(m + 1):
                        s, e = (t, x_a[j]) if i < j else (x_a[j], t)
                        if s < m and e < m:
                            value = association_edge(w, points[low], points[high], others[s], others[e], s, e)
                        elif s == m and e == m:
                            value = w[4]
                        else:
                            value = -w[3]
                        association[row, t, f] += value
                else:
                    told = x_a[low] < m and x_a[high] < m
                    clustering_edges(
                        w, points[low], points[high], others[min(x_a[low], m - 1)], others[min(x_a[high], m - 1)],
                        told, motions, edges,
                    )  # fmt: skip
                    for t in range(count + 1):
                        clustering[row, t, f - first] += edges[t, x_c[j]] if i < j else edges[x_c[j], t]


def negative_pseudo_likelihood(
    weights: Array, nodes: Sequence[tuple[Array, NDArray[np.int64], int]], regularisation: float = 1e-5
) -> tuple[float, Array]:
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

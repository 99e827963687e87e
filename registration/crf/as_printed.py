"""The joint CRF as the text prints it, in its notation: p(x^A, x^C, x^RT | z), equation (4).

x^A_i is one of the M points of the second scan or an outlier, x^C_i one of D clusters, the last one the outliers, and
x^RT the motion of every cluster. Two chains, joined only through x^RT (figure 1); Algorithm 1 in `as_printed_messages`;
weights are learned beside the product (III.B, `evaluation.crf.crf_learning`). It begins blind, or where `start`
is given, with its motions.

What the text leaves open: formulas of the features, so that there are 16 weights here for its 30; InitialiseRT, here
K-means over the displacements of the likeliest associations; MaxIterations.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray, require_count, require_kind
from estimation.learning.boosting import AdaBoost
from registration.crf.as_printed_messages import (
    FEATURES,
    Inferred,
    algorithm_1,
    association_local,
    log_score,
)
from registration.crf.beams import Beams, beams_of, moved, per_beam
from registration.crf.estimate import JointEstimate, nothing, read_model
from registration.crf.setup import Start
from registration.crf.shape_features import NAMES, pair_features
from registration.laser.rigid import rigid_motion
from registration.laser.scan import Scan
from registration.result import UNKNOWN

FORMAT, VERSION = "whereabouts.printed_crf", 1
CLUSTERS = 4  # and the outliers: D = 5 in section V
ITERATIONS = 15  # MaxIterations
LEAST_MEMBERS = 3  # of a cluster that is not vacuous
REGISTERED = NAMES.index("registered translation")


@dataclass(eq=False)
class PrintedCrf:
    """Weights (16,) in the order of `FEATURES`, and the boosted classifiers of the association's local features."""

    weights: FloatArray
    data: AdaBoost
    outlier: AdaBoost
    card: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path | None = None) -> PrintedCrf:
        """The model of `path`, or the one that is shipped; InputError if the file is none."""

        def made_of(content: dict[str, Any]) -> PrintedCrf:
            weights = np.array([content["weights"][name] for name in FEATURES])
            data, outlier = (AdaBoost.from_dict(content[name]) for name in ("data", "outlier"))
            return cls(weights, data, outlier, content.get("card", {}))

        return read_model(path, "as_printed.json", FORMAT, VERSION, made_of)

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

        Begun from a registration that did not converge, it did not either, and says why.
        """
        require_kind("scan_a", scan_a, Scan)
        require_kind("scan_b", scan_b, Scan)
        if start is not None:
            require_kind("start", start, Start)
        if nearest is not None:
            nearest = require_count("nearest", nearest)
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
        estimate = _estimate(a, b, chains, start is None)
        if start is None or start.registration.converged:
            return estimate
        return replace(estimate, converged=False, reason=start.registration.reason)

    def match(
        self, scan_a: Scan, scan_b: Scan, start: Start | None = None, nearest: int | None = None
    ) -> NDArray[np.int64]:
        """CRF-Matching: (n,) point of scan_b of every point of scan_a, -1 outlier."""
        chains = _Chains(self, beams_of(scan_a), beams_of(scan_b), start, nearest)
        chains.run(True, False, False)
        return chains.partners

    def boosted(
        self, a: Beams, b: Beams, states: NDArray[np.int64]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
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
        outlier = self.outlier.score(least_of(features)) - 0.5
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
        there = np.array([moved(one, self.motions[d]) for d, one in zip(self.x_c, a.points, strict=True)])
        if nearest is None or nearest >= len(b):
            self._states = all_states(a, b)
        else:
            self._states = np.sort(cKDTree(b.points).query(there, nearest)[1].reshape(len(a), -1), axis=1)
        static, outlier, stumps = self._local = model.boosted(a, b, self._states)
        self.x_a = np.empty(len(a), dtype=np.int64)
        local = np.empty(self._states.shape[1] + 1)
        for i, (x, y) in enumerate(there):
            association_local(
                model.weights, static[i], outlier[i], stumps, x, y, b.points, self._states[i], local
            )
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
            self.x_a, self.x_c, ITERATIONS, Inferred(associate, cluster, moving),
        )  # fmt: skip


def all_states(a: Beams, b: Beams) -> NDArray[np.int64]:
    """(n, M) every point of the second scan, for every point of the first."""
    return np.ascontiguousarray(np.broadcast_to(np.arange(len(b)), (len(a), len(b))))


def least_of(features: FloatArray) -> FloatArray:
    """(n, 11) least of each feature over all states, but for the registered one: inputs of outlier boosting."""
    return np.asarray(np.delete(features, REGISTERED, axis=2).min(axis=1))


def initialise_rt(a: Beams, b: Beams, partners: NDArray[np.int64]) -> tuple[NDArray[np.int64], FloatArray]:
    """InitialiseRT without any knowledge: K-means over the displacements of the associations (n,)."""
    found = k_means(b.points[partners] - a.points, partners >= 0)
    motions = np.zeros((CLUSTERS, 3))
    for d in range(CLUSTERS):
        members = found == d
        if members.sum() >= LEAST_MEMBERS:
            motions[d] = rigid_motion(a.points[members], b.points[partners[members]])
    return np.where(found >= 0, found, CLUSTERS), motions


def k_means(
    displacements: FloatArray,
    told: NDArray[np.bool_],
    centres: FloatArray | None = None,
    clusters: int = CLUSTERS,
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
        near = cKDTree(middle).query(points)[1]
        again = np.array(
            [points[near == k].mean(axis=0) if k in near else one for k, one in enumerate(middle)]
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
    associations, labels, probabilities = per_beam(
        a, b, partners, clusters, (clusters > 0).astype(np.float64)
    )
    covariances = np.repeat(UNKNOWN[None], len(kept), axis=0)
    return JointEstimate(associations, labels, motions[kept], chains.log_score(), covariances, probabilities)

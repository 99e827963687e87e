"""Training of the joint model from labelled pairs of scans."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from estimation.gradient_boosting import GradientBoosting
from registration.crf.evidence import evidence
from registration.crf.finish import finish
from registration.crf.hypotheses import Hypothesis
from registration.crf.inference import infer_labels
from registration.crf.learning import Labels, Likelihood, learn_boosting, learn_weights, node_features
from registration.crf.model import JointModel
from registration.crf.setup import Start, boosting_features, problem_of, start, starts_of
from registration.motion import Array
from registration.scan import Scan

TREES, DEPTH = 150, 6
MOST_POINTS = 400  # of a pair, that the trees learn from
SAME = 0.3  # overlap of members from which a group is a true object


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


class Moving(Protocol):
    """A pair of scans and which beams of the first hit something that moves, (N,)."""

    @property
    def scan_a(self) -> Scan: ...
    @property
    def scan_b(self) -> Scan: ...
    @property
    def moving(self) -> NDArray[np.bool_]: ...


class Example:
    """A labelled pair made ready: its start with every true object among the groups, and its truth as states."""

    def __init__(self, pair: Labelled) -> None:
        self.begun = start(pair.scan_a, pair.scan_b)
        a, b = self.begun.a, self.begun.b
        clusters = pair.clusters[a.beams]
        number = np.full(len(b.ranges), -1)
        number[b.beams] = np.arange(len(b))
        partners = pair.associations[a.beams]
        self.partners = np.where(partners >= 0, number[np.maximum(partners, 0)], -1)
        owner = _complete(self.begun, clusters, pair.motions)
        self.motions, self.starts = self.begun.motions, starts_of(self.begun)
        outlier = len(self.motions)
        self.clusters = np.where(
            clusters > 0, owner[np.maximum(clusters, 0)], np.where(clusters == 0, 0, outlier)
        )
        self.clusters[self.partners < 0] = outlier

    def labels(self, states: NDArray[np.int64]) -> Labels:
        """Truth as states of the nodes."""
        k = states.shape[1]
        hit = states == self.partners[:, None]
        truth = np.where(self.partners < 0, k, np.where(hit.any(axis=1), hit.argmax(axis=1), -1))
        return Labels(truth, self.clusters)


def _complete(begun: Start, clusters: NDArray[np.int64], motions: Array) -> NDArray[np.int64]:
    """Add the true objects that were not found; returns the state of each true cluster, (D,)."""
    owner = np.zeros(len(motions), dtype=np.int64)
    taken: set[int] = set()
    for k in range(1, len(motions)):
        members = clusters == k
        overlaps = [
            (members & group.members).sum() / max((members | group.members).sum(), 1)
            if g not in taken
            else 0.0
            for g, group in enumerate(begun.found)
        ]
        best = int(np.argmax(overlaps)) if overlaps else -1
        if best >= 0 and overlaps[best] > SAME:
            taken.add(best)
        else:
            begun.found.append(Hypothesis(members, motions[k], float(members.sum()), True))
            best = len(begun.found) - 1
            taken.add(best)
        owner[k] = best + 1
    return owner


def train(pairs: Sequence[Labelled], card: dict[str, object] | None = None, exact: bool = True) -> JointModel:
    """Boosting first, then the weights over its outputs by pseudo-likelihood, then by likelihood (`exact`)."""
    return train_examples([Example(pair) for pair in pairs], card, exact)


def train_examples(
    examples: Sequence[Example], card: dict[str, object] | None = None, exact: bool = True
) -> JointModel:
    """As `train`, of pairs made ready."""
    rows = []
    for example in examples:
        plain = problem_of(example.begun, example.motions, example.starts, None, None)
        features, hints = boosting_features(example.begun, example.motions, example.starts, plain.states)
        rows.append((features, plain.states, hints, example.labels(plain.states).associations))
    data, outlier = learn_boosting(rows)
    cases = []
    for example in examples:
        problem = problem_of(example.begun, example.motions, example.starts, data, outlier)
        cases.append((problem, example.labels(problem.states)))
    weights = learn_weights([nodes for case in cases for nodes in node_features(*case)])
    if exact:
        weights = Likelihood(cases).learn(weights)
    return JointModel(weights, data, outlier, dict(card or {}))


def train_verdict(model: JointModel, pairs: Iterable[Moving]) -> GradientBoosting:
    """The trees that have the last word on what moves, from what `model` without them says of labelled pairs."""
    features, truth = [], []
    for pair in pairs:
        begun = start(pair.scan_a, pair.scan_b)
        if not begun.registration.converged:
            continue
        problem = problem_of(begun, begun.motions, starts_of(begun), model.data, model.outlier)
        estimate = finish(begun, problem, infer_labels(problem, model.weights))
        beams = begun.a.beams
        every = max(1, round(len(beams) / MOST_POINTS))
        rows = evidence(begun, problem, estimate.clusters[beams], estimate.probabilities[beams])
        features.append(rows[::every])
        truth.append(pair.moving[beams][::every])
    return GradientBoosting(TREES, DEPTH).fit(
        np.concatenate(features), np.concatenate(truth).astype(np.int64)
    )

"""What a tracker reports, and how it is read off an intensity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from tracking.mixture.components import Components
from tracking.mixture.global_hypotheses import Alternative, Hypotheses
from tracking.mixture.hypothesis_kernels import count_probabilities
from tracking.mixture.phd_config import PhdConfig


@dataclass(frozen=True)
class Target:
    """One target at the time of the scan.

    label : stays with the target; mean (4,) x, y, vx, vy in m and m/s, in the frame of the measurements, with
    covariance (4, 4); weight : expected number of targets here, about 1; extent (2, 2) : covariance of its returns
    about its centre, m², sensor noise included; rate : expected returns per scan. The arrays cannot be written to.
    """

    label: int
    mean: FloatArray
    covariance: FloatArray
    weight: float
    extent: FloatArray
    rate: float


def shown(array: FloatArray) -> FloatArray:
    """`array` itself, which from now on cannot be written to: who gets to see it must not change what is kept."""
    array.flags.writeable = False
    return array


LabelState = tuple[dict[int, int], int]


class PublicLabels:
    """Numbers targets in the order in which they are first reported."""

    def __init__(self) -> None:
        self.public: dict[int, int] = {}
        self.given = 0

    def number(self, label: int) -> int:
        """The number a filter's own label is reported by."""
        if label not in self.public:
            self.public[label] = self.fresh()
        return self.public[label]

    def fresh(self) -> int:
        """A number that nothing has been reported by."""
        self.given += 1
        return self.given - 1

    def known(self, label: int) -> bool:
        """Whether it has been reported."""
        return label in self.public

    def forget(self, known: set[int]) -> None:
        """Drops all labels but the known."""
        self.public = {label: public for label, public in self.public.items() if label in known}


class Reporter:
    """Makes targets of components."""

    def __init__(self, config: PhdConfig) -> None:
        self.threshold = config.extraction_weight
        self.confirmation = max(config.confirmation_weight, config.extraction_weight)
        self.prior = config.measurement_noise**2 * np.eye(2), config.measurement_rate
        self.labels = PublicLabels()

    def state(self) -> LabelState:
        """What `restore` takes."""
        return dict(self.labels.public), self.labels.given

    def restore(self, state: LabelState) -> None:
        """Back to an earlier state."""
        self.labels.public, self.labels.given = dict(state[0]), state[1]

    def target(self, components: Components, i: int, weight: float) -> Target:
        """Component i as a target of some weight."""
        noise, gamma = self.prior
        freedom, (shape, rate) = components.freedom[i], components.counts[i]
        return Target(
            self.labels.number(int(components.labels[i])),
            shown(components.means[i].copy()),
            shown(components.covariances[i].copy()),
            weight,
            shown(components.spread[i] / freedom if freedom > 1e-9 else noise),
            float(shape / rate) if rate > 1e-9 else gamma,
        )


class Extractor(Reporter):
    """Reports every label of enough weight in an intensity, at its heaviest component."""

    def extract(self, components: Components) -> list[Target]:
        """The targets, by label."""
        names, name = np.unique(components.labels, return_inverse=True)
        totals = np.bincount(name, components.weights, len(names))
        found = []
        self.labels.forget({int(label) for label in names})
        for k in np.flatnonzero(totals > self.threshold).tolist():
            members = np.flatnonzero(name == k)
            best = int(members[components.weights[members].argmax()])
            found.append(self.target(components, best, float(totals[k])))
        return sorted(found, key=lambda target: target.label)


class HypothesisExtractor(Reporter):
    """Reports, of every group of targets, as many as are there with enough probability, in the likeliest hypothesis."""

    def extract(self, hypotheses: Hypotheses) -> list[Target]:
        """The targets, by label; `weight` is a label's probability of existence over all hypotheses."""
        tracks = hypotheses.tracks
        self.labels.forget({int(label) for label in tracks.labels})
        weights = hypotheses.track_weights
        found = []
        names, name = np.unique(tracks.labels, return_inverse=True)
        total = np.bincount(name, weights, len(names))[name]
        for alternatives in hypotheses.alternatives():
            for row in self._chosen(alternatives, tracks.weights):
                if self.labels.known(int(tracks.labels[row])) or total[row] > self.confirmation:
                    found.append(self.target(tracks, row, min(float(total[row]), 1.0)))
        return sorted(found, key=lambda target: target.label)

    def _chosen(self, alternatives: list[Alternative], existence: FloatArray) -> list[int]:
        """Rows of the tracks to report: the largest n with P(at least n targets) above the threshold."""
        counts = [count_probabilities(existence[list(rows)]) for _, rows in alternatives]
        most = max(len(count) for count in counts)
        number = np.zeros(most)
        for (value, _), count in zip(alternatives, counts, strict=True):
            number[: len(count)] += np.exp(value) * count
        at_least = np.cumsum(number[::-1])[::-1]
        n = int(np.flatnonzero(at_least > self.threshold)[-1])
        if n == 0:
            return []
        scores = [
            np.exp(value) * count[n] if len(count) > n else -1.0
            for (value, _), count in zip(alternatives, counts, strict=True)
        ]
        rows = alternatives[int(np.argmax(scores))][1]
        return sorted(rows, key=lambda row: -existence[row])[:n]

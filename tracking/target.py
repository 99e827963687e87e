"""What a tracker reports, and how it is read off an intensity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from tracking.components import Components
from tracking.phd_config import PhdConfig


@dataclass(frozen=True)
class Target:
    """One target at the time of the scan.

    label : stays with the target; mean (4,) x, y, vx, vy in m and m/s, in the frame of the measurements, with
    covariance (4, 4); weight : expected number of targets here, about 1; extent (2, 2) : covariance of its returns
    about its centre, m², sensor noise included; rate : expected returns per scan.
    """

    label: int
    mean: FloatArray
    covariance: FloatArray
    weight: float
    extent: FloatArray
    rate: float


class Extractor:
    """Reports every label of enough weight, at its heaviest component."""

    def __init__(self, config: PhdConfig) -> None:
        self.threshold = config.extraction_weight
        self.prior = config.measurement_noise**2 * np.eye(2), config.measurement_rate
        self.public: dict[int, int] = {}
        self.given = 0

    def extract(self, components: Components) -> list[Target]:
        """The targets, by label. Labels are numbered in the order in which they are first reported."""
        names, name = np.unique(components.labels, return_inverse=True)
        totals = np.bincount(name, components.weights, len(names))
        found = []
        known = {int(label) for label in names}
        self.public = {label: public for label, public in self.public.items() if label in known}
        for k in np.flatnonzero(totals > self.threshold).tolist():
            label = int(names[k])
            if label not in self.public:
                self.public[label] = self.given
                self.given += 1
            members = np.flatnonzero(name == k)
            best = int(members[components.weights[members].argmax()])
            found.append(self._target(components, best, self.public[label], float(totals[k])))
        return sorted(found, key=lambda target: target.label)

    def _target(self, components: Components, i: int, label: int, weight: float) -> Target:
        noise, gamma = self.prior
        freedom, (shape, rate) = components.freedom[i], components.counts[i]
        return Target(
            label,
            components.means[i].copy(),
            components.covariances[i].copy(),
            weight,
            components.spread[i] / freedom if freedom > 1e-9 else noise,
            float(shape / rate) if rate > 1e-9 else gamma,
        )

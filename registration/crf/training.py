"""Training of the trees that say what moves, from labelled pairs of scans."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from estimation.gradient_boosting import GradientBoosting
from registration.crf.evidence import evidence
from registration.crf.labels import groups_as_labels
from registration.crf.setup import start
from registration.scan import Scan

TREES, DEPTH = 150, 6
MOST_POINTS = 40  # of a pair, that the trees learn from


class Moving(Protocol):
    """A pair of scans and which beams of the first hit something that moves, (N,)."""

    @property
    def scan_a(self) -> Scan: ...
    @property
    def scan_b(self) -> Scan: ...
    @property
    def moving(self) -> NDArray[np.bool_]: ...


def train(pairs: Iterable[Moving], trees: int = TREES) -> GradientBoosting:
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

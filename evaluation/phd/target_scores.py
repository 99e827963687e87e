"""How well a tracker does against known targets: OSPA over time, cardinality error, labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.checks import FloatArray
from estimation.metrics.statistics import ospa
from tracking.mixture.target import Target


def positions(targets: Sequence[Target]) -> FloatArray:
    """Positions (N, 2) of reported targets."""
    return np.array([target.mean[:2] for target in targets], dtype=np.float64).reshape(-1, 2)


@dataclass
class Score:
    """Scan by scan: OSPA, numbers of true and reported targets, the expected number, labels and places."""

    cut_off: float
    order: float = 2.0
    ospa: list[float] = field(default_factory=list)
    true_count: list[int] = field(default_factory=list)
    count: list[int] = field(default_factory=list)
    expected: list[float] = field(default_factory=list)
    labels: list[list[int]] = field(default_factory=list)
    found: list[FloatArray] = field(default_factory=list)

    def add(
        self, targets: Sequence[Target] | FloatArray, truth: FloatArray, expected_count: float = float("nan")
    ) -> None:
        """One scan's reported targets, or their places (m, 2) alone, against true positions (n, 2)."""
        named = [] if isinstance(targets, np.ndarray) else list(targets)
        found = targets if isinstance(targets, np.ndarray) else positions(targets)
        self.ospa.append(ospa(found, truth, self.cut_off, self.order))
        self.true_count.append(len(truth))
        self.count.append(len(found))
        self.expected.append(expected_count)
        self.labels.append([target.label for target in named])
        self.found.append(found)

    @property
    def mean_ospa(self) -> float:
        """Over all scans."""
        return float(np.mean(self.ospa))

    @property
    def count_bias(self) -> float:
        """Mean of reported less true targets."""
        return float(np.mean(np.array(self.count) - np.array(self.true_count)))


def labels_kept(score: Score, truth: list[FloatArray], before: int, after: int) -> bool:
    """Whether the target nearest to each true one carries the same label at the scans `before` and `after`."""

    def nearest(k: int) -> list[int]:
        away = np.linalg.norm(truth[k][:, None] - score.found[k][None], axis=-1)
        return [score.labels[k][j] for j in away.argmin(1)] if away.shape[1] else []

    first = nearest(before)
    return len(first) > 0 and first == nearest(after)

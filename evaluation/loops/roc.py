"""How good a classifier of pairs is: detection rate D against false alarm rate FA (section 5 of Paper A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite
from estimation.errors import InputError

FALSE_ALARMS = (0.0, 0.001, 0.01)


@dataclass(frozen=True, eq=False)
class Roc:
    """Receiver operating characteristic: one point per distinct score, from the strictest threshold to the loosest.

    Parameters
    ----------
    false_alarm, detection : (K + 1,) rates in [0, 1], from (0, 0) on to (1, 1).
    threshold : (K + 1,) a pair is called positive where its score is at least this; the first is infinite.
    positives, negatives : how many pairs the rates are of.
    """

    false_alarm: FloatArray
    detection: FloatArray
    threshold: FloatArray
    positives: int
    negatives: int

    def detection_at(self, false_alarm: float) -> float:
        """D at the loosest threshold whose FA is at most `false_alarm`: pairs of equal score are called alike."""
        return float(self.detection[np.searchsorted(self.false_alarm, false_alarm, side="right") - 1])

    @property
    def rates(self) -> list[float]:
        """D in % at each rate of FALSE_ALARMS."""
        return [100.0 * self.detection_at(rate) for rate in FALSE_ALARMS]

    @property
    def area(self) -> float:
        """Area under the curve: how likely a positive pair scores above a negative one (ties count half)."""
        middle = 0.5 * (self.detection[1:] + self.detection[:-1])
        return float(np.sum(np.diff(self.false_alarm) * middle))

    @property
    def average_precision(self) -> float:
        """Mean over the detections of the share of true ones among all pairs with at least that score."""
        found = self.detection * self.positives
        called = found + self.false_alarm * self.negatives
        return float(np.sum(np.diff(self.detection) * found[1:] / called[1:]))

    def as_dict(self) -> dict[str, float]:
        """The figures that are quoted, in %: D at each rate of FALSE_ALARMS, area and average precision."""
        named = zip(FALSE_ALARMS, self.rates, strict=True)
        rates = {f"detection_at_{100 * fa:g}_percent": rate for fa, rate in named}
        return {**rates, "area": 100.0 * self.area, "average_precision": 100.0 * self.average_precision}


def roc(scores: npt.ArrayLike, same: npt.ArrayLike) -> Roc:
    """The curve of scores (M,) for pairs labelled `same` (M,), 1 or 0.

    Raises
    ------
    InputError : shapes that differ, scores that are not finite, or only one class.
    """
    values = as_finite("scores", scores)
    labels = np.asarray(same)
    if values.ndim != 1 or labels.shape != values.shape:
        raise InputError(f"scores and same must be (M,) each, not {values.shape} and {labels.shape}")
    positives = int((labels == 1).sum())
    negatives = len(labels) - positives
    if not positives or not negatives:
        raise InputError("same must hold examples of both classes, 0 and 1")
    order = np.argsort(-values, kind="stable")
    values, true = values[order], (labels[order] == 1).astype(np.float64)
    ends = np.concatenate((np.flatnonzero(np.diff(values)), [len(values) - 1]))
    found = np.cumsum(true)[ends]
    return Roc(
        np.concatenate(([0.0], (ends + 1 - found) / negatives)),
        np.concatenate(([0.0], found / positives)),
        np.concatenate(([np.inf], values[ends])),
        positives,
        negatives,
    )

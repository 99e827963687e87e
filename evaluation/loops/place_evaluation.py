"""Protocols of section 5.2 of Paper A: cross validation, informative features, training rounds, repetitiveness.

All take a `make` that gives an untrained classifier with `fit(F, y)` and `score(F)`, and pairs as features F (M, n)
with labels `same` (M,), so that they serve the plain method and any other behind its interface alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_points, require_count
from estimation.errors import InputError
from estimation.learning.boosting import AdaBoost
from evaluation.loops.roc import FALSE_ALARMS, Roc, roc


class Classifier(Protocol):
    """What is trained on pair features (M, n) with labels (M,) and scores pairs."""

    def fit(self, F: npt.ArrayLike, y: npt.ArrayLike) -> Any: ...

    def score(self, F: npt.ArrayLike) -> FloatArray: ...


Make = Callable[[], Classifier]


@dataclass(frozen=True)
class Spread:
    """Detection rates of several validations at one false alarm rate, all in [0, 1]."""

    false_alarm: float
    mean: float
    deviation: float
    least: float
    most: float


@dataclass(frozen=True, eq=False)
class Validation:
    """Outcome of a cross validation.

    curves : one per repetition, over all pairs that were scored by a classifier not trained on them.
    """

    curves: tuple[Roc, ...]

    def spread(self, false_alarm: float) -> Spread:
        """Mean, standard deviation, least and most of D at a false alarm rate."""
        rates = np.array([curve.detection_at(false_alarm) for curve in self.curves])
        return Spread(false_alarm, *(float(f(rates)) for f in (np.mean, np.std, np.min, np.max)))

    def spreads(self) -> list[Spread]:
        return [self.spread(rate) for rate in FALSE_ALARMS]


def k_fold(
    make: Make, F: npt.ArrayLike, same: npt.ArrayLike, folds: int = 10, repetitions: int = 5, seed: int = 0
) -> Validation:
    """k-fold cross validation, repeated with other permutations: within one data set, as the text does it.

    Folds are of pairs drawn at random, so that a place in one fold is also in others: it says how well a classifier
    knows the data set, not how well it will do elsewhere.

    Raises
    ------
    InputError : shapes, fewer pairs of a class than folds, or folds below 2.
    """
    features, labels = _examples(F, same)
    if require_count("folds", folds) < 2 or min(labels.sum(), (labels == 0).sum()) < folds:
        raise InputError(f"folds: 2 up to the number of pairs of the rarer class, got {folds}")
    rng = np.random.default_rng(seed)
    curves = []
    for _ in range(require_count("repetitions", repetitions)):
        fold = _folds(labels, folds, rng)
        scores = np.empty(len(labels))
        for k in range(folds):
            model = make()
            model.fit(features[fold != k], labels[fold != k])
            scores[fold == k] = model.score(features[fold == k])
        curves.append(roc(scores, labels))
    return Validation(tuple(curves))


def _folds(labels: npt.NDArray[np.integer], folds: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Fold of each pair (M,), each fold with its share of either class."""
    fold = np.empty(len(labels), dtype=np.int64)
    for value in (0, 1):
        rows = rng.permutation(np.flatnonzero(labels == value))
        fold[rows] = np.arange(len(rows)) % folds
    return fold


def cross_environment(
    make: Make,
    environments: Mapping[str, Sequence[tuple[FloatArray, npt.NDArray[np.integer]]]],
    most: int | None = 4000,
    seed: int = 0,
) -> dict[str, list[Roc]]:
    """Leave one environment out: trained on the others, judged on it. The curves of its recordings, by environment.

    Parameters
    ----------
    environments : recordings of each as pair features (M, n) and labels (M,). Two recordings of one building belong
        to one environment.
    most : pairs of a class that a recording contributes to training, so that none outweighs the others; None for all.

    Raises
    ------
    InputError : fewer than two environments.
    """
    if len(environments) < 2:
        raise InputError("environments: at least two are needed to train on some and judge on another")
    curves: dict[str, list[Roc]] = {}
    for name in environments:
        F, y = balanced(
            [data for other, recordings in environments.items() if other != name for data in recordings],
            most,
            seed,
        )
        model = make()
        model.fit(F, y)
        curves[name] = [roc(model.score(features), labels) for features, labels in environments[name]]
    return curves


def balanced(
    recordings: Sequence[tuple[FloatArray, npt.NDArray[np.integer]]], most: int | None, seed: int = 0
) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    """Pairs of several recordings as one training set, at most `most` of each class from each, drawn at random."""
    rng = np.random.default_rng(seed)
    F, y = [], []
    for features, labels in recordings:
        for value in (1, 0):
            rows = np.flatnonzero(labels == value)
            if most is not None and len(rows) > most:
                rows = np.sort(rng.choice(rows, most, replace=False))
            F.append(features[rows])
            y.append(np.full(len(rows), value, dtype=np.int8))
    return np.concatenate(F), np.concatenate(y)


def error_rate(
    model: Classifier, F: FloatArray, same: npt.NDArray[np.integer], threshold: float = 0.5
) -> float:
    """Share of misclassified pairs, a score of `threshold` or more called positive: equation (13)."""
    return float(np.mean((model.score(F) >= threshold) != (same == 1)))


def round_curve(
    rounds: Sequence[int],
    train: tuple[npt.ArrayLike, npt.ArrayLike],
    validation: tuple[npt.ArrayLike, npt.ArrayLike],
) -> list[tuple[int, float, float]]:
    """Figure 4: (T, training error, validation error) of AdaBoost for each number of rounds T.

    One model is trained; its first T stumps are what T rounds would have learned.
    """
    F, y = _examples(*train)
    V, z = _examples(*validation)
    model = AdaBoost(max(rounds)).fit(F, y)
    found = []
    for count in rounds:
        first = model.first(count)
        found.append((count, error_rate(first, F, y), error_rate(first, V, z)))
    return found


def first_features(F: npt.ArrayLike, same: npt.ArrayLike, rounds: int = 5) -> list[int]:
    """Test 1 of Tables 3 and 4: feature numbers (from 1) chosen in the first rounds."""
    return [int(feature) + 1 for feature in AdaBoost(rounds).fit(*_examples(F, same)).chosen]


def removal_errors(
    F: npt.ArrayLike, same: npt.ArrayLike, rounds: int = 50, folds: int = 5, seed: int = 0
) -> list[tuple[int, float]]:
    """Test 2 of Tables 3 and 4: (feature number, validation error without it), the most missed first."""
    features, labels = _examples(F, same)
    fold = _folds(labels, folds, np.random.default_rng(seed))
    found = []
    for feature in range(features.shape[1]):
        kept = np.delete(features, feature, axis=1)
        errors = [
            error_rate(
                AdaBoost(rounds).fit(kept[fold != k], labels[fold != k]), kept[fold == k], labels[fold == k]
            )
            for k in range(folds)
        ]
        found.append((feature + 1, float(np.mean(errors))))
    return sorted(found, key=lambda entry: (-entry[1], entry[0]))


def repetitiveness(
    F: npt.ArrayLike, same: npt.ArrayLike, histograms: int = 9
) -> tuple[FloatArray, FloatArray]:
    """Equations (25) and (26): ratios of means and of standard deviations per feature, (n,) each.

    Near or above 1 the feature is alike at different places. The last `histograms` are correlations, whose mean ratio
    is the other way round. NaN where the divisor is 0.
    """
    features, labels = _examples(F, same)
    positive, negative = features[labels == 1], features[labels == 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        means = positive.mean(axis=0) / negative.mean(axis=0)
        means[len(means) - histograms :] = 1.0 / means[len(means) - histograms :]
        deviations = positive.std(axis=0) / negative.std(axis=0)
    return (
        np.where(np.isfinite(means), means, np.nan),
        np.where(np.isfinite(deviations), deviations, np.nan),
    )


def _examples(F: npt.ArrayLike, same: npt.ArrayLike) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    features, labels = as_points("F", F), np.asarray(same)
    if labels.shape != (len(features),) or not np.isin(labels, (0, 1)).all():
        raise InputError(f"same must hold {len(features)} labels, 0 or 1")
    return features, labels.astype(np.int8)

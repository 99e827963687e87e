"""AdaBoost over decision stumps: Algorithms 3 and 4 of Paper A (Algorithm 2 of chapter 4).

    model = AdaBoost(rounds=50).fit(F, y)      # F (M, n), y (M,) of 0 and 1
    likelihood = model.score(F)                # (M,) in [0, 1]
    model.save("model.json"); AdaBoost.load("model.json")

Every round adds the stump c(F) = [p F_f < p λ] of least weighted error. Each class starts with half the weight, so
the numbers of examples per class need not be equal. The fit is deterministic: there is no random choice in it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_points, require_count
from estimation.errors import InputError
from estimation.learning.boosting_kernels import best_stump, vote

FORMAT = "whereabouts.adaboost"
VERSION = 1


@dataclass(frozen=True)
class Stump:
    """One weak classifier, equation (8): 1 where `polarity` · F[`feature`] < `polarity` · `threshold`, else 0.

    feature : column of F, from 0.
    threshold : in units of that column.
    polarity : 1 (small values mean class 1) or -1 (large values do).
    weight : α of the vote, log(1 / β); above zero.
    error : weighted training error ε of its round, in [0, 0.5).
    """

    feature: int
    threshold: float
    polarity: int
    weight: float
    error: float


class AdaBoost:
    """Discrete AdaBoost over decision stumps, Algorithm 3.

    Parameters
    ----------
    rounds : T, the number of stumps. Fewer are learned when no stump is better than chance any more, and a single
        one when it separates the training data without error: its weight would be infinite, so it decides alone and
        gets the weight 1.

    Attributes
    ----------
    stumps : the weak classifiers in the order they were chosen; empty before `fit`.
    feature_count : n, the columns that `score` expects; 0 before `fit`.
    """

    def __init__(self, rounds: int = 50) -> None:
        self.rounds = require_count("rounds", rounds)
        self._set((), 0)

    def _set(self, stumps: Sequence[Stump], feature_count: int) -> None:
        self.stumps = tuple(stumps)
        self.feature_count = feature_count
        self._features = np.array([stump.feature for stump in stumps], dtype=np.int64)
        self._thresholds = np.array([stump.threshold for stump in stumps], dtype=np.float64)
        self._polarities = np.array([stump.polarity for stump in stumps], dtype=np.float64)
        self._weights = np.array([stump.weight for stump in stumps], dtype=np.float64)

    @property
    def chosen(self) -> npt.NDArray[np.int64]:
        """The feature each round chose, (T,): early and often means informative."""
        return self._features.copy()

    def first(self, rounds: int) -> AdaBoost:
        """What as many rounds would have learned: a model of the first stumps. InputError before `fit`."""
        self._require_fitted()
        model = AdaBoost(rounds)
        model._set(self.stumps[:rounds], self.feature_count)
        return model

    def fit(self, F: npt.ArrayLike, y: npt.ArrayLike) -> AdaBoost:
        """Learn from features (M, n) and labels (M,) of 0 and 1; returns the model itself.

        Raises InputError: wrong shapes, features that are not finite, labels other than 0 and 1 or of one class only,
        or features that are all constant or no better than chance from the first round on.
        """
        features = as_points("F", F)
        labels = as_labels(y, len(features))
        columns, order = _sorted_columns(features)
        positive = labels == 1
        weights = np.where(positive, 0.5 / positive.sum(), 0.5 / (~positive).sum())
        stumps: list[Stump] = []
        for _ in range(self.rounds):
            weights = weights / weights.sum()
            feature, threshold, polarity = best_stump(columns, order, labels, weights)
            if feature < 0:
                break
            wrong = (polarity * features[:, feature] < polarity * threshold) != positive
            # Summed anew: the running sums of the search leave a residue where the error is zero.
            error = float(weights[wrong].sum())
            if error >= 0.5 - 1e-12:
                break
            perfect = error == 0.0
            weight = 1.0 if perfect else math.log((1.0 - error) / error)
            stumps.append(Stump(int(feature), float(threshold), int(polarity), weight, error))
            if perfect:
                break
            weights = np.where(wrong, weights, weights * (error / (1.0 - error)))
        if not stumps:
            raise InputError("F: no column tells the classes apart better than chance")
        self._set(stumps, features.shape[1])
        return self

    def score(self, F: npt.ArrayLike) -> FloatArray:
        """Likelihood of class 1, (M,) in [0, 1]: the vote share c of equation (12), for features (M, n).

        Raises InputError: not fitted, wrong number of columns, or features that are not finite.
        """
        self._require_fitted()
        values, stumps = as_points("F", F, self.feature_count), (self._features, self._thresholds)
        return np.asarray(vote(values, *stumps, self._polarities, self._weights))

    def save(self, path: str | Path) -> None:
        """Write the model as readable JSON, numbers in full precision. InputError before `fit`."""
        Path(path).write_text(json.dumps(self.to_dict(), indent=1) + "\n", encoding="utf-8")

    def to_dict(self) -> dict[str, Any]:
        """What `save` writes, for models that contain this one. InputError before `fit`."""
        self._require_fitted()
        return {
            "format": FORMAT,
            "version": VERSION,
            "rounds": self.rounds,
            "feature_count": self.feature_count,
            "stumps": [asdict(stump) for stump in self.stumps],
        }

    @classmethod
    def load(cls, path: str | Path) -> AdaBoost:
        """The model that `save` wrote; InputError where the file is no such model or of another version."""
        return cls.from_dict(read_json(path), path)

    @classmethod
    def from_dict(cls, content: Any, path: str | Path = "model") -> AdaBoost:
        """The model of `to_dict`; errors as in `load`, `path` says where it was found."""
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise InputError(f"path: {path} does not hold a {FORMAT} model")
        if content.get("version") != VERSION:
            raise InputError(f"path: {path} has version {content.get('version')}, readable is {VERSION}")
        try:
            model = cls(content["rounds"])
            feature_count = require_count("feature_count", content["feature_count"])
            stumps = [_stump(entry, feature_count) for entry in content["stumps"]]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"path: {path} is not a complete model: {error}") from error
        if not stumps:
            raise InputError(f"path: {path} holds no stumps")
        model._set(stumps, feature_count)
        return model

    def _require_fitted(self) -> None:
        if not self.stumps:
            raise InputError("model: not trained yet; call fit(F, y) or AdaBoost.load(path)")


def _stump(entry: dict[str, float], feature_count: int) -> Stump:
    """A stump from its JSON object; ValueError where a number is out of its range."""
    kinds = {"feature": int, "threshold": float, "polarity": int, "weight": float, "error": float}
    stump = Stump(**{name: kind(entry[name]) for name, kind in kinds.items()})
    if not 0 <= stump.feature < feature_count or stump.polarity not in (-1, 1):
        raise ValueError(f"feature {stump.feature} of {feature_count}, polarity {stump.polarity}")
    if not (math.isfinite(stump.threshold) and 0.0 < stump.weight < math.inf):
        raise ValueError(f"threshold {stump.threshold}, weight {stump.weight}")
    return stump


def read_json(path: str | Path) -> Any:
    """The content of a JSON file. InputError where it is none."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"path: {path} is not a JSON file") from error


def as_labels(y: npt.ArrayLike, count: int) -> npt.NDArray[np.int8]:
    """Labels (M,) as 0 and 1 of both classes."""
    labels = np.asarray(y)
    if labels.shape != (count,):
        raise InputError(f"y must have shape ({count},), one label per row of F, not {labels.shape}")
    if not np.isin(labels, (0, 1)).all():
        raise InputError("y must hold only 0 and 1")
    if len(np.unique(labels)) < 2:
        raise InputError("y must hold examples of both classes, 0 and 1")
    return labels.astype(np.int8)


def _sorted_columns(features: FloatArray) -> tuple[FloatArray, npt.NDArray[np.int32]]:
    """Every column ascending, (n, M), and the rows the values came from, (n, M): sorted once for all rounds."""
    columns = np.ascontiguousarray(features.T)
    order = np.argsort(columns, axis=1, kind="stable")
    return np.take_along_axis(columns, order, axis=1), order.astype(np.int32)

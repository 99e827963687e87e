"""Gradient boosting of shallow trees on the logistic loss, behind the interface of `boosting.AdaBoost`.

    model = GradientBoosting(rounds=150, depth=3).fit(F, y)     # F (M, n), y (M,) of 0 and 1
    likelihood = model.score(F)                                 # (M,) in [0, 1]

Trees are grown level by level on features cut into at most 255 quantile bins, each leaf being a Newton step of the
loss (the second-order method of XGBoost and LightGBM). Each class has half the weight, so `score` is the probability
of class 1 where both are equally likely. Rows and features are drawn anew for every tree from a seeded generator: the
same data and seed give the same model. Thresholds and leaves are rounded to single precision when they are learned, so
that a model that was saved and loaded is the same model.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_number, as_points, require_count, require_positive
from estimation.errors import InputError
from estimation.learning.boosting import as_labels, read_json
from estimation.learning.gradient_boosting_kernels import grow, sum_trees

FORMAT = "whereabouts.gradient_boosting"
VERSION = 1
BINS = 255
# JSON has no infinity: the threshold of a node that is not split, larger than any other.
_NO_SPLIT = float(np.float32(3e38))


class GradientBoosting:
    """Boosted trees of fixed depth.

    Parameters
    ----------
    rounds : number of trees. depth : of each, 1 to 8. learning_rate : in (0, 1].
    least_weight : smallest share of the examples' total curvature in a leaf. l2 : penalty on leaf values, as a share
        of the total curvature.
    rows, columns : share of examples and of features drawn for each tree, in (0, 1]. seed : of these draws.

    Attributes
    ----------
    feature_count : n, the columns that `score` expects; 0 before `fit`.
    """

    def __init__(
        self,
        rounds: int = 150,
        depth: int = 3,
        learning_rate: float = 0.1,
        least_weight: float = 1e-3,
        l2: float = 1e-4,
        rows: float = 0.7,
        columns: float = 0.6,
        seed: int = 0,
    ) -> None:
        self.rounds = require_count("rounds", rounds)
        self.depth = require_count("depth", depth)
        if self.depth > 8:
            raise InputError(f"depth must be 1 to 8, not {depth}")
        self.learning_rate = _share("learning_rate", learning_rate)
        self.least_weight = require_positive("least_weight", least_weight)
        self.l2 = require_positive("l2", l2)
        self.rows, self.columns = _share("rows", rows), _share("columns", columns)
        self.seed = require_count("seed", seed, minimum=0)
        self.feature_count = 0
        self._features = np.zeros((0, 0), dtype=np.uint32)
        self._thresholds = np.zeros((0, 0))
        self._leaves = np.zeros((0, 0))

    def fit(
        self, F: npt.ArrayLike, y: npt.ArrayLike, weights: npt.ArrayLike | None = None
    ) -> GradientBoosting:
        """Learn from features (M, n), labels (M,) of 0 and 1 and, where given, weights (M,) above 0; returns itself.

        Weights are scaled so that each class has half of their sum.
        Raises InputError: wrong shapes, features that are not finite, labels other than 0 and 1 or of one class only.
        """
        features = as_points("F", F)
        labels = as_labels(y, len(features)).astype(np.float64)
        weight = np.ones(len(labels)) if weights is None else as_finite("weights", weights)
        if weight.shape != labels.shape or (weight <= 0.0).any():
            raise InputError(f"weights must have shape {labels.shape} and be above 0")
        weight = np.where(labels == 1, weight / weight[labels == 1].sum(), weight / weight[labels == 0].sum())
        edges = [_edges(column) for column in features.T]
        bins = np.array(
            [np.searchsorted(e, column) for e, column in zip(edges, features.T, strict=True)], dtype=np.uint8
        )
        rng = np.random.default_rng(self.seed)
        count = max(1, round(self.columns * features.shape[1]))
        odds = np.zeros(len(labels))
        trees: list[tuple[npt.NDArray[np.uint32], FloatArray, FloatArray]] = []
        for _ in range(self.rounds):
            chosen = np.sort(rng.choice(features.shape[1], count, replace=False))
            drawn = rng.random(len(labels)) < self.rows
            probability = 1.0 / (1.0 + np.exp(-odds))
            gradient = np.where(drawn, weight * (probability - labels), 0.0)
            curvature = np.where(drawn, weight * probability * (1.0 - probability), 0.0)
            total = max(float(curvature.sum()), 1e-12)
            least, l2 = self.least_weight * total, self.l2 * total
            split, cuts, leaves = grow(bins, chosen, gradient, curvature, self.depth, BINS, least, l2)
            split = split.astype(np.uint32)
            thresholds = np.array(
                [edges[f][c] if c >= 0 else _NO_SPLIT for f, c in zip(split, cuts, strict=True)]
            )
            # A leaf that few fell into must not run away where the rest is already certain.
            leaves = _single(self.learning_rate * np.clip(leaves, -4.0, 4.0))
            odds += sum_trees(features, split[None], thresholds[None], leaves[None], self.depth)
            trees.append((split, thresholds, leaves))
        self.feature_count = features.shape[1]
        self._features, self._thresholds, self._leaves = map(np.array, zip(*trees, strict=True))
        return self

    def decision(self, F: npt.ArrayLike) -> FloatArray:
        """Log odds of class 1, (M,), for features (M, n); InputError as `score`."""
        self._require_fitted()
        values = np.ascontiguousarray(as_points("F", F, self.feature_count))
        return np.asarray(sum_trees(values, self._features, self._thresholds, self._leaves, self.depth))

    def score(self, F: npt.ArrayLike) -> FloatArray:
        """Likelihood of class 1, (M,) in [0, 1], for features (M, n).

        Raises InputError: not fitted, wrong number of columns, or features that are not finite.
        """
        return np.asarray(1.0 / (1.0 + np.exp(-self.decision(F))))

    def to_dict(self) -> dict[str, Any]:
        """The model as plain numbers and lists, for `from_dict`. InputError before `fit`."""
        self._require_fitted()
        return {
            "format": FORMAT,
            "version": VERSION,
            "depth": self.depth,
            "feature_count": self.feature_count,
            "trees": [
                {
                    "features": features.tolist(),
                    "thresholds": [_short(t) if t < _NO_SPLIT else None for t in thresholds],
                    "leaves": [_short(leaf) for leaf in leaves],
                }
                for features, thresholds, leaves in zip(
                    self._features, self._thresholds, self._leaves, strict=True
                )
            ],
        }

    @classmethod
    def from_dict(cls, content: Any) -> GradientBoosting:
        """The model that `to_dict` described; InputError where it is none or not complete."""
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise InputError(f"content: not a {FORMAT} model")
        if content.get("version") != VERSION:
            raise InputError(f"content: version {content.get('version')}, readable is {VERSION}")
        try:
            trees = content["trees"]
            model = cls(len(trees), content["depth"])
            model.feature_count = require_count("feature_count", content["feature_count"])
            model._features = np.array([tree["features"] for tree in trees], dtype=np.uint32)
            model._thresholds = _single(
                [[_NO_SPLIT if t is None else t for t in tree["thresholds"]] for tree in trees]
            )
            model._leaves = _single([tree["leaves"] for tree in trees])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"content: not a complete model: {error}") from error
        inner, leaves = 2**model.depth - 1, 2**model.depth
        shapes = (model._features.shape, model._thresholds.shape, model._leaves.shape)
        if shapes != ((len(trees), inner), (len(trees), inner), (len(trees), leaves)):
            raise InputError(f"content: trees do not have depth {model.depth}")
        if model._features.max() >= model.feature_count:
            raise InputError(f"content: a feature is not one of {model.feature_count}")
        if not (np.isfinite(model._leaves).all() and np.isfinite(model._thresholds).all()):
            raise InputError("content: a threshold or leaf is not finite")
        return model

    def save(self, path: str | Path) -> None:
        """Write the model as JSON. InputError before `fit`."""
        Path(path).write_text(json.dumps(self.to_dict()) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> GradientBoosting:
        """The model that `save` wrote; InputError where the file is no such model or of another version."""
        return cls.from_dict(read_json(path))

    def _require_fitted(self) -> None:
        if not self.feature_count:
            raise InputError("model: not trained yet; call fit(F, y) or GradientBoosting.load(path)")


def _share(name: str, value: float) -> float:
    if not 0.0 < as_number(name, value) <= 1.0:
        raise InputError(f"{name} must be above 0 and at most 1, not {value!r}")
    return float(value)


def _edges(column: FloatArray) -> FloatArray:
    """Upper edges of the bins of one feature, ascending, fewer than BINS: quantiles, or between all distinct values."""
    distinct = np.unique(column)
    if len(distinct) < BINS:
        between = 0.5 * distinct[:-1] + 0.5 * distinct[1:]
    else:
        between = np.quantile(column, np.linspace(0.0, 1.0, BINS)[1:-1])
    return np.unique(_single(between))


def _short(value: float) -> float:
    """The number with the fewest digits that is `value` in single precision."""
    return float(np.format_float_positional(np.float32(value), trim="-"))


def _single(values: npt.ArrayLike) -> FloatArray:
    """Numbers written by `_short` as they were, in double precision."""
    return np.array(values, dtype=np.float32).astype(np.float64)

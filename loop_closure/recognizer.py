"""Recognise a place among all seen before: the exhaustive comparison of Paper A, section 3.1, in one batched call."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, require_count
from estimation.errors import InputError
from loop_closure.comparison import PlaceDatabase, pair_features_many
from loop_closure.features import PlaceFeatures


class PairClassifier(Protocol):
    """What tells from pair features (M, n) how likely each pair is one place, (M,) in [0, 1]."""

    def score(self, F: npt.ArrayLike) -> FloatArray: ...


class PlaceRecognizer:
    """A history of places that can be asked which of them a new one is.

    Parameters
    ----------
    model : trained classifier of pair features, such as `AdaBoost.load(path)` or `AdaBoost().fit(F, y)`.

    Raises
    ------
    InputError : no model. None is shipped yet.
    """

    def __init__(self, model: PairClassifier | None = None) -> None:
        if model is None:
            raise InputError(
                "model: a trained classifier is needed and none is shipped yet; pass "
                "PlaceRecognizer(model=AdaBoost.load(path)) or one trained with AdaBoost().fit(F, y) "
                "on the rows of pair_features"
            )
        self.model = model
        self._places = PlaceDatabase()
        self._stamps: list[float] = []

    def __len__(self) -> int:
        return len(self._places)

    def add(self, features: PlaceFeatures, stamp: float) -> int:
        """Remember a place seen at `stamp` (s); returns its id, counted from 0.

        Raises
        ------
        InputError : features that do not match those already there, or a stamp that is not finite.
        """
        if not math.isfinite(stamp):
            raise InputError(f"stamp: finite number of seconds expected, got {stamp}")
        identity = self._places.append(features)
        self._stamps.append(float(stamp))
        return identity

    def stamp(self, identity: int) -> float:
        """When a place was seen, seconds. InputError for an unknown id."""
        if not 0 <= identity < len(self):
            raise InputError(f"identity: 0 to {len(self) - 1} expected, got {identity}")
        return self._stamps[identity]

    def likelihoods(self, features: PlaceFeatures) -> FloatArray:
        """Likelihood that `features` is each of the places, (M,) in [0, 1] by id."""
        if len(self) == 0:
            return np.zeros(0)
        return self.model.score(pair_features_many(features, self._places))

    def query(self, features: PlaceFeatures, k: int) -> list[tuple[int, float]]:
        """The `k` most likely places as (id, likelihood), best first; fewer when fewer are known.

        Of equal likelihoods the earlier place comes first. Places are compared as they were added: leaving out the
        ones just passed is up to the caller, who knows the path.

        Raises
        ------
        InputError : k below 1, or features that do not match the history or the model.
        """
        k = require_count("k", k)
        scores = self.likelihoods(features)
        if k < len(scores):
            # All that reach the k-th best score, so that ties are decided by id and not by the partition.
            least = np.partition(scores, len(scores) - k)[len(scores) - k]
            candidates = np.flatnonzero(scores >= least)
        else:
            candidates = np.arange(len(scores))
        best = candidates[np.argsort(-scores[candidates], kind="stable")[:k]]
        return [(int(identity), float(scores[identity])) for identity in best]

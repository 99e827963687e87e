"""Recognise a place among all seen before: section 3.1 of Paper A, in one batched call, and in less for long histories.

    recognizer = PlaceRecognizer()                       # the shipped model for scans or clouds, as the first place is
    recognizer.add(features_2d(scan, 50.0), stamp)
    recognizer.query(features_2d(scan, 50.0), k=10)      # [(id, likelihood), ...]

Places are added in order of path, and asked about before they are added: a model with context (that for clouds) also
looks at the places before the query. Up to `exhaustive` places every one is compared; of longer histories only the
`candidates` nearest in the index of `loop_closure.places.retrieval`.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_stamp, require_count
from estimation.errors import InputError
from loop_closure.places.comparison import PlaceDatabase, pair_features_many
from loop_closure.places.context import GAP, PREDECESSORS, UNKNOWN, context_features, usual_odds
from loop_closure.places.features import SCALARS_2D, PlaceFeatures
from loop_closure.places.place_model import PlaceModel, shipped_model
from loop_closure.places.retrieval import Embedding, NearestPlaces
from loop_closure.work import Steps, at_once

# Places that must be known before how a place resembles them says how it resembles others.
SETTLED = 100


class PairClassifier(Protocol):
    """What tells from pair features (M, n) how likely each pair is one place, (M,) in [0, 1]."""

    def score(self, F: npt.ArrayLike) -> FloatArray: ...


class PlaceRecognizer:
    """A history of places that can be asked which of them a new one is.

    Parameters
    ----------
    model : a `PlaceModel`, or any classifier of the text's pair features such as `AdaBoost().fit(F, y)`. None: the
        best shipped model, for scans or for clouds, whichever comes first.
    looks : pairs of a query that the model's second stage may look at; the rest keep the first stage's order, below.
    exhaustive : places up to which a query compares all. candidates : of a longer history, how many.
    """

    def __init__(
        self,
        model: PlaceModel | PairClassifier | None = None,
        looks: int = 100,
        exhaustive: int = 4000,
        candidates: int = 2000,
    ) -> None:
        self.looks = require_count("looks", looks)
        self.exhaustive = require_count("exhaustive", exhaustive)
        self.candidates = require_count("candidates", candidates)
        self._index: NearestPlaces | None = None
        self._asked: tuple[PlaceFeatures, FloatArray] | None = None
        self._usual: list[FloatArray] = []
        self._before: deque[FloatArray] = deque(maxlen=PREDECESSORS)
        self._stamps: list[float] = []
        self._model: PlaceModel | PairClassifier | None = model
        self._places = PlaceDatabase(wide=isinstance(model, PlaceModel) and model.wide)

    def __len__(self) -> int:
        return len(self._places)

    @property
    def model(self) -> PlaceModel | PairClassifier | None:
        """The model; None before the first place where none was given."""
        return self._model

    @property
    def nbytes(self) -> int:
        """Memory of the stored places in bytes, with the index."""
        return self._places.nbytes + (0 if self._index is None else self._index.nbytes)

    def add(self, features: PlaceFeatures, stamp: float) -> int:
        """Remember a place seen at `stamp` (s); returns its id, counted from 0.

        Raises
        ------
        InputError : features that do not match those already there, or a stamp that is not finite.
        """
        stamp = as_stamp("stamp", stamp)
        self._choose(features)
        if self._in_context:
            asked = self._asked
            known = asked is not None and asked[0] is features
            row = asked[1] if asked is not None and known else self._odds(features)
            self._before.appendleft(row)
            self._usual.append(usual_odds(row[: max(len(row) - GAP, 0)]))
        identity = self._places.append(features)
        if self._embedding is not None:
            if self._index is None:
                self._index = NearestPlaces(self._embedding.dimension)
            self._index.add(self._embedding(features.signature))
        self._stamps.append(stamp)
        return identity

    def keep(self, stay: npt.NDArray[np.bool_]) -> None:
        """Forget the places that do not `stay`, (M,); the others are counted anew."""
        if len(stay) != len(self):
            raise InputError(f"stay: {len(self)} expected, one of each place, got {len(stay)}")
        kept = np.flatnonzero(stay)
        self._places.keep(kept)
        if self._index is not None:
            self._index = self._index.of(kept)
        self._stamps = [self._stamps[i] for i in kept]
        self._asked = None
        if self._in_context:
            self._usual = [self._usual[i] for i in kept]
            self._before = deque((row[stay[: len(row)]] for row in self._before), maxlen=PREDECESSORS)

    def stamp(self, identity: int) -> float:
        """When a place was seen, seconds. InputError for an unknown id."""
        if not 0 <= identity < len(self):
            raise InputError(f"identity: 0 to {len(self) - 1} expected, got {identity}")
        return self._stamps[identity]

    def likelihoods(self, features: PlaceFeatures, looks: int | None = None) -> FloatArray:
        """Likelihood that `features` is each of the places, (M,) in [0, 1] by id, all compared.

        `looks` limits the second stage; None lets it look at every pair that passes the first.
        """
        if len(self) == 0:
            return np.zeros(0)
        return at_once(self._scoring(features, None, looks))

    def query(self, features: PlaceFeatures, k: int) -> list[tuple[int, float]]:
        """The `k` most likely places as (id, likelihood), best first; fewer when fewer are known.

        Of equal likelihoods the earlier place comes first. Places are compared as they were added: leaving out the
        ones just passed is up to the caller, who knows the path.

        Raises
        ------
        InputError : k below 1, or features that do not match the history or the model.
        """
        return at_once(self.querying(features, k))

    def querying(self, features: PlaceFeatures, k: int) -> Steps[list[tuple[int, float]]]:
        """`query`, in steps; nothing may be added meanwhile."""
        k = require_count("k", k)
        if len(self) == 0:
            return []
        rows = self._candidates(features, k)
        scores = yield from self._scoring(features, rows, max(self.looks, k))
        if k < len(scores):
            # All that reach the k-th best score, so that ties are decided by id and not by the partition.
            least = np.partition(scores, len(scores) - k)[len(scores) - k]
            kept = np.flatnonzero(scores >= least)
        else:
            kept = np.arange(len(scores))
        best = kept[np.argsort(-scores[kept], kind="stable")[:k]]
        return [(int(i if rows is None else rows[i]), float(scores[i])) for i in best]

    def _candidates(self, features: PlaceFeatures, k: int) -> npt.NDArray[np.int64] | None:
        """Ids to compare, ascending; None for all."""
        if self._index is None or self._embedding is None or len(self) <= max(self.exhaustive, k):
            return None
        return np.sort(self._index.query(self._embedding(features.signature), max(self.candidates, k)))

    @property
    def _embedding(self) -> Embedding | None:
        return self._model.embedding if isinstance(self._model, PlaceModel) else None

    def _choose(self, features: PlaceFeatures) -> None:
        """Load the shipped model where none was given, once it is known what the places are."""
        if self._model is None:
            name = "best_2d" if len(features.values) == SCALARS_2D else "best_3d"
            self._model = shipped_model(name)
            self._places = self._model.database()

    def _usual_odds(self, row: FloatArray) -> FloatArray:
        """`usual_odds` of all places; of those added to a short history the query's stand for them, (M, 3)."""
        own = usual_odds(row[: max(len(row) - GAP, 0)])
        return np.array([own if k < SETTLED else usual for k, usual in enumerate(self._usual)])

    @property
    def _in_context(self) -> bool:
        return isinstance(self._model, PlaceModel) and self._model.context is not None

    def _odds(self, features: PlaceFeatures) -> FloatArray:
        """First-stage log odds of all places, (M,); of a long history only those of candidates, the rest unknown."""
        assert isinstance(self._model, PlaceModel)
        if len(self) == 0:
            return np.zeros(0)
        rows = self._candidates(features, 1)
        if rows is None:
            return self._model.odds(features, self._places)
        odds = np.full(len(self), UNKNOWN)
        odds[rows] = self._model.odds(features, self._places, rows)
        return odds

    def _scoring(
        self, features: PlaceFeatures, rows: npt.NDArray[np.integer] | None, looks: int | None
    ) -> Steps[FloatArray]:
        if isinstance(self._model, PlaceModel) and self._model.context is not None:
            odds = self._odds(features)
            self._asked = (features, odds)
            count = len(self)
            chain = [odds, *(_padded(row, count) for row in self._before)]
            F = context_features(chain, np.arange(count) < count - GAP, self._usual_odds(odds))
            return self._model.context.score(F if rows is None else F[rows])
        if isinstance(self._model, PlaceModel):
            return (yield from self._model.judging(features, self._places, rows, looks))
        assert self._model is not None  # chosen with the first place
        pairs = pair_features_many(features, self._places)
        return self._model.score(pairs if rows is None else pairs[rows])


def _padded(row: FloatArray, count: int) -> FloatArray:
    """A row of log odds of an earlier query, for a history that has grown to `count` places since."""
    return np.concatenate((row, np.full(count - len(row), UNKNOWN)))

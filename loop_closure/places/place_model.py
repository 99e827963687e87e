"""A trained model of what makes two places one: the cascade that goes beyond the text's single classifier.

    model = PlaceModel.load(path)             # or loop_closure.shipped_model("best_2d")
    likelihood = model.likelihoods(query, database)

First stage: a boosted classifier over all pairs, on the text's features and, in a wider model, the differences of
signatures. Second stage: gradient boosting on how well the outlines can be laid on each other
(`loop_closure.places.matching`), only for pairs that pass the gate, at most `most` per query; of pairs that
are one place for certain it puts the nearer ones first. A model without second stage is the first alone; the
text's plain method is such a model.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError
from estimation.learning.boosting import FORMAT as ADABOOST
from estimation.learning.boosting import AdaBoost
from estimation.learning.gradient_boosting import GradientBoosting
from loop_closure.places.comparison import PlaceDatabase
from loop_closure.places.context import contexts
from loop_closure.places.features import PlaceFeatures
from loop_closure.places.matching import match_features
from loop_closure.places.outline_kernels import MATCH_FEATURES
from loop_closure.places.pairs import Pairs
from loop_closure.places.retrieval import Embedding
from loop_closure.work import Steps, at_once

FORMAT = "whereabouts.place_model"
# Version 1 had second stages trained without grades; models without second stage are the same in both.
VERSION = 2
# Pairs that did not pass the gate stay in the order of the first stage, below those that were looked at closely.
REJECTED = 0.01
TRAINED_RANGE = 50.0  # metres of a scan or cloud that the shipped models look at
PLAIN_WIDTH = {2: 44, 3: 41}
# What comes with the package; `docs/loop_closure_models.md` says on what they were trained and how good they are.
NAMES = ("plain_2d", "best_2d", "plain_3d", "best_3d")
COMPARING, MATCHING = 0.0015, 0.7  # ms for each pair, in the first stage and in the second
TOGETHER = 10  # pairs of the second stage that are one step


@dataclass(frozen=True, eq=False)
class PlaceModel:
    """A classifier of pairs of places in one or two stages.

    Parameters
    ----------
    dimension : 2 for scans, 3 for clouds.
    first : trained on `pair_features` (44 | 41 columns) or on those and differences of signatures.
    second : trained on `second_features`, None for a model of one stage.
    gate : first-stage likelihood from which a pair is looked at by the second stage.
    card : what it was trained on and how good it was, as written into the file.
    embedding : metric of signatures, to find candidates in a long history; None: the whole history is compared.
    context : trained on `loop_closure.places.context`, for histories in order of path; None where pairs stand alone.

    Raises
    ------
    InputError : another dimension, or a gate outside [0, 1].
    """

    dimension: int
    first: AdaBoost | GradientBoosting
    second: GradientBoosting | None = None
    gate: float = 0.0
    card: dict[str, Any] = field(default_factory=dict)
    embedding: Embedding | None = None
    context: GradientBoosting | None = None

    def __post_init__(self) -> None:
        if self.dimension not in PLAIN_WIDTH:
            raise InputError(f"dimension must be 2 or 3, not {self.dimension}")
        if not 0.0 <= self.gate <= 1.0:
            raise InputError(f"gate must be in [0, 1], not {self.gate}")

    @property
    def wide(self) -> bool:
        """Whether it looks at more than the text's features, so that databases must be `wide`."""
        beyond = self.second is not None or self.embedding is not None
        return beyond or self.first.feature_count > PLAIN_WIDTH[self.dimension]

    def database(self, places: Sequence[PlaceFeatures] = ()) -> PlaceDatabase:
        """An empty or filled history of the kind this model needs."""
        return PlaceDatabase(places, wide=self.wide)

    def first_features(
        self, query: PlaceFeatures, database: PlaceDatabase, rows: npt.NDArray[np.integer] | None = None
    ) -> FloatArray:
        """What the first stage sees, (K, n), of all places or those of `rows`."""
        if self.first.feature_count > PLAIN_WIDTH[self.dimension]:
            return database.compare_wide(query, rows)
        return database.compare(query, rows)

    def likelihoods(
        self,
        query: PlaceFeatures,
        database: PlaceDatabase,
        rows: npt.NDArray[np.integer] | None = None,
        most: int | None = None,
    ) -> FloatArray:
        """Likelihood in [0, 1] that `query` is each place of the database, or of `rows`, (K,).

        Parameters
        ----------
        most : pairs that the second stage may look at, the best of the first; None for all that pass the gate.

        Raises
        ------
        InputError : places that cannot be compared, or do not match the model.
        """
        return at_once(self.judging(query, database, rows, most))

    def judging(
        self,
        query: PlaceFeatures,
        database: PlaceDatabase,
        rows: npt.NDArray[np.integer] | None = None,
        most: int | None = None,
    ) -> Steps[FloatArray]:
        """`likelihoods`, in steps."""
        yield COMPARING * (len(database) if rows is None else len(rows))
        F = self.first_features(query, database, rows)
        likelihood = self.first.score(F)
        if self.second is None or query.outline is None:
            return likelihood
        passed = np.flatnonzero(likelihood >= self.gate)
        if most is not None and len(passed) > most:
            passed = passed[np.argsort(-likelihood[passed], kind="stable")[:most]]
        found = REJECTED * likelihood
        if len(passed):
            places = passed if rows is None else rows[passed]
            outlines = [outline for place in places if (outline := database.outline(int(place))) is not None]
            laid = np.empty((len(outlines), MATCH_FEATURES))
            for start in range(0, len(outlines), TOGETHER):
                yield MATCHING * TOGETHER
                part = slice(start, start + TOGETHER)
                laid[part], _ = match_features(query.outline, outlines[part])
            found[passed] = self.second.score(
                second_features(F[passed], likelihood[passed], laid, self.dimension)
            )
        return found

    def score_pairs(self, places: Sequence[PlaceFeatures], pairs: Pairs) -> FloatArray:
        """Likelihood of each pair of places, (M,) in the order of the pairs: for evaluation.

        With a context `places` must be in order of path, and the later place of a pair is the query.
        """
        database = self.database(places)
        if self.context is not None:
            return self._score_in_context(places, database, pairs)
        scores = np.empty(len(pairs))
        for query, rows in pairs.by_first():
            scores[rows] = self.likelihoods(places[query], database, pairs.second[rows])
        return scores

    def odds(
        self, query: PlaceFeatures, database: PlaceDatabase, rows: npt.NDArray[np.integer] | None = None
    ) -> FloatArray:
        """First-stage log odds that `query` is each place, (K,): what `loop_closure.places.context` starts from."""
        likelihood = np.clip(self.first.score(self.first_features(query, database, rows)), 1e-9, 1.0 - 1e-9)
        return np.asarray(np.log(likelihood / (1.0 - likelihood)))

    def _score_in_context(
        self, places: Sequence[PlaceFeatures], database: PlaceDatabase, pairs: Pairs
    ) -> FloatArray:
        assert self.context is not None
        later, earlier = np.maximum(pairs.first, pairs.second), np.minimum(pairs.first, pairs.second)
        odds = np.array([self.odds(place, database) for place in places])
        queries = np.unique(later)
        found = dict(zip(queries.tolist(), contexts(odds, queries), strict=True))
        scores = np.empty(len(pairs))
        for query, rows in Pairs(later, earlier, pairs.same).by_first():
            scores[rows] = self.context.score(found[query][earlier[rows]])
        return scores

    def save(self, path: str | Path) -> None:
        """Write the model and its card as JSON."""
        content = {
            "format": FORMAT,
            "version": VERSION,
            "dimension": self.dimension,
            "card": self.card,
            "gate": self.gate,
            "first": self.first.to_dict(),
            "second": None if self.second is None else self.second.to_dict(),
            "embedding": None if self.embedding is None else self.embedding.to_dict(),
            "context": None if self.context is None else self.context.to_dict(),
        }
        Path(path).write_text(json.dumps(content) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> PlaceModel:
        """The model that `save` wrote; InputError where the file is no such model or of another version."""
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
        except ValueError as error:
            raise InputError(f"path: {path} is not a JSON file") from error
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise InputError(f"path: {path} does not hold a {FORMAT} model")
        version = content.get("version")
        if version != VERSION and not (version == 1 and content.get("second") is None):
            raise InputError(f"path: {path} has version {version}, readable is {VERSION}: train it again")
        try:
            first, second = content["first"], content["second"]
            context = content.get("context")
            return cls(
                content["dimension"],
                AdaBoost.from_dict(first)
                if first["format"] == ADABOOST
                else GradientBoosting.from_dict(first),
                None if second is None else GradientBoosting.from_dict(second),
                content["gate"],
                content["card"],
                None if content["embedding"] is None else Embedding.from_dict(content["embedding"]),
                None if context is None else GradientBoosting.from_dict(context),
            )
        except (KeyError, TypeError) as error:
            raise InputError(f"path: {path} is not a complete model: {error}") from error


def second_features(F: FloatArray, likelihood: FloatArray, laid: FloatArray, dimension: int) -> FloatArray:
    """What the second stage sees, (K, 44 + 1 + 28): the text's features, the first stage's verdict, the placement."""
    return np.column_stack((F[:, : PLAIN_WIDTH[dimension]], likelihood, laid))


@cache
def shipped_model(name: str) -> PlaceModel:
    """One of NAMES: the text's plain method or the best there is, for scans or clouds. InputError for another name."""
    if name not in NAMES:
        raise InputError(f"name: one of {', '.join(NAMES)} expected, got {name!r}")
    with as_file(files("loop_closure.places").joinpath("models", f"{name}.json")) as path:
        return PlaceModel.load(path)

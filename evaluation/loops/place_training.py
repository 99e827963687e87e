"""Training of place models from recordings with poses: the text's plain method, and the cascade beyond it.

    model = train_plain(recordings, PairRule(distance=2.0))
    model = train_cascade(recordings)
    model.save("model.json")

A recording is a list of places with their poses. Every recording counts alike, however long it is; one with few
positive pairs counts less. Nothing is drawn without a seed: the same recordings give the same model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh

from estimation.checks import FloatArray, as_finite, as_points, require_count
from estimation.errors import InputError
from estimation.learning.boosting import AdaBoost
from estimation.learning.gradient_boosting import GradientBoosting
from loop_closure.places.comparison import PlaceDatabase
from loop_closure.places.features import PlaceFeatures
from loop_closure.places.matching import Grids
from loop_closure.places.outline_kernels import MATCH_FEATURES
from loop_closure.places.outlines import Outline
from loop_closure.places.pairs import PairRule, Pairs, compare_pairs, sample_pairs
from loop_closure.places.place_model import PlaceModel, second_features
from loop_closure.places.retrieval import Embedding

# A recording with fewer positive pairs counts less, in proportion.
FULL_WEIGHT = 500
# Negative pairs to each positive one that the text's method is trained on. On clouds not trained on, ten instead of one
# raise D at 1 % FA from 46 to 55 %; on scans they change nothing.
NEGATIVE_SHARE = 10


@dataclass(frozen=True, eq=False)
class Recording:
    """Places of one log with their poses.

    Parameters
    ----------
    name : of the log. environment : the building or area; recordings of one are never on both sides of a test.
    places : N features. poses : (N, 3) [x, y, yaw], or positions (N, 2). path : (N,) metres travelled up to each.
    """

    name: str
    environment: str
    places: Sequence[PlaceFeatures]
    poses: FloatArray
    path: FloatArray

    @property
    def dimension(self) -> int:
        return 2 if len(self.places[0].values) == 35 else 3

    def pairs(
        self, rule: PairRule, negatives: int = 10_000, positives: int | None = None, seed: int = 0
    ) -> Pairs:
        """`sample_pairs` of this recording."""
        return sample_pairs(self.poses, rule, negatives, positives, seed, self.path)


def train_plain(
    recordings: Sequence[Recording], rule: PairRule, rounds: int = 50, most: int = 2000, seed: int = 0
) -> PlaceModel:
    """The text's method: AdaBoost over decision stumps on its pair features.

    most : positive pairs from each recording; negative ones are NEGATIVE_SHARE times as many. Either class has half
    the weight all the same, but what few negative pairs have in common with positive ones is learned from many.

    Raises
    ------
    InputError : no recording, or none with pairs of both classes.
    """
    F, y = [], []
    for recording in _some(recordings):
        pairs = plain_share(recording.pairs(rule, NEGATIVE_SHARE * most, most, seed))
        F.append(compare_pairs(recording.places, pairs))
        y.append(pairs.same)
    model = AdaBoost(rounds).fit(np.concatenate(F), np.concatenate(y))
    return PlaceModel(recordings[0].dimension, model)


def plain_share(pairs: Pairs) -> Pairs:
    """All positive pairs and at most NEGATIVE_SHARE times as many negative ones, the first of them."""
    return pairs.take(np.arange(min((1 + NEGATIVE_SHARE) * pairs.positives, len(pairs))))


@dataclass(frozen=True)
class CascadeConfig:
    """How a cascade is trained.

    rule : of positive pairs. positives, negatives : pairs drawn from each recording at random. hard : further negative
    pairs, those that look most alike among `pool`. recall : share of positive pairs that pass the gate. grades : what
    the second stage learns of a positive pair is whether it is nearer than each of these shares of the rule's distance.
    """

    rule: PairRule = field(default_factory=lambda: PairRule(distance=2.5, apart=4.0))
    positives: int = 1200
    negatives: int = 5000
    hard: int = 2500
    pool: int = 40_000
    recall: float = 0.97
    grades: tuple[float, ...] = (0.4, 0.8, 1.0)
    first_rounds: int = 80
    second_rounds: int = 160
    dimension: int = 16
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Examples:
    """Pairs of one recording as both stages see them.

    F : (M, n) of the first stage. laid : (M, 28) of the placement. same : (M,). random : (M,) whether the pair was
    drawn at random, not because it was hard: only those tell error rates. differences : (M, S) signed, of signatures.
    apart : (M,) metres between the two places.
    """

    name: str
    environment: str
    dimension: int
    F: FloatArray
    laid: FloatArray
    same: npt.NDArray[np.int8]
    random: npt.NDArray[np.bool_]
    differences: npt.NDArray[np.float32]
    apart: FloatArray

    @cached_property
    def weights(self) -> FloatArray:
        """Weight of each pair (M,): both classes alike, as much in all as the recording has to say."""
        positive = max(int(self.same.sum()), 1)
        share = min(1.0, positive / FULL_WEIGHT)
        return np.where(self.same == 1, share / positive, share / max(len(self.same) - positive, 1))


def examples(recording: Recording, config: CascadeConfig) -> Examples:
    """Pairs of a recording, random ones and hard ones, with all features; minutes for a long one."""
    drawn = recording.pairs(config.rule, config.pool, config.positives, config.seed)
    database = PlaceDatabase(recording.places, wide=True)
    positives = drawn.positives
    start = np.arange(min(len(drawn), positives + config.negatives))
    F = compare_wide(recording.places, database, drawn.take(start))
    first = GradientBoosting(40, 3, 0.2, seed=config.seed).fit(F, drawn.same[start])
    rest = np.arange(len(start), len(drawn))
    hard = np.zeros(0, dtype=np.int64)
    if len(rest) and config.hard:
        scores = np.concatenate(
            [
                first.score(compare_wide(recording.places, database, drawn.take(part)))
                for part in np.array_split(rest, 1 + len(rest) // 20_000)
            ]
        )
        hard = np.sort(rest[np.argsort(-scores, kind="stable")[: config.hard]])
        F = np.concatenate((F, compare_wide(recording.places, database, drawn.take(hard))))
    pairs = drawn.take(np.concatenate((start, hard)))
    outlines = [place.outline for place in recording.places if place.outline is not None]
    if len(outlines) < len(recording.places):
        raise InputError(f"recording {recording.name}: a cascade needs places with outlines")
    laid, _ = match_pairs(outlines, pairs)
    return Examples(
        recording.name,
        recording.environment,
        recording.dimension,
        F,
        laid,
        pairs.same,
        np.arange(len(pairs)) < len(start),
        database.signatures[pairs.first] - database.signatures[pairs.second],
        np.linalg.norm(recording.poses[pairs.first, :2] - recording.poses[pairs.second, :2], axis=1),
    )


def fit_cascade(sets: Sequence[Examples], config: CascadeConfig) -> PlaceModel:
    """The cascade trained on prepared examples.

    The gate, and the first stage's verdicts that the second stage learns from, come from first stages that were
    trained without the environment in question: on its own training data a classifier is too sure of itself. The second
    stage sees each pair once for every grade, so that of two sure places the nearer one comes first.
    """
    F, y = np.concatenate([s.F for s in sets]), np.concatenate([s.same for s in sets])
    laid, weights = np.concatenate([s.laid for s in sets]), np.concatenate([s.weights for s in sets])
    where = np.concatenate([np.full(len(s.same), s.environment) for s in sets])

    def first_stage(rows: npt.NDArray[np.bool_]) -> GradientBoosting:
        model = GradientBoosting(config.first_rounds, 3, 0.15, rows=0.5, columns=0.4, seed=config.seed)
        return model.fit(F[rows], y[rows], weights[rows])

    first = first_stage(np.ones(len(y), dtype=bool))
    verdict = np.empty(len(y))
    for environment in dict.fromkeys(where):
        inside = where == environment
        other = first if inside.all() else first_stage(~inside)
        verdict[inside] = other.score(F[inside])
    gate = _weighted_quantile(verdict[y == 1], weights[y == 1], 1.0 - config.recall)
    seen = verdict >= gate
    apart = np.concatenate([s.apart for s in sets])[seen]
    graded = [y[seen] * (apart < grade * config.rule.distance) for grade in config.grades]
    second = GradientBoosting(config.second_rounds, 4, 0.1, rows=0.5, columns=0.4, seed=config.seed).fit(
        np.tile(second_features(F[seen], verdict[seen], laid[seen], sets[0].dimension), (len(graded), 1)),
        np.concatenate(graded),
        np.tile(weights[seen], len(graded)),
    )
    differences = np.concatenate([s.differences[s.random] for s in sets])
    random = np.concatenate([s.random for s in sets])
    embedding = learn_embedding(differences, y[random], config.dimension, weights[random])
    return PlaceModel(sets[0].dimension, first, second, float(gate), embedding=embedding)


def train_cascade(recordings: Sequence[Recording], config: CascadeConfig | None = None) -> PlaceModel:
    """Examples of all recordings, and a cascade of them. InputError for recordings without outlines."""
    config = config or CascadeConfig()
    return fit_cascade([examples(recording, config) for recording in _some(recordings)], config)


def compare_wide(places: Sequence[PlaceFeatures], database: PlaceDatabase, pairs: Pairs) -> FloatArray:
    """Features of pairs of places (M, ..), differences of their signatures among them."""
    first = places[0]
    F = np.empty((len(pairs), len(first.values) + len(first.histograms) + len(first.signature)))
    for query, rows in pairs.by_first():
        F[rows] = database.compare_wide(places[query], pairs.second[rows])
    return F


def _some(recordings: Sequence[Recording]) -> Sequence[Recording]:
    if not recordings:
        raise InputError("recordings: at least one is needed")
    if len({recording.dimension for recording in recordings}) > 1:
        raise InputError("recordings: scans and clouds cannot be mixed")
    return recordings


def _weighted_quantile(values: FloatArray, weights: FloatArray, share: float) -> float:
    order = np.argsort(values, kind="stable")
    cumulated = np.cumsum(weights[order])
    at = int(np.searchsorted(cumulated, share * cumulated[-1]))
    return float(values[order][min(at, len(values) - 1)])


def learn_embedding(
    differences: npt.ArrayLike, same: npt.ArrayLike, dimension: int = 16, weights: npt.ArrayLike | None = None
) -> Embedding:
    """The discriminant metric of signature differences (M, S) of pairs labelled `same` (M,).

    Signs do not matter: absolute differences do as well as far as second moments of single numbers go, but lose how
    numbers go together; pass signed ones.

    Raises
    ------
    InputError : wrong shapes, one class only, or more dimensions than numbers in a signature.
    """
    D, labels = as_points("differences", differences), np.asarray(same)
    weight = np.ones(len(D)) if weights is None else as_finite("weights", weights)
    if labels.shape != (len(D),) or weight.shape != (len(D),) or not 0 < (labels == 1).sum() < len(D):
        raise InputError("same and weights must be (M,), with pairs of both classes")
    if require_count("dimension", dimension) > D.shape[1]:
        raise InputError(f"dimension must be at most {D.shape[1]}, not {dimension}")
    moments = []
    for value in (1, 0):
        rows = labels == value
        scaled = D[rows] * np.sqrt(weight[rows, None] / weight[rows].sum())
        moments.append(scaled.T @ scaled)
    within, between = moments
    # Directions that hardly vary within a place would count without bound.
    within = within + np.diag(0.05 * np.diag(within) + 1e-6 * np.trace(within))
    _, vectors = eigh(between, within)
    return Embedding(np.ascontiguousarray(vectors[:, ::-1][:, :dimension].T))


def match_pairs(
    outlines: Sequence[Outline], pairs: Pairs, cached: int = 4000
) -> tuple[FloatArray, FloatArray]:
    """`match_features` of pairs of places: features (M, 28) and poses (M, 3), in the order of the pairs."""

    @lru_cache(cached)
    def grids_of(place: int) -> Grids:
        return Grids(outlines[place])

    F, poses = np.empty((len(pairs), MATCH_FEATURES)), np.empty((len(pairs), 3))
    for row, (i, j) in enumerate(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)):
        grids_of(i).match(grids_of(j), F[row], poses[row])
    return F, poses

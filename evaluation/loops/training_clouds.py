"""Training of the model for clouds: wide boosting on pairs, then on their context along the path.

Judged and stacked by place: the area is cut into tiles, the tiles are dealt into folds, and a pair is only ever scored
by a classifier that has seen neither of its tiles.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError
from estimation.learning.boosting import AdaBoost
from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.loops.place_training import Recording, compare_wide, learn_embedding, plain_share
from evaluation.loops.roc import Roc, roc
from loop_closure.places.comparison import PlaceDatabase
from loop_closure.places.context import contexts
from loop_closure.places.pairs import IntArray, PairRule, Pairs, sample_pairs
from loop_closure.places.place_model import PlaceModel

TILE = 25.0
INNER = 3
NEGATIVES = 15_000
TEXT = 41  # features of the text, the first of the wide ones

Folds = npt.NDArray[np.int64]


def tiles(positions: FloatArray, folds: int, seed: int = 0) -> Folds:
    """Fold of each place (N,): tiles of 25 m, dealt at random."""
    _, tile = np.unique(np.floor(positions[:, :2] / TILE), axis=0, return_inverse=True)
    tile = tile.ravel()
    order = np.random.default_rng(seed).permutation(tile.max() + 1)
    return np.asarray(order[tile] % folds, dtype=np.int64)


def pairs_among(recording: Recording, nodes: IntArray, rule: PairRule, seed: int) -> Pairs:
    """Pairs of a recording both of whose places are among `nodes`, ascending; `rule.index_gap` counts in the log."""
    drawn = sample_pairs(recording.poses[nodes], replace(rule, index_gap=1), 4 * NEGATIVES, None, seed)
    first, second = nodes[drawn.first], nodes[drawn.second]
    kept = np.flatnonzero(second - first >= rule.index_gap)
    positive = kept[drawn.same[kept] == 1]
    kept = np.concatenate((positive, kept[drawn.same[kept] == 0][:NEGATIVES]))
    return Pairs(first[kept], second[kept], drawn.same[kept])


def wide_pairs(recording: Recording, pairs: Pairs) -> FloatArray:
    """The text's features and differences of signatures of pairs, (M, 41 + 56)."""
    return compare_wide(recording.places, PlaceDatabase(recording.places, wide=True), pairs)


def log_odds(recording: Recording, first: GradientBoosting) -> FloatArray:
    """First-stage log odds of all places with each other, (N, N)."""
    database = PlaceDatabase(recording.places, wide=True)
    return np.array([first.decision(database.compare_wide(place)) for place in recording.places])


def fit_first(recording: Recording, nodes: IntArray, rule: PairRule, seed: int) -> GradientBoosting:
    """The first stage from pairs among these places."""
    pairs = pairs_among(recording, nodes, rule, seed)
    model = GradientBoosting(150, 4, 0.08, columns=0.35, seed=seed)
    return model.fit(wide_pairs(recording, pairs), pairs.same)


def context_of(odds: FloatArray, pairs: Pairs) -> FloatArray:
    """Context features of pairs (M, ..), the later place of each being the query."""
    query, other = np.maximum(pairs.first, pairs.second), np.minimum(pairs.first, pairs.second)
    unique, inverse = np.unique(query, return_inverse=True)
    found = contexts(odds, unique)
    return np.array([found[k][place] for k, place in zip(inverse, other, strict=True)])


def train_clouds(
    recording: Recording, rule: PairRule, nodes: IntArray | None = None, seed: int = 0
) -> PlaceModel:
    """First stage and context from the places `nodes` of a recording; None for all.

    The context's training pairs lie within one inner fold each and are scored by first stages of the other folds.

    Raises
    ------
    InputError : a recording of scans, or one that is too small to be cut into folds.
    """
    if recording.dimension != 3:
        raise InputError(f"recording {recording.name}: clouds are expected")
    nodes = np.arange(len(recording.places)) if nodes is None else np.asarray(nodes, dtype=np.int64)
    fold = tiles(recording.poses[nodes], INNER, seed + 1)
    features, labels = [], []
    for k in range(INNER):
        inside, outside = nodes[fold == k], nodes[fold != k]
        pairs = pairs_among(recording, inside, rule, seed)
        if not 0 < pairs.positives < len(pairs):
            raise InputError(f"recording {recording.name}: too few places to be cut into {INNER} folds")
        odds = log_odds(recording, fit_first(recording, outside, rule, seed))
        features.append(context_of(odds, pairs))
        labels.append(pairs.same)
    context = GradientBoosting(120, 3, 0.06, seed=seed).fit(np.concatenate(features), np.concatenate(labels))
    pairs = pairs_among(recording, nodes, rule, seed)
    signatures = np.array([place.signature for place in recording.places])
    embedding = learn_embedding(signatures[pairs.first] - signatures[pairs.second], pairs.same)
    return PlaceModel(3, fit_first(recording, nodes, rule, seed), context=context, embedding=embedding)


def judge_by_place(recording: Recording, rule: PairRule, seed: int = 0) -> dict[str, list[Roc]]:
    """Curves on tiles that were not trained on, one per fold: of AdaBoost, the first stage, and with context."""
    return _judged(recording, rule, tiles(recording.poses, 4, seed), seed, context=True)


def judge_by_node(recording: Recording, rule: PairRule, seed: int = 0) -> dict[str, list[Roc]]:
    """Curves on nodes that were not trained on, dealt at random: their neighbours along the path may have been.

    Without context, which looks at these neighbours.
    """
    fold = np.random.default_rng(seed).integers(0, 2, len(recording.places))
    return _judged(recording, rule, fold, seed, context=False)


def _judged(
    recording: Recording, rule: PairRule, fold: Folds, seed: int, context: bool
) -> dict[str, list[Roc]]:
    """Curves on each fold (N,) of what was trained on the others."""
    found: dict[str, list[Roc]] = {}
    for k in range(int(fold.max()) + 1):
        inside, outside = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
        pairs = pairs_among(recording, inside, rule, seed + 2)
        train = plain_share(pairs_among(recording, outside, rule, seed))
        features, text = wide_pairs(recording, pairs), wide_pairs(recording, train)[:, :TEXT]
        scores = {
            f"AdaBoost, T = {rounds}": AdaBoost(rounds).fit(text, train.same).score(features[:, :TEXT])
            for rounds in (50, 200)
        }
        if context:
            model = train_clouds(recording, rule, outside, seed)
            scores["wide boosting"] = model.first.score(features)
            scores["best"] = model.score_pairs(recording.places, pairs)
        else:
            scores["wide boosting"] = fit_first(recording, outside, rule, seed).score(features)
        for name, score in scores.items():
            found.setdefault(name, []).append(roc(score, pairs.same))
    return found

"""Context of pairs along the path, on histories made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.loops.place_training import Recording
from evaluation.loops.training_clouds import pairs_among, tiles, train_clouds
from loop_closure import PlaceDatabase, PlaceFeatures, PlaceModel, PlaceRecognizer
from loop_closure.places.context import CONTEXT_FEATURES, GAP, PREDECESSORS, context_features, contexts
from loop_closure.places.pairs import PairRule, path_lengths


def odds_of_a_second_visit(reverse: bool) -> np.ndarray:
    """Log odds (100, 100) of a path whose second half repeats the first, the other way round if `reverse`."""
    rng = np.random.default_rng(0)
    odds = rng.normal(size=(100, 100)) - 2.0
    for k in range(50):
        other = 49 - k if reverse else k
        odds[50 + k, other] += 3.0
    return odds


@pytest.mark.parametrize("reverse", [False, True])
def test_a_run_of_matches_stands_out_in_either_direction(reverse: bool) -> None:
    odds = odds_of_a_second_visit(reverse)
    queries = np.arange(60, 100)
    found = contexts(odds, queries)
    # The mean along the path (columns 7 onwards) finds the place more often than the single comparison.
    truth = 49 - (queries - 50) if reverse else queries - 50
    single = np.mean([odds[q, :50].argmax() == t for q, t in zip(queries, truth, strict=True)])
    # Coming back, places of the first visit that follow the candidate are the ones seen before.
    along = np.mean([abs(F[:50, 9].argmax() - t) <= 1 for F, t in zip(found, truth, strict=True)])
    assert along > max(single, 0.9)


def test_a_query_that_resembles_everything_resembles_nothing() -> None:
    row = np.full(50, 3.0)
    F = context_features([row])
    assert F.shape == (50, CONTEXT_FEATURES)
    np.testing.assert_allclose(F[:, 1:4], 0.0)
    row[7] = 5.0
    assert context_features([row])[7, 1] == 2.0


def test_only_places_far_along_the_path_say_how_the_query_fares() -> None:
    row = np.concatenate((np.zeros(30), np.full(10, 9.0)))
    far = np.arange(40) < 30
    np.testing.assert_allclose(context_features([row], far)[:, 3], row)
    assert context_features([row], np.zeros(40, dtype=bool)).shape == (40, CONTEXT_FEATURES)


def laps(count: int = 120) -> Recording:
    """Clouds (their features made up) along a round of 200 m, driven twice: features are functions of the position."""
    rng = np.random.default_rng(0)
    angle = np.linspace(0, 4 * np.pi, 2 * count)
    xy = 32.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    waves = rng.normal(size=(2, 32)) / 6.0
    phases = rng.uniform(0, 6, 32)
    places = []
    for position in xy:
        values = 2.0 + np.sin(position @ waves + phases) + 0.1 * rng.normal(size=32)
        counts = tuple(rng.poisson(5, size).astype(float) for size in (400, 160, 80, 54, 40, 27, 20, 16, 14))
        places.append(PlaceFeatures(values, counts, 40.0))
    return Recording("laps", "laps", places, xy, path_lengths(xy))


def test_tiles_keep_a_place_in_one_fold_and_pairs_keep_to_their_places() -> None:
    recording = laps()
    fold = tiles(recording.poses, 3)
    assert set(fold) == {0, 1, 2}
    cell = np.floor(recording.poses / 25.0)
    for corner in np.unique(cell, axis=0):
        assert len(set(fold[(cell == corner).all(axis=1)])) == 1
    nodes = np.flatnonzero(fold == 1)
    pairs = pairs_among(recording, nodes, PairRule(3.0, 0.0, index_gap=20), 0)
    assert np.isin(pairs.first, nodes).all()
    assert np.isin(pairs.second, nodes).all()
    assert (pairs.second - pairs.first >= 20).all()
    apart = np.linalg.norm(recording.poses[pairs.first] - recording.poses[pairs.second], axis=1)
    np.testing.assert_array_equal(apart < 3.0, pairs.same == 1)


def test_clouds_are_trained_saved_and_recognised_in_order_of_path(tmp_path) -> None:
    recording = laps()
    model = train_clouds(recording, PairRule(3.0, 0.0, index_gap=20))
    model.save(tmp_path / "model.json")
    model = PlaceModel.load(tmp_path / "model.json")
    recognizer = PlaceRecognizer(model)
    right = asked = 0
    for k, place in enumerate(recording.places):
        if k >= 140:
            scores = recognizer.likelihoods(place)
            assert scores.shape == (k,)
            best = int(scores[: k - GAP].argmax())
            right += np.linalg.norm(recording.poses[best] - recording.poses[k]) < 4.0
            asked += 1
        recognizer.add(place, float(k))
    assert right > 0.9 * asked
    pairs = recording.pairs(PairRule(3.0, 0.0, index_gap=20), 500, 50)
    scores = model.score_pairs(recording.places, pairs)
    assert scores[pairs.same == 1].mean() > scores[pairs.same == 0].mean() + 0.3


def test_asking_first_changes_nothing_but_time() -> None:
    recording = laps(60)
    first = GradientBoosting(20, 3).fit(*_examples(recording))
    context = GradientBoosting(5, 2).fit(
        np.random.default_rng(0).normal(size=(90, CONTEXT_FEATURES)), [0, 1] * 45
    )
    model = PlaceModel(3, first, context=context)
    asked, silent = PlaceRecognizer(model), PlaceRecognizer(model)
    for k, place in enumerate(recording.places[:30]):
        asked.query(place, 1)
        for recognizer in (asked, silent):
            recognizer.add(place, float(k))
    assert PREDECESSORS < 30
    np.testing.assert_array_equal(
        asked.likelihoods(recording.places[40]), silent.likelihoods(recording.places[40])
    )


def _examples(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    pairs = recording.pairs(PairRule(3.0, 0.0, index_gap=20), 200, 100)
    database = PlaceDatabase(recording.places, wide=True)
    F = np.vstack(
        [
            database.compare_wide(recording.places[i], np.array([j]))
            for i, j in zip(pairs.first, pairs.second, strict=True)
        ]
    )
    return F, pairs.same


def test_scans_are_refused(tmp_path) -> None:
    recording = laps(30)
    small = Recording("small", "small", recording.places[:25], recording.poses[:25], recording.path[:25])
    with pytest.raises(InputError):
        train_clouds(small, PairRule(3.0, 0.0, index_gap=20))

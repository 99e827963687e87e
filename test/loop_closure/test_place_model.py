"""The cascade: what its stages see, what it says of rows and all, and the models that are shipped."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.learning.boosting import AdaBoost
from evaluation.loops.place_training import (
    NEGATIVE_SHARE,
    CascadeConfig,
    Recording,
    plain_share,
    train_cascade,
    train_plain,
)
from evaluation.loops.roc import roc
from loop_closure import (
    PlaceDatabase,
    PlaceModel,
    PlaceRecognizer,
    features_2d,
    pair_features,
    pair_features_many,
    shipped_model,
)
from loop_closure.places.pairs import PairRule, path_lengths, sample_pairs
from loop_closure.places.place_model import NAMES
from whereabouts.simulation import Lidar, random_floor
from whereabouts.simulation.robot import Drive

CONFIG = CascadeConfig(
    rule=PairRule(2.0, 10.0),
    positives=150,
    negatives=300,
    hard=50,
    pool=600,
    first_rounds=10,
    second_rounds=10,
    dimension=4,
)


def floor(seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    shapes, waypoints = random_floor(rng, rooms=2)
    drive = Drive(np.concatenate((waypoints, waypoints[::-1])), speed=1.0)
    poses = np.array([drive(float(t)) for t in np.arange(0.0, drive.duration, 1.2)])
    lidar = Lidar(beams=180)
    places = [features_2d(lidar.scan(shapes, pose, rng).scan, 50.0) for pose in poses]
    return Recording(f"floor {seed}", f"floor {seed}", places, poses, path_lengths(poses[:, :2]))


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    return [floor(1), floor(2)]


@pytest.fixture(scope="module")
def model(recordings) -> PlaceModel:
    return train_cascade(recordings, CONFIG)


def test_a_saved_cascade_says_the_same(model, recordings, tmp_path) -> None:
    model.save(tmp_path / "model.json")
    again = PlaceModel.load(tmp_path / "model.json")
    pairs = sample_pairs(recordings[0].poses, PairRule(2.0, 10.0), 100, 50)
    places = recordings[0].places
    np.testing.assert_allclose(again.score_pairs(places, pairs), model.score_pairs(places, pairs), atol=1e-12)
    assert again.wide
    assert again.gate == model.gate


def test_training_draws_nothing_by_chance(model, recordings) -> None:
    again = train_cascade(recordings, CONFIG)
    assert again.first.to_dict() == model.first.to_dict()
    assert again.second is not None
    assert model.second is not None
    assert again.second.to_dict() == model.second.to_dict()


def test_it_knows_the_places_of_an_unseen_floor_better_than_chance(model) -> None:
    other = floor(5)
    pairs = other.pairs(PairRule(1.0, 10.0, np.radians(45)), 300, 100)
    scores = model.score_pairs(other.places, pairs)
    assert np.mean(scores[pairs.same == 1]) > np.mean(scores[pairs.same == 0]) + 0.2


def test_pairs_below_the_gate_stay_below_and_the_rest_is_looked_at(model, recordings) -> None:
    places = recordings[0].places
    database = model.database(places)
    first = model.first.score(model.first_features(places[10], database))
    full = model.likelihoods(places[10], database)
    passed = first >= model.gate
    assert 0 < passed.sum() < len(places)
    np.testing.assert_allclose(full[~passed], 0.01 * first[~passed])
    some = np.array([3, 10, 40])
    np.testing.assert_allclose(model.likelihoods(places[10], database, some), full[some])
    limited = model.likelihoods(places[10], database, most=5)
    best = np.argsort(-np.where(passed, first, -1.0), kind="stable")[:5]
    np.testing.assert_allclose(limited[best], full[best])
    others = np.setdiff1d(np.arange(len(places)), best)
    np.testing.assert_allclose(limited[others], 0.01 * first[others])


def test_of_two_sure_places_the_nearer_one_comes_first(recordings) -> None:
    graded = train_cascade(recordings, CONFIG)
    alike = train_cascade(recordings, replace(CONFIG, grades=(1.0,)))
    other = floor(5)
    near = other.pairs(PairRule(0.8, 10.0, np.radians(45)), 0, 200)
    far = other.pairs(PairRule(2.0, 10.0, np.radians(45)), 0, 400)
    apart = np.linalg.norm(other.poses[far.first, :2] - other.poses[far.second, :2], axis=1)
    far = far.take(apart > 1.6)
    assert len(near) > 20
    assert len(far) > 20

    def sorted_rightly(model: PlaceModel) -> float:
        same = np.repeat([1, 0], [len(near), len(far)])
        scores = [model.score_pairs(other.places, pairs) for pairs in (near, far)]
        return roc(np.concatenate(scores), same).area

    assert sorted_rightly(graded) > max(0.7, sorted_rightly(alike))


def test_a_long_history_is_searched_by_its_index(model, recordings) -> None:
    places = recordings[0].places
    whole = PlaceRecognizer(model, looks=10**6)
    indexed = PlaceRecognizer(model, looks=10**6, exhaustive=10, candidates=len(places) // 2)
    for recognizer in (whole, indexed):
        for k, place in enumerate(places):
            assert recognizer.add(place, float(k)) == k
    hits = 0
    for query in range(0, len(places), 10):
        best, found = whole.query(places[query], 3), indexed.query(places[query], 3)
        assert len(found) == 3
        # What is found has the likelihood that the exhaustive comparison gives it.
        scores = whole.likelihoods(places[query])
        assert all(value == pytest.approx(scores[identity]) for identity, value in found)
        hits += best[0][0] == found[0][0]
    assert hits >= 0.8 * len(range(0, len(places), 10))


def test_the_plain_method_is_adaboost_on_the_texts_features(recordings) -> None:
    model = train_plain(recordings, PairRule(2.0, 10.0), rounds=5, most=100)
    assert isinstance(model.first, AdaBoost)
    assert not model.wide
    places = recordings[0].places
    expected = model.first.score(pair_features_many(places[0], places))
    np.testing.assert_array_equal(model.likelihoods(places[0], model.database(places)), expected)


def test_the_plain_method_learns_from_ten_negative_pairs_to_a_positive_one(recordings) -> None:
    rule = PairRule(2.0, 10.0)
    pairs = recordings[0].pairs(rule, 10 * NEGATIVE_SHARE, 10, 3)
    kept = plain_share(pairs.take(np.arange(4, len(pairs))))
    assert kept.positives == 6
    assert len(kept) == 6 + 6 * NEGATIVE_SHARE
    F = np.array(
        [
            pair_features(recordings[0].places[i], recordings[0].places[j])
            for i, j in zip(pairs.first, pairs.second, strict=True)
        ]
    )
    expected = AdaBoost(5).fit(F, pairs.same)
    assert train_plain(recordings[:1], rule, rounds=5, most=10, seed=3).first.to_dict() == expected.to_dict()


def test_memory_of_a_place_is_what_the_readme_says(recordings) -> None:
    places = recordings[0].places
    narrow, wide = PlaceDatabase(places), PlaceDatabase(places, wide=True)
    assert narrow.nbytes / len(places) == pytest.approx(4368, abs=1)
    outlines = sum(8 * len(place.outline.points) + 2048 for place in places)
    assert wide.nbytes - narrow.nbytes == 4 * 108 * len(places) + outlines
    # 4.4 kB for the text's features, 2.5 kB and 8 bytes per outline point beyond: at most 9.4 kB.
    assert wide.nbytes / len(places) < 4368 + 2480 + 8 * 320


@pytest.mark.parametrize("name", NAMES)
def test_shipped_models_say_what_they_were_trained_on(name: str) -> None:
    model = shipped_model(name)
    assert model.dimension == int(name[-2])
    assert model.card["trained_on"]
    assert shipped_model(name) is model


def test_shipped_models_are_small() -> None:
    sizes = [len(path.read_bytes()) for path in files("loop_closure.places").joinpath("models").iterdir()]
    assert sum(sizes) < 1_000_000


def test_without_a_model_the_shipped_one_is_used(recordings) -> None:
    recognizer = PlaceRecognizer()
    assert recognizer.model is None
    assert recognizer.query(recordings[0].places[0], 3) == []
    for k in range(60):
        recognizer.add(recordings[0].places[k], float(k))
    assert recognizer.model is shipped_model("best_2d")
    assert recognizer.query(recordings[0].places[30], 1)[0][0] == 30


def test_wrong_models_are_refused(model, recordings, tmp_path) -> None:
    with pytest.raises(InputError, match="name"):
        shipped_model("other")
    with pytest.raises(InputError, match="dimension"):
        PlaceModel(4, AdaBoost(1))
    with pytest.raises(InputError, match="gate"):
        PlaceModel(2, AdaBoost(1), gate=2.0)
    for text, message in (
        ("{", "JSON"),
        ("{}", "does not hold"),
        ('{"format": "whereabouts.place_model"}', "version"),
    ):
        (tmp_path / "model.json").write_text(text)
        with pytest.raises(InputError, match=message):
            PlaceModel.load(tmp_path / "model.json")
    model.save(tmp_path / "model.json")
    content = json.loads((tmp_path / "model.json").read_text())
    (tmp_path / "model.json").write_text(json.dumps({**content, "version": 1}))
    with pytest.raises(InputError, match="train it again"):
        PlaceModel.load(tmp_path / "model.json")
    (tmp_path / "model.json").write_text(json.dumps({**content, "version": 1, "second": None}))
    assert PlaceModel.load(tmp_path / "model.json").second is None
    with pytest.raises(InputError, match="wide"):
        model.likelihoods(recordings[0].places[0], PlaceDatabase(recordings[0].places))

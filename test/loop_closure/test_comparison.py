"""Pair features, singly and batched, and the recogniser built on them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.errors import InputError
from loop_closure import (
    AdaBoost,
    PlaceDatabase,
    PlaceFeatures,
    PlaceRecognizer,
    features_2d,
    features_3d,
    pair_features,
    pair_features_many,
)
from registration import Scan


def corridor(seed, noise=0.0):
    """A full-circle view of a place of its own; the same seed is the same place."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    r = 5 + sum(rng.uniform(-1, 1) * np.sin(k * angle + rng.uniform(0, 6)) for k in range(1, 6))
    return Scan(
        r + np.random.default_rng(seed + 999).normal(0, 1, 180) * noise, -np.pi, np.pi / 90, 0.1, 30.0
    )


def place(seed, noise=0.0):
    return features_2d(corridor(seed, noise), 20.0)


def cloud(seed):
    return features_3d(np.random.default_rng(seed).normal(0, 4, (150, 3)), 15.0)


def trained():
    """A model that has seen 30 places twice."""
    rows, labels = [], []
    for i in range(30):
        again = place(i, 0.05)
        rows += [pair_features(place(i), again), pair_features(place(i + 50), again)]
        labels += [1, 0]
    return AdaBoost(20).fit(rows, labels)


@pytest.mark.parametrize(("make", "scalars"), [(place, 35), (cloud, 32)])
def test_differences_and_correlation_coefficients(make, scalars):
    a, b = make(1), make(2)
    F = pair_features(a, b)
    assert F.shape == (scalars + 9,)
    np.testing.assert_array_equal(F[:scalars], np.abs(a.values - b.values))
    for k in range(9):
        expected = np.corrcoef(a.histograms[k], b.histograms[k])[0, 1]
        assert F[scalars + k] == pytest.approx(expected, abs=1e-6)


@given(st.integers(0, 40), st.integers(0, 40), st.sampled_from([place, cloud]))
@settings(max_examples=60)
def test_symmetry_and_identity(i, j, make):
    a, b = make(i), make(j)
    np.testing.assert_array_equal(pair_features(a, b), pair_features(b, a))
    same = pair_features(a, make(i))
    np.testing.assert_array_equal(same[:-9], 0.0)
    np.testing.assert_allclose(same[-9:], 1.0, atol=1e-6)
    assert (np.abs(pair_features(a, b)[-9:]) <= 1.0).all()


@given(st.lists(st.lists(st.integers(0, 3), min_size=4, max_size=4), min_size=2, max_size=2))
def test_correlation_of_any_counts(pair):
    places = [PlaceFeatures(np.zeros(3), (np.array(h, float),), 10.0) for h in pair]
    coefficient = pair_features(*places)[-1]
    constant = [len(set(h)) == 1 for h in pair]
    if any(constant):
        assert coefficient == float(all(constant))
    else:
        assert coefficient == pytest.approx(np.corrcoef(pair)[0, 1], abs=1e-6)


def test_many_equal_one_by_one():
    query, others = place(0), [place(i) for i in range(37)]
    expected = np.array([pair_features(query, other) for other in others])
    np.testing.assert_array_equal(pair_features_many(query, others), expected)
    database = PlaceDatabase(others)
    np.testing.assert_array_equal(pair_features_many(query, database), expected)
    assert database.append(place(99)) == 37
    assert pair_features_many(query, database).shape == (38, 44)
    assert (len(database), database.values.shape) == (38, (38, 35))
    assert pair_features_many(query, []).shape == (0, 44)
    assert database.nbytes == 38 * (8 * 35 + 4 * (sum(len(h) for h in query.histograms) + 9))


def test_turned_by_half_a_circle_is_the_same_place():
    scan = corridor(3)
    turned = Scan(np.roll(scan.ranges, 90), -np.pi, np.pi / 90, 0.1, 30.0)
    F = pair_features(features_2d(scan, 20.0), features_2d(turned, 20.0))
    np.testing.assert_allclose(F[:35], 0.0, atol=1e-9)
    np.testing.assert_allclose(F[35:], 1.0, atol=1e-6)


def test_places_that_cannot_be_compared():
    a = place(1)
    for other, match in (
        (cloud(1), "scalar features"),
        (features_2d(corridor(1), 25.0), "max_range"),
        (PlaceFeatures(a.values, (*a.histograms[:8], np.ones(3)), 20.0), "bins"),
    ):
        with pytest.raises(InputError, match=match):
            pair_features(a, other)
        with pytest.raises(InputError, match=match):
            pair_features_many(a, [a, other])
    for values, histograms in (
        ([np.nan], ([1.0],)),
        ([], ([1.0],)),
        ([1.0], ([np.inf],)),
        ([[1.0]], ([1.0],)),
    ):
        with pytest.raises(InputError):
            PlaceFeatures(np.array(values), tuple(np.array(h) for h in histograms), 10.0)


def test_recogniser_finds_the_place_again():
    recognizer = PlaceRecognizer(trained())
    assert recognizer.query(place(0), 3) == []
    identities = [recognizer.add(place(100 + i), 0.1 * i) for i in range(40)]
    assert identities == list(range(40))
    assert len(recognizer) == 40
    assert recognizer.stamp(7) == pytest.approx(0.7)
    ranks = [[i for i, _ in recognizer.query(place(100 + k, 0.02), 3)].count(k) for k in range(40)]
    assert sum(ranks) >= 36


def test_queries_are_ordered_and_limited():
    recognizer = PlaceRecognizer(trained())
    for i in range(25):
        recognizer.add(place(i % 5), i)
    found = recognizer.query(place(2), 25)
    scores = recognizer.likelihoods(place(2))
    assert found == sorted(enumerate(scores.tolist()), key=lambda pair: (-pair[1], pair[0]))
    for k in (1, 3, 7, 24):
        assert recognizer.query(place(2), k) == found[:k]
    assert recognizer.query(place(2), 100) == found
    assert found[0] == (2, scores.max())


def test_recogniser_refuses_what_it_cannot_use():
    with pytest.raises(InputError, match="looks"):
        PlaceRecognizer(trained(), looks=0)
    recognizer = PlaceRecognizer(trained())
    with pytest.raises(InputError, match="stamp"):
        recognizer.add(place(1), np.nan)
    recognizer.add(place(1), 0.0)
    with pytest.raises(InputError, match="scalar features"):
        recognizer.add(cloud(1), 1.0)
    assert len(recognizer) == 1
    with pytest.raises(InputError, match="k must"):
        recognizer.query(place(1), 0)
    with pytest.raises(InputError, match="identity"):
        recognizer.stamp(1)
    three_dimensional = PlaceRecognizer(trained())
    three_dimensional.add(cloud(1), 0.0)
    with pytest.raises(InputError, match="shape"):
        three_dimensional.query(cloud(2), 1)

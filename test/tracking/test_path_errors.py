"""Whether people are where predictions say they may be: shares inside regions, against walks drawn at random."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tracking.intentions import IntentionModel

AHEAD = np.array([1.0, 2.0, 4.0])
# Squared Mahalanobis distance below which 90 of 100 draws of a normal distribution in two dimensions are.
NINETY = -2.0 * np.log(0.1)


def wandering(rng: np.random.Generator, turning: float, start: float, rate: float = 10.0) -> np.ndarray:
    """A walk of 12 s (N, 3) x, y, t whose velocity changes as white noise of `turning` m/s^1.5 does."""
    count = int(12.0 * rate)
    change = rng.normal(0.0, turning / np.sqrt(rate), (count, 2))
    velocity = 1.1 * np.array([np.cos(a := rng.uniform(-np.pi, np.pi)), np.sin(a)]) + np.cumsum(
        change, axis=0
    )
    places = rng.uniform(-4.0, 4.0, 2) + np.cumsum(velocity, axis=0) / rate
    return np.column_stack((places + rng.normal(0.0, 0.03, (count, 2)), start + np.arange(count) / rate))


def inside(model: IntentionModel, walks: list[np.ndarray], ahead: float) -> float:
    """Share of walks that are within the 90 % region of their predicted paths `ahead` s after 5 s."""
    hits = []
    for walk in walks:
        told = model.predict(walk[:50], ahead)
        off = walk[np.searchsorted(walk[:, 2], walk[49, 2] + ahead - 1e-6), :2] - told.path[-1, :2]
        hits.append(off @ np.linalg.solve(told.covariances[-1], off) <= NINETY)
    return float(np.mean(hits))


@pytest.mark.parametrize("turning", [0.1, 0.5])
@pytest.mark.parametrize("ahead", [1.0, 2.0, 4.0])
def test_nine_of_ten_are_where_nine_of_ten_should_be_however_much_people_turn(
    turning: float, ahead: float
) -> None:
    rng = np.random.default_rng(5)
    model = IntentionModel()
    for k in range(40):
        model.learn(wandering(rng, turning, 100.0 * k))
    share = inside(model, [wandering(rng, turning, 1e5 + 100.0 * k) for k in range(150)], ahead)
    assert 0.75 < share <= 0.99


def test_who_stands_is_surer_to_be_there_than_who_walks() -> None:
    rng = np.random.default_rng(6)
    model = IntentionModel()
    for k in range(20):
        walk = wandering(rng, 0.5, 100.0 * k)
        t = walk[-1, 2] + np.arange(1, 120) / 10.0
        model.learn(np.vstack((walk, np.column_stack((walk[-1, :2] + rng.normal(0.0, 0.03, (119, 2)), t)))))
    assert (model.errors.rates(True, AHEAD) > 2.0 * model.errors.rates(False, AHEAD)).all()


@pytest.mark.parametrize("rate", [5.0, 10.0, 40.0])
@pytest.mark.parametrize("seen", [1, 2, 3])
def test_of_who_has_only_just_been_seen_little_is_said(seen: int, rate: float) -> None:
    rng = np.random.default_rng(7)
    model, squares, errors = IntentionModel(), [], []
    for _ in range(300):
        bearing = rng.uniform(-np.pi, np.pi)
        velocity = rng.uniform(0.0, 1.6) * np.array([np.cos(bearing), np.sin(bearing)])
        t = np.arange(seen) / rate
        rows = np.column_stack((t[:, None] * velocity + rng.normal(0.0, 0.03, (seen, 2)), t))
        told = model.predict(rows, 2.0)
        off = velocity * (t[-1] + 2.0) - told.path[-1, :2]
        squares.append(off @ np.linalg.solve(told.covariances[-1], off))
        errors.append(float(np.hypot(*off)))
    assert np.mean(np.array(squares) <= NINETY) > 0.85
    # Standing still would be off by 1.6 m on average; nobody is thrown across the room by the noise of two looks.
    assert np.mean(errors) < 1.75


def test_what_errors_taught_is_saved(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    model = IntentionModel()
    for k in range(5):
        model.learn(wandering(rng, 0.5, 100.0 * k))
    again = IntentionModel.load(model.save(tmp_path / "hall.npz"))
    for walking in (False, True):
        np.testing.assert_array_equal(again.errors.rates(walking, AHEAD), model.errors.rates(walking, AHEAD))
    assert (model.errors.rates(True, AHEAD) > 0.15).all()
    assert again.errors.elsewhere == model.errors.elsewhere != 0.5


def to_a_door(rng: np.random.Generator, start: float, strays: float) -> np.ndarray:
    """A walk of some 8 s (N, 3) from the middle of the south to one of three doors, or with `strays` just anywhere."""
    doors = np.array([[-6.0, 8.0], [0.0, 10.0], [6.0, 8.0]])
    end = rng.uniform((-8.0, 3.0), (8.0, 10.0)) if rng.random() < strays else doors[rng.integers(3)]
    t = np.arange(0.0, 8.01, 0.2)
    share = (t / 8.0)[:, None]
    # All set out northward and turn to where they go.
    places = share * np.array([0.0, 4.0]) * (1.0 - share) + share**2 * end
    return np.column_stack((places + rng.normal(0.0, 0.03, places.shape), start + t))


@pytest.mark.parametrize("strays", [0.0, 0.4])
def test_goals_are_not_told_as_surer_than_they_are_right(strays: float) -> None:
    rng, model = np.random.default_rng(6), IntentionModel()
    told, right = [], []
    for k in range(150):
        walk = to_a_door(rng, 100.0 * k, strays)
        if k >= 50:
            seen = model.predict(walk[:21], 5.0)
            told.append((1.0 - seen.elsewhere) * seen.probabilities[0])
            right.append(np.hypot(*(seen.goals[0] - walk[-1, :2])) <= model.config.goal_radius)
        model.learn(walk)
    # Strays count twice a little: as walks that nearly fit, and as a share.
    assert -0.15 < np.mean(told) - np.mean(right) < 0.03
    assert (np.mean(right) > 0.95) == (strays == 0.0)


def test_nothing_learned_is_as_likely_wrong_as_right() -> None:
    seen = IntentionModel().predict(wandering(np.random.default_rng(1), 0.1, 0.0)[:50], 5.0)
    assert (seen.probabilities.sum(), seen.elsewhere) == (1.0, 0.5)


def straight(rng: np.random.Generator, start: float) -> np.ndarray:
    """A walk along the x axis at 1.2 m/s, (N, 3), each place seen with 5 cm of noise, as a model expects."""
    t = np.arange(0.0, 9.0, 0.4)
    places = np.column_stack((1.2 * t, np.zeros_like(t))) + rng.normal(0.0, 0.05, (len(t), 2))
    return np.column_stack((places, start + t))


def test_what_noise_is_told_of_is_not_learned_as_well() -> None:
    rng, model = np.random.default_rng(4), IntentionModel()
    for k in range(60):
        model.learn(straight(rng, 100.0 * k))
    for ahead in AHEAD:
        squares = []
        for k in range(60, 140):
            told = model.predict(straight(rng, 100.0 * k)[:10], ahead)
            there = np.array([1.2 * (3.6 + ahead), 0.0]) + rng.normal(0.0, 0.05, 2)
            off = there - told.path[-1, :2]
            squares.append(off @ np.linalg.solve(told.covariances[-1], off))
        assert 0.75 < np.mean(squares) / 2.0 < 1.4

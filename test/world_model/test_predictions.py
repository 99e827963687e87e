"""Movers that are hidden are expected where a motion predictor says (section 2.4.2 with chapter 4)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from tracking.intentions import IntentionModel
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldState

REGION = ((-10.0, 10.0), (-10.0, 10.0), (0.0, 2.0))
PERSON = {"class": {"person": 0.95, "cup": 0.05}}
STEP = 0.1
TURN = 2.0
"""s: when the person walks round the corner and is hidden."""


def config(**more: Any) -> WorldModelConfig:
    return WorldModelConfig(classes=("person", "cup"), region=REGION, rate_hz=1.0 / STEP, **more)


def where(t: float) -> np.ndarray:
    """At 1 m/s along x until the corner, along y after it."""
    return np.array([min(t, TURN), max(t - TURN, 0.0), 1.0])


def person(t: float) -> WorldEvidence:
    # Blocked, as the tracker's targets are: who is not seen may be hidden.
    return WorldEvidence([ObjectEvidence(where(t), 0.05**2 * np.eye(3), PERSON)], blocked=True)


def path(begin: float, end: float = 6.0) -> np.ndarray:
    times = np.arange(begin, end, 0.25)
    return np.array([[*where(t)[:2], t] for t in times])


def walked(until: float, predicted: bool = True, **more: Any) -> tuple[WorldModel, WorldState]:
    """Seen until some moment; then hidden."""
    model = WorldModel(config(**more))
    for k in range(round(until / STEP) + 1):
        t = k * STEP
        told = {"person-1": path(t)} if predicted else None
        state = model.update(person(t), t, told)
    return model, state


def test_hidden_person_is_expected_where_the_predictor_says() -> None:
    model, _ = walked(TURN - 0.2)
    plain, _ = walked(TURN - 0.2, predicted=False)
    hidden = WorldEvidence([], blocked=True)
    for k in range(round(TURN / STEP) - 1, round((TURN + 2.0) / STEP) + 1):
        state = model.update(hidden, k * STEP)
        plain.update(hidden, k * STEP)
    [item] = state.objects
    truth = where(TURN + 2.0)
    assert item.id == "person-1"
    assert np.hypot(*(item.position - truth)[:2]) < 0.2
    np.testing.assert_allclose(item.velocity[:2], [0.0, 1.0], atol=0.05)
    assert item.behaviors["predicted"] > item.behaviors["constant_velocity"]
    assert np.linalg.eigvalsh(item.covariance).min() > 0.0
    # Straight on is two metres farther along x and two less along y.
    straight = walked(TURN - 0.2, predicted=False)[0].propagate(TURN + 2.0).objects[0]
    assert np.hypot(*(straight.position - truth)[:2]) > 2.0


def test_who_comes_out_at_the_predicted_place_is_the_same_person() -> None:
    model, _ = walked(TURN - 0.2)
    for k in range(25):
        model.update(WorldEvidence([], blocked=True), TURN + k * STEP)
    for k in range(25, 35):
        state = model.update(person(TURN + k * STEP), TURN + k * STEP)
    assert [item.id for item in state.objects] == ["person-1"]
    np.testing.assert_allclose(state.objects[0].position[:2], where(state.stamp)[:2], atol=0.1)


def test_who_went_straight_on_after_all_is_believed() -> None:
    """Constant velocity stays a behaviour beside the prediction, and evidence decides."""
    model, _ = walked(TURN - 0.2)
    for k in range(1, 15):
        model.update(WorldEvidence([], blocked=True), TURN + k * STEP)
    for k in range(15, 25):
        t = TURN + k * STEP
        seen = ObjectEvidence((t, 0.0, 1.0), 0.05**2 * np.eye(3), PERSON)
        state = model.update(WorldEvidence([seen], blocked=True), t)
    [item] = [item for item in state.objects if abs(item.position[1]) < 0.3]
    assert item.id == "person-1"
    assert item.behaviors["constant_velocity"] > 0.9
    assert item.velocity[0] == pytest.approx(1.0, abs=0.2)


def test_stale_and_withdrawn_predictions_fall_back_to_constant_velocity() -> None:
    plain, _ = walked(TURN - 0.2, predicted=False)
    wanted = plain.propagate(TURN + 0.5).objects[0]
    model, _ = walked(TURN - 0.2)
    model.update(WorldEvidence([], blocked=True), TURN - 0.1, {"person-1": None})
    model.update(WorldEvidence([], blocked=True), TURN)
    item = model.propagate(TURN + 0.5).objects[0]
    assert item.behaviors["predicted"] == 0.0
    np.testing.assert_allclose(item.position, wanted.position, atol=0.1)
    old = WorldModel(config())
    for k in range(round((TURN - 0.2) / STEP) + 1):
        told = {"person-1": path(0.0, 1.0)} if k < 10 else None
        old.update(person(k * STEP), k * STEP, told)
    item = old.propagate(TURN + 0.5).objects[0]
    assert item.behaviors["predicted"] == 0.0
    np.testing.assert_allclose(item.position, wanted.position, atol=0.1)


def test_share_of_those_who_keep_to_the_path_is_a_setting() -> None:
    motion = {
        "*": {"model": "static"},
        "person": {"model": "constant_velocity", "follows_prediction": 0.0},
    }
    model, _ = walked(TURN - 0.2, motion=motion)
    item = model.propagate(TURN + 2.0).objects[0]
    assert item.behaviors["predicted"] == 0.0
    with pytest.raises(InputError, match="follows_prediction"):
        config(motion={"person": {"model": "constant_velocity", "follows_prediction": 1.5}})


def test_things_that_lie_about_are_led_nowhere() -> None:
    model = WorldModel(config())
    for k in range(20):
        seen = ObjectEvidence((1.0, 1.0, 1.0), 1e-4 * np.eye(3), {"class": {"person": 0.02, "cup": 0.98}})
        model.update(WorldEvidence([seen], blocked=True), k * STEP, {"cup-1": path(0.0)})
    item = model.propagate(5.0).objects[0]
    np.testing.assert_allclose(item.position, [1.0, 1.0, 1.0], atol=0.01)
    assert item.behaviors["constant_position"] > 0.9


def test_the_predictor_of_chapter_4_can_be_passed_on() -> None:
    learned = IntentionModel()
    rng = np.random.default_rng(0)
    for k in range(12):
        t = np.arange(0.0, 6.0, 0.2)
        walk = np.array([where(s)[:2] for s in t]) + rng.normal(0.0, 0.02, (len(t), 2))
        learned.learn(np.column_stack([walk, t + 100.0 * k]))
    seen = np.array([[*where(s)[:2], s] for s in np.arange(0.0, TURN - 0.1, STEP)])
    told = learned.predict(seen, 5.0)
    model, state = walked(TURN - 0.2, predicted=False)
    model.update(person(TURN - 0.2), state.stamp, {"person-1": told})
    item = model.propagate(TURN + 1.5).objects[0]
    said = [np.interp(TURN + 1.5, told.path[:, 2], told.path[:, a]) for a in (0, 1)]
    np.testing.assert_allclose(item.position[:2], said, atol=0.05)
    plain = walked(TURN - 0.2, predicted=False)[0].propagate(TURN + 1.5).objects[0]
    off = [np.hypot(*(x.position - where(TURN + 1.5))[:2]) for x in (item, plain)]
    assert off[0] < off[1]


def test_paths_without_names_belong_to_those_who_are_there() -> None:
    model, state = walked(TURN - 0.2, predicted=False)
    ends = SimpleNamespace(path=path(TURN - 0.2), covariances=None)
    far = path(TURN - 0.2) + np.array([5.0, 5.0, 0.0])
    model.update(person(TURN - 0.2), state.stamp, [far, ends])
    item = model.propagate(TURN + 1.0).objects[0]
    assert np.hypot(*(item.position - where(TURN + 1.0))[:2]) < 0.2


@pytest.mark.parametrize(
    "bad",
    [
        {"person-1": [[0.0, 0.0, 0.0]]},
        {"person-1": [[0.0, 0.0, 1.0], [1.0, 0.0, 0.5]]},
        {"person-1": [[0.0, 0.0, 0.0], [np.nan, 0.0, 1.0]]},
        {"person-1": SimpleNamespace(path=[[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]], covariances=np.eye(2))},
        "person-1",
    ],
)
def test_bad_predictions_are_refused_and_change_nothing(bad: Any) -> None:
    model, state = walked(1.0, predicted=False)
    with pytest.raises(InputError, match="predictions"):
        model.update(person(1.1), 1.1, bad)
    assert model.stamp == state.stamp
    assert model.propagate(1.1).objects[0].behaviors["predicted"] == 0.0

"""The intention model: what it learns and predicts, what it does with bad input, and what it saves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from estimation.errors import InputError
from tracking.intentions import IntentionConfig, IntentionModel, Prediction
from tracking.intentions.observations import clean, filled, spaced

METHODS = ("routes", "ghmm")
EXITS = {"right": (10.0, 0.0), "up": (5.0, 6.0)}


def walk(
    goal: str, rng: np.random.Generator | None = None, rate: float = 9.0, start: float = 0.0
) -> np.ndarray:
    """From the origin to (5, 0), then right or up, at 1.2 m/s."""
    corners = np.array([[0.0, 0.0], [5.0, 0.0], EXITS[goal]])
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    t = np.arange(0.0, along[-1] / 1.2, 1.0 / rate)
    points = np.column_stack([np.interp(1.2 * t, along, corners[:, k]) for k in (0, 1)])
    if rng is not None:
        points = points + rng.normal(0, 0.15, 2) + rng.normal(0, 0.02, points.shape)
    return np.column_stack((points, start + t))


def taught(method: str = "routes", count: int = 12, **settings: object) -> IntentionModel:
    rng = np.random.default_rng(4)
    model = IntentionModel(IntentionConfig(method=method, **settings))  # type: ignore[arg-type]
    for k in range(count):
        model.learn(walk("right" if k % 3 else "up", rng, start=60.0 * k))
    return model


def check(prediction: Prediction, partial: np.ndarray, horizon: float) -> None:
    """What holds for every prediction."""
    assert prediction.goals.shape == (len(prediction.probabilities), 2)
    assert prediction.probabilities.sum() == pytest.approx(1.0)
    assert (np.diff(prediction.probabilities) <= 1e-12).all()
    path = prediction.path
    assert np.isfinite(path).all()
    assert path[0, 2] == pytest.approx(partial[-1, 2])
    assert path[-1, 2] == pytest.approx(partial[-1, 2] + horizon)
    assert (np.diff(path[:, 2]) > 0.0).all()
    traces = np.trace(prediction.covariances, axis1=1, axis2=2)
    assert (np.diff(traces) >= -1e-12).all()
    assert (np.linalg.eigvalsh(prediction.covariances) > 0.0).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("goal", EXITS)
def test_after_the_fork_the_goal_is_known_and_the_path_leads_there(method: str, goal: str) -> None:
    model = taught(method)
    full = walk(goal)
    partial = full[: int(0.8 * len(full))]
    prediction = model.predict(partial, 12.0)
    check(prediction, partial, 12.0)
    assert np.hypot(*(prediction.goals[0] - EXITS[goal])) < 0.72
    assert prediction.probabilities[0] > 0.7
    assert np.hypot(*(prediction.path[-1, :2] - prediction.goals[0])) < 0.5


@pytest.mark.parametrize("method", METHODS)
def test_before_the_fork_both_goals_are_held(method: str) -> None:
    model = taught(method)
    prediction = model.predict(walk("up")[:20], 5.0)
    for goal in EXITS.values():
        near = np.hypot(*(prediction.goals - goal).T) < 1.0
        assert prediction.probabilities[near].sum() > 0.1
    assert len(prediction.alternatives) >= 1
    ends = [prediction.path[-1], *(way.path[-1] for way in prediction.alternatives)]
    assert len(ends) == 1 + len(prediction.alternatives)


def test_without_anything_learned_people_go_straight_on() -> None:
    partial = walk("right")[:15]
    prediction = IntentionModel().predict(partial, 4.0)
    check(prediction, partial, 4.0)
    assert prediction.novelty == 1.0
    np.testing.assert_allclose(prediction.path[-1, :2], partial[-1, :2] + [4.8, 0.0], atol=0.1)


def test_in_a_place_never_seen_they_go_straight_on_too() -> None:
    partial = walk("right")[:15] + np.array([40.0, 40.0, 0.0])
    prediction = taught().predict(partial, 4.0)
    assert prediction.novelty > 0.99
    np.testing.assert_allclose(prediction.path[-1, :2], partial[-1, :2] + [4.8, 0.0], atol=0.1)


def test_each_person_keeps_its_own_pace() -> None:
    model = taught()
    slow, fast = walk("right"), walk("right")
    slow[:, 2] *= 2.0
    fast[:, 2] *= 0.7
    lengths = []
    for rows in (slow, fast):
        path = model.predict(rows[:40], 1.5).path
        lengths.append(np.hypot(*(path[-1] - path[0])[:2]) / 1.5)
    assert lengths[0] == pytest.approx(0.6, abs=0.1)
    assert lengths[1] == pytest.approx(1.2 / 0.7, abs=0.25)


def test_people_make_way_for_each_other_and_for_walls() -> None:
    model = taught(people_strength=2.0, people_range=0.5)
    partial = walk("right")[:20]
    alone = model.predict(partial, 4.0)
    oncoming = partial.copy()
    oncoming[:, 0] = 9.0 - oncoming[:, 0]
    oncoming[:, 1] += 0.1
    both = model.predict(partial, 4.0, others=[oncoming])
    assert np.abs(both.path[:, 1] - alone.path[:, 1]).max() > 0.1
    together = model.predict_all([partial, oncoming], 4.0)
    np.testing.assert_allclose(together[0].path, both.path)
    state = np.array([[*oncoming[-1, :2], -1.2, 0.0]])
    assert np.abs(model.predict(partial, 4.0, others=state).path[:, 1] - alone.path[:, 1]).max() > 0.1


def test_paths_do_not_cross_walls() -> None:
    partial = walk("right")[:20]
    across = np.column_stack((np.full(80, 4.5), np.linspace(-2.0, 2.0, 80)))
    slanted = np.column_stack((np.linspace(3.0, 6.0, 80), np.linspace(-0.6, 1.2, 80)))
    for model in (taught(), IntentionModel()):
        path = model.predict(partial, 4.0, obstacles=across).path
        assert path[:, 0].max() < 4.5
        assert path[-1, 0] > 3.5
        path = model.predict(partial, 4.0, obstacles=slanted).path
        on_wall = np.interp(path[:, 0], slanted[:, 0], slanted[:, 1])
        assert (path[:, 1] > on_wall).all()


def test_people_last_seen_at_different_times_are_predicted_from_one_moment() -> None:
    model = IntentionModel()
    seen, hidden = walk("right")[:30], walk("right")[:12] + np.array([0.0, 3.0, 0.0])
    now, before = model.predict_all([seen, hidden], 3.0)
    assert now.path[0, 2] == before.path[0, 2] == pytest.approx(seen[-1, 2])
    np.testing.assert_allclose(before.path[0, :2], now.path[0, :2] + [0.0, 3.0], atol=0.05)
    assert np.trace(before.covariances[0]) > np.trace(now.covariances[0])


def test_the_same_input_gives_the_same_prediction() -> None:
    partial = walk("up")[:25]
    one, two = (taught().predict(partial, 5.0, others=[walk("right")[:20]]) for _ in range(2))
    np.testing.assert_array_equal(one.path, two.path)
    np.testing.assert_array_equal(one.probabilities, two.probabilities)


def test_old_walks_fade_when_people_change_their_ways() -> None:
    model = taught(count=10, routes=10)
    for k in range(10):
        model.learn(walk("up", np.random.default_rng(k)))
    prediction = model.predict(walk("up")[:15], 5.0)
    assert len(model.routes) == 10
    assert np.hypot(*(prediction.goals[0] - EXITS["up"])) < 0.72
    assert prediction.probabilities[0] > 0.8


@pytest.mark.parametrize("method", METHODS)
def test_what_was_learned_moves_with_the_map(method: str) -> None:
    from estimation.geometry.poses import compound

    model, moved, pose = taught(method), taught(method), np.array([3.0, -7.0, 2.1])
    moved.move(pose)
    partial = walk("up")[:40]
    elsewhere = partial.copy()
    for row in elsewhere:
        row[:2] = compound(pose, np.array([row[0], row[1], 0.0]))[:2]
    here, there = model.predict(partial, 5.0), moved.predict(elsewhere, 5.0)
    np.testing.assert_allclose(there.probabilities, here.probabilities, atol=1e-3)
    # Straight on ends at the axis-parallel border of what is known; the learned goals do not depend on axes.
    for goal, other in list(zip(here.goals, there.goals, strict=True))[:2]:
        np.testing.assert_allclose(compound(pose, np.array([*goal, 0.0]))[:2], other, atol=1e-3)
    with pytest.raises(InputError, match="pose"):
        model.move([1.0, 2.0])


# Bad input.


@pytest.mark.parametrize("method", METHODS)
def test_a_track_of_one_point_teaches_nothing_and_can_be_predicted(method: str) -> None:
    model = taught(method)
    before = model.learned
    outcome = model.learn([[1.0, 2.0, 3.0]])
    assert (outcome.taken, outcome.reason, model.learned) == (False, "one observation", before)
    partial = np.array([[0.1, 0.0, 5.0]])
    check(model.predict(partial, 3.0), partial, 3.0)
    check(IntentionModel().predict(partial, 3.0), partial, 3.0)


@pytest.mark.parametrize(
    "units",
    [(100.0, 100.0, 1.0), (1e3, 1e3, 1.0), (1.0, 1.0, 1e-3), (1.0, 1.0, 1e3), (1.0, 1.0, 1e9)],
    ids=["cm", "mm", "ks", "ms", "ns"],
)
def test_a_walk_in_other_units_teaches_nothing_and_says_so(units: tuple[float, float, float]) -> None:
    model = IntentionModel()
    outcome = model.learn(walk("up") * units)
    assert not outcome.taken
    assert "metres and seconds" in outcome.reason


def test_one_who_stands_teaches_nothing_and_stays() -> None:
    model = taught()
    rng = np.random.default_rng(0)
    standing = np.column_stack((rng.normal(3.0, 0.03, (300, 2)), np.arange(300) / 9.0))
    assert not model.learn(standing).taken
    path = model.predict(standing, 4.0).path
    assert np.hypot(*(path[:, :2] - standing[-1, :2]).T).max() < 0.4


@pytest.mark.parametrize("method", METHODS)
def test_jumps_duplicates_gaps_and_loops_are_survived_and_counted(method: str) -> None:
    model = IntentionModel(IntentionConfig(method=method))
    rows = np.repeat(walk("right"), 2, axis=0)  # every time twice
    rows[21, 2] = 0.0
    rows[40:42, :2] += 30.0  # away and back
    rows[30] = np.nan
    outcome = model.learn(rows)
    assert outcome.taken
    assert outcome.dropped["not finite"] == 1
    assert outcome.dropped["duplicate time"] > 30
    assert outcome.dropped["jump away and back"] == 1
    far = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [1e30, 0.0, 2.0], [1e30, 1.0, 3.0]])
    assert "gap" in model.learn(far).reason
    gap = walk("up")
    assert model.learn(np.concatenate((gap[:10], gap[-10:]))).taken
    angle = np.linspace(0, 4 * np.pi, 200)
    loop = np.column_stack((3 * np.cos(angle), 3 * np.sin(angle), np.arange(200) / 9.0))
    assert model.learn(loop).taken
    teleport = walk("right")
    teleport[20:, :2] += 25.0
    assert model.learn(teleport).taken
    for partial in (rows[:60], gap[:12], loop[:100], teleport[:25], gap[[0, -1]]):
        kept = clean("partial", partial).rows
        check(model.predict(partial, 5.0), kept, 5.0)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda m: m.learn(np.zeros((4, 2))), "trajectory"),
        (lambda m: m.learn(np.full((4, 3), np.nan)), "trajectory"),
        (lambda m: m.learn("nonsense"), "trajectory"),
        (lambda m: m.predict(np.zeros(3), 1.0), "partial"),
        (lambda m: m.predict(walk("up"), 0.0), "horizon"),
        (lambda m: m.predict(walk("up"), float("nan")), "horizon"),
        (lambda m: m.predict(walk("up"), 5e6), "horizon"),
        (lambda m: m.predict(walk("up"), 1.0, others=np.zeros((2, 3))), "others"),
        (lambda m: m.predict(walk("up"), 1.0, others=[np.zeros((2, 2))]), r"others\[0\]"),
        (lambda m: m.predict(walk("up"), 1.0, obstacles=np.zeros((2, 3))), "obstacles"),
        (lambda m: IntentionConfig(method="oracle"), "method"),
        (lambda m: IntentionConfig(resolution=-1.0), "resolution"),
        (lambda m: IntentionModel({}), "config"),
    ],
)
def test_wrong_arguments_are_named(call: object, named: str) -> None:
    with pytest.raises(InputError, match=named):
        call(taught())  # type: ignore[operator]


# Storage.


@pytest.mark.parametrize("method", METHODS)
def test_what_was_learned_is_saved_and_goes_on(method: str, tmp_path: Path) -> None:
    model = taught(method)
    path = model.save(tmp_path / "hall.npz", map_id="hall")
    again = IntentionModel.load(path, map_id="hall")
    assert again.learned == model.learned
    assert again.config == model.config
    partial = walk("up")[:30]
    np.testing.assert_allclose(again.predict(partial, 5.0).path, model.predict(partial, 5.0).path)
    for continued in (model, again):
        continued.learn(walk("up"))
    np.testing.assert_allclose(
        again.predict(partial, 5.0).probabilities, model.predict(partial, 5.0).probabilities
    )
    assert [item.name for item in tmp_path.iterdir()] == ["hall.npz"]


def test_a_model_of_another_map_or_version_is_refused(tmp_path: Path) -> None:
    path = taught().save(tmp_path / "hall.npz", map_id="hall")
    with pytest.raises(InputError, match=r"'hall', not 'office'"):
        IntentionModel.load(path, map_id="office")
    with np.load(path) as content:
        arrays = dict(content)
    header = json.loads(str(arrays["header"]))
    for change, expected in (({"version": 99}, "version 99"), ({"format": "something"}, "something")):
        arrays["header"] = np.array(json.dumps(header | change))
        other = tmp_path / "other.npz"
        np.savez(other, **arrays)
        with pytest.raises(InputError, match=expected):
            IntentionModel.load(other)


def test_damaged_and_missing_files_are_named(tmp_path: Path) -> None:
    path = taught().save(tmp_path / "hall.npz")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    for bad in (path, tmp_path / "absent.npz"):
        with pytest.raises(InputError, match=bad.name):
            IntentionModel.load(bad)
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(InputError, match=r"text\.npz"):
        IntentionModel.load(tmp_path / "text.npz")
    with pytest.raises(InputError, match="nowhere"):
        taught().save(tmp_path / "nowhere" / "hall.npz")


# Observations.


def test_spacing_keeps_ends_and_filling_closes_gaps() -> None:
    line = np.column_stack((np.linspace(0, 10, 1001), np.zeros(1001)))
    thin = spaced(line, 0.25)
    assert thin[0, 0] == 0.0
    assert thin[-1, 0] == 10.0
    assert np.diff(thin[:-1, 0]).min() >= 0.25 - 1e-9
    full = filled(line[[0, 500, 1000]], 0.5)
    assert np.diff(full[:, 0]).max() <= 0.5 + 1e-9

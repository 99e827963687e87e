"""The model's contract: time, verification, bad input, restart, movers."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldState
from world_model.memory.store import Store

REGION = ((-3.0, 3.0), (-3.0, 3.0), (0.0, 2.0))
SENSOR = {"pose": (-4.0, 0.0, 1.0, 0.0), "range": 20.0, "angle": 2.0 * np.pi}
CUP = {"class": {"cup": 0.9, "bowl": 0.1}, "color": {"red": 0.8, "blue": 0.2}}


def config(**more: Any) -> WorldModelConfig:
    return WorldModelConfig(classes=("cup", "bowl"), colors=("red", "blue"), region=REGION, **more)


def evidence(*positions: Any, sigma: float = 0.03, sensor: Any = SENSOR) -> WorldEvidence:
    return WorldEvidence([ObjectEvidence(p, sigma**2 * np.eye(3), CUP) for p in positions], sensor)


def watched(looks: int = 20, *positions: Any, **more: Any) -> tuple[WorldModel, WorldState]:
    model = WorldModel(config(**more))
    for k in range(looks):
        state = model.update(evidence(*(positions or [(0.0, 0.0, 1.0)])), 0.05 * k)
    return model, state


def test_objects_have_symbols_and_distributions() -> None:
    _, state = watched(20, (0.0, 0.0, 1.0), (1.0, 0.0, 1.0))
    assert [item.id for item in state.objects] == ["cup-1", "cup-2"]
    for item in state.objects:
        assert item.attributes["class"]["cup"] > 0.99
        assert sum(item.attributes["color"].values()) == pytest.approx(1.0)
        assert item.existence > 0.99
        assert not item.lost
        assert item.last_seen == pytest.approx(0.95)
        assert np.linalg.eigvalsh(item.covariance).min() > 0.0
        # Twenty detections of 3 cm.
        assert item.covariance[0, 0] == pytest.approx(0.03**2 / 20, rel=0.2)
    assert state.associations == ("cup-1", "cup-2")


def test_hypotheses_are_normalised_and_the_first_is_the_state() -> None:
    model = WorldModel(config(detection_probability=0.6))
    rng = np.random.default_rng(0)
    for k in range(30):
        spots = [p for p in ((0.0, 0.0, 1.0), (0.1, 0.0, 1.0)) if rng.random() < 0.6]
        state = model.update(evidence(*[p + rng.normal(0, 0.05, 3) for p in spots], sigma=0.05), 0.05 * k)
        worlds = model.hypotheses()
        assert sum(world.probability for world in worlds) == pytest.approx(1.0)
        assert [w.probability for w in worlds] == sorted((w.probability for w in worlds), reverse=True)
        assert worlds[0].probability == pytest.approx(state.probability)
        assert [item.id for item in worlds[0].objects] == [item.id for item in state.objects]
        assert len(worlds) <= 100


def test_late_evidence_counts_and_its_absences_do_not() -> None:
    model, state = watched()
    late = model.update(evidence((0.0, 0.0, 1.0)), state.stamp - 0.5)
    assert late.stamp == state.stamp
    assert late.epoch == 0
    assert late.objects[0].covariance[0, 0] < state.objects[0].covariance[0, 0]
    for k in range(50):
        late = model.update(evidence(), state.stamp - 0.5 - 0.001 * k)
    assert [item.id for item in late.objects] == ["cup-1"]


def test_late_detection_of_a_mover_is_put_where_it_was() -> None:
    model = WorldModel(config(motion={"*": {"model": "constant_velocity", "accel_sigma": 0.1}}))
    for k in range(40):
        state = model.update(evidence((0.05 * k - 1.0, 0.0, 1.0)), 0.05 * k)
    assert state.objects[0].velocity[0] == pytest.approx(1.0, abs=0.05)
    late = model.update(evidence((0.05 * 33 - 1.0, 0.0, 1.0)), 0.05 * 33)
    assert len(late.objects) == 1
    assert late.associations == (state.objects[0].id,)
    assert late.objects[0].position[0] == pytest.approx(state.objects[0].position[0], abs=0.02)


def test_a_detector_that_is_always_late_is_believed_in_what_it_sees_and_misses() -> None:
    model = WorldModel(config(late_window=10.0))
    seen = evidence((0.0, 0.0, 1.0))
    for k in range(400):
        # Another source has told the time, and says nothing about the cup.
        model.update(WorldEvidence([], SENSOR, blocked=True), 100.0 + 0.1 * k)
        state = model.update(seen if k < 100 else evidence(), 100.0 + 0.1 * k - 1.3)
        if k == 99:
            assert [item.id for item in state.objects] == ["cup-1"]
            assert state.objects[0].existence > 0.9
    assert state.epoch == 0
    assert not state.objects or state.objects[0].existence < 0.1


def test_what_rests_outlives_a_new_run_and_is_less_certain(tmp_path: Path) -> None:
    model, before = watched(60)
    model.store = Store(tmp_path / "world.sqlite")
    model.update(evidence((0.0, 0.0, 1.0)), before.stamp + 0.05)
    model.next_run()
    after = model.update(WorldEvidence([], None), 1.0)
    assert (after.epoch, after.stamp) == (before.epoch + 1, 1.0)
    [cup], [known] = after.objects, before.objects
    assert (cup.id, cup.most_probable("class")) == (known.id, known.most_probable("class"))
    assert cup.existence < known.existence
    assert cup.last_seen < 1.0
    assert cup.first_seen <= cup.last_seen
    assert model.of_earlier_runs == 1
    # A restart finds it as well.
    model.store.close()
    again = WorldModel(config(), None, tmp_path / "world.sqlite")
    assert [item.id for item in again.propagate(again.stamp).objects] == ["cup-1"]
    # It is seen again, and something else is new.
    for k in range(20):
        after = model.update(evidence((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)), 1.1 + 0.05 * k)
    assert [item.id for item in after.objects] == ["cup-1", "cup-2"]
    assert model.of_earlier_runs == 0
    assert after.objects[0].existence > 0.99


def test_older_stamp_starts_a_new_epoch() -> None:
    model, state = watched(60)
    again = model.update(evidence((1.0, 1.0, 1.0)), 0.0)
    assert again.epoch == state.epoch + 1
    assert again.stamp == 0.0
    assert len(again.objects) == 1
    np.testing.assert_allclose(again.objects[0].position, [1.0, 1.0, 1.0])


def test_propagation_moves_movers_and_leaves_the_model_alone() -> None:
    model = WorldModel(config(motion={"*": {"model": "constant_velocity", "accel_sigma": 0.1}}))
    for k in range(40):
        state = model.update(evidence((0.05 * k - 1.0, 0.0, 1.0)), 0.05 * k)
    ahead = model.propagate(state.stamp + 0.5)
    assert ahead.stamp == pytest.approx(state.stamp + 0.5)
    assert ahead.objects[0].position[0] == pytest.approx(state.objects[0].position[0] + 0.5, abs=0.05)
    assert ahead.objects[0].covariance[0, 0] > state.objects[0].covariance[0, 0]
    np.testing.assert_array_equal(model.propagate(state.stamp).objects[0].position, state.objects[0].position)


def test_static_objects_do_not_drift() -> None:
    model, state = watched()
    later = model.propagate(state.stamp + 3600.0)
    np.testing.assert_array_equal(later.objects[0].position, state.objects[0].position)


def test_known_place_is_not_blurred_by_what_may_have_happened_meanwhile() -> None:
    motion = {"*": {"model": "static", "moved_per_second": 1e-3}}
    model, _ = watched(20, rate_hz=2.0, motion=motion)
    # Out of sight for minutes, it may have been carried; seen again, it was not.
    for k in range(60):
        t = 300.0 + 0.5 * k
        offset = 0.03 * (-1) ** k
        state = model.update(evidence((offset, 0.05, 1.0), sigma=0.05), t)
        [item] = state.objects
        assert item.id == "cup-1"
        assert np.sqrt(item.covariance.diagonal().max()) < 0.05
    # Hidden in view for a while, with many looks that say nothing, neither.
    for k in range(200):
        state = model.update(WorldEvidence([], SENSOR, blocked=True), 330.0 + 0.5 * k)
    assert np.sqrt(state.objects[0].covariance.diagonal().max()) < 0.1


def test_verification_names_its_object() -> None:
    model, state = watched(20, (0.0, 0.0, 1.0), (0.2, 0.0, 1.0))
    first, second = state.objects
    # Nearer to the second, but said to be the first.
    named = WorldEvidence([ObjectEvidence((0.19, 0.0, 1.0), 1e-4 * np.eye(3), CUP, first.id)], None)
    after = model.update(named, state.stamp + 0.05)
    assert after.associations == (first.id,)
    moved, stayed = after.find(first.id), after.find(second.id)
    assert moved is not None
    assert stayed is not None
    assert moved.position[0] > 0.15
    np.testing.assert_allclose(stayed.position, second.position)


def test_failed_verification_makes_an_object_lost_and_finding_it_ends_that() -> None:
    model, state = watched()
    name = state.objects[0].id
    assert model.report(name, "occluded", state.stamp).objects[0].lost is False
    lost = model.report(name, "not_found", state.stamp).objects[0]
    assert lost.lost
    assert lost.id == name
    assert lost.covariance[0, 0] == pytest.approx(6.0**2 / 12.0)
    found = WorldEvidence([ObjectEvidence((1.0, 1.0, 1.0), 1e-4 * np.eye(3), CUP, name)], None)
    back = model.update(found, state.stamp + 1.0).objects[0]
    assert not back.lost
    np.testing.assert_allclose(back.position, [1.0, 1.0, 1.0], atol=0.01)
    with pytest.raises(InputError, match="nothing-7"):
        model.report("nothing-7", "found", state.stamp)
    with pytest.raises(InputError, match="outcome"):
        model.report(name, "perhaps", state.stamp)


def test_lost_object_is_recognised_elsewhere() -> None:
    model, state = watched(60)
    name = state.objects[0].id
    model.report(name, "not_found", state.stamp)
    for k in range(20):
        after = model.update(evidence((1.5, 1.0, 1.0)), state.stamp + 0.05 * (k + 1))
    assert [item.id for item in after.objects] == [name]
    assert not after.objects[0].lost


def test_forget_relabel_restore_and_reset() -> None:
    model, state = watched(20, (0.0, 0.0, 1.0), (1.0, 0.0, 1.0))
    model.relabel("cup-1", class_name="bowl", new_object_id="sugar-bowl")
    renamed = model.propagate(state.stamp)
    assert [item.id for item in renamed.objects] == ["sugar-bowl", "cup-2"]
    assert renamed.objects[0].most_probable("class") == "bowl"
    with pytest.raises(InputError, match="cup-2"):
        model.relabel("sugar-bowl", new_object_id="cup-2")
    with pytest.raises(InputError, match="spoon"):
        model.relabel("cup-2", class_name="spoon")
    model.forget("cup-2")
    left = model.propagate(state.stamp)
    assert [item.id for item in left.objects] == ["sugar-bowl"]
    other = WorldModel(config())
    other.restore(list(state.objects), state.stamp, epoch=3)
    after = other.update(evidence((0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (2.0, 0.0, 1.0)), state.stamp + 0.05)
    after = other.update(evidence((0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (2.0, 0.0, 1.0)), state.stamp + 0.1)
    assert [item.id for item in after.objects] == ["cup-1", "cup-2", "cup-3"]
    assert after.epoch == 3
    model.reset()
    assert model.update(evidence(), 100.0).objects == ()


BAD = {
    "sum": ObjectEvidence((0, 0, 0), np.eye(3), {"class": {"cup": 0.7, "bowl": 0.7}}),
    "negative": ObjectEvidence((0, 0, 0), np.eye(3), {"class": {"cup": 1.3, "bowl": -0.3}}),
    "class": ObjectEvidence((0, 0, 0), np.eye(3), {"class": {"spoon": 1.0}}),
    "attribute": ObjectEvidence((0, 0, 0), np.eye(3), {"taste": {"sweet": 1.0}}),
    "indefinite": ObjectEvidence((0, 0, 0), np.diag([1.0, 1.0, -1.0])),
    "asymmetric": ObjectEvidence((0, 0, 0), [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]),
    "shape": ObjectEvidence((0, 0), np.eye(3)),
    "nan": ObjectEvidence((0, np.nan, 0), np.eye(3)),
    "type": ObjectEvidence("here", np.eye(3)),
    "covariance that is none": ObjectEvidence((0, 0, 0), np.full((3, 3), np.nan)),
    "no attributes": ObjectEvidence((0, 0, 0), np.eye(3), None),  # type: ignore[arg-type]
    "no quantities": ObjectEvidence((0, 0, 0), np.eye(3), quantities=None),  # type: ignore[arg-type]
    "id": ObjectEvidence((0, 0, 0), np.eye(3), object_id=7),  # type: ignore[arg-type]
    "begins": ObjectEvidence((0, 0, 0), np.eye(3), begins="no"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_evidence_is_refused_and_changes_nothing(kind: str) -> None:
    model, state = watched()
    with pytest.raises(InputError, match=r"objects\[1\]|covariance"):
        model.update(WorldEvidence([*evidence((2.0, 2.0, 1.0)).objects, BAD[kind]], SENSOR), 1.0)
    after = model.propagate(state.stamp)
    assert [item.id for item in after.objects] == ["cup-1"]
    np.testing.assert_array_equal(after.objects[0].position, state.objects[0].position)
    assert model.stamp == state.stamp


def test_detections_in_unknown_words_can_be_left_out() -> None:
    model, _ = watched()
    given = WorldEvidence(
        [BAD["class"], *evidence((0.0, 0.0, 1.0)).objects, BAD["attribute"]], SENSOR, blocked=False
    )
    kept, refused = model.usable(given)
    assert sorted(refused) == [0, 2]
    assert "objects[0].attributes['class']: unknown value 'spoon'" in refused[0]
    assert "unknown attribute 'taste'" in refused[2]
    state = model.update(kept, 1.0)
    assert state.associations == ("cup-1",)
    assert kept.sensor == SENSOR
    good = evidence((0.0, 0.0, 1.0))
    assert model.usable(good) == (good, {})


def test_detections_in_another_unit_are_far_from_the_region_and_a_tight_region_is_no_matter() -> None:
    region = np.array(REGION, dtype=float)
    middle, beside = region.mean(axis=1), region[:, 1] + 0.5
    spots = [middle, beside, 1000.0 * np.ones(3)]
    found = WorldModel(config()).outside(WorldEvidence([ObjectEvidence(spot) for spot in spots]))
    np.testing.assert_array_equal(found, [1000.0 * np.ones(3)])


@pytest.mark.parametrize("given", [{"config": {"classes": ["cup"]}}, {"places": "home.yaml"}])
def test_settings_of_another_kind_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(given))):
        WorldModel(**given)


@pytest.mark.parametrize(
    "sensor",
    [
        {"pose": (0, 0, 0), "range": 1, "angle": 1},
        {"range": 1, "angle": 1},
        {"pose": (0, 0, 0, 0), "range": -1, "angle": 1},
        {"pose": (0, 0, 0, 0), "range": 1, "angle": 7.0},
        {"pose": (0, 0, 0, np.nan), "range": 1, "angle": 1},
        {"pose": (0, 0, 0, 0), "range": 1, "angle": 1, "fov": 1},
    ],
)
def test_bad_sensor_is_refused(sensor: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="sensor"):
        WorldModel(config()).update(WorldEvidence([], sensor), 0.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("detection_probability", 1.5),
        ("clutter_per_frame", -1.0),
        ("hypotheses", 0),
        ("region", ((0, 1), (0, 1))),
        ("region", ((1, 0), (0, 1), (0, 1))),
        ("motion", {"*": {"model": "flying"}}),
        ("motion", {"*": {"acceleration": 1.0}}),
        ("motion", {"spoon": {"model": "static"}}),
        ("classes", "cup"),
        ("classes", None),
        ("quantities", None),
        ("learn_sensor_bias", "false"),
        ("classes", ("cup", "cup")),
        ("rate_hz", "fast"),
    ],
)
def test_bad_settings_name_the_field(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=name):
        WorldModelConfig(**{"classes": ("cup",), name: value})


def test_stamps_must_be_numbers() -> None:
    model = WorldModel(config())
    with pytest.raises(InputError, match="stamp"):
        model.update(evidence(), float("nan"))


@pytest.mark.parametrize("stamp", [np.nan, np.inf, "now", None, True, 1.7e12])
def test_a_stamp_that_is_none_changes_nothing(stamp: Any) -> None:
    model, state = watched()
    for call in (
        lambda: model.update(evidence(), stamp),
        lambda: model.propagate(stamp),
        lambda: model.report("cup-1", "not_found", stamp),
        lambda: model.seen_through((0, 0, 0), [(1, 1, 1)], stamp),
        lambda: model.restore((), stamp),
    ):
        with pytest.raises(InputError, match="stamp"):
            call()
    assert model.stamp == state.stamp
    assert [item.id for item in model.hypotheses()[0].objects] == ["cup-1"]


def test_a_store_of_a_run_that_has_seen_nothing_is_opened_again(tmp_path: Path) -> None:
    model = WorldModel(config(), store=tmp_path / "world.sqlite")
    model.update(evidence((0.0, 0.0, 1.0)), 1.0)
    model.reset()
    model.close()
    again = WorldModel(config(), store=tmp_path / "world.sqlite")
    assert again.update(evidence((0.0, 0.0, 1.0)), 2.0).stamp == 2.0
    again.close()


def test_names_must_be_words() -> None:
    model, _ = watched()
    for call in (
        lambda: model.report(3, "found", 1.0),  # type: ignore[arg-type]
        lambda: model.relabel("cup-1", new_object_id=3),  # type: ignore[arg-type]
        lambda: model.relabel("cup-1", class_name=["bowl"]),  # type: ignore[arg-type]
        lambda: model.query(class_name=3),
        lambda: model.query(predicate=3),
    ):
        with pytest.raises(InputError, match="must be"):
            call()


def test_what_was_told_is_no_handle_on_the_model() -> None:
    _, state = watched()
    with pytest.raises(ValueError, match="read-only"):
        state.objects[0].position[:] = 9.0


def test_copies_go_on_by_themselves() -> None:
    model, _ = watched()
    for other in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        assert other._by_now.where.__self__ is other
        other.update(evidence((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)), 2.0)
        assert model.stamp < 2.0


def test_unknown_names_are_taken_as_they_come_where_none_are_listed() -> None:
    model = WorldModel(WorldModelConfig(region=REGION))
    for k, kind in enumerate(["cup", "cup", "fork", "cup", "cup", "cup"]):
        given = ObjectEvidence((0.0, 0.0, 1.0), 1e-3 * np.eye(3), {"class": {kind: 1.0}})
        state = model.update(WorldEvidence([given], SENSOR), 0.1 * k)
    assert [item.most_probable("class") for item in state.objects] == ["cup"]
    assert set(state.objects[0].attributes["class"]) == {"cup", "fork"}


def test_leaves_are_given_back() -> None:
    model = WorldModel(config(detection_probability=0.6, clutter_per_frame=3.0))
    rng = np.random.default_rng(0)
    spots = rng.uniform([-1, -1, 0.5], [1, 1, 1.5], (10, 3))
    for k in range(300):
        seen = [p + rng.normal(0, 0.03, 3) for p in spots if rng.random() < 0.6]
        seen += list(rng.uniform([-3, -3, 0], [3, 3, 2], (rng.poisson(3), 3)))
        model.update(evidence(*seen), 0.05 * k)
        anchors = model._anchors
        used = np.concatenate([cluster.rows.ravel() for cluster in anchors.clusters.values()])
        assert set(used[used >= 0].tolist()) == set(np.flatnonzero(anchors.pool.leaves.track >= 0).tolist())
        tracks = [number for cluster in anchors.clusters.values() for number in cluster.tracks]
        assert sorted(tracks) == sorted(anchors.tracks)
        for cluster in anchors.clusters.values():
            assert np.exp(cluster.weights).sum() == pytest.approx(1.0)


def test_a_color_that_was_never_measured_is_not_the_only_one_anybody_has() -> None:
    """With an open list of colors: nothing is told of it until it is measured, and then that at once."""
    model = WorldModel(WorldModelConfig(classes=("cup",), region=REGION))
    spots = [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (2.0, 0.0, 1.0)]

    def look(stamp: float, *colors: str) -> list[dict[str, float] | None]:
        told = [{"class": {"cup": 1.0}} | ({"color": {color: 1.0}} if color else {}) for color in colors]
        objects = [ObjectEvidence(p, 1e-4 * np.eye(3), each) for p, each in zip(spots, told, strict=False)]
        state = model.update(WorldEvidence(objects, SENSOR), stamp)
        return [item.attributes.get("color") for item in state.objects]

    for k in range(10):
        told = look(0.1 * k, "red", "")
    red, plain = told
    assert red is not None
    assert red["red"] > 0.99
    assert plain is None
    for k in range(10, 20):
        told = look(0.1 * k, "red", "", "blue")
    _, plain, blue = told
    assert plain is None
    assert blue is not None
    assert blue["blue"] > 0.99
    # Two of a detector that is right in nine of ten cases.
    look(2.0, "red", "green", "blue")
    _, green, _ = look(2.1, "red", "green", "blue")
    assert green is not None
    assert green["green"] > 0.9

"""What goes into anchoring from outside: behaviours of a class, and what is known of the sensor's errors."""

from __future__ import annotations

import numpy as np
import pytest

from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldObject

REGION = ((-5.0, 5.0), (-5.0, 5.0), (0.0, 2.0))
SIGMA = 0.02


class Belt:
    """A conveyor along x, then along y from a stamp on, at 0.5 m/s."""

    end = np.inf
    turn = 2.0

    def place(self, stamp: float) -> np.ndarray:
        return 0.5 * np.array([min(stamp, self.turn), max(stamp - self.turn, 0.0), 0.0])

    def step(self, begin: float, stamp: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        velocity = np.array([0.5, 0.0, 0.0] if stamp < self.turn else [0.0, 0.5, 0.0])
        return self.place(stamp) - self.place(begin), 1e-4 * (stamp - begin) * np.eye(3), velocity


def parcels(behaviors: dict | None) -> WorldModel:
    config = WorldModelConfig(
        classes=("parcel", "cup"),
        region=REGION,
        measurement_sigma=SIGMA,
        motion={"*": {}, "parcel": {"model": "constant_velocity", "follows_prediction": 0.95}},
    )
    model = WorldModel(config, behaviors=behaviors)
    rng, belt = np.random.default_rng(0), Belt()
    for k in range(40):
        spot = belt.place(0.05 * k) + np.array([0.0, 0.0, 1.0]) + rng.normal(0.0, SIGMA, 3)
        model.update(WorldEvidence([ObjectEvidence(spot, attributes={"class": {"parcel": 1.0}})]), 0.05 * k)
    return model


@pytest.mark.parametrize("known", [True, False])
def test_a_class_goes_on_as_its_behaviour_says(known: bool) -> None:
    asked: list[str] = []

    def on_belt(item: WorldObject, stamp: float) -> Belt:
        asked.append(item.id)
        return Belt()

    model = parcels({"parcel": on_belt, "cup": lambda item, stamp: 1 / 0} if known else None)
    parcel = model.propagate(4.0).find("parcel-1")
    assert parcel is not None
    # Without it the parcel goes straight on, off the belt.
    expected = Belt().place(4.0) if known else np.array([2.0, 0.0, 0.0])
    assert np.linalg.norm(parcel.position[:2] - expected[:2]) < (0.1 if known else 0.4)
    assert asked == (["parcel-1"] if known else [])


def drive(config: WorldModelConfig, errors: tuple[float, float], looks: int, named: int = -1) -> WorldModel:
    """A sensor that moves in a circle among six things, with an offset and a scale in range."""
    model = WorldModel(config)
    rng = np.random.default_rng(1)
    spots = np.array([[2.5, 0], [0, 2.5], [-2.5, 0], [0, -2.5], [2, 2], [-2, -2]])
    for k in range(looks):
        pose = np.array([1.5 * np.sin(0.02 * k), 1.5 * np.cos(0.02 * k), 1.0, 0.0])
        off = spots - pose[:2]
        distance = np.hypot(*off.T)[:, None]
        seen = spots + off / distance * (errors[0] + errors[1] * distance) + rng.normal(0, SIGMA, (6, 2))
        given = [ObjectEvidence(np.append(p, 1.0), SIGMA**2 * np.eye(3)) for p in seen]
        if k == named:
            given[0].object_id = model.hypotheses()[0].objects[0].id
        sensor = {"pose": pose, "range": 8.0, "angle": 2.0 * np.pi}
        model.update(WorldEvidence(given, sensor), 0.1 * k)
    return model


def test_stated_errors_are_taken_off() -> None:
    config = WorldModelConfig(
        region=REGION, learn_sensor_bias=False, sensor_bias=(0.1, 0.05, 0.0, 0.0), clutter_per_frame=0.01
    )
    model = drive(config, (0.1, 0.05), 30)
    objects = model.hypotheses()[0].objects
    spots = np.array([[2.5, 0], [0, 2.5], [-2.5, 0], [0, -2.5], [2, 2], [-2, -2]])
    # To first order: the error is taken off where the thing is said to be.
    for item in objects:
        assert np.linalg.norm(spots - item.position[:2], axis=1).min() < 0.04
    assert len(objects) == 6
    assert model.sensor_bias[:2] == (0.1, 0.05)
    assert model.look_back() == []


def test_stated_delay_is_taken_off_without_learning() -> None:
    """What a sensor at 1 m/s says half a second late is half a metre off."""
    delay = (0.0,) * 7 + (0.5,)
    config = WorldModelConfig(
        region=REGION, learn_sensor_bias=False, sensor_bias=delay, clutter_per_frame=0.01
    )
    model = WorldModel(config)
    for k in range(20):
        sensor = {"pose": (-4.0 + 0.2 * k, 0.0, 1.0, 0.0), "range": 8.0, "angle": 2.0 * np.pi}
        seen = [ObjectEvidence((1.5, 1.0, 1.0), SIGMA**2 * np.eye(3))] if k > 2 else []
        state = model.update(WorldEvidence(seen, sensor), 0.2 * k)
    (item,) = state.objects
    assert item.position[:2] == pytest.approx((1.0, 1.0), abs=0.01)


def test_what_is_named_while_errors_are_learned_is_taken_in() -> None:
    """A look with a detection that was told to be of an object says nothing about the errors, and breaks nothing."""
    config = WorldModelConfig(region=REGION, clutter_per_frame=0.01)
    model = drive(config, (0.12, 0.06), 260, named=250)
    assert abs(model.sensor_bias[1]) > 0.01
    assert len(model.hypotheses()[0].objects) == 6

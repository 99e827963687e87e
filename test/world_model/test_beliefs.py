"""What the contract says of objects beyond where they are: other symbols for them, and how fast they grow uncertain."""

from __future__ import annotations

import numpy as np
import pytest

from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig

REGION = ((-3.0, 3.0), (-3.0, 3.0), (0.0, 2.0))
CUP = {"class": {"cup": 0.95, "bowl": 0.05}}


def look(
    *positions: tuple[float, float, float], view: tuple[float, float] = (0.0, 2.0 * np.pi)
) -> WorldEvidence:
    """What a sensor at the origin sees that looks towards view[0] rad, view[1] rad wide."""
    seen = [ObjectEvidence(p, 4e-4 * np.eye(3), CUP) for p in positions]
    return WorldEvidence(seen, {"pose": (0.0, 0.0, 1.0, view[0]), "range": 6.0, "angle": view[1]})


def test_other_hypotheses_give_other_symbols_to_an_object() -> None:
    motion = {"*": {"model": "static", "moved_per_second": 0.01}}
    config = WorldModelConfig(
        classes=("cup", "bowl"),
        region=REGION,
        motion=motion,
        new_objects_per_second=1e-3,
        initial_objects=0.5,
    )
    model = WorldModel(config)
    known = [(2.0, 0.5, 1.0), (2.0, -0.5, 1.0)]
    for k in range(40):
        state = model.update(look(*known), 0.05 * k)
    assert [item.alternatives for item in state.objects] == [(), ()]
    # Nobody looks for a while; then a cup is seen behind, where there was none, and the known ones are out of view.
    for k in range(6):
        state = model.update(look((-2.0, 0.0, 1.0), view=(np.pi, 1.0)), 22.0 + 0.05 * k)
    [item] = [item for item in state.objects if item.position[0] < 0.0]
    names = {item.id, *item.alternatives}
    assert len(model.hypotheses()) > 1
    assert {"cup-1", "cup-2"} <= names
    assert item.id not in item.alternatives
    # What another hypothesis calls it is what that hypothesis has there.
    there = {
        other.id
        for world in model.hypotheses()
        for other in world.objects
        if other.position[0] < 0.0 and world.probability > 0.01
    }
    assert there >= {"cup-1", "cup-2"}
    assert model.propagate(22.5).find(item.id).alternatives == item.alternatives  # type: ignore[union-attr]
    # Both known ones are where they were: it is a new one, and nobody calls it otherwise.
    for k in range(20):
        state = model.update(look(*known, (-2.0, 0.0, 1.0)), 23.0 + 0.05 * k)
    assert len(state.objects) == 3
    assert [item.alternatives for item in state.objects] == [(), (), ()]


def test_process_noise_is_what_the_covariance_grows_by() -> None:
    motion = {"*": {"model": "static"}, "bowl": {"model": "constant_velocity", "accel_sigma": 0.3}}
    model = WorldModel(WorldModelConfig(classes=("cup", "bowl"), region=REGION, motion=motion))
    bowl = {"class": {"cup": 0.02, "bowl": 0.98}}
    for k in range(40):
        mover = ObjectEvidence((0.05 * k - 1.0, 1.0, 1.0), 4e-4 * np.eye(3), bowl)
        state = model.update(WorldEvidence([*look((2.0, 0.0, 1.0)).objects, mover]), 0.05 * k)
    later = {item.id: item for item in model.propagate(state.stamp + 1.0).objects}
    assert sorted(later) == ["bowl-1", "cup-1"]
    for item in state.objects:
        grown = later[item.id].covariance - item.covariance
        np.testing.assert_allclose(item.process_noise, grown, rtol=1e-6, atol=1e-9)
    assert later["bowl-1"].process_noise[0, 0] > 0.01
    assert later["cup-1"].process_noise[0, 0] == pytest.approx(0.0)


def test_a_thing_that_nobody_looked_for_is_not_lost_by_the_time_that_passes() -> None:
    motion = {"*": {"model": "static", "moved_per_second": 1e-3}}
    config = WorldModelConfig(classes=("cup", "bowl"), region=REGION, motion=motion, removed_per_second=1e-9)
    model = WorldModel(config)
    edge, beside = (2.0, 0.5, 1.0), (1.9, 0.5, 1.0)
    for k in range(10):
        model.update(look(edge, beside), 0.05 * k)
    # Half an hour later a look reaches only to between the two: what lies behind its edge is as it was.
    near = {"pose": (0.0, 0.0, 1.0, 0.0), "range": 1.99, "angle": 2.0 * np.pi}
    for k in range(3):
        seen = [ObjectEvidence(beside, 4e-4 * np.eye(3), CUP)]
        state = model.update(WorldEvidence(seen, near), 1800.0 + 0.05 * k)
    assert [(item.id, item.lost) for item in state.objects] == [("cup-1", False), ("cup-2", False)]
    assert state.objects[0].behaviors["uniform"] > 0.5  # what the settings say of half an hour
    np.testing.assert_allclose(state.objects[0].position, edge, atol=0.05)
    # A look that covers it and does not find it says otherwise.
    for k in range(5):
        state = model.update(look(beside), 1801.0 + 0.05 * k)
    assert all(item.lost or item.position[0] < 1.95 for item in state.objects)

"""What stands behind an object of known size is not missed; what stands beside or before it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig

REGION = ((-3.0, 3.0), (-3.0, 3.0), (0.0, 2.0))
SENSOR: dict[str, Any] = {"pose": (-2.5, 0.0, 1.0, 0.0), "range": 6.0, "angle": 2.0}
BOX = ObjectEvidence(
    (0.0, 0.0, 1.0),
    4e-4 * np.eye(3),
    {"class": {"cup": 0.03, "box": 0.97}},
    quantities={"size": (0.6, 1e-4), "ratio": (1.0, 1e-3)},
)
"""About 35 cm wide and high."""


def cup(position: tuple[float, float, float]) -> ObjectEvidence:
    return ObjectEvidence(position, 4e-4 * np.eye(3), {"class": {"cup": 0.97, "box": 0.03}})


def existence_when_unseen(position: tuple[float, float, float], box: ObjectEvidence = BOX) -> float:
    """Of a cup that was seen from behind, after ten looks from the front that show a box only."""
    model = WorldModel(WorldModelConfig(classes=("cup", "box"), region=REGION))
    other_side = {**SENSOR, "pose": (2.9, 0.0, 1.0, np.pi)}
    for k in range(20):
        model.update(WorldEvidence([cup(position), box], other_side), 0.05 * k)
    for k in range(20, 40):
        state = model.update(WorldEvidence([box], SENSOR), 0.05 * k)
    found = [item.existence for item in state.objects if item.most_probable("class") == "cup"]
    return found[0] if found else 0.0


@pytest.mark.parametrize("position", [(0.8, 0.0, 1.0), (0.5, 0.05, 0.95), (2.0, 0.1, 1.1)])
def test_what_is_behind_it_keeps_its_existence(position: tuple[float, float, float]) -> None:
    assert existence_when_unseen(position) > 0.98


@pytest.mark.parametrize(
    "position", [(0.8, 0.6, 1.0), (-0.8, 0.0, 1.0), (0.8, 0.0, 1.6)], ids=["beside", "before", "above"]
)
def test_what_would_be_seen_does_not(position: tuple[float, float, float]) -> None:
    assert existence_when_unseen(position) < 0.1


def test_a_box_of_unknown_size_hides_nothing() -> None:
    plain = ObjectEvidence(BOX.position, BOX.covariance, BOX.attributes)
    assert existence_when_unseen((0.8, 0.0, 1.0), plain) < 0.1


def believed_beside(apart: float, size: float) -> float:
    """Expected number of others after a mover was detected twenty times, and once something beside its middle."""
    model = WorldModel(
        WorldModelConfig(
            region=REGION, motion={"*": {"model": "constant_velocity"}}, quantities={"size": (size, 0.1)}
        )
    )
    told = {"size": (size, 1e-4)}
    for k in range(20):
        seen = [ObjectEvidence((0.0, 0.0, 1.0), 1e-4 * np.eye(3), quantities=told)]
        if k == 19:
            seen.append(ObjectEvidence((apart, 0.0, 1.0), 1e-4 * np.eye(3)))
        state = model.update(WorldEvidence(seen, {**SENSOR, "angle": 6.2}), 0.05 * k)
    return state.expected_count - 1.0


def test_two_things_are_not_in_the_same_place() -> None:
    outside = believed_beside(1.2, size=1.5)
    assert believed_beside(0.15, size=0.05) == pytest.approx(outside, rel=0.2)
    assert believed_beside(0.15, size=1.5) < 0.1 * outside

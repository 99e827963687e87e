"""A measurement that names an object and says next to nothing about where it is."""

from __future__ import annotations

import numpy as np
import pytest

from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig


def person(x: float, variance: float, object_id: str | None = None) -> WorldEvidence:
    kinds = {"class": {"person": 1.0}}
    return WorldEvidence(
        [ObjectEvidence(np.array([x, 0.0, 0.9]), variance * np.eye(3), kinds, object_id)], blocked=True
    )


@pytest.mark.parametrize("variance", [1.0, 1e8])
@pytest.mark.parametrize("later", [0.1, 1e5])
def test_it_is_survived_and_the_next_ones_count(variance: float, later: float) -> None:
    motion = {"person": {"model": "constant_velocity", "accel_sigma": 0.5}}
    model = WorldModel(WorldModelConfig(classes=["person", "cup"], motion=motion))
    for k in range(20):
        state = model.update(person(0.1 * k, 0.01), 0.1 * k)
    known = max(state.objects, key=lambda item: item.existence)
    for k in range(4):
        model.update(person(2.0, variance, known.id), 2.0 + later + 0.1 * k)
    for k in range(30):
        state = model.update(person(2.0 + 0.1 * k, 0.01), 2.5 + later + 0.1 * k)
    assert max(item.existence for item in state.objects) > 0.9

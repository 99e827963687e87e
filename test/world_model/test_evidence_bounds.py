"""Evidence of recorded messages, which no node has looked at before."""

from __future__ import annotations

from types import SimpleNamespace as Fields
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from whereabouts.recorded.evidence_messages import Reader, SeenFrame
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig


def detections(
    size: tuple[float, float, float],
    x: float = 1.0,
    score: float = 0.9,
    name: str = "cup",
    variances: tuple[float, ...] = (0.01,) * 6,
) -> Any:
    """A Detection3DArray of one cup, by its fields."""
    place = Fields(x=x, y=0.0, z=0.5)
    covariance = np.diag(variances).ravel()
    hypothesis = Fields(class_id=name, score=score)
    pose = Fields(pose=Fields(position=place), covariance=covariance)
    box = Fields(center=Fields(position=place), size=Fields(**dict(zip("xyz", size, strict=True))))
    result = Fields(hypothesis=hypothesis, pose=pose)
    return Fields(detections=[Fields(results=[result, result], bbox=box)])


READER = Reader({"class": ["cup", "bowl"]}, ("class",), 0.1, quantities=("size", "ratio"))


@pytest.mark.parametrize("size", [(1e200, 0.1, 0.1), (0.1, float("nan"), 0.1), (0.1, 0.1, 1e7)])
def test_extents_that_nothing_has_are_refused(size: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match=r"detections\[0\]"):
        READER.detections(detections(size), SeenFrame())


def test_an_extent_too_small_to_be_measured_has_no_ratio() -> None:
    (found,) = READER.detections(detections((5e-324, 5e-324, 0.1)), SeenFrame()).objects
    assert set(found.quantities) == {"size"}


@pytest.mark.parametrize(("x", "score"), [(1e19, 0.9), (float("nan"), 0.9), (1.0, 1.7e308), (1.0, 87.0)])
def test_places_and_scores_beyond_counting_are_refused(x: float, score: float) -> None:
    with pytest.raises(InputError, match=r"detections\[0\]"):
        READER.detections(detections((0.1, 0.1, 0.1), x, score), SeenFrame())


def test_scores_that_nobody_filled_in_are_even_and_without_a_name_there_is_no_class() -> None:
    for score, name, words in ((0.0, "cup", {"class": {"cup": 1.0}}), (0.8, "", {})):
        (found,) = READER.detections(detections((0.1, 0.1, 0.1), score=score, name=name), SeenFrame()).objects
        assert found.attributes == words


def test_along_axes_without_a_variance_it_is_that_of_the_settings() -> None:
    for variances in ((0.0,) * 6, (-1.0,) * 6, (-1.0, *(0.0,) * 5)):
        (found,) = READER.detections(detections((0.1, 0.1, 0.1), variances=variances), SeenFrame()).objects
        np.testing.assert_allclose(found.covariance, 0.01 * np.eye(3))
    planar = detections((0.1, 0.1, 0.1), variances=(0.04, 0.04, *(0.0,) * 4))
    (found,) = READER.detections(planar, SeenFrame()).objects
    np.testing.assert_allclose(found.covariance, np.diag([0.04, 0.04, 0.01]))


def test_what_is_of_no_class_rests_whatever_class_comes_first_in_the_list() -> None:
    model = WorldModel(WorldModelConfig(classes=("person", "cup")))
    for step in range(40):
        seen = [ObjectEvidence((1.0, 0.001 * (step % 3), 0.8))] if step < 20 else []
        state = model.update(WorldEvidence(seen), 0.1 * step)
    (item,) = state.objects
    assert item.id == "object-1"
    assert item.behaviors["constant_position"] > 0.99

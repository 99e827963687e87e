"""Evidence of recorded messages, which no node has looked at before."""

from __future__ import annotations

from types import SimpleNamespace as Fields
from typing import Any

import pytest

from estimation.errors import InputError
from whereabouts.recorded.evidence_messages import Reader, SeenFrame


def detections(size: tuple[float, float, float], x: float = 1.0, score: float = 0.9) -> Any:
    """A Detection3DArray of one cup, by its fields."""
    place = Fields(x=x, y=0.0, z=0.5)
    covariance = [0.01 * (k % 7 == 0) for k in range(36)]
    hypothesis = Fields(class_id="cup", score=score)
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


@pytest.mark.parametrize(("x", "score"), [(1e19, 0.9), (float("nan"), 0.9), (1.0, 1.7e308)])
def test_places_and_scores_beyond_counting_are_refused(x: float, score: float) -> None:
    with pytest.raises(InputError, match=r"detections\[0\]"):
        READER.detections(detections((0.1, 0.1, 0.1), x, score), SeenFrame())

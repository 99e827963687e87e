"""A simulated camera that drives among landmarks which stand close together."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.anchoring.anchoring_landmarks import DELAY, LandmarkWorld
from evaluation.anchoring.anchoring_recorded import anchored


def test_errors_are_learned_where_there_are_some() -> None:
    """Lens, age of detections and all: more detections get the right landmark, at once and looking back."""
    world = LandmarkWorld(30, minutes=6.0)
    plain, learned = (anchored(world.sightings(), learn=learn) for learn in (False, True))
    assert plain.detections == learned.detections > 500
    assert learned.right > plain.right + 0.02
    assert learned.right > 0.94
    assert learned.corrected > 0.97


def test_nothing_is_learned_where_there_are_none() -> None:
    world = LandmarkWorld(31, minutes=4.0, errors=False)
    plain, learned = (anchored(world.sightings(), learn=learn) for learn in (False, True))
    assert learned.right == plain.right > 0.9
    assert learned.corrected > plain.right


def test_world_is_the_same_for_a_seed() -> None:
    one, other, third = (list(LandmarkWorld(seed, minutes=0.5).sightings()) for seed in (1, 1, 2))
    assert len(one) > 10
    assert all(np.array_equal(a.readings, b.readings) for a, b in zip(one, other, strict=True))
    assert len(one) != len(third) or any((a.pose != b.pose).any() for a, b in zip(one, third, strict=True))
    assert 0.0 < DELAY < 0.2


def test_camera_without_errors_sees_where_landmarks_are() -> None:
    """Within its noise, but for one in a hundred."""
    places: dict[int, list[np.ndarray]] = {}
    for seen in LandmarkWorld(3, minutes=2.0, errors=False).sightings():
        for (distance, bearing), subject in zip(seen.readings, seen.subjects, strict=True):
            angle = seen.pose[2] + bearing
            place = seen.pose[:2] + distance * np.array([np.cos(angle), np.sin(angle)])
            places.setdefault(int(subject), []).append(place)
    spread = [np.median(np.abs(np.array(found) - np.median(found, 0))) for found in places.values()]
    assert max(spread) < 0.03
    middles = [np.median(found, 0) for found in places.values()]
    apart = np.linalg.norm(np.array(middles)[:, None] - np.array(middles)[None], axis=2)
    apart += 10.0 * np.eye(len(apart))
    assert apart.min() == pytest.approx(0.17, abs=0.06)

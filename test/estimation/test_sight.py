"""Sight against rays traced through a simulated room, with the exact distances."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.sight import AGREES, HIDDEN, RANGE_SIGMA, SIGMAS, THROUGH, UNSEEN, beam_at, sight

STEP = np.deg2rad(1.0)
POSE = np.array([0.3, -0.2, 0.4])


def room(bearings: np.ndarray) -> np.ndarray:
    """Ranges from POSE to the walls of a square room, 4 m to each side of the origin."""
    heading = POSE[2] + bearings
    with np.errstate(divide="ignore"):
        x = (np.sign(np.cos(heading)) * 4.0 - POSE[0]) / np.cos(heading)
        y = (np.sign(np.sin(heading)) * 4.0 - POSE[1]) / np.sin(heading)
    return np.minimum(x, y)


@pytest.mark.parametrize("step", [STEP, -STEP])
@pytest.mark.parametrize("count", [360, 181])
def test_spots_in_a_room_are_told_apart_by_their_distance_from_the_walls(step: float, count: int) -> None:
    first = -0.5 * step * (count - 1)
    ranges = room(first + step * np.arange(count))
    rng = np.random.default_rng(3)
    spots = rng.uniform(-5.0, 5.0, (2000, 2))
    labels = sight(spots, POSE, 0.05, ranges, first, step)
    away = spots - POSE[:2]
    bearing = np.angle(np.exp(1j * (np.arctan2(away[:, 1], away[:, 0]) - POSE[2])))
    short = room(bearing) - np.hypot(*away.T)  # of the wall
    margin = SIGMAS * np.hypot(RANGE_SIGMA, 0.05)
    seen = np.abs(bearing) < abs(first) - 0.1 if count == 181 else np.ones(2000, dtype=bool)
    # Walls seen at a low angle come with some doubt on both sides.
    assert (labels[seen & (short > margin + 0.5)] == THROUGH).all()
    assert (labels[seen & (short < -margin - 0.5)] == HIDDEN).all()
    assert (labels[seen & (np.abs(short) < 0.5 * margin)] == AGREES).mean() > 0.95
    assert not (labels[short < 0.0] == THROUGH).any()
    assert not (labels[short > 0.0] == HIDDEN).any()
    assert (labels[np.abs(bearing) > abs(first) + STEP] == UNSEEN).all()


def test_more_doubt_about_the_spot_never_makes_a_beam_surer() -> None:
    first = -0.5 * STEP * 359
    ranges = room(first + STEP * np.arange(360))
    spots = np.random.default_rng(4).uniform(-5.0, 5.0, (500, 2))
    before = None
    for doubt in (0.0, 0.02, 0.1, 0.3):
        labels = sight(spots, POSE, doubt, ranges, first, STEP)
        told = np.isin(labels, (THROUGH, HIDDEN))
        if before is not None:
            assert not (told & ~before).any()
        before = told


def test_beside_an_edge_nothing_is_said() -> None:
    ranges = np.full(11, 5.0)
    ranges[6:] = 2.0
    spots = np.column_stack((3.5 * np.cos(STEP * np.arange(-5, 6)), 3.5 * np.sin(STEP * np.arange(-5, 6))))
    labels = sight(spots, np.zeros(3), 0.0, ranges, -5 * STEP, STEP)
    assert labels[:5].tolist() == [THROUGH] * 5
    assert labels[5] == UNSEEN
    assert labels[6] == UNSEEN
    assert labels[7:].tolist() == [HIDDEN] * 4


def test_no_return_says_nothing() -> None:
    ranges = np.full(11, np.inf)
    assert sight(np.array([[1.0, 0.0]]), np.zeros(3), 0.05, ranges, -5 * STEP, STEP).tolist() == [UNSEEN]


@pytest.mark.parametrize("step", [STEP, -STEP])
def test_the_beam_that_looks_at_a_spot_is_the_one_with_the_nearest_bearing(step: float) -> None:
    first = -0.5 * step * 359
    bearings = first + step * np.arange(360)
    for angle in np.random.default_rng(5).uniform(-np.pi, np.pi, 200):
        found = int(beam_at(np.cos(angle), np.sin(angle), first, step))
        apart = np.abs(np.angle(np.exp(1j * (bearings - angle))))
        assert apart[found] == pytest.approx(apart.min(), abs=1e-9)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"points": [[1.0, np.nan]]}, "points"),
        ({"pose": [0.0, 0.0]}, "pose"),
        ({"doubt": np.nan}, "doubt"),
        ({"ranges": np.ones((2, 5))}, "ranges"),
        ({"step": 0.0}, "step"),
    ],
)
def test_bad_arguments_are_named(changed, named) -> None:
    given = {
        "points": [[1, 0]],
        "pose": [0, 0, 0],
        "doubt": 0,
        "ranges": [2, 2, 2],
        "angle_min": 0,
        "step": 1,
    }
    assert sight(**given).tolist() == [THROUGH]
    with pytest.raises(InputError, match=named):
        sight(**{**given, **changed})

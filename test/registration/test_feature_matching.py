"""Features are matched beside us: what ends the library's process is no answer, and the next question has one."""

from __future__ import annotations

import numpy as np
import pytest

from registration.clouds.feature_matching import match_features

pytest.importorskip("kiss_matcher")


def room(rng: np.random.Generator) -> np.ndarray:
    """Walls, a floor and boxes, (N, 3), metres."""
    floor = np.c_[rng.uniform([-6.0, -4.0], [6.0, 4.0], (4000, 2)), np.zeros(4000)]
    wall = np.c_[rng.uniform(-6.0, 6.0, 3000), np.full(3000, 4.0), rng.uniform(0.0, 2.5, 3000)]
    side = np.c_[np.full(2000, -6.0), rng.uniform(-4.0, 4.0, 2000), rng.uniform(0.0, 2.5, 2000)]
    boxes = [
        rng.uniform([x - 0.5, y - 0.5, 0.0], [x + 0.5, y + 0.5, 1.0], (600, 3))
        for x, y in ((3, 1), (-2, -3), (1, -1.5), (-4, 2))
    ]
    return np.vstack([floor, wall, side, *boxes])


def test_what_has_no_features_is_no_answer_and_the_next_has_one() -> None:
    rng = np.random.default_rng(0)
    few = rng.uniform(-50.0, 50.0, (60, 3))
    for cloud in (few, np.zeros((200, 3)), np.zeros((0, 3))):
        assert match_features(cloud, few, 0.3) is None
    points = room(rng)
    moved = np.array([0.9, 1.8, 0.3])  # whole voxels
    match = match_features(points, points + moved, 0.3)
    assert match is not None
    assert match.inliers > 100
    assert match.transform[:3, 3] == pytest.approx(moved, abs=0.02)


def test_the_same_clouds_have_the_same_answer() -> None:
    rng = np.random.default_rng(1)
    source, target = room(rng), room(rng)[::2]
    answers = [match_features(source, target, 0.3) for _ in range(5)]
    assert answers[0] is not None
    for answer in answers[1:]:
        assert answer is not None
        np.testing.assert_array_equal(answer.transform, answers[0].transform)
        assert answer.inliers == answers[0].inliers

"""Which goals are named: the places that most walks end within reach of, and those of companions."""

from __future__ import annotations

import numpy as np
import pytest

from tracking.intentions import IntentionConfig, IntentionModel
from tracking.intentions.route_kernels import EDGE, gather

RADIUS = 0.7


def mass(ends: np.ndarray, weights: np.ndarray, place: np.ndarray, radius: float) -> float:
    """Weight of the ends within `radius` of a place."""
    return float(weights[np.hypot(*(ends - place).T) <= radius].sum())


@pytest.mark.parametrize("seed", range(6))
def test_the_first_goal_is_right_as_often_as_the_best_place_of_a_dense_grid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0.0, 4.0, (60, 2))
    weights = rng.exponential(1.0, 60)
    weights /= weights.sum()
    goals, shares = gather(ends, weights, RADIUS, 10)
    axis = np.arange(-0.5, 4.5, 0.03)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    # The edge is worn: what a smaller circle takes in counts fully, what a larger one leaves out not at all.
    inner = max(mass(ends, weights, place, (1.0 - EDGE) * RADIUS) for place in grid)
    outer = mass(ends, weights, goals[0], (1.0 + EDGE) * RADIUS)
    assert outer >= 0.95 * inner
    assert shares[0] == pytest.approx(outer)
    assert shares.sum() <= 1.0 + 1e-9


def test_two_doors_side_by_side_outweigh_one_that_is_more_popular() -> None:
    ends = np.array([[0.0, 0.0], [1.0, 0.0], [6.0, 0.0]])
    goals, shares = gather(ends, np.array([0.31, 0.29, 0.4]), RADIUS, 10)
    np.testing.assert_allclose(goals, [[0.5, 0.0], [6.0, 0.0]], atol=0.21)
    np.testing.assert_allclose(shares, [0.6, 0.4])


def test_goals_turn_with_the_frame() -> None:
    rng = np.random.default_rng(3)
    ends, weights = rng.uniform(0.0, 3.0, (40, 2)), rng.exponential(1.0, 40)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    here, _ = gather(ends, weights, RADIUS, 5)
    there, _ = gather(ends @ turn.T, weights, RADIUS, 5)
    np.testing.assert_allclose(here @ turn.T, there, atol=1e-6)


def fork(goal: np.ndarray, start: float, aside: float = 0.0) -> np.ndarray:
    """From the origin over (5, 0) to a goal at 1.2 m/s, `aside` m to the left."""
    corners = np.array([[0.0, aside], [5.0, aside], goal])
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    t = np.arange(0.0, along[-1] / 1.2, 0.1)
    return np.column_stack([*(np.interp(1.2 * t, along, corners[:, a]) for a in (0, 1)), start + t])


def test_who_walks_beside_another_leaves_with_them() -> None:
    right, up = np.array([10.0, 0.0]), np.array([5.0, 6.0])
    config = IntentionConfig(method="routes")
    beside, before = IntentionModel(config), IntentionModel(config)
    for model, begun in ((beside, 1000.0), (before, 500.0)):
        for k in range(6):
            model.learn(fork(right, -100.0 * k))
            model.learn(fork(up, -100.0 * k - 50.0))
        model.learn(fork(up, begun, 0.4))
    partial = fork(right, 1000.2)[:20]
    goals, together = beside.intentions(partial)
    assert np.hypot(*(goals[0] - up)) < 0.72
    _, alone = before.intentions(partial)
    assert together[0] > alone[0] + 0.1


def test_times_that_count_from_each_start_say_nothing_about_company() -> None:
    right, up = np.array([10.0, 0.0]), np.array([5.0, 6.0])
    counted, apart = IntentionModel(), IntentionModel()
    for k in range(8):
        walk = fork(right if k % 2 else up, 0.0, 0.05 * k)
        counted.learn(walk)
        apart.learn(walk + np.array([0.0, 0.0, 1e4 * (k + 1)]))
    partial = fork(right, 0.0)[:20]
    for one, other in zip(counted.intentions(partial), apart.intentions(partial), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)

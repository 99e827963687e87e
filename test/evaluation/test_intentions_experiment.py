"""The measures of the experiment `intentions` on walks whose outcome is known."""

from __future__ import annotations

import numpy as np

from evaluation.datasets import recording
from evaluation.experiments.intentions import simulated_walks
from evaluation.intentions import intentions_protocol as protocol
from evaluation.intentions.intentions_days import simulated_day
from evaluation.intentions.trajectories import read_trajectories


def test_learned_exits_beat_straight_lines_early_and_are_nearly_sure_late() -> None:
    walks = simulated_walks(1, 90)
    routes, linear = (protocol.online(walks, method).rates for method in ("routes", "linear"))
    assert routes[0] > linear[0] + 0.1
    assert routes[-1] > 0.8
    assert (np.diff(routes) > -0.1).all()


def test_exits_of_straight_walks_are_found_by_straight_lines() -> None:
    t = np.arange(60) / 9.0
    walk = np.column_stack((1.0 + 1.2 * t, 2.0 + 0.6 * t, t))
    found = protocol.linear_exit(walk[:20], np.zeros(2), np.array([10.0, 100.0]))
    np.testing.assert_allclose(found, [10.0, 6.5], atol=1e-6)
    assert protocol.is_complete(walk, walk[0, :2], walk[-1, :2])
    assert not protocol.is_complete(walk, walk[0, :2] - 2.0, walk[-1, :2] + 2.0)


def test_displacement_of_constant_velocity_is_what_is_expected() -> None:
    t = 0.4 * np.arange(24)
    straight = np.column_stack((1.1 * t, np.zeros(24), t))
    turning = np.column_stack((np.where(t < 3.0, 1.1 * t, 3.3), np.where(t < 3.0, 0.0, 1.1 * (t - 3.0)), t))
    for method in ("last step", "mean of 8", "fresh"):
        errors, _ = protocol.displacement({1: straight}, method)
        assert errors.shape == (5, 12)
        np.testing.assert_allclose(errors, 0.0, atol=1e-6)
    errors, _ = protocol.displacement({1: turning}, "last step")
    assert errors[0, 11] > 2.0


def test_paths_to_learned_goals_swing_less_than_straight_lines() -> None:
    walks = simulated_walks(2, 80)
    assert protocol.swing(walks, "routes", 12).mean() < protocol.swing(walks, "linear", 12).mean()


def test_hotel_errors_are_no_worse_than_constant_velocity_at_any_horizon() -> None:
    path = recording("trajectories/hotel_obsmat.txt.gz")
    if path is None:
        import pytest

        pytest.skip("the hotel recording is absent")
    people = read_trajectories(path).trajectories
    learned, constant = (
        protocol.displacement(people, method, stride=3)[0].mean(axis=0) for method in ("learned", "mean of 8")
    )
    assert (learned <= constant).all()


def test_a_simulated_day_is_in_order_within_the_hall_and_differs_by_seed() -> None:
    day, again, other = (simulated_day(seed, 40) for seed in (0, 0, 1))
    assert all((a == b).all() for a, b in zip(day, again, strict=True))
    assert not np.array_equal(day[0], other[0])
    begun = [walk[0, 2] for walk in day]
    assert begun == sorted(begun)
    for walk in day:
        assert (np.diff(walk[:, 2]) > 0.0).all()
        assert np.hypot(*np.diff(walk[:, :2], axis=0).T).max() < 1.0
        assert (walk[:, :2] >= [0.0, 0.0]).all()
        assert (walk[:, :2] <= [16.0, 11.5]).all()

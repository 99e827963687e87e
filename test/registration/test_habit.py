"""What is learned about how a sensor moves, and odometry over scans that are kept a metre apart without wheels."""

from __future__ import annotations

import numpy as np

from registration.odometry.habit import Habit


def walked(motions: np.ndarray) -> Habit:
    habit = Habit()
    last = np.zeros(3)
    for motion in motions:
        habit.learn(motion, last)
        last = motion
    return habit


def test_scans_a_metre_apart_are_expected_a_metre_on_whatever_the_last_turn_was() -> None:
    rng = np.random.default_rng(1)
    steps = np.column_stack((rng.normal(1.0, 0.05, 80), rng.normal(0.0, 0.02, 80), rng.normal(0.0, 0.3, 80)))
    habit = walked(steps)
    assert habit.steady
    assert habit.regular
    expected = habit.expected(np.array([1.0, 0.0, 0.6]), False)
    np.testing.assert_allclose(expected, [1.0, 0.0, 0.0], atol=0.12)


def test_a_smooth_run_at_a_rate_goes_on_as_before_and_may_come_to_rest() -> None:
    t = np.linspace(0.0, 12.0, 150)
    steps = np.column_stack((0.06 + 0.05 * np.sin(t), np.zeros(150), 0.05 * np.cos(0.7 * t)))
    habit = walked(steps)
    assert not habit.steady
    last = np.array([0.1, 0.0, 0.03])
    for lost in (False, True):
        np.testing.assert_array_equal(habit.expected(last, lost), last)


def test_who_stops_now_and_then_is_not_taken_to_go_on() -> None:
    steps = np.zeros((90, 3))
    steps[::2, 0] = 1.0
    assert not walked(steps).steady


def test_little_is_made_of_few_motions() -> None:
    habit = walked(np.tile([1.0, 0.0, 0.0], (10, 1)))
    assert not habit.steady
    assert not habit.regular

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
    assert habit.regular
    expected = habit.expected(np.array([1.0, 0.0, 0.6]))
    np.testing.assert_allclose(expected, [1.0, 0.0, 0.0], atol=0.15)


def test_a_smooth_run_at_a_rate_goes_on_as_before_and_may_come_to_rest() -> None:
    t = np.linspace(0.0, 12.0, 150)
    steps = np.column_stack((0.06 + 0.05 * np.sin(t), np.zeros(150), 0.05 * np.cos(0.7 * t)))
    habit = walked(steps)
    assert not habit.regular
    last = np.array([0.1, 0.0, 0.03])
    np.testing.assert_array_equal(habit.expected(last), last)


def test_its_doubt_is_that_of_the_motions_from_what_was_expected() -> None:
    rng = np.random.default_rng(2)
    sigma = np.array([0.08, 0.08, 0.3])
    habit = walked(rng.normal([1.0, 0.0, 0.0], sigma, (400, 3)))
    assert habit.regular
    np.testing.assert_allclose(np.sqrt(np.diag(habit.doubt)), sigma, rtol=0.4)
    assert (np.diag(Habit().doubt) > 0.2).all(), "before anything was seen"


def test_little_is_made_of_few_motions() -> None:
    assert not walked(np.tile([1.0, 0.0, 0.0], (10, 1))).regular


def test_lost_scans_are_counted_as_periods_and_stamps_that_jitter_are_not() -> None:
    habit, rng = Habit(), np.random.default_rng(3)
    assert {habit.periods(elapsed) for elapsed in 0.1 + rng.uniform(-0.04, 0.04, 30)} == {1}
    assert [habit.periods(elapsed) for elapsed in (0.2, 0.31, 0.0, -5.0, 60.0)] == [2, 3, 1, 1, 10]


def test_a_pause_between_scans_that_are_kept_by_distance_is_one_period() -> None:
    habit = Habit()
    assert [habit.periods(elapsed) for elapsed in (2.0, 1.5, 3.0, 60.0)] == [1, 1, 1, 1]

"""How a person's motion is judged from its latest observations."""

from __future__ import annotations

import numpy as np
import pytest

from tracking.intentions.walking_motion import estimate


def line(rate: float, noise: float, rng: np.random.Generator, duration: float = 6.0) -> np.ndarray:
    t = np.arange(0.0, duration, 1.0 / rate)
    return np.column_stack((1.2 * t, -0.5 * t, t)) + np.column_stack(
        (rng.normal(0, noise, (len(t), 2)), np.zeros(len(t)))
    )


@pytest.mark.parametrize("rate", [2.5, 10.0, 40.0])
def test_a_line_without_noise_is_found_exactly(rate: float) -> None:
    rows = line(rate, 0.0, np.random.default_rng(0))
    motion = estimate(rows, 1.5, 0.06)
    np.testing.assert_allclose(motion.state, [*rows[-1, :2], 1.2, -0.5], atol=1e-9)
    assert motion.pace == pytest.approx(1.3, abs=0.05)


@pytest.mark.parametrize(("rate", "noise"), [(2.5, 0.05), (10.0, 0.05), (10.0, 0.15)])
def test_noise_is_averaged_more_the_more_there_is(rate: float, noise: float) -> None:
    rng = np.random.default_rng(1)
    ours, last, where, seen = [], [], [], []
    for _ in range(200):
        rows = line(rate, noise, rng)
        motion = estimate(rows, 1.5, 0.06)
        step = (rows[-1] - rows[-2])[:2] * rate
        truth = np.array([1.2, -0.5])
        ours.append(np.hypot(*(motion.state[2:] - truth)))
        last.append(np.hypot(*(step - truth)))
        where.append(np.hypot(*(motion.state[:2] - truth * rows[-1, 2])))
        seen.append(np.hypot(*(rows[-1, :2] - truth * rows[-1, 2])))
    assert np.mean(ours) < 0.25 * np.mean(last)
    assert np.mean(where) < np.mean(seen)


def test_a_turn_is_followed_within_two_seconds() -> None:
    t = np.arange(0.0, 8.0, 0.1)
    rows = np.column_stack((np.minimum(1.2 * t, 6.0), 1.2 * np.maximum(t - 5.0, 0.0), t))
    rows[:, :2] += np.random.default_rng(2).normal(0, 0.02, (len(t), 2))
    state = estimate(rows[t < 7.0], 1.5, 0.06).state
    assert state[3] > 0.9
    assert abs(state[2]) < 0.35


def test_one_and_two_observations() -> None:
    np.testing.assert_array_equal(
        estimate(np.array([[1.0, 2.0, 3.0]]), 1.5, 0.06).state, [1.0, 2.0, 0.0, 0.0]
    )
    state = estimate(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]), 1.5, 0.06).state
    # Noise of 3 cm leaves 4 cm/s open, beside the 1 m/s of people at large.
    np.testing.assert_allclose(state[2:], [1.0 / 1.0018, 0.0], atol=1e-9)
    np.testing.assert_allclose(state[:2], [1.0, 0.0], atol=2e-4)
    # After a gap of an hour.
    state = estimate(np.array([[0.0, 0.0, 0.0], [3.6, 0.0, 3600.0]]), 1.5, 0.06).state
    np.testing.assert_allclose(state, [3.6, 0.0, 0.001, 0.0], atol=1e-9)


def test_pace_leaves_out_where_the_person_stood() -> None:
    t = np.arange(0.0, 20.0, 0.2)
    rows = np.column_stack((1.4 * np.minimum(t, 10.0), np.zeros(len(t)), t))
    motion = estimate(rows, 1.5, 0.06)
    assert motion.pace == pytest.approx(1.4, abs=0.1)
    assert motion.speed < 0.01

"""Wheel odometry between stamps, against the path it was sampled from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimation.geometry.poses import between, compound
from registration.laser.scan import Scan
from registration.odometry.wheel_history import NANOSECONDS, WheelHistory


def on_circle(time: float) -> np.ndarray:
    """A robot that drives 1 m/s on a circle of radius 2 m."""
    angle = time / 2.0
    return np.array(
        [2.0 * np.sin(angle), 2.0 - 2.0 * np.cos(angle), np.arctan2(np.sin(angle), np.cos(angle))]
    )


def history(step: float = 0.05, end: float = 20.0, offset: np.ndarray | None = None) -> WheelHistory:
    wheels = WheelHistory()
    for time in np.arange(0.0, end, step):
        pose = on_circle(float(time))
        wheels.insert(round(time * NANOSECONDS), pose if offset is None else compound(offset, pose))
    return wheels


@given(st.floats(0.0, 19.0), st.floats(0.0, 0.9))
def test_motion_is_that_of_the_path_wherever_the_wheels_started(start: float, length: float) -> None:
    expected = between(on_circle(start), on_circle(start + length))
    for offset in (None, np.array([5.0, -3.0, 2.0])):
        motion = history(offset=offset).motion(round(start * 1e9), round((start + length) * 1e9), 0.5)
        assert motion is not None
        assert np.allclose(motion, expected, atol=2e-3)


def test_a_little_beyond_the_newest_is_extrapolated_and_too_far_is_refused() -> None:
    wheels = history(end=5.0)
    newest = 4.95
    motion = wheels.motion(round(4e9), round((newest + 0.05) * 1e9), 0.5)
    assert motion is not None
    assert np.allclose(motion, between(on_circle(4.0), on_circle(newest + 0.05)), atol=5e-3)
    assert wheels.motion(round(4e9), round((newest + 0.6) * 1e9), 0.5) is None
    assert wheels.motion(-1, round(1e9), 0.5) is None
    assert WheelHistory().motion(0, 1, 0.5) is None


def test_the_motion_in_a_sweep_is_told_once_half_of_it_is_known() -> None:
    scan = Scan(np.ones(101), 0.0, 0.01, 0.1, 10.0, time_increment=0.002)
    start = round(4.85 * NANOSECONDS)
    motion = history(end=5.0).sweep(start, scan)
    assert motion is not None
    assert np.allclose(motion, between(on_circle(4.85), on_circle(5.05)), atol=5e-3)
    assert history(end=4.95).sweep(start, scan) is None
    assert history().sweep(start, replace(scan, time_increment=0.0)) is None
    assert history().sweep(start, replace(scan, time_increment=-0.002)) is None
    assert WheelHistory().sweep(start, scan) is None


def test_history_is_bounded() -> None:
    wheels = history(step=0.05, end=100.0)
    assert len(wheels) <= 601


def test_wheels_that_begin_anew_tell_nothing_of_the_motion_between() -> None:
    """Their driver was started again: the pose leaps to zero, and the robot has not moved."""
    wheels = history(end=5.0, offset=np.array([3.0, 1.0, 0.5]))
    for time in np.arange(5.0, 8.0, 0.05):
        wheels.insert(round(time * NANOSECONDS), between(on_circle(5.0), on_circle(float(time))))
    assert wheels.motion(round(4.9e9), round(5.1e9), 0.5) is None
    motion = wheels.motion(round(5.1e9), round(5.3e9), 0.5)
    assert motion is not None
    assert np.allclose(motion, between(on_circle(5.1), on_circle(5.3)), atol=2e-3)

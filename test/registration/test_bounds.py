"""Readings and guesses that no scanner and no robot ever makes."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from registration import Odometry, Scan
from registration.laser.scan import FARTHEST
from registration.laser.submap import _see


@pytest.mark.parametrize("step", [0.0, 1e-9, -1e-9, 7.0, 1e30])
def test_a_step_between_beams_that_is_none_is_refused(step: float) -> None:
    with pytest.raises(InputError, match="angle_increment"):
        Scan([1.0, 2.0], 0.0, step)
    assert Scan([1.0], 0.0, step).angle_increment == pytest.approx(2.0 * np.pi)


def test_degrees_in_place_of_radians_are_refused() -> None:
    Scan(np.ones(721), -2.0 * np.pi, 4.0 * np.pi / 720)
    with pytest.raises(InputError, match="go round 57 times"):
        Scan(np.ones(360), -180.0, 1.0)


def test_a_reading_farther_than_anything_is_none() -> None:
    scan = Scan([1.0, 0.9 * FARTHEST, 1.1 * FARTHEST, 1e30], 0.0, 0.1)
    assert scan.valid.tolist() == [True, True, False, False]


def cloud(offset: float) -> np.ndarray:
    return np.random.default_rng(0).uniform(-5.0, 5.0, (500, 3)) + np.array([offset, 0.0, 0.0])


def test_clouds_out_of_reach_are_answered_by_the_prediction() -> None:
    odometry = Odometry()
    odometry.register(cloud(0.0), 0.0)
    for k in range(1, 4):
        odometry.register(cloud(1e6), 0.1 * k)
        assert not odometry.converged
        assert "range" in odometry.reason
    assert np.isfinite(odometry.pose).all()


def test_a_guess_that_is_no_motion_is_refused() -> None:
    odometry = Odometry()
    odometry.register(cloud(0.0), 0.0)
    with pytest.raises(InputError, match="guess"):
        odometry.register(cloud(0.0), 0.1, guess=np.diag([2.0, 1.0, 1.0, 1.0]))
    almost = np.eye(4)
    almost[0, 1] = 1e-7
    odometry.register(cloud(0.0), 0.1, guess=almost)
    assert np.allclose(odometry.pose[:3, :3] @ odometry.pose[:3, :3].T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("x", [-1e19, -5.0, 1e19, np.nan])
def test_beams_beside_the_grid_mark_nothing(x: float) -> None:
    seen = np.zeros((10, 10), dtype=np.bool_)
    _see(seen, np.zeros(2), np.array([x, 0.0, 0.0]), np.ones(3), 0.0, 0.1)
    assert not seen.any()


def test_a_stamp_in_milliseconds_is_refused() -> None:
    with pytest.raises(InputError, match="stamp"):
        Scan(np.ones(3), 0.0, 0.1, stamp=1.7e12)

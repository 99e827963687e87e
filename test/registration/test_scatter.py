"""Covariances of pairwise registration against the errors they speak of."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.geometry.poses import wrap_angle
from estimation.metrics.statistics import anees_bounds
from evaluation.scenes.scan_pairs import EASY, random_pair
from registration import align
from registration.placement.scatter import _sandwich
from whereabouts.simulation import Lidar, corridor
from whereabouts.simulation.robot import relative

LIDARS = {
    "around": Lidar(361, 2.0 * np.pi * 360 / 361),
    "ahead": Lidar(1081, np.deg2rad(270.0)),
}


@pytest.mark.parametrize("lidar", LIDARS)
def test_errors_in_rooms_are_as_large_as_stated(lidar: str) -> None:
    rng = np.random.default_rng(20)
    squares = []
    for _ in range(150):
        pair = random_pair(rng, LIDARS[lidar], EASY)
        found = align(pair.source.scan, pair.target.scan)
        error = found.transform - pair.motion
        error[2] = wrap_angle(error[2])
        squares.append(error @ np.linalg.solve(found.covariance, error))
    low, high = anees_bounds(150, 3)
    assert low < np.mean(squares) < high


def test_half_a_metre_along_a_corridor_leaves_no_unexpected_error_across() -> None:
    rng = np.random.default_rng(4)
    squares = []
    for _ in range(60):
        first = np.array([0.0, rng.uniform(-0.6, 0.6), rng.uniform(-0.3, 0.3)])
        second = first + np.array([0.5 * rng.standard_normal(), 0.1 * rng.standard_normal(), 0.1])
        scans = [LIDARS["ahead"].scan(corridor(), pose, rng).scan for pose in (first, second)]
        found = align(scans[1], scans[0])
        error = found.transform - relative(first, second)
        values, vectors = np.linalg.eigh(found.covariance)
        assert values[2] > 0.1
        squares.append(float((vectors[:, 1] @ error) ** 2 / values[1]))
    # Chi-square with one degree of freedom each: 60 ± 3 · sqrt(120).
    assert np.sum(squares) == pytest.approx(60.0, abs=33.0)


def test_equal_noise_gives_back_the_information_and_open_directions_stay_open() -> None:
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((40, 3))
    outer = rows.T @ rows
    np.testing.assert_allclose(_sandwich(outer, outer, 0), outer, rtol=1e-9)
    middle = np.diag([4.0, 1.0, 9.0]) * 30.0
    expected = outer @ np.linalg.inv(middle) @ outer
    np.testing.assert_allclose(_sandwich(outer, middle, 0), expected, rtol=1e-9)
    free = np.array([0.6, 0.8, 0.0])
    keep = np.eye(3) - np.outer(free, free)
    flat = keep @ outer @ keep
    found = _sandwich(flat, flat, 1)
    np.testing.assert_allclose(found, flat, atol=1e-9 * np.abs(flat).max())
    np.testing.assert_allclose(found @ free, 0.0, atol=1e-8)

"""How noisy ranges are is learned from scans, and what is one wall is one wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from registration.laser.range_noise import RangeNoise
from registration.laser.surface import scan_surface
from whereabouts.simulation import Lidar, box, random_room

NARROW = 2.0 * np.pi * 57.0 / 360.0


@pytest.mark.parametrize("beams", [181, 720, 3600])
@pytest.mark.parametrize("sigma", [0.015, 0.05])
def test_the_noise_is_that_of_the_simulated_scanner(beams: int, sigma: float) -> None:
    rng, noise = np.random.default_rng(beams), RangeNoise(0.01)
    lidar = Lidar(beams, 1.5 * np.pi, sigma=sigma)
    for _ in range(20):
        noise.learn(lidar.scan(random_room(rng), np.zeros(3), rng).scan)
    assert noise.value == pytest.approx(sigma, rel=0.2)


def test_a_good_scanner_and_what_is_rough_close_by_leave_it_as_it_is() -> None:
    rng, noise, room = np.random.default_rng(8), RangeNoise(0.01), box(3.0, 2.0)
    lidar = Lidar(1800, 1.5 * np.pi, sigma=0.004)
    for number in range(60):
        scan = lidar.scan(room, np.zeros(3), rng).scan
        if number % 3 == 1:
            scan = replace(scan, ranges=scan.ranges + rng.uniform(-0.3, 0.3, len(scan)))
        noise.learn(scan)
        assert noise.value == 0.01


def test_walls_at_a_slant_are_no_noise_however_far_apart_the_beams_are() -> None:
    rng, noise = np.random.default_rng(9), RangeNoise()
    noise.learn(Lidar(60, np.pi, sigma=1e-6).scan(box(20.0, 2.0), np.array([3.0, 0.5, 0.3]), rng).scan)
    assert noise.value < 2e-6


def test_a_few_readings_tell_nothing() -> None:
    rng, noise = np.random.default_rng(9), RangeNoise(0.01)
    noise.learn(Lidar(20, np.pi, sigma=0.5).scan(box(6.0, 4.0), np.zeros(3), rng).scan)
    assert noise.value == 0.01


@pytest.mark.parametrize("sigma", [0.005, 0.02, 0.04])
def test_a_wall_before_a_dense_and_noisy_scanner_is_one_piece_with_one_direction(sigma: float) -> None:
    """As of a depth camera's line: beams are nearer to each other than they are exact."""
    rng, wall = np.random.default_rng(7), box(4.0, 40.0)
    surface = scan_surface(
        Lidar(640, NARROW, sigma=sigma).scan(wall, np.zeros(3), rng).scan, max(sigma, 0.01)
    )
    assert surface.pieces.max() == 0
    assert surface.lined.mean() > 0.95
    turned = np.arctan2(surface.normals[:, 1], -surface.normals[:, 0])[surface.lined]
    assert np.sqrt(np.mean(turned**2)) < 3.0 * sigma
    assert surface.noise == pytest.approx(sigma, rel=0.3)

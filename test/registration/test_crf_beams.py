"""Points that another scan saw, found by beam, beside a search among all of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from registration import Scan
from registration.crf.beams import beams_of, moved, nearest_point, point_there, seen, shifted

SCANNERS = {
    "half": (-0.5 * np.pi, np.pi / 360.0, 361),
    "all around": (-np.pi, 2.0 * np.pi / 450.0, 450),
    "clockwise": (np.pi, -2.0 * np.pi / 360.0, 360),
}


@pytest.fixture(params=SCANNERS)
def scan(request: pytest.FixtureRequest) -> Scan:
    """Some thing or other at every distance, and beams without return between."""
    rng = np.random.default_rng(4)
    first, step, count = SCANNERS[request.param]
    ranges = rng.uniform(0.3, 8.0, count)
    ranges[rng.random(count) < 0.2] = np.inf
    return Scan(ranges, first, step, 0.1, 20.0, 0.0)


def test_the_nearest_point_is_that_of_a_search_among_all(scan: Scan) -> None:
    beams = beams_of(scan)
    spots = np.random.default_rng(5).uniform(-9.0, 9.0, (2000, 2))
    for reach in (0.1, 0.6, 20.0):
        away, nearest = cKDTree(beams.points).query(spots)
        for spot, d, expected in zip(spots, away, nearest, strict=True):
            found, distance = nearest_point(*spot, reach, seen(beams))
            assert found == (expected if d < reach else -1)
            assert distance == pytest.approx(min(d, reach))


def test_each_point_is_seen_by_its_own_beam(scan: Scan) -> None:
    beams = beams_of(scan)
    for number, beam in enumerate(beams.beams):
        assert point_there(*beams.points[number], seen(beams)) == (number, beam)


def test_shifted_is_moved() -> None:
    points, motion = np.random.default_rng(6).normal(size=(20, 2)), np.array([0.3, -1.0, 2.0])
    np.testing.assert_allclose(shifted(points, motion), moved(points, motion), atol=1e-12)

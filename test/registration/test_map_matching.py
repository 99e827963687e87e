"""Where in a map of lines a scan was taken, on simulated rooms: near where it was expected, far from there, nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.geometry.poses import between
from registration.laser.local_map import LineMap
from registration.laser.prepared import PreparedScan, prepare_scan
from registration.odometry.map_matching import ExpectedPose, MapMatcher
from whereabouts.simulation import Lidar, Shapes, box, joined

LIDAR = Lidar(361, 2.0 * np.pi * 360 / 361)
DOUBT = np.diag([0.1, 0.1, 0.1]) ** 2
ROOM = joined([box(9.0, 7.0), box(1.5, 0.6, (2.0, 1.5, 0.4)), box(0.8, 0.8, (-2.5, -1.0, 0.0))])
ANOTHER = joined([box(5.0, 12.0), box(0.7, 2.0, (1.0, 3.0, 0.7))])


def seen(shapes: Shapes, pose: np.ndarray, seed: int = 1) -> PreparedScan:
    return prepare_scan(LIDAR.scan(shapes, pose, np.random.default_rng(seed), 0.0).scan)


@pytest.fixture
def matcher() -> MapMatcher:
    lines = LineMap(30.0, 100.0)
    for k, x in enumerate((-1.0, -0.5, 0.0, 0.5)):
        pose = np.array([x, 0.2 * x, 0.1 * k])
        scan = seen(ROOM, pose, k)
        lines.add(scan.surface, scan.view, pose, x + 1.0)
    return MapMatcher(lines, 0.3, 0.08)


@pytest.mark.parametrize("off", [[0.1, -0.1, 0.05], [0.8, -0.6, 0.9], [-0.5, 0.5, -1.0]])
def test_a_scan_is_found_near_where_it_was_expected_and_farther_away(
    matcher: MapMatcher, off: list[float]
) -> None:
    pose = np.array([0.6, 0.3, 0.5])
    match = matcher.find(seen(ROOM, pose, 9), ExpectedPose(pose + off, DOUBT), pose)
    assert match.believable
    assert (np.abs(between(pose, match.refined.pose)) < [0.03, 0.03, 0.01]).all()


def test_a_scan_of_another_room_is_found_nowhere(matcher: MapMatcher) -> None:
    pose = np.array([0.2, 0.1, 0.2])
    match = matcher.find(seen(ANOTHER, pose), ExpectedPose(pose, DOUBT), pose)
    assert not match.believable
    assert "contradict" in match.reason


def test_odds_are_less_the_farther_a_place_is_from_where_it_was_expected(matcher: MapMatcher) -> None:
    pose = np.array([0.6, 0.3, 0.5])
    scan, odds = seen(ROOM, pose, 9), []
    for away in (0.0, 0.2, 0.6, 1.0):
        expected = ExpectedPose(pose + np.array([away, 0.0, 0.0]), DOUBT)
        odds.append(matcher.find(scan, expected, pose).odds)
    assert (np.diff(odds) < -0.5).all()


def test_what_speaks_against_a_surprise_is_a_square_at_first_and_then_a_logarithm() -> None:
    expected = ExpectedPose(np.zeros(3), DOUBT)
    near, far, farther = (expected.against(np.array([x, 0.0, 0.0])) for x in (0.01, 10.0, 20.0))
    assert near == pytest.approx(2.5 * 0.01 / 2.0, rel=0.01)
    assert farther - far == pytest.approx(5.0 * np.log(2.0), rel=0.01)

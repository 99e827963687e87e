"""Histogram registration against sums written out, motions that are known, and rooms from anywhere."""

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.poses import inverse, transform_points, wrap_angle
from evaluation.scenes.scan_pairs import EASY, free_pose, random_pair
from registration import align_globally
from registration.laser.prepared import prepare
from registration.placement.histograms import (
    BINS,
    CELL,
    CELLS,
    facing,
    histogram_candidates,
    orientations,
    profile,
    shifts,
    turns,
)
from whereabouts.simulation import Lidar, random_room
from whereabouts.simulation.robot import relative

ROUND = Lidar(361, 2.0 * np.pi * 360 / 361)


def test_orientations_hold_every_metre_of_outline_that_has_a_line() -> None:
    surface = prepare("scan", random_pair(np.random.default_rng(1), ROUND, EASY).target.scan).surface
    histogram = orientations(surface)
    assert histogram.sum() == pytest.approx(surface.length[surface.lined].sum())
    angle = np.arctan2(*surface.normals[surface.lined].T[::-1])
    # The mean direction of four times the angle: where walls are at right angles, the way of the room.
    bins = np.arange(BINS) * 2.0 * np.pi / BINS - np.pi
    own = np.angle((surface.length[surface.lined] * np.exp(4j * angle)).sum())
    assert np.angle((histogram * np.exp(4j * bins)).sum()) == pytest.approx(own, abs=0.02)


def test_turns_are_the_best_of_all_turns_tried() -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        pair = random_pair(rng, ROUND, EASY)
        one, other = (orientations(prepare("scan", s.scan).surface) for s in (pair.source, pair.target))
        alike = [np.roll(one, k) @ other for k in range(BINS)]
        best = turns(one, other)[0] * BINS / (2.0 * np.pi)
        assert abs((best - np.argmax(alike) + BINS / 2) % BINS - BINS / 2) <= 0.5


def test_shifts_are_the_best_of_all_shifts_tried() -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        pair = random_pair(rng, ROUND, EASY)
        one, other = (prepare("scan", s.scan).surface for s in (pair.source, pair.target))
        way = facing(orientations(other))[0]
        sides = [[profile(s, t, way, sign) for sign in (1.0, -1.0)] for s, t in ((one, 0.3), (other, 0.0))]
        padded = np.pad(np.array(sides), ((0, 0), (0, 0), (CELLS, CELLS)))
        alike = [(np.roll(padded[0], k, axis=1) * padded[1]).sum() for k in range(-150, 151)]
        found, worth = shifts(one, other, 0.3, way)
        assert abs(found[0] - (np.argmax(alike) - 150) * CELL) <= 0.51 * CELL
        assert worth[0] == pytest.approx(max(alike))


def test_what_was_moved_by_hand_is_found_from_anywhere() -> None:
    """Points of one scan, turned and moved: the motion is among the first few, to a cell and a bin."""
    rng = np.random.default_rng(4)
    for _ in range(10):
        points = random_pair(rng, ROUND, EASY).target.scan.points()
        motion = rng.uniform(-1.0, 1.0, 3) * [3.0, 3.0, np.pi]
        source = prepare("source", transform_points(inverse(motion), points)).surface
        candidates = histogram_candidates(source, prepare("target", points).surface, 24)
        off = candidates - motion
        near = (np.hypot(off[:, 0], off[:, 1]) < 0.1) & (np.abs(wrap_angle(off[:, 2])) < 0.02)
        assert near.any()


def test_rooms_from_anywhere_with_icp_after_it() -> None:
    rng = np.random.default_rng(5)
    right = 0
    for _ in range(20):
        room = random_room(rng)
        a, b = (free_pose(room, rng, 1.0) for _ in range(2))
        scans = [ROUND.scan(room, pose, rng).scan for pose in (b, a)]
        off = align_globally(*scans, method="histogram").transform - relative(a, b)
        right += np.hypot(*off[:2]) < 0.05 and abs(wrap_angle(off[2])) < np.deg2rad(1.0)
    assert right >= 16


def test_poor_data_and_unknown_methods_are_refused() -> None:
    scan = random_pair(np.random.default_rng(6), ROUND, EASY).target.scan
    for poor in (np.zeros((0, 2)), scan.points()[:5], np.full((50, 2), np.nan)):
        assert not align_globally(poor, scan, "histogram").converged
        assert not align_globally(scan, poor, "histogram").converged
    with pytest.raises(InputError, match="method"):
        align_globally(scan, scan, "magic")
    with pytest.raises(InputError, match="method"):
        align_globally(np.zeros((30, 3)), np.zeros((30, 3)), "histogram")

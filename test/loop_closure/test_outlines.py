"""Outlines of places and laying them on each other, in simulated rooms whose walls and poses are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.poses import between
from evaluation.loops.place_training import match_pairs
from loop_closure import LocalMap, features_2d
from loop_closure.places.matching import MATCH_FEATURES, NAMES, match_features
from loop_closure.places.outline_kernels import CELL, CELLS, RADIUS, mark_free, reach
from loop_closure.places.outlines import SECTORS, THIN, outline_of_scan
from loop_closure.places.pairs import Pairs
from loop_closure.places.signatures import SCAN_SIZE, range_quantiles
from registration import Scan
from whereabouts.simulation import Lidar, random_room
from whereabouts.simulation.shapes import box, joined

LIDAR = Lidar(beams=361, opening=math.radians(359.0), sigma=0.005)
AHEAD = Lidar(beams=181, sigma=0.005)


def hall():
    """A hall of 12 m by 8 m with two pillars; nothing in it is symmetric."""
    return joined(
        [box(12.0, 8.0, (1.0, 0.5, 0.0)), box(0.6, 1.4, (3.0, 2.0, 0.4)), box(0.8, 0.5, (-2.0, -1.5, 0.0))]
    )


def passage():
    """A long room with furniture along its walls: from either side the same pieces are passed."""
    rng = np.random.default_rng(3)
    pieces = [
        box(rng.uniform(0.5, 1.5), rng.uniform(0.4, 1.0), (x, side * 2.2, 0.0))
        for side in (-1, 1)
        for x in rng.uniform(-9.0, 9.0, 6)
    ]
    return joined([box(24.0, 6.0, (0.0, 0.0, 0.0)), *pieces])


def scan_at(pose, shapes=None, lidar=LIDAR, seed=0) -> Scan:
    return lidar.scan(hall() if shapes is None else shapes, np.array(pose), np.random.default_rng(seed)).scan


def free_cells(outline) -> np.ndarray:
    return np.unpackbits(outline.free)[: CELLS * CELLS].reshape(CELLS, CELLS).astype(bool)


def test_points_stand_on_walls_one_per_cell() -> None:
    scan = scan_at((0.0, 0.0, 0.3))
    points = outline_of_scan(scan).points
    returned = scan.points()
    apart = np.linalg.norm(points[:, None] - returned[None], axis=2).min(axis=1)
    assert apart.max() < THIN
    cells = np.floor((points + RADIUS) / THIN)
    assert len(np.unique(cells, axis=0)) == len(points)
    # Any first part is spread over the whole: all four quadrants are in the first twelve.
    assert len(np.unique(points[:12] > 0, axis=0)) == 4


def test_free_cells_are_those_the_beams_passed() -> None:
    scan = scan_at((0.0, 0.0, 0.0))
    free = free_cells(outline_of_scan(scan))
    centre = (np.arange(CELLS) + 0.5) * CELL - RADIUS
    x, y = np.meshgrid(centre, centre, indexing="ij")
    range_there = np.interp(np.arctan2(y, x), scan.bearings, scan.ranges)
    distance = np.hypot(x, y)
    inside = np.abs(np.arctan2(y, x)) < math.radians(178.0)
    assert free[inside & (distance < 0.8)].all()
    assert not free[inside & (distance > range_there + 0.3)].any()
    assert free[inside & (distance < range_there - 1.2)].mean() > 0.97


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (3.1, -4.2, 2.5), (-7.0, 1.0, -0.8)])
def test_cells_are_free_where_the_beam_that_way_went_further(pose) -> None:
    scan = scan_at((0.4, -0.3, 0.9))
    seen = reach(scan.ranges, scan.valid, scan.angle_min, scan.angle_increment, SECTORS)
    free = np.zeros((CELLS, CELLS), dtype=np.uint8)
    mark_free(free, seen, *pose)
    centre = (np.arange(CELLS) + 0.5) * CELL - RADIUS
    x, y = np.meshgrid(centre - pose[0], centre - pose[1], indexing="ij")
    turns = (np.arctan2(y, x) - pose[2]) / (2.0 * math.pi)
    limit = seen[(turns * len(seen) + 1.5 * len(seen)).astype(int) % len(seen)] - 0.3
    # Directions are looked up in steps of a sixth of a sector: a few cells fall to the neighbouring one.
    assert (free.astype(bool) != (np.hypot(x, y) < limit)).sum() <= 0.005 * free.sum()
    assert free.sum() > 300


def test_a_scan_of_nothing_has_an_outline_too() -> None:
    outline = outline_of_scan(Scan(np.full(90, np.inf), 0.0, 0.02, 0.1, 30.0))
    assert len(outline.points) == 0
    assert not free_cells(outline).any()
    place = features_2d(Scan(np.full(90, np.inf), 0.0, 0.02, 0.1, 30.0), 50.0)
    assert place.signature.shape == (SCAN_SIZE,)
    assert np.isfinite(place.signature).all()
    F, _ = match_features(outline, [outline, outline_of_scan(scan_at((0.0, 0.0, 0.0)))])
    assert np.isfinite(F).all()


@pytest.mark.parametrize("other", [(0.8, 0.4, 1.0), (-1.5, 1.0, 3.0), (1.9, -1.2, -2.2)])
def test_the_placement_is_the_true_pose(other) -> None:
    first, second = (0.0, 0.0, 0.0), other
    a, b = outline_of_scan(scan_at(first)), outline_of_scan(scan_at(second, seed=1))
    F, poses = match_features(a, [b])
    truth = between(np.array(second), np.array(first))
    np.testing.assert_allclose(poses[0][:2], truth[:2], atol=0.12)
    assert abs(math.remainder(poses[0][2] - truth[2], 2 * math.pi)) < math.radians(2.5)
    named = dict(zip(NAMES, F[0], strict=True))
    assert named["lesser share on obstacles"] > 0.85
    assert named["greater share on free floor"] < 0.05
    assert named["distance"] == pytest.approx(np.hypot(*truth[:2]), abs=0.12)


def test_another_room_agrees_less() -> None:
    rng = np.random.default_rng(4)
    here = outline_of_scan(scan_at((0.0, 0.0, 0.0)))
    again = outline_of_scan(scan_at((1.0, 0.5, 0.7), seed=1))
    rooms = [outline_of_scan(scan_at((0.0, 0.0, 0.0), random_room(rng))) for _ in range(8)]
    F, _ = match_features(here, [again, *rooms])
    assert F.shape == (9, MATCH_FEATURES)
    assert F[0, 0] > F[1:, 0].max() + 10.0
    assert F[0, NAMES.index("closeness")] > F[1:, NAMES.index("closeness")].max()


def test_local_maps_of_opposite_directions_are_laid_as_they_are() -> None:
    there, back = LocalMap(length=8.0), LocalMap(length=8.0)
    for k in range(20):
        x = -6.6 + 0.4 * k
        there.add(scan_at((x, 0.0, 0.0), passage(), AHEAD, k), np.array([x, 0.0, 0.0]))
        # Odometry of its own: another frame.
        back.add(scan_at((8.6 - 0.4 * k, 0.3, math.pi), passage(), AHEAD, k), np.array([0.4 * k, 7.0, 0.0]))
    truth = between(np.array([1.0, 0.3, math.pi]), np.array([1.0, 0.0, 0.0]))

    def error(a, b) -> tuple[float, float]:
        F, poses = match_features(a, [b])
        return float(np.hypot(*(poses[0][:2] - truth[:2]))), float(
            F[0, NAMES.index("lesser share on obstacles")]
        )

    off, shared = error(there.outline(), back.outline())
    assert off < 0.3
    # The far ends of the room are seen from one side only.
    assert shared > 0.5


def test_a_pose_that_is_added_up_in_place_moves_no_scan_that_was_kept() -> None:
    one, other, pose = LocalMap(), LocalMap(), np.zeros(3)
    for k in range(6):
        scan = scan_at((0.5 * k, 0.0, 0.0), passage(), AHEAD, k)
        pose[0] = 0.5 * k
        one.add(scan, pose)
        other.add(scan, pose.copy())
    np.testing.assert_array_equal(one.outline().points, other.outline().points)
    with pytest.raises(InputError, match="scan"):
        one.add(np.ones(3), pose)  # type: ignore[arg-type]


def test_a_local_map_forgets_what_is_far_behind_and_starts_anew() -> None:
    around = LocalMap(length=2.0)
    with pytest.raises(InputError, match="no scan"):
        around.outline()
    for k in range(20):
        around.add(scan_at((0.0, 0.0, 0.0)), np.array([0.5 * k, 0.0, 0.0]))
    alone = outline_of_scan(scan_at((0.0, 0.0, 0.0)))
    assert len(around.outline().points) > len(alone.points)
    around.clear()
    around.add(scan_at((0.0, 0.0, 0.0)), np.zeros(3))
    np.testing.assert_array_equal(around.outline().points, alone.points)
    with pytest.raises(InputError, match="pose"):
        around.add(scan_at((0.0, 0.0, 0.0)), np.array([0.0, np.nan, 0.0]))


def test_signatures_do_not_change_when_the_scanner_turns() -> None:
    a, b, far = (
        features_2d(scan_at((0.3, 0.2, 0.0)), 50.0),
        features_2d(scan_at((0.3, 0.2, 2.0)), 50.0),
        features_2d(scan_at((0.3, 0.2, 0.0), random_room(np.random.default_rng(1))), 50.0),
    )
    turned, other = np.abs(a.signature - b.signature), np.abs(a.signature - far.signature)
    assert turned.max() < 0.12
    assert turned.mean() < 0.25 * other.mean()


def test_quantiles_of_a_histogram_are_those_of_its_ranges() -> None:
    ranges = np.random.default_rng(0).uniform(1.0, 20.0, 20_000)
    counts = np.histogram(ranges, np.arange(0.0, 50.05, 0.1))[0].astype(float)
    expected = np.log(np.quantile(ranges, (np.arange(24) + 0.5) / 24))
    np.testing.assert_allclose(range_quantiles(counts, 0.1), expected, atol=0.01)
    assert (range_quantiles(np.zeros(10), 0.1) == 0.0).all()


def test_pairs_in_a_batch_are_laid_as_singly() -> None:
    outlines = [outline_of_scan(scan_at((0.3 * k, 0.0, 0.2 * k), seed=k)) for k in range(4)]
    pairs = Pairs(np.array([0, 2, 1]), np.array([3, 1, 3]), np.zeros(3, dtype=np.int8))
    F, poses = match_pairs(outlines, pairs, cached=2)
    for row, (i, j) in enumerate(((0, 3), (2, 1), (1, 3))):
        one, pose = match_features(outlines[i], [outlines[j]])
        np.testing.assert_array_equal(F[row], one[0])
        np.testing.assert_array_equal(poses[row], pose[0])

"""What moves, scan after scan: within a deadline, and left out of the next scan where it has gone on to."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.geometry.poses import between
from evaluation.registration.odometry_people import WithoutMovers
from evaluation.scenes.labelled_pairs import random_labelled_pairs
from evaluation.scenes.people_scenes import peopled_floor
from registration import Odometry
from registration.crf import online
from registration.crf.online import ScanSegmenter, SegmenterConfig
from whereabouts.simulation import Drive, Lidar, Mover, joined, outlines, random_room

ROUND = Lidar(361, 2.0 * np.pi * 360 / 361)
RATE = 10.0


def test_the_online_segmenter_keeps_its_deadline() -> None:
    (pair,) = random_labelled_pairs(np.random.default_rng(82), "office", 1, lidar=ROUND)
    seconds = iter(np.arange(0.0, 1e4, 0.03))
    segmenter = ScanSegmenter(SegmenterConfig(segment_deadline=0.02), clock=lambda: float(next(seconds)))
    segmenter.keep(pair.scan_a, 0.0, np.zeros(3))
    found = segmenter.segment(pair.scan_b, 0.5, np.zeros(3))
    assert segmenter.skipped == 1
    assert (found.labels == -1).all()
    assert not found.segments
    patient = ScanSegmenter(
        SegmenterConfig(segment_deadline=0.02), in_time=False, clock=lambda: float(next(seconds))
    )
    patient.keep(pair.scan_a, 0.0, np.zeros(3))
    found = patient.segment(pair.scan_b, 0.5, np.zeros(3))
    assert patient.skipped == 0
    assert (found.labels >= 0).sum() > 200


def test_what_moved_is_left_out_of_the_next_scan_where_it_has_gone_on_to() -> None:
    rng, room = np.random.default_rng(4), random_room(np.random.default_rng(12))
    movers = [
        Mover("person", np.array([1.5, -1.0, 1.6]), np.array([0.1, 1.1]), size=0.6),
        Mover("box", np.array([-1.5, 0.5, 0.2]), np.array([0.6, 0.2]), size=0.5),
    ]
    segmenter = ScanSegmenter(in_time=False)
    left = np.zeros(2)
    every = np.zeros(2)
    for k in range(16):
        pose = np.array([0.02 * k, 0.0, 0.01 * k])
        seen = ROUND.scan(joined([room, outlines(movers, k / RATE - 0.8)]), pose, rng, k / RATE)
        still = segmenter.still(seen.scan, k / RATE, pose)
        if k < 3:
            assert still is seen.scan
        elif k > 6:
            moves = seen.owners > 0
            left += [np.sum(still.valid & moves), np.sum(still.valid & ~moves)]
            every += [np.sum(seen.scan.valid & moves), np.sum(seen.scan.valid & ~moves)]
        segmenter.segment(seen.scan, k / RATE, pose)
        segmenter.keep(seen.scan, k / RATE, pose)
    assert left[0] / every[0] < 0.1
    assert left[1] / every[1] > 0.9
    # What moved long ago may be anywhere.
    assert segmenter.still(seen.scan, 1.5 + 0.6, pose) is seen.scan
    segmenter.reset()
    assert segmenter.still(seen.scan, 1.5, pose) is seen.scan


def turning(stamp: float) -> np.ndarray:
    """Stands for 0.8 s, then turns on the spot at 1 rad/s."""
    return np.array([0.3, -0.2, 0.2 + max(stamp - 0.8, 0.0)])


def test_walls_stand_still_while_the_sensor_turns_and_so_does_its_sweep() -> None:
    rng, room = np.random.default_rng(6), random_room(np.random.default_rng(12))
    mover = Mover("person", np.array([1.5, -1.0, 1.6]), np.array([0.1, 1.1]), size=0.6)
    sweeping, segmenter = Lidar(361, ROUND.opening, sweep_time=0.099), ScanSegmenter(in_time=False)
    right = wrong = missed = 0
    for k in range(24):
        world = joined([room, outlines([mover], k / RATE - 1.0)])
        seen = sweeping.scan(world, turning, rng, k / RATE)
        found = segmenter.segment(seen.scan, k / RATE, turning(k / RATE))
        segmenter.keep(seen.scan, k / RATE, turning(k / RATE))
        if k > 11:
            moving = found.labels > 0
            right += int(np.sum(moving & (seen.owners > 0)))
            wrong += int(np.sum(moving & (seen.owners == 0)))
            missed += int(np.sum(~moving & (seen.owners > 0)))
            assert (found.labels[~seen.scan.valid] == -1).all()
    assert right > 4 * missed
    # With the bends of the sweeps in it there are more of walls than of the one who moves.
    assert wrong < 0.2 * right


def test_a_scan_that_is_all_but_filled_by_what_moves_stays_as_it_is() -> None:
    rng, room = np.random.default_rng(4), random_room(np.random.default_rng(12))
    scan = ROUND.scan(room, np.zeros(3), rng).scan
    segmenter = ScanSegmenter(in_time=False)
    for share, kept in ((0.5, False), (0.95, True)):
        few = scan.points()[: round(share * scan.valid.sum())]
        segmenter._moving = online._Moving(few, np.zeros_like(few), 1.0)
        assert (segmenter.still(scan, 1.1, np.zeros(3)) is scan) is kept


@pytest.mark.parametrize("wheels", [True, False])
def test_who_walks_where_walls_leave_the_way_open_does_not_pull_odometry_along(wheels: bool) -> None:
    scene = peopled_floor(np.random.default_rng([1, 5]), 12, 40.0)
    assert isinstance(scene.pose, Drive)
    rng = np.random.default_rng(1)
    away = {}
    scans = [scan for k, scan in enumerate(scene.scans(rng)) if k < 100]
    for odometry in (WithoutMovers(), Odometry()):
        worst = 0.0
        for k, scan in enumerate(scans):
            guess = between(scans[k - 1].pose, scan.pose) if wheels and k else None
            pose = odometry.register(scan.scan, k / RATE, guess=guess)
            off = between(pose, between(scans[0].pose, scan.pose))
            worst = max(worst, float(np.hypot(*off[:2])))
        away[isinstance(odometry, WithoutMovers)] = worst
    assert away[True] < 0.05
    # Good wheels hold what hangs on one body only.
    assert away[False] < 0.2 if wheels else away[False] > 0.2

"""How `whereabouts experiment slam` judges: relations, false closures and revisits against a known path."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from estimation.geometry.poses import between, compound
from estimation.metrics.statistics import relations_error
from evaluation.experiments.odometry import noisy
from evaluation.slam import slam_shaken
from evaluation.slam.slam_judging import (
    CLOSE,
    Followed,
    false_closures,
    jitter,
    largest_miss,
    misses,
    recall,
    relations_of,
    revisits_among,
    true_poses,
    with_scale,
)
from registration import Scan
from whereabouts.logs import ScanRecord

# Along a corridor of 40 m and back, a pose every half metre.
OUT = np.column_stack((np.arange(0.0, 40.0, 0.5), np.zeros(80), np.zeros(80)))
BACK = OUT[::-1] + np.array([0.0, 0.3, np.pi])
TRUTH = np.concatenate((OUT, BACK))


def closure(earlier: int, later: int, off: float = 0.0, turn: float = 0.0) -> tuple[int, int, np.ndarray]:
    c, s = np.cos(TRUTH[earlier, 2]), np.sin(TRUTH[earlier, 2])
    away = TRUTH[later, :2] - TRUTH[earlier, :2]
    relative = np.array([c * away[0] + s * away[1] + off, -s * away[0] + c * away[1], 0.0])
    relative[2] = TRUTH[later, 2] - TRUTH[earlier, 2] + turn
    return earlier, later, relative


def test_closures_off_by_more_than_allowed_are_false() -> None:
    log = SimpleNamespace(truth=TRUTH, poses=TRUTH)
    missed = misses(
        log,
        [closure(70, 89), closure(60, 99, off=0.4), closure(50, 109, off=0.6), closure(40, 119, turn=0.2)],
    )
    assert false_closures(missed, 0.5) == [2, 3]
    assert false_closures(missed, 3.0) == [3]
    assert largest_miss(missed) == pytest.approx(0.6)
    assert largest_miss(misses(log, [])) == 0.0


def test_revisits_are_those_of_the_way_back_and_closed_where_a_closure_ends() -> None:
    path = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(TRUTH[:, :2], axis=0).T))))
    revisits = revisits_among(path, TRUTH)
    # 20 m of path to a place within 2 m: from 10 m less those 2 m before the turning point on.
    assert 60 <= len(revisits) <= 66
    assert recall([149, 139, 139], revisits) == pytest.approx(200.0 / len(revisits))


def test_relations_measure_a_stretch_and_keep_to_their_distances() -> None:
    stretched = TRUTH * np.array([1.01, 1.0, 1.0])
    for least, farthest in ((1.0, 20.0), CLOSE):
        track, relations = relations_of(stretched, TRUTH, least, farthest)
        lengths = np.hypot(relations[:, 2], relations[:, 3])
        assert least < lengths.min()
        assert lengths.max() < farthest
        along = np.abs(
            TRUTH[(relations[:, 1] / 10).astype(int), 0] - TRUTH[(relations[:, 0] / 10).astype(int), 0]
        )
        assert relations_error(track, relations).translation_mean == pytest.approx(
            0.01 * along.mean(), rel=1e-6
        )


def test_jitter_is_that_of_the_reference_alone() -> None:
    rng = np.random.default_rng(0)
    moved = np.array([compound(np.array([3.0, -2.0, 0.7]), pose) for pose in TRUTH])
    assert jitter(moved, TRUTH) == pytest.approx(0.0, abs=1e-9)
    noisy = TRUTH + 0.02 * rng.standard_normal(TRUTH.shape) * [1.0, 1.0, 0.0]
    # Of the difference of two noisy positions: Rayleigh's median with a deviation of 0.02 √2.
    assert jitter(moved, noisy) == pytest.approx(0.02 * np.sqrt(2.0) * 1.177, rel=0.2)


def test_a_scale_is_found_and_what_is_left_with_it() -> None:
    moved = np.array([compound(np.array([3.0, -2.0, 0.7]), pose) for pose in TRUTH])[:, :2]
    scale, left = with_scale(0.98 * moved, TRUTH[:, :2])
    assert scale == pytest.approx(1.0 / 0.98)
    assert left == pytest.approx(0.0, abs=1e-9)


def test_scans_without_a_true_pose_take_that_of_the_nearest_moved_by_odometry() -> None:
    truth = np.full(TRUTH.shape, np.nan)
    truth[::10] = TRUTH[::10]
    odometry = np.array([compound(np.array([3.0, -2.0, 0.7]), pose) for pose in TRUTH])
    log = SimpleNamespace(truth=truth, poses=odometry)
    assert true_poses(log, [0, 4, 37, 76, 84, 159]) == pytest.approx(TRUTH[[0, 4, 37, 76, 84, 159]])


def test_a_shaken_log_keeps_what_is_not_shaken() -> None:
    rng = np.random.default_rng(0)
    scans = [Scan(np.full(8, 2.0 + 0.01 * k), -1.0, 0.25, stamp=float(k)) for k in range(400)]
    records = [ScanRecord(scan, scan.stamp, pose=TRUTH[0]) for scan in scans]
    stamps = [record.stamp for record in records]
    kept = [record.stamp for record in slam_shaken.dropped(records, rng)]
    assert set(kept) < set(stamps)
    assert len(kept) == pytest.approx(360, abs=25)
    twice = [record.stamp for record in slam_shaken.doubled(records, rng)]
    assert twice == sorted(twice)
    assert set(twice) == set(stamps)
    assert len(twice) == pytest.approx(440, abs=25)
    off = np.array([record.stamp for record in slam_shaken.shaken_stamps(records, rng)]) - stamps
    assert 0.004 < np.abs(off).max() <= 0.005
    shaken = noisy(records, rng, 0.01)
    change = np.array([a.scan.ranges - b.scan.ranges for a, b in zip(shaken, records, strict=True)])
    assert change.std() == pytest.approx(0.01, rel=0.1)
    log = Followed(records[:160], TRUTH.copy(), np.zeros((160, 3, 3)), TRUTH, 0.0)
    drifted = slam_shaken.noisy_odometry(log, 0.01, rng).poses
    steps = between(drifted[:-1], drifted[1:]) - between(TRUTH[:-1], TRUTH[1:])
    assert steps[:, :2].std() == pytest.approx(0.01, rel=0.2)

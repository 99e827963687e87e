"""How a trajectory with closed loops is judged: false closures, revisits closed, relations, and the reference too."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound, wrap_angle
from estimation.metrics.statistics import absolute_trajectory_error, align_points, relations_error
from loop_closure.graph.uncertainty import Uncertainty
from loop_closure.keyframes import AROUND, Keyframes
from loop_closure.slam.closing import BACK
from loop_closure.slam.trajectory import Slam
from registration.laser.submap import Submap, fuse
from registration.placement.align_submaps import LEAST_AGREEING, LEAST_OVERLAP, Placement, place
from whereabouts.logs import ScanRecord

Array = NDArray[np.float64]
Closed = tuple[int, int, Array]  # numbers of the earlier and the later scan, and the relative pose
FALSE = (0.5, np.deg2rad(10.0))  # metres and radians from which on a closure is false
DOUBT = 0.5  # metres by which a relative pose may be off from which an overlap is looked for
ALIKE = 0.7  # rad between the headings of scans registered directly
CLOSE = (0.2, 2.0)  # metres between the poses of close relations
TRIES = 20000  # pairs of keyframes drawn for that


@dataclass
class Followed:
    """A log after odometry. poses (N, 3) of the sensor, covariances (N, 3, 3); truth (N, 3), NaN where unknown."""

    records: list[ScanRecord]
    poses: Array
    covariances: Array
    truth: Array
    seconds: float


def true_poses(log: Followed, scans: list[int]) -> Array:
    """True pose (K, 3) at scans: that of the nearest scan that has one, moved on by odometry."""
    known, numbers = np.flatnonzero(np.isfinite(log.truth[:, 0])), np.asarray(scans, dtype=np.int64)
    after = np.clip(np.searchsorted(known, numbers), 1, len(known) - 1)
    at = np.where(numbers - known[after - 1] <= known[after] - numbers, known[after - 1], known[after])
    return np.asarray(compound(log.truth[at], between(log.poses[at], log.poses[numbers])))


def keyframe_truth(slam: Slam, log: Followed) -> Array:
    """True pose (K, 3) of every keyframe."""
    return true_poses(log, list(slam.first_visits().values()))


def closures_of(slam: Slam) -> list[Closed]:
    """The closures by the numbers of their scans: those of keyframes change as some are taken out."""
    first = slam.first_visits()
    return [(first[c.earlier], first[c.later], c.relative) for c in slam.closures]


def misses(log: Followed, closures: Sequence[Closed]) -> Array:
    """By how much (M, 3) closures are off the true relative poses."""
    if not closures:
        return np.zeros((0, 3))
    earlier, later, relatives = zip(*closures, strict=True)
    expected = between(true_poses(log, list(earlier)), true_poses(log, list(later)))
    return np.asarray(between(expected, np.array(relatives)))


def false_closures(missed: Array, tolerance: float = FALSE[0]) -> list[int]:
    """Which of `misses` (M, 3) are more than `tolerance` metres or 10 degrees."""
    wrong = np.hypot(missed[:, 0], missed[:, 1]) > tolerance
    return np.flatnonzero(wrong | (np.abs(wrap_angle(missed[:, 2])) > FALSE[1])).tolist()


def largest_miss(missed: Array) -> float:
    """Metres of the worst of `misses` (M, 3); 0 without any."""
    return float(np.hypot(missed[:, 0], missed[:, 1]).max(initial=0.0))


def revisits_among(paths: Array, truth: Array, near: float = 2.0, apart: float = 20.0) -> dict[int, int]:
    """Keyframes that revisit a place, and the earlier keyframe nearest to each; `paths` (K,) metres to each."""
    found = {}
    for k in range(len(truth)):
        away = np.hypot(*(truth[:k, :2] - truth[k, :2]).T)
        turned = np.abs(wrap_angle(truth[:k, 2] - truth[k, 2]))
        alike = (turned < np.pi / 4) | (turned > 3 * np.pi / 4)
        there = np.flatnonzero((away < near) & (paths[:k] < paths[k] - apart) & alike)
        if len(there):
            found[k] = int(there[np.argmin(away[there])])
    return found


def recall(closed: Collection[int], revisits: Collection[int]) -> float:
    """How many of the keyframes that revisit a place have a closure, %."""
    return 100.0 * len(set(closed) & set(revisits)) / max(len(revisits), 1)


def recalls(slam: Slam, truth: Array) -> tuple[float, float]:
    """`recall` of all revisits, and of those that have outline in common with the place: at least 4 m and 35 %.

    As far as local maps of the path around both show, laid on each other at the true or the estimated relative pose or
    within half a metre of it.
    """
    closed = {closure.later for closure in slam.closures}
    revisits = revisits_among(slam.keyframes.paths, truth)
    common = [k for k, j in revisits.items() if k in closed or overlapping(slam, truth, j, k)]
    return recall(closed, revisits), recall(closed, common)


def overlapping(slam: Slam, truth: Array, j: int, k: int) -> bool:
    """Whether the local maps around keyframes `j` and `k` have enough in common for a closure."""
    source = slam.keyframes.local_map(k, BACK, AROUND)
    target = slam.keyframes.local_map(j, AROUND, AROUND)
    if min(len(source), len(target)) < 20:
        return False
    for poses in (truth, slam.graph.poses):
        placed = place(source, target, between(poses[j], poses[k]), DOUBT)
        if placed.agreeing >= LEAST_AGREEING and placed.overlap >= LEAST_OVERLAP:
            return True
    return False


def with_scale(estimate: Array, truth: Array) -> tuple[float, float]:
    """Scale that brings `estimate` (N, 2) closest to `truth`, and the error in metres that is left with it."""
    T = align_points(estimate, truth)
    moved = (estimate - estimate.mean(axis=0)) @ T[:2, :2].T
    wanted = truth - truth.mean(axis=0)
    scale = float((moved * wanted).sum() / (moved**2).sum())
    return scale, float(np.sqrt(((scale * moved - wanted) ** 2).sum(axis=1).mean()))


def judged_row(
    name: str, kind: str, log: Followed, estimate: Array, missed: Array, tolerance: float,
    recalled: float, overlapping: object, ratio: object, keyframes: int,
) -> list[object]:  # fmt: skip
    """The row of a log in the experiment's table; estimate : (N, 3) of all scans. missed : its `misses`."""
    known = np.flatnonzero(np.isfinite(log.truth[:, 0]))
    truth = log.truth[known]
    errors = [
        absolute_trajectory_error(poses[known, :2], truth[:, :2]).rmse for poses in (log.poses, estimate)
    ]
    relations, close = (
        relations_error(*relations_of(estimate[known], truth, *distances), tolerance=0.5)
        for distances in ((), CLOSE)
    )
    return [
        name, kind, *errors, len(missed), len(false_closures(missed, tolerance)), largest_miss(missed),
        recalled, overlapping, relations.translation_mean, relations.translation_std,
        float(np.degrees(relations.rotation_mean)), close.translation_mean, ratio, keyframes,
    ]  # fmt: skip


def jitter(odometry: Array, truth: Array) -> float:
    """Median difference in metres between steps of the reference and of odometry, from one of its poses to the next.

    Odometry is good to millimetres over so little: what is left is the reference's own.
    """
    steps = np.array(
        [
            between(between(truth[k], truth[k + 1]), between(odometry[k], odometry[k + 1]))
            for k in range(len(truth) - 1)
        ]
    )
    return float(np.median(np.hypot(steps[:, 0], steps[:, 1])))


def relations_of(
    estimate: Array, truth: Array, least: float = 1.0, farthest: float = 20.0, most: int = 4000
) -> tuple[Array, Array]:
    """Trajectory (N, 4) and relations (M, 5) between true poses `least` to `farthest` metres apart.

    Positions in the arrays stand for stamps.
    """
    rng = np.random.default_rng(0)
    stamps = np.arange(len(truth), dtype=np.float64) * 10.0
    # Close pairs are rare among all: more are drawn.
    pairs = rng.integers(0, len(truth), ((20 if farthest > 10.0 else 100) * most, 2))
    away = np.hypot(*(truth[pairs[:, 0], :2] - truth[pairs[:, 1], :2]).T)
    pairs = pairs[(away > least) & (away < farthest)][:most]
    motions = np.array([between(truth[i], truth[j]) for i, j in pairs])
    return np.column_stack((stamps, estimate)), np.column_stack((stamps[pairs], motions))


def worth(slam: Slam, truth: Array, path: float = 100.0, places: int = 60) -> tuple[float, float]:
    """RMS of odometry's error over `path` metres, divided by the deviation it is taken to have: position, heading."""
    frames = slam.keyframes
    odometry = np.array([frames[k].odometry for k in range(len(frames))])
    uncertainty, paths = Uncertainty(), frames.paths
    uncertainty.learn([edge for edge in slam.graph.edges if not edge.closure])
    ratios = []
    for k in np.linspace(0, len(frames) - 1, places).astype(int):
        j = int(np.searchsorted(paths, paths[k] + path))
        if j >= len(frames):
            break
        sigma, turn = uncertainty.around(odometry, int(k))
        off = between(between(truth[k], truth[j]), between(odometry[k], odometry[j]))
        ratios.append((np.hypot(*off[:2]) / sigma[j], off[2] / turn[j]))
    if not ratios:
        return np.nan, np.nan
    position, heading = np.sqrt(np.mean(np.square(ratios), axis=0))
    return float(position), float(heading)


def against_scans(slam: Slam, truth: Array, least: float = 3.0, farthest: float = 12.0) -> Array:
    """Medians (2, 2): m and rad by which the estimate, and the reference, miss scans registered directly.

    The scans are single ones, `least` to `farthest` metres apart with about the same heading, which fix all three
    directions to 4 cm: neither map nor odometry is in between.
    """
    rng, poses, frames = np.random.default_rng(0), slam.graph.poses, slam.keyframes
    pairs = np.sort(rng.integers(0, len(poses), (TRIES, 2)), axis=1)
    away = np.hypot(*(poses[pairs[:, 0], :2] - poses[pairs[:, 1], :2]).T)
    turned = np.abs(wrap_angle(poses[pairs[:, 0], 2] - poses[pairs[:, 1], 2]))
    known: dict[int, Submap] = {}
    misses = []
    for i, j in pairs[(away > least) & (away < farthest) & (turned < ALIKE)]:
        relative = between(poses[i], poses[j])
        source, target = (_alone(frames, int(n), known) for n in (j, i))
        placed = place(source, target, relative, 0.15)
        if not _decided(placed):
            continue
        offs = [between(placed.pose, other) for other in (relative, between(truth[i], truth[j]))]
        misses.append([(np.hypot(*off[:2]), abs(off[2])) for off in offs])
    return np.median(misses, axis=0) if misses else np.full((2, 2), np.nan)


def _alone(frames: Keyframes, k: int, known: dict[int, Submap]) -> Submap:
    prepared = frames[k].prepared
    assert prepared is not None
    if k not in known:
        known[k] = fuse([prepared], np.zeros((1, 3)))
    return known[k]


def _decided(placed: Placement) -> bool:
    sure = not placed.open_directions and placed.agreeing >= 3.0 and placed.fitness >= 0.9
    return bool(sure and np.sqrt(np.diag(placed.covariance)[:2]).max() < 0.04)

"""SLAM as the node does it: keyframes of known places are taken out on the way, and every closure counts once made."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.metrics.statistics import absolute_trajectory_error, relations_error
from evaluation.slam.slam_judging import (
    CLOSE,
    Followed,
    false_among,
    largest_among,
    relations_of,
    revisits_among,
    true_poses,
)
from loop_closure.slam.trajectory import Slam

Array = NDArray[np.float64]


@dataclass
class Driven:
    """What the node would have said along a log.

    estimate (N, 3) : of all scans in the end. kept : scans that became keyframes, and `paths` in metres to each.
    closures : scans of the earlier and the later place, and the relative pose, as they were made.
    """

    estimate: Array
    kept: list[int]
    paths: list[float]
    closures: list[tuple[int, int, Array]]
    left: int
    seconds: float


def driven(log: Followed) -> Driven:
    """Close the loops of a log, thinning on the way."""
    begun = time.perf_counter()
    slam = Slam(thin=True, every_scan=True)
    kept: list[int] = []
    paths: list[float] = []
    closures: list[tuple[int, int, Array]] = []
    for number, record in enumerate(log.records):
        update = slam.process(record.scan, log.poses[number], log.covariances[number])
        if update.keyframe is not None:
            kept.append(number)
            paths.append(slam.keyframes[update.keyframe].path)
        if update.closures:
            # Numbers change as keyframes are taken out; scans keep theirs.
            first = slam.first_visits()
            closures += [(first[c.earlier], first[c.later], c.relative) for c in update.closures]
    estimate = slam.trajectory()[:, 1:]
    elapsed = time.perf_counter() - begun + log.seconds
    return Driven(estimate, kept, paths, closures, len(slam.keyframes), elapsed)


def row(name: str, kind: str, log: Followed, run: Driven, tolerance: float) -> list[object]:
    """The line of a log in the experiment's table."""
    known = np.flatnonzero(np.isfinite(log.truth[:, 0]))
    truth, estimate = log.truth[known], run.estimate[known]
    before = absolute_trajectory_error(log.poses[known, :2], truth[:, :2]).rmse
    after = absolute_trajectory_error(estimate[:, :2], truth[:, :2]).rmse
    earlier = true_poses(log, [a for a, _, _ in run.closures])
    later = true_poses(log, [b for _, b, _ in run.closures])
    worst = largest_among(earlier, later, [relative for _, _, relative in run.closures])
    rank = {number: k for k, number in enumerate(run.kept)}
    found = revisits_among(np.array(run.paths), true_poses(log, run.kept))
    closed = {rank[again] for _, again, _ in run.closures} & set(found)
    relations = relations_error(*relations_of(estimate, truth), tolerance=0.5)
    close = relations_error(*relations_of(estimate, truth, *CLOSE), tolerance=0.5)
    return [
        name, kind, float(before), float(after), len(run.closures),
        len(false_closures(run, log, tolerance)), worst, 100.0 * len(closed) / max(len(found), 1), "",
        float(relations.translation_mean), float(relations.translation_std),
        float(np.degrees(relations.rotation_mean)), float(close.translation_mean), "", run.left,
    ]  # fmt: skip


def false_closures(run: Driven, log: Followed, tolerance: float) -> list[int]:
    """Numbers of the closures that were false when they were made."""
    earlier = true_poses(log, [a for a, _, _ in run.closures])
    later = true_poses(log, [b for _, b, _ in run.closures])
    return false_among(earlier, later, [relative for _, _, relative in run.closures], tolerance)

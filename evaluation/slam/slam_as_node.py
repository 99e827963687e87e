"""SLAM as the node does it: keyframes of known places are taken out on the way, and every closure counts once made."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluation.slam.slam_judging import (
    Closed,
    Followed,
    judged_row,
    misses,
    recall,
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
    closures: list[Closed]
    left: int
    seconds: float


def driven(log: Followed) -> Driven:
    """Close the loops of a log, thinning on the way."""
    begun = time.perf_counter()
    slam = Slam(thin=True, every_scan=True)
    kept: list[int] = []
    paths: list[float] = []
    closures: list[Closed] = []
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
    rank = {number: k for k, number in enumerate(run.kept)}
    found = revisits_among(np.array(run.paths), true_poses(log, run.kept))
    closed = recall({rank[again] for _, again, _ in run.closures}, found)
    missed = misses(log, run.closures)
    return judged_row(name, kind, log, run.estimate, missed, tolerance, closed, "", "", run.left)

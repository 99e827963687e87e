"""Moving beams over a window of scans: each compared with several others of them, and one decision per piece.

Consecutive scans show almost no motion, so each scan is compared with some half a second to a second away, before and
(where the recording goes on) after. What a pair cannot decide, because it is hidden or slides along itself, another
pair often can.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.poses import between
from registration.crf.beams import beams_of
from registration.crf.estimate import JointEstimate
from registration.crf.joint_model import JointModel
from registration.laser.prepared import prepared
from registration.laser.scan import Scan
from registration.placement.align import among_movers

INTERVALS = (-1.0, -0.8, -0.6, -0.4, 0.4, 0.6, 0.8, 1.0)  # seconds to the scans compared with
FARTHEST = 1.5  # metres the sensor may have gone between two scans that are compared
WALL = 2.0  # metres across a piece from which each of its beams decides for itself
MOVES = 0.5  # mean probability of a piece from which it moves


def partners(
    stamps: FloatArray, poses: FloatArray, index: int, intervals: Sequence[float] = INTERVALS
) -> list[int]:
    """Which scans to compare scan `index` with: one per interval, where the recording has one near enough."""
    chosen: list[int] = []
    for interval in intervals:
        wanted = stamps[index] + interval
        nearest = int(np.argmin(np.abs(stamps - wanted)))
        away = float(np.hypot(*(poses[nearest, :2] - poses[index, :2])))
        if abs(stamps[nearest] - wanted) < 0.15 and away < FARTHEST and nearest not in (index, *chosen):
            chosen.append(nearest)
    return chosen


def mean_probability(estimates: Sequence[JointEstimate], beams: int) -> FloatArray:
    """(N,) that each beam of one scan moves, by all pairs that say something of it; NaN where none does."""
    said = [each.probabilities for each in estimates if each.converged]
    if not said:
        return np.full(beams, np.nan)
    told = np.isfinite(said).sum(axis=0)
    return np.where(told > 0, np.nansum(said, axis=0) / np.maximum(told, 1), np.nan)


def decide(scan: Scan, probability: FloatArray) -> NDArray[np.int64]:
    """Labels (N,): number of the moving piece from 1, 0 static, -1 no return or nothing known.

    probability : (N,) that each beam moves, NaN where nothing is known (`mean_probability`).
    """
    made = beams_of(scan)
    labels = np.full(len(scan), -1, dtype=np.int64)
    own, pieces = probability[made.beams], made.pieces
    if not len(pieces):
        return labels
    told = np.isfinite(own)
    own = np.where(told, own, 0.0)
    mean = np.bincount(pieces, own) / np.maximum(np.bincount(pieces, told), 1)
    # A piece moves as a whole or not at all, unless it is a wall with something before it.
    moving = np.where(_lengths(made.points, pieces)[pieces] < WALL, mean[pieces], own) > MOVES
    found = np.where(told, 0, -1)
    found[moving] = np.unique(pieces[moving], return_inverse=True)[1] + 1
    labels[made.beams] = found
    return labels


def _lengths(points: FloatArray, pieces: NDArray[np.int64]) -> FloatArray:
    """(pieces,) metres across each piece."""
    count = int(pieces.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, pieces, points)
    np.maximum.at(high, pieces, points)
    return np.asarray(np.hypot(*(high - low).T))


def segment(
    model: JointModel, scans: Sequence[Scan], stamps: FloatArray, poses: FloatArray, index: int,
    intervals: Sequence[float] = INTERVALS,
) -> NDArray[np.int64]:  # fmt: skip
    """Labels (N,) of scan `index` of a recording with sensor poses (M, 3) by odometry; see `decide`."""
    scan = scans[index]
    estimates = []
    moving = prepared(scan)
    for other in partners(stamps, poses, index, intervals):
        still = prepared(scans[other])
        registration = among_movers(moving, still, between(poses[other], poses[index]))
        estimates.append(model.infer(scan, scans[other], registration if registration.converged else None))
    return decide(scan, mean_probability(estimates, len(scan)))

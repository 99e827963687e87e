"""Moving beams over a window of scans: the joint inference against several others of them, and one decision per piece.

Consecutive scans show almost no motion, so each scan is compared with some half a second to a second away, before and
(where the recording goes on) after. What a pair cannot decide, because it is hidden or slides along itself, another
pair often can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.poses import between
from registration.align import among_movers
from registration.crf.beams import beams_of
from registration.crf.estimate import JointEstimate
from registration.crf.model import JointModel
from registration.crf.prepared import prepared
from registration.motion import Array
from registration.scan import Scan

INTERVALS = (-1.0, -0.8, -0.6, -0.4, 0.4, 0.6, 0.8, 1.0)  # seconds to the scans compared with
FARTHEST = 1.5  # metres the sensor may have gone between two scans that are compared
STATIC_VOTE = -0.6  # of a pair in which a beam is background; that it moves counts 1
MOVES = 0.25  # mean vote of a piece from which it moves


@dataclass(frozen=True, eq=False)
class Votes:
    """Votes for one scan: total (N,) and how many pairs had an opinion (N,)."""

    total: Array
    count: NDArray[np.int64]


def partners(stamps: Array, poses: Array, index: int, intervals: Sequence[float] = INTERVALS) -> list[int]:
    """Which scans to compare scan `index` with: one per interval, where the recording has one near enough."""
    chosen: list[int] = []
    for interval in intervals:
        wanted = stamps[index] + interval
        nearest = int(np.argmin(np.abs(stamps - wanted)))
        away = float(np.hypot(*(poses[nearest, :2] - poses[index, :2])))
        if abs(stamps[nearest] - wanted) < 0.15 and away < FARTHEST and nearest not in (index, *chosen):
            chosen.append(nearest)
    return chosen


def vote(estimates: Sequence[JointEstimate], beams: int) -> Votes:
    """Sum of what several pairs say about the beams of one scan.

    A beam without partner may have moved or be hidden: its vote lies between, by its probability of moving. Left out,
    it would be heard only in the pairs that believe that it moves.
    """
    total, count = np.zeros(beams), np.zeros(beams, dtype=np.int64)
    for estimate in estimates:
        if not estimate.converged:
            continue
        moving, static = estimate.clusters > 0, estimate.clusters == 0
        told = np.isfinite(estimate.probabilities)
        doubtful = STATIC_VOTE + (1.0 - STATIC_VOTE) * np.where(told, estimate.probabilities, 0.0)
        total += np.where(moving, 1.0, np.where(static, STATIC_VOTE, np.where(told, doubtful, 0.0)))
        count += moving | static | told
    return Votes(total, count)


def decide(scan: Scan, votes: Votes) -> NDArray[np.int64]:
    """Labels (N,): number of the moving piece from 1, 0 static, -1 no return or no opinion."""
    made = beams_of(scan)
    labels = np.full(len(scan), -1, dtype=np.int64)
    total, count = votes.total[made.beams], votes.count[made.beams]
    pieces = made.pieces
    if not len(pieces):
        return labels
    mean = np.bincount(pieces, total) / np.maximum(np.bincount(pieces, count), 1)
    own = np.where(count > 0, total / np.maximum(count, 1), 0.0)
    length = _lengths(made.points, pieces)
    # A piece moves as a whole or not at all, unless it is a wall with something before it.
    score = np.where(length[pieces] < 2.0, mean[pieces], own)
    moving = score > MOVES
    numbers = np.unique(pieces[moving], return_inverse=True)[1] + 1
    found = np.where(count > 0, 0, -1)
    found[moving] = numbers
    labels[made.beams] = found
    return labels


def _lengths(points: Array, pieces: NDArray[np.int64]) -> Array:
    """(pieces,) metres across each piece."""
    count = int(pieces.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, pieces, points)
    np.maximum.at(high, pieces, points)
    return np.asarray(np.hypot(*(high - low).T))


def segment(
    model: JointModel, scans: Sequence[Scan], stamps: Array, poses: Array, index: int,
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
    return decide(scan, vote(estimates, len(scan)))

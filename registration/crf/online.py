"""What moves in each scan of a running robot: compared with a few earlier scans, within a deadline.

Consecutive scans show almost no motion; the scans compared with are those half a second and more ago, so that a slow
walker has gone farther than the noise. A scan for which there is no time is not labelled, and counted; `Pace` says how
much there is. Odometry does not wait for labels: it does without what moved in the scan before (`ScanSegmenter.still`).

Scans are compared as seen from where their first beams were sent: a sensor that turns bends its sweeps, and walls that
are bent otherwise than half a second ago look as if they moved.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from estimation.geometry.poses import between, compound, inverse, inverse_covariance, transform_points
from estimation.settings import check_settings, setting
from registration.crf.estimate import JointEstimate
from registration.crf.joint_model import JointModel
from registration.crf.window import FARTHEST, decide, mean_probability
from registration.laser.prepared import prepared
from registration.laser.scan import Scan
from registration.laser.sweep import moved_to_first_beam
from registration.odometry.pace import Duration
from registration.placement.expected import near_expected
from registration.result import UNKNOWN

LEAST_LEFT = 0.3  # share of the returned beams that has to stand for odometry to do without the others
LEAST_BEAMS = 30  # of them, likewise
SPACING = 0.04  # seconds between scans that are remembered
SWING = (
    0.45  # metres around where a beam's body has gone on to: a leg swings ahead of it. 0.3 leaves too much
)


@dataclass(frozen=True)
class SegmenterConfig:
    """Settings of `ScanSegmenter`; each field's metadata has its unit, meaning and allowed range."""

    segment_scans: bool = setting(
        True, "", "label moving objects in each scan and leave them out of odometry"
    )
    segment_interval: float = setting(
        0.5, "s", "age of the earlier scan that each scan is compared with", 0.1, 5.0
    )
    segment_references: int = setting(2, "", "number of earlier scans that each scan is compared with", 1, 8)
    segment_deadline: float = setting(
        0.05,
        "s",
        "time limit for the labels of a scan, less at high scan rates; none in lock-step replay",
        0.0,
        10.0,
    )

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, eq=False)
class MovingSegment:
    """One rigid body of a scan. motion (3,), covariance (3, 3): of the body from the earlier scan to this one, in this
    scan's frame; interval : seconds between the two; probability : that it moves."""

    label: int
    motion: FloatArray
    covariance: FloatArray
    interval: float
    probability: float


@dataclass(frozen=True, eq=False)
class Segmented:
    """Labels of one scan, (N,): number of the moving segment from 1, 0 static, -1 unknown; probabilities (N,) that each
    beam moves, NaN where unknown; segments, the background first, none where nothing is known."""

    labels: NDArray[np.int64]
    probabilities: FloatArray
    segments: list[MovingSegment]


@dataclass(frozen=True, eq=False)
class _Kept:
    scan: Scan
    stamp: float
    pose: FloatArray


@dataclass(frozen=True, eq=False)
class _Moving:
    """What a scan showed to move: points (M, 2), m, and velocities (M, 2), m/s, in the frame of the poses."""

    points: FloatArray
    velocities: FloatArray
    stamp: float


class ScanSegmenter:
    """Labels scan after scan of one sensor.

    Attributes
    ----------
    labelled, skipped : how many scans were, and how many there was no time for.
    """

    def __init__(
        self,
        config: SegmenterConfig | None = None,
        in_time: bool = True,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """in_time : keep to the deadline and to limits; False where results have to repeat. clock : s, monotonic."""
        self.config = config or SegmenterConfig()
        self._model = JointModel.load()
        self._in_time, self._clock = in_time, clock
        self.reset()

    def reset(self) -> None:
        """Forget all scans."""
        self._kept: deque[_Kept] = deque()
        self._last: tuple[float, FloatArray] | None = None  # stamp and pose of the scan before
        self._unbent: tuple[Scan, Scan, NDArray[np.int64]] | None = (
            None  # a scan, and what `_at_once` made of it
        )
        self._moving: _Moving | None = None
        self._duration = Duration()
        self.labelled = self.skipped = 0

    def keep(self, scan: Scan, stamp: float, pose: FloatArray) -> None:
        """Remember a scan and where odometry puts its sensor, (3,)."""
        if self._kept and stamp <= self._kept[-1].stamp:
            return
        if not self._kept or stamp - self._kept[-1].stamp >= SPACING:
            self._kept.append(_Kept(self._at_once(scan, stamp, pose)[0], stamp, pose.copy()))
        self._last = stamp, pose.copy()
        longest = self.config.segment_interval * (self.config.segment_references + 0.5)
        while len(self._kept) > 1 and stamp - self._kept[1].stamp > longest:
            self._kept.popleft()

    def still(self, scan: Scan, stamp: float, pose: FloatArray) -> Scan:
        """A scan expected at `pose` (3,) without what moved when one was labelled last, as far as it has gone on.

        As it is where that is long ago, or where too little would be left.
        """
        moving = self._moving
        if moving is None or not 0.0 <= stamp - moving.stamp <= self.config.segment_interval:
            return scan
        beams = np.flatnonzero(scan.valid)
        points = transform_points(pose, scan.points())
        bodies = cKDTree(moving.points + (stamp - moving.stamp) * moving.velocities)
        gone = np.isfinite(bodies.query(points, distance_upper_bound=SWING)[0])
        if len(beams) - gone.sum() < max(LEAST_LEFT * len(beams), LEAST_BEAMS):
            return scan
        mask = np.zeros(len(scan), dtype=bool)
        mask[beams[gone]] = True
        return scan.without(mask)

    def fits(self, limit: float) -> bool:
        """Whether a comparison with one earlier scan is expected to take at most `limit` seconds."""
        return not self._in_time or self._duration.expected <= limit

    def segment(self, scan: Scan, stamp: float, pose: FloatArray, limit: float = np.inf) -> Segmented:
        """Label a scan whose sensor is expected at `pose` (3,), in the frame of the poses that were kept.

        limit : seconds there are; a further comparison that is not expected to fit is left out.
        """
        begun = self._clock()
        swept, (scan, beams) = scan, self._at_once(scan, stamp, pose)
        references = self._references(stamp, pose)
        if not references:
            return _unknown(swept)
        limit = min(limit, self.config.segment_deadline)
        found: list[tuple[JointEstimate, float]] = []
        tried = 0
        for kept in references:
            before = self._clock()
            if not self.fits(limit - (before - begun)):
                break
            tried += 1
            # The background's motion is told by the first pair; the others need it only to see what left its place.
            first = not found
            registration = near_expected(prepared(scan), prepared(kept.scan), between(kept.pose, pose), first)
            if registration.converged:
                known = None if first else found[0][0]
                estimate = self._model.movers(scan, kept.scan, registration, first, known)
                if estimate.converged:
                    found.append((estimate, stamp - kept.stamp))
                pose = compound(kept.pose, registration.transform)
            self._duration.took(self._clock() - before)
        if not tried:
            self.skipped += 1
            self._duration.not_done()
            return _unknown(swept)
        self.labelled += 1
        segmented = _combined(scan, found)
        self._moving = _moving(segmented, scan, stamp, pose)
        return _of_beams(segmented, beams, swept.valid)

    def _at_once(self, scan: Scan, stamp: float, pose: FloatArray) -> tuple[Scan, NDArray[np.int64]]:
        """A scan as seen from its first beam at `pose` (3,), and (N,) where its beams are in that, -1 nowhere."""
        if self._last is None:
            return scan, np.arange(len(scan))
        before, there = self._last
        if self._unbent is None or self._unbent[0] is not scan:
            # Kept: what is prepared of a scan is prepared once in its life.
            self._unbent = scan, *moved_to_first_beam(scan, between(there, pose), stamp - before)
        return self._unbent[1:]

    def _references(self, stamp: float, pose: FloatArray) -> list[_Kept]:
        """Earlier scans to compare with, one per multiple of the interval."""
        interval = self.config.segment_interval
        chosen: list[_Kept] = []
        for multiple in range(1, self.config.segment_references + 1):
            wanted = stamp - multiple * interval
            near = [kept for kept in self._kept if abs(kept.stamp - wanted) <= 0.5 * interval]
            near = [kept for kept in near if np.hypot(*(kept.pose[:2] - pose[:2])) < FARTHEST]
            best = min(near, key=lambda kept: abs(kept.stamp - wanted), default=None)
            if best is not None and best not in chosen:
                chosen.append(best)
        return chosen


def _moving(segmented: Segmented, scan: Scan, stamp: float, pose: FloatArray) -> _Moving | None:
    """What moves in a labelled scan whose sensor is at `pose` (3,); None where nothing does."""
    labels = segmented.labels[scan.valid]
    points, labels = scan.points()[labels > 0], labels[labels > 0]
    if not len(points):
        return None
    ahead = points.copy()  # where each would be a second on
    for segment in segmented.segments[1:]:
        mine = labels == segment.label
        there = transform_points(inverse(segment.motion), points[mine])
        ahead[mine] += (points[mine] - there) / segment.interval
    at, on = transform_points(pose, points), transform_points(pose, ahead)
    return _Moving(at, on - at, stamp)


def _of_beams(segmented: Segmented, beams: NDArray[np.int64], valid: NDArray[np.bool_]) -> Segmented:
    """What is said of a scan seen from its first beam, said of the beams that saw it; beams, valid : (N,)."""
    told = valid & (beams >= 0)
    labels = np.where(told, segmented.labels[beams], -1)
    return Segmented(labels, np.where(told, segmented.probabilities[beams], np.nan), segmented.segments)


def _unknown(scan: Scan) -> Segmented:
    return Segmented(np.full(len(scan), -1, dtype=np.int64), np.full(len(scan), np.nan), [])


def _combined(scan: Scan, found: list[tuple[JointEstimate, float]]) -> Segmented:
    """Labels by the votes of all pairs; each segment has its motion from the first pair that found it."""
    if not found:
        return _unknown(scan)
    first, interval = found[0]
    known = np.any([estimate.clusters >= 0 for estimate, _ in found], axis=0)
    labels = np.where(known, 0, -1)
    probabilities = np.mean([np.nan_to_num(each.probabilities) for each, _ in found], axis=0)
    probabilities[~scan.valid] = np.nan
    segments = [_segment(0, first.motions[0], first.covariances[0], interval, 0.0)]
    if not any(_some_moves(estimate) for estimate, _ in found):
        return Segmented(labels, probabilities, segments)
    moving = first.clusters > 0
    if len(found) > 1:
        moving = decide(scan, mean_probability([estimate for estimate, _ in found], len(scan))) > 0
    rest = moving.copy()
    for estimate, seconds in found:
        for k in range(1, len(estimate.motions)):
            members = rest & (estimate.clusters == k)
            if members.sum() < 3:
                continue
            number = len(segments)
            labels[members], rest[members] = number, False
            share = float(np.mean(probabilities[members]))
            segments.append(_segment(number, estimate.motions[k], estimate.covariances[k], seconds, share))
    if rest.any():
        # Beams of moving pieces that no cluster of enough beams has: part of the segment nearest in bearing.
        told = np.flatnonzero(labels > 0)
        if len(told):
            loose = np.flatnonzero(rest)
            labels[loose] = labels[told[np.abs(loose[:, None] - told[None]).argmin(axis=1)]]
        else:
            labels[rest] = len(segments)
            segments.append(_segment(len(segments), first.motions[0], UNKNOWN, interval, 0.5))
    return Segmented(labels, probabilities, segments)


def _some_moves(estimate: JointEstimate) -> bool:
    """Whether anything moves, or is more likely to than not."""
    return bool((estimate.clusters > 0).any() or (estimate.probabilities > 0.5).any())


def _segment(
    label: int, motion: FloatArray, covariance: FloatArray, interval: float, probability: float
) -> MovingSegment:
    """`motion` takes this scan's points to the earlier scan; told is the way forward, in this scan's frame."""
    forward = inverse_covariance(motion, covariance)
    return MovingSegment(label, inverse(motion), forward, interval, probability)

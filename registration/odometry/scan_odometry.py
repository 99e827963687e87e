"""Planar odometry: each scan is registered to the local map around it.

Prediction by the wheels, or by the last motion again (logs have stamps that jitter and run backwards, so no velocity
is made of them); refinement on lines; where that does not agree with the map, a correlative search around the
prediction; where that fails too, the prediction is kept and said to be one, and after a while a new map is begun.

A scan is laid on the map as seen from where the sensor was in the middle of its sweep: there an error of the motion
that is taken out of the sweep pulls one half as far forwards as the other backwards. From the first beam it would pull
all one way, come back as an error of the next motion, and without wheels grow from scan to scan.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import (
    between,
    compound,
    compound_jacobians,
    inverse,
    transform_points,
    wrap_angle,
)
from registration.laser.local_map import LineMap
from registration.laser.prepared import NOISE, PreparedScan, view_of
from registration.laser.range_noise import RangeNoise
from registration.laser.scan import Scan
from registration.laser.surface import Surface, scan_surface
from registration.laser.sweep import beam_shares
from registration.odometry.habit import Habit
from registration.odometry.map_matching import GROSS, ExpectedPose, MapMatcher, Match
from registration.odometry.odometry_config import OdometryConfig
from registration.odometry.odometry_step import Step
from registration.odometry.range_offset import RangeOffset
from registration.odometry.wheel_doubt import REFUTED, WheelDoubt, prediction_covariance
from registration.placement.influence import borrowed
from registration.placement.refine import EFFICIENCY, Refined

DRIFT = 0.1  # share of a keyframe's covariance that stays: the map takes the error in
LEAST_LINED = 15  # points on lines below which a scan is not registered
# Share of the last motion that is expected next where nothing has told of it but itself, without wheels: a sensor that
# has stopped meanwhile must not be driven on for ever.
FADE = 0.5
CARRIED = 1.5  # m/s, deviation of a sensor that nobody follows: somebody may walk with it
# rad, deviation of a heading of which nothing is known: two and a half are half a turn, as far as closures are looked
# for. More would make places farther off than any heading does: a circle's deviation is its radius.
ANY_HEADING = math.pi / 2.5


class ScanTracker:
    """Follows scans against a map of line elements."""

    def __init__(self, config: OdometryConfig | None = None) -> None:
        self.config = config or OdometryConfig()
        # The second in the map of the scans since the first was lost; takes its place if that is not found again.
        self._matcher, self._spare = self._empty(), self._empty()
        self.offset, self.noise = RangeOffset(), RangeNoise(NOISE)
        self.pose = np.zeros(3)
        self._habit, self._wheels = Habit(), WheelDoubt()
        self._key, self._sure = np.zeros(3), np.zeros(3)
        self._sure_at = 0.0  # s
        self._at_best = 0.0  # nat, the lowest odds that a scan has had at best since the map was lost
        self._last = np.zeros(3)  # motion of the last step, which took as many times the usual
        self._periods = 1
        self._stamp: float | None = None
        # Motion from the first beam of the last scan to the middle of its sweep, and its covariance.
        self._ahead = np.zeros(3), np.zeros((3, 3))
        self._travelled = 0.0
        self._lost = self._open = 0
        self._noise = np.zeros((3, 3))  # covariance of the pose against the map, odometry frame

    def _empty(self) -> MapMatcher:
        made = LineMap(self.config.map_radius, self.config.map_memory)
        return MapMatcher(made, self.config.doubt, self.config.tolerance)

    @property
    def map(self) -> LineMap:
        """Of the surroundings."""
        return self._matcher.map

    def step(
        self, scan: Scan, stamp: float, guess: FloatArray | None, sweep: FloatArray | None = None
    ) -> Step:
        """Register one scan; `guess` (3,) is the expected motion since the last, `sweep` (3,) that in its sweep."""
        elapsed = 0.0 if self._stamp is None else stamp - self._stamp
        self._stamp = stamp
        before, self._periods = self._periods, self._habit.periods(elapsed)
        self._last = self._last * (self._periods / before)
        self.noise.learn(scan)
        share = beam_shares(scan, elapsed)
        half = 0.5 * float(share[-1]) if len(share) else 0.0
        if guess is None or sweep is None or not half:
            last = self._last
            step = self._from_middle(scan, guess, share - half, None)
            # Its speed may have changed as much as it did before.
            doubt = np.diag(0.5 * half * (step.increment - last)) ** 2
            return self._from_first_beam(step, half * step.increment, doubt)
        motion = between(self._ahead[0], compound(guess, 0.5 * sweep))
        step = self._from_middle(scan, motion, share - half, sweep / (2.0 * half))
        # What the wheels got wrong since the last scan they get wrong in the sweep.
        ahead = 0.5 * sweep + half * (step.increment - motion)
        return self._from_first_beam(step, ahead, half * self._wheels.covariance(motion))

    def _from_first_beam(self, step: Step, ahead: FloatArray, doubt: FloatArray) -> Step:
        """A step between the middles of two sweeps as one between their first beams, where scans are stamped.

        ahead : (3,) motion in the first half of the sweep. doubt : its covariance (3, 3).
        """
        (before, doubt_before), self._ahead = self._ahead, (ahead, doubt)
        if not np.any(before) and not np.any(ahead):
            return step
        increment = compound(compound(before, step.increment), inverse(ahead))
        points = transform_points(ahead, step.static_points)
        covariance = step.covariance + doubt_before + doubt
        noise = None if step.noise is None else step.noise + in_frame(doubt, -float(self.pose[2]))
        return replace(step, increment=increment, covariance=covariance, static_points=points, noise=noise)

    def _from_middle(
        self, scan: Scan, guess: FloatArray | None, share: FloatArray, pace: FloatArray | None
    ) -> Step:
        """share : (N,) when each beam was sent after the middle of the sweep, of the time since the last scan.

        guess : (3,) motion from middle to middle. pace : (3,) motion in the sweep per such time, None as guessed.
        """
        motion = guess if guess is not None else self._habit.expected(self._last)
        prepared = self._prepared(scan, share, motion if pace is None else pace)
        lined = int(prepared.surface.lined.sum())
        poor = (
            f"only {lined} points on lines; at least {LEAST_LINED} are needed" if lined < LEAST_LINED else ""
        )
        if not len(self.map):
            return self._begin(prepared, motion, poor)
        if poor:
            return self._predict(motion, guess is not None, poor, 0.0)
        expected = self._expected(motion, guess is not None)
        match = self._matcher.find(prepared, expected, self._sure)
        if not match.believable and guess is not None and share.any():
            # Wheels that leap bend a sweep until it looks like nothing.
            unbent = self._prepared(scan, share, self._last)
            found = self._matcher.find(unbent, expected, self._sure)
            prepared, match = (unbent, found) if found.believable else (prepared, match)
        if not match.believable:
            return self._stray(prepared, motion, expected, match)
        return self._accept(prepared, motion, guess is not None, match)

    def _prepared(self, scan: Scan, share: FloatArray, pace: FloatArray) -> PreparedScan:
        """A scan as seen from where the sensor was in the middle of its sweep; share, pace : as of `_from_middle`."""
        sweep = (pace, share) if share.any() else None
        surface = scan_surface(scan, self.noise.value, self.config.max_range, self.offset.value, sweep)
        return PreparedScan(surface, view_of(scan))

    def _expected(self, motion: FloatArray, wheels: bool) -> ExpectedPose:
        """Where a motion leads, and how surely: the less, the longer the map has been lost.

        Wheels err as any prediction where they stall or jump, however good they have been; what they hold is a prior.
        """
        pose, doubt = compound(self.pose, motion), prediction_covariance(motion)
        prior = None
        if wheels:
            prior = pose, np.asarray(np.linalg.inv(self._wheel_covariance(motion) / EFFICIENCY))
        else:
            doubt = doubt + self._habit.doubt
        return ExpectedPose(pose, in_frame((1.0 + self._lost) * doubt, -float(self.pose[2])), prior)

    def _wheel_covariance(self, motion: FloatArray) -> FloatArray:
        """(3, 3) of where a motion leads that wheels tell of, odometry frame."""
        return in_frame(self._wheels.covariance(motion), -float(self.pose[2]))

    def _begin(self, scan: PreparedScan, motion: FloatArray, poor: str) -> Step:
        """Start a map here: at the first scan, and where the old map is of no use any more."""
        first = self._travelled == 0.0 and not self._lost
        doubt = drift = np.zeros((3, 3))
        if not first:
            doubt = prediction_covariance(motion)
            self._go(motion, doubt)
            drift = in_frame(self._noise, float(self.pose[2] - motion[2]))
        self._noise = np.zeros((3, 3))
        self._sure, self._sure_at = self.pose, self._stamp or 0.0
        if not poor:
            self._lost = 0
            self._insert(scan)
        reason = poor or ("" if first else "a new map begins at the predicted pose")
        static = scan.surface.points if not poor else scan.surface.points[:0]
        increment = np.zeros(3) if first else motion
        return Step(increment, doubt, not reason, reason, 0.0 if reason else 1.0, static, drift)

    def _go(self, motion: FloatArray, doubt: FloatArray) -> None:
        """Go on by a motion (3,) of which the map does not tell; doubt : (3, 3) of it, in the frame it starts from.

        Until the map is found again, or given up, the doubts add up.
        """
        by_pose, by_motion = compound_jacobians(self.pose, motion)
        self._noise = by_pose @ self._noise @ by_pose.T + by_motion @ doubt @ by_motion.T
        self.pose = compound(self.pose, motion)

    def _stray(self, scan: PreparedScan, motion: FloatArray, expected: ExpectedPose, match: Match) -> Step:
        """A scan that is nowhere in the map: laid on those since the map was lost, else where it probably is.

        match : the best there is in the map.
        """
        wheels = expected.prior is not None
        self._at_best = min(match.odds, self._at_best if self._lost else 0.0)
        if len(self._spare.map):
            found = self._spare.find(scan, expected, self.pose)
            if found.believable:
                return self._changed(self._follow(scan, motion, found.refined, found.share))
        reason = f"{match.reason}: the pose is predicted"
        if not wheels and match.odds > self._matcher.kept(scan, expected, match).odds:
            motion = between(self.pose, match.refined.pose)
            reason = f"{match.reason}, but less than where it was predicted"
        step = self._predict(motion, wheels, reason, match.share)
        self._spare.map.clear()
        self._spare.map.add(scan.surface, scan.view, self.pose, self._travelled)
        return self._changed(step)

    def _follow(self, scan: PreparedScan, motion: FloatArray, refined: Refined, share: float) -> Step:
        """The motion since the last scan is known by the scans since the map was lost."""
        self._lost += 1
        yaw = float(self.pose[2])
        noise = in_frame(scan_covariance(refined, in_frame(prediction_covariance(motion), -yaw)), yaw)
        self._last = between(self.pose, refined.pose)
        self._go(self._last, noise)
        self._spare.map.add(scan.surface, scan.view, self.pose, self._travelled)
        self._spare.saw(scan.view, self.pose)
        reason = "the map is lost: the scan is laid on those before it"
        return Step(self._last, noise, True, reason, share, np.zeros((0, 2)), np.zeros((3, 3)), self._noise)

    def _changed(self, step: Step) -> Step:
        """Give the map up where it was not found for long. Where it does not just lack what is seen, but contradicts it
        beyond belief, nobody knows how the sensor came to where it is now."""
        if self._lost < self.config.patience or self._stamp is None:
            return step
        self._matcher, self._spare = self._spare, self._matcher
        self._spare.map.clear()
        drift = in_frame(self._noise, float(self.pose[2] - step.increment[2]))
        self._lost, self._sure, self._noise = 0, self.pose, np.zeros((3, 3))
        if self._at_best > -GROSS:
            return replace(step, drift=drift, noise=None)
        away = min(CARRIED * max(self._stamp - self._sure_at, 0.0), self.config.map_radius)
        anywhere = np.diag([away, away, ANY_HEADING]) ** 2
        reason = "the map was not found again: a new one begins where it is predicted"
        return replace(
            step,
            covariance=step.covariance + anywhere,
            drift=drift + anywhere,
            noise=None,
            converged=False,
            reason=reason,
        )

    def _predict(self, motion: FloatArray, wheels: bool, reason: str, fitness: float) -> Step:
        self._lost += 1
        doubt = prediction_covariance(motion)
        self._go(motion, doubt)
        self._last = motion if wheels else FADE * motion
        if self._lost >= self.config.patience and not len(self._spare.map):
            self.map.clear()
        nothing = np.zeros((0, 2))
        return Step(motion, doubt, False, reason, fitness, nothing, np.zeros((3, 3)), self._noise)

    def _accept(self, scan: PreparedScan, motion: FloatArray, wheels: bool, match: Match) -> Step:
        before, refined = self.pose, match.refined
        found_before = not self._lost
        self._lost = 0
        if not found_before:
            self._spare.map.clear()
        doubt = loose = in_frame(prediction_covariance(motion), -float(before[2]))
        refined = self._owning(refined, scan.surface)
        if wheels:
            doubt = self._wheel_covariance(motion)
            start = compound(before, motion)
            self.pose = fused(refined, start, doubt, loose, self._matcher.led(match, scan, start))
            if not refined.open_directions and match.sure:
                self._wheels.learn(motion, between(before, refined.pose))
        else:
            self.pose = refined.pose
        increment = between(before, self.pose)
        if not wheels and found_before and match.sure and not refined.open_directions:
            self._habit.learn(increment, self._last)
        self._last = FADE * increment if refined.open_directions and not wheels else increment
        self._travelled += float(np.hypot(*increment[:2]))
        noise, by_step = self._uncertainty(refined, doubt, wheels)
        covariance = in_frame(by_step, float(before[2]))
        self._noise = noise
        drift = np.zeros((3, 3))
        turned = abs(wrap_angle(float(self.pose[2] - self._key[2])))
        moved = float(np.hypot(*(self.pose[:2] - self._key[:2])))
        if (
            moved > self.config.key_distance
            or turned > self.config.key_turn
            or telling(scan.surface, refined)
        ):
            if self.config.learn_offset:
                self.offset.learn(scan.surface, refined, self.map.target, self.map.facing)
            self._insert(scan)
            drift = DRIFT * in_frame(noise, float(before[2]))
        self._sure, self._sure_at = self.pose, self._stamp or 0.0
        self._matcher.saw(scan.view, self.pose)
        static = scan.surface.points[match.agreement.labels == 0]
        sure = match.odds > 0.0
        reason = "" if sure else match.reason
        if refined.open_directions:
            opened = f"{refined.open_directions} of 3 directions of motion are open"
            reason = f"{opened}: the prediction is kept there"
        return Step(increment, covariance, sure, reason, match.share, static, drift, noise)

    def _uncertainty(
        self, refined: Refined, doubt: FloatArray, wheels: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Covariances (3, 3) of the pose against the map and of the step, odometry frame; doubt : of its prediction.

        What the map does not tell was not told before either: there the doubt of steps adds up. Where nothing tells of
        a motion but the one before, all steps since then miss the same way, each by as much as the sensor moves.
        """
        before = self._noise
        self._open = self._open + 1 if refined.open_directions and not wheels else 0
        if self._open:
            missed = np.diag([1.0, 1.0, 0.0]) * self._habit.length**2
            doubt = doubt + missed
            before = (1.0 + 1.0 / self._open) * before + self._open * missed
        noise = scan_covariance(refined, before + doubt)
        told = noise @ refined.information / EFFICIENCY
        rest = np.eye(3) - told
        return noise, told @ self._noise @ told.T + told @ noise + rest @ doubt @ rest.T

    def _owning(self, refined: Refined, surface: Surface) -> Refined:
        """With less information where it hangs on one small piece, which may be a person who walks."""
        doubt = borrowed(refined, surface, self.map.target, self.config.tolerance, self.config.doubt**2)
        if not doubt.any():
            return refined
        kept = np.linalg.inv(np.eye(3) + doubt @ refined.information / EFFICIENCY)
        return replace(refined, information=refined.information @ kept)

    def _insert(self, scan: PreparedScan) -> None:
        self.map.add(scan.surface, scan.view, self.pose, self._travelled)
        self._key = self.pose.copy()


def telling(surface: Surface, refined: Refined) -> bool:
    """Whether lines that the map lacks tell more than all that it has, where these tell least.

    In a corridor whose end comes into view nothing else tells the way: a sensor that seems to stand for want of it
    would never have it in its map.
    """
    known = refined.matched >= 0
    _, directions = np.linalg.eigh(surface.normals[known].T @ surface.normals[known])
    told = (surface.normals @ directions[:, 0]) ** 2 * surface.lined
    return bool(told[~known].sum() > told[known].sum())


def in_frame(covariance: FloatArray, yaw: float) -> FloatArray:
    """(3, 3) of x, y, yaw in the odometry frame, in a frame turned by `yaw`."""
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ covariance @ turn.T)


def fused(
    refined: Refined, start: FloatArray, wheels: FloatArray, loose: FloatArray, more: float
) -> FloatArray:
    """Pose (3,) from lines and from where wheels lead, `start` (3,), each as far as it is sure.

    Where a corridor tells little of the way along it, scans alone slide by metres into what looks alike. Along a single
    wall the noise of the map's lines seems to tell the way, in every scan the same; and a wall that comes into view may
    be taken for another. Where wheels explain a scan better, lines count for as much as they do tell.

    wheels : (3, 3) covariance of `start`. loose : the same where lines refute the wheels. more : nat by which lines
    make `refined` likelier than `start`.
    """
    information = refined.information / EFFICIENCY
    away = refined.pose - start
    away[2] = wrap_angle(away[2])
    prior = np.linalg.inv(wheels)
    # How far the two are apart, in what both are uncertain of together.
    apart = float(away @ information @ np.linalg.inv(np.eye(3) + wheels @ information) @ away)
    if more < min(0.5 * apart, GROSS):
        along = information @ away
        seems = max(float(away @ along), 1e-12)
        told = min(max(2.0 * more, 0.0), seems)
        information = information - (1.0 - told / seems) * np.outer(along, along) / seems
    elif apart > REFUTED:
        prior = np.linalg.inv(loose)
    pose = start + np.linalg.solve(information + prior, information @ away)
    pose[2] = wrap_angle(pose[2])
    return np.asarray(pose)


def scan_covariance(refined: Refined, doubt: FloatArray) -> FloatArray:
    """(3, 3) of a scan's pose against the map, odometry frame; open directions have the prediction's `doubt` (3, 3)."""
    told = doubt @ refined.information / EFFICIENCY
    covariance = np.linalg.solve(np.eye(3) + told, doubt)
    return np.asarray(0.5 * (covariance + covariance.T))

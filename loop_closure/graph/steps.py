"""How far odometry may be off between two keyframes: what a pose graph takes its steps to be worth.

Odometry states the covariance of its pose since the start. What it adds from one keyframe to the next is that of white
noise, while its errors last, so it is taken some times over. A step that was predicted instead of measured says so
itself, and both its ends hang loose: the scan before was laid on the map, and so will be the next that is found again.
Leaps no registration from scan to scan can be sure of are doubted unless the scan fits what was seen before there only.
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from loop_closure.keyframes import Keyframes
from loop_closure.motions import doubt_of, grown, length, motion, planar, positions, rotation, turn
from loop_closure.slam_config import SlamConfig
from registration.placement.align_submaps import align_submaps, ambiguous

FLOOR = 0.01  # metres, of any step
# Variances of position and heading over those that odometry states of a step it measured.
LASTING = (30.0, 8.0)
GUESSED = 4.0  # the same of a step that was predicted, which is stated amply
LEAP = (3.0, 1.2)  # metres and radians from one scan to the next that no registration can be sure of
DOUBTED = 0.5  # share of such a leap that may be wrong
BEHIND = 8.0  # metres of path before a leap that the scan after it is laid on
CONFIRMED = (0.15, 0.05)  # metres and radians within which the placement has to be where odometry says


class StepDoubt:
    """Covariances of odometry steps, one after the other."""

    def __init__(self, config: SlamConfig) -> None:
        self._config = config
        self._last: FloatArray | None = None  # covariance odometry stated at the last keyframe
        self._loose: FloatArray | None = None  # of the last step, if predicted, in the frame it ends in
        self._leap = (0.0, 0.0)  # metres and radians of leaps since the last keyframe

    def watch(self, before: FloatArray, here: FloatArray) -> None:
        """Remember leaps of planar odometry from one scan to the next: views of little in common were laid together."""
        if not planar(here):
            return
        step = motion(before, here)
        away, angle = length(step), turn(step)
        if away > LEAP[0] or angle > LEAP[1]:
            self._leap = (float(np.hypot(self._leap[0], away)), float(np.hypot(self._leap[1], angle)))

    def arrived(self, covariance: FloatArray | None) -> None:
        """A keyframe was made where odometry states `covariance`; the next step starts there."""
        self._last, self._leap = covariance, (0.0, 0.0)

    def begin(self) -> None:
        """Odometry starts anew."""
        self._last = self._loose = None

    def of(
        self, step: FloatArray, before: FloatArray, covariance: FloatArray | None, keyframes: Keyframes
    ) -> FloatArray:
        """Covariance of `step` from odometry pose `before` to the newest keyframe, in the frame of `before`.

        covariance : what odometry states at its end. Local maps are broken off where the step was not measured.
        """
        away = FLOOR + self._config.odometry_drift * length(step)
        angle = self._config.odometry_turn_drift + 0.02 * turn(step)
        if any(self._leap) and not _confirmed(step, keyframes):
            away, angle = away + DOUBTED * self._leap[0], angle + DOUBTED * self._leap[1]
            keyframes.break_off(away)
        doubt = doubt_of(step, away, angle)
        loose, self._loose = self._loose, None
        if covariance is not None and self._last is not None:
            own = grown(before, step, self._last, covariance)
            guessed = _spread(own)
            if guessed > 0.04 + 0.1 * length(step):
                keyframes.break_off(float(np.hypot(away, guessed)))
                B = rotation(step)
                self._loose = GUESSED * B.T @ own @ B
                doubt = doubt + GUESSED * own
            else:
                size = len(positions(step))
                factors = np.sqrt([LASTING[0]] * size + [LASTING[1]] * (len(own) - size))
                doubt = doubt + own * np.outer(factors, factors)
        if loose is not None:
            keyframes.break_off(float(np.hypot(away, _spread(loose))))
            doubt = doubt + loose
        return doubt


def _spread(covariance: FloatArray) -> float:
    """Largest standard deviation of the position, metres."""
    size = 2 if len(covariance) == 3 else 3
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:size, :size])[-1]))


def _confirmed(step: FloatArray, keyframes: Keyframes) -> bool:
    """Whether the newest scan, laid on the path before it from anywhere, fits where odometry put it and only there."""
    k = len(keyframes) - 1
    source, target = keyframes.local_map(k, 0.0, 0.0), keyframes.local_map(k - 1, BEHIND, 0.0)
    placements = align_submaps(source, target, step, LEAP[0], np.pi)
    if not placements or not placements[0].sure or ambiguous(placements):
        return False
    off = motion(step, placements[0].pose)
    return length(off) <= CONFIRMED[0] and turn(off) <= CONFIRMED[1]

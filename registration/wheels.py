"""Recent wheel odometry, asked for the motion between two stamps."""

from __future__ import annotations

import bisect

import numpy as np
from numpy.typing import NDArray

from estimation.poses import between, compound, wrap_angle

Array = NDArray[np.float64]
NANOSECONDS = 1_000_000_000
HISTORY = 30 * NANOSECONDS


class WheelHistory:
    """Stamped planar poses of the last half minute, in the wheels' own frame. Stamps are nanoseconds."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._poses: list[Array] = []

    def clear(self) -> None:
        self._stamps.clear()
        self._poses.clear()

    def insert(self, stamp: int, pose: Array) -> None:
        """Add a pose (3,) x, y, yaw; one at a known stamp replaces it."""
        index = bisect.bisect_left(self._stamps, stamp)
        if index < len(self._stamps) and self._stamps[index] == stamp:
            self._poses[index] = pose
            return
        self._stamps.insert(index, stamp)
        self._poses.insert(index, pose)
        outdated = bisect.bisect_left(self._stamps, self._stamps[-1] - HISTORY)
        if outdated:
            del self._stamps[:outdated], self._poses[:outdated]

    def motion(self, start: int, end: int, max_age: float) -> Array | None:
        """Motion (3,) from one stamp to another in the robot frame at the first, None where the wheels say nothing.

        A stamp up to `max_age` seconds beyond the newest pose is extrapolated at the speed of the last two.
        """
        first, second = self._at(start, max_age), self._at(end, max_age)
        if first is None or second is None:
            return None
        return np.asarray(between(first, second))

    def _at(self, stamp: int, max_age: float) -> Array | None:
        if not self._stamps or stamp < self._stamps[0]:
            return None
        index = bisect.bisect_left(self._stamps, stamp)
        if index < len(self._stamps):
            if self._stamps[index] == stamp:
                return self._poses[index]
            return self._blend(index - 1, index, stamp)
        age = stamp - self._stamps[-1]
        if age > max_age * NANOSECONDS:
            return None
        # Extrapolating over more than the wheels' own period would multiply their noise.
        if len(self._stamps) > 1 and age <= 2 * (self._stamps[-1] - self._stamps[-2]):
            return self._blend(len(self._stamps) - 2, len(self._stamps) - 1, stamp)
        return self._poses[-1]

    def _blend(self, before: int, after: int, stamp: int) -> Array:
        share = (stamp - self._stamps[before]) / (self._stamps[after] - self._stamps[before])
        step = np.asarray(between(self._poses[before], self._poses[after])) * share
        step[2] = wrap_angle(step[2])
        return np.asarray(compound(self._poses[before], step))

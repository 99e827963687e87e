"""Recent wheel odometry, asked for the motion between two stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.history import StampedHistory
from estimation.geometry.poses import between, compound
from registration.laser.scan import Scan

Array = NDArray[np.float64]
NANOSECONDS = 1_000_000_000
HISTORY = 30 * NANOSECONDS
# m or rad, and m/s or rad/s, that no wheels drive between two readings: their driver has started anew, elsewhere.
LEAP, FASTEST = 1.0, 10.0


class WheelHistory(StampedHistory[Array]):
    """Planar poses (3,) x, y, yaw of the last half minute, in the wheels' own frame. Stamps are nanoseconds.

    A pose that no wheels drive to from the newest is in a frame of its own: those before it are forgotten.
    """

    def __init__(self) -> None:
        super().__init__(HISTORY)

    def insert(self, stamp: int, value: Array) -> None:
        """Add a pose (3,), and drop those that have become too old."""
        for newest, before in self.latest(1):
            away = between(before, value)
            reach = LEAP + FASTEST * abs(stamp - newest) / NANOSECONDS
            if max(float(np.hypot(away[0], away[1])), abs(float(away[2]))) > reach:
                self.clear()
        super().insert(stamp, value)

    def motion(self, start: int, end: int, max_age: float) -> Array | None:
        """Motion (3,) from one stamp to another in the robot frame at the first, None where the wheels say nothing.

        A stamp up to `max_age` seconds beyond the newest pose is extrapolated at the speed of the last two.
        """
        first, second = self._at(start, max_age), self._at(end, max_age)
        if first is None or second is None:
            return None
        return np.asarray(between(first, second))

    def sweep(self, start: int, scan: Scan) -> Array | None:
        """Motion (3,) from the first beam of a scan of that stamp to its last, as `motion`.

        None where all beams are of one time, and where the wheels tell of less than half of the sweep.
        """
        whole = round(scan.time_increment * (len(scan) - 1) * NANOSECONDS)
        known = whole if self.newest is None else min(whole, self.newest - start)
        if whole <= 0 or 2 * known < whole:
            return None
        motion = self.motion(start, start + known, 0.0)
        return None if motion is None else motion * (whole / known)

    def _at(self, stamp: int, max_age: float) -> Array | None:
        found = self.around(stamp)
        if found is not None:
            return _blend(*found)
        if self.newest is None or stamp < self.newest:
            return None
        age = stamp - self.newest
        if age > max_age * NANOSECONDS:
            return None
        *earlier, (last_stamp, last) = self.latest(2)
        # Extrapolating over more than the wheels' own period would multiply their noise.
        if earlier and age <= 2 * (last_stamp - earlier[0][0]):
            return _blend(earlier[0][1], last, (stamp - earlier[0][0]) / (last_stamp - earlier[0][0]))
        return last


def _blend(before: Array, after: Array, share: float) -> Array:
    """A pose on the way from one to the other, or beyond, at constant speed and turn rate."""
    return np.asarray(compound(before, share * np.asarray(between(before, after))))

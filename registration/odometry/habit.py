"""How a sensor moves from scan to scan, learned while it is followed: what to expect next.

Without wheels the motion since the last scan is only a guess. Where scans come at a rate the last motion again is a
good one; where a scan is kept per metre of path it is not, as every step is about as long as all the others but turns
differ. There the sensor is taken to go on even where it is lost, and neighbouring scans share so little that little
agreement has to do (`MapMatcher.find`).
"""

from __future__ import annotations

from collections import deque

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import wrap_angle

KEPT = 200  # motions remembered
FEWEST = 15  # motions before anything is made of them
APART = 0.7  # metres between scans from which on they are taken to be kept by distance
STEADY = 0.6  # a fifth of the motions may be shorter than this share of the median


class Habit:
    """Motions (3,) of sure steps, in the frame they start from.

    steady : whether scans are kept by distance: the sensor never rests, and gets on far and about equally with each.
    """

    def __init__(self) -> None:
        self._motions = np.zeros((KEPT, 3))
        self._count = 0
        self._errors: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self._typical = np.zeros(3)
        self.steady = False

    def learn(self, motion: FloatArray, last: FloatArray) -> None:
        """Take in a sure motion that followed `last`."""
        self._motions[self._count % KEPT] = motion
        self._count += 1
        if self._count < FEWEST:
            return
        known = self._motions[: self._count]
        distance = np.sort(np.hypot(known[:, 0], known[:, 1]))
        middle = distance[len(distance) // 2]
        self.steady = bool(middle > APART and distance[len(distance) // 5] > STEADY * middle)
        if self.steady:
            self._errors.append((_difference(motion, self._typical), _difference(motion, last)))
            self._typical = np.median(known, axis=0)

    @property
    def regular(self) -> bool:
        """Whether the typical motion tells more about the next than the last motion does.

        It helps in a corridor without an end.
        """
        if len(self._errors) < FEWEST:
            return False
        habit, before = np.median(self._errors, axis=0)
        return bool(habit < before)

    def expected(self, last: FloatArray, lost: bool) -> FloatArray:
        """The motion (3,) to expect after `last`, which is only a guess itself where the sensor is `lost`."""
        return self._typical.copy() if self.steady and (lost or self.regular) else last


def _difference(one: FloatArray, other: FloatArray) -> float:
    """How far apart two motions are: m, a radian counting as a metre."""
    return float(np.hypot(*(one[:2] - other[:2])) + abs(wrap_angle(float(one[2] - other[2]))))

"""How a sensor moves from scan to scan without wheels, learned while it is followed: what to expect next, how surely.

Where scans come at a rate the last motion again is a good guess of the next; where a scan is kept per metre of path it
is not, as every step is about as long as all the others but turns differ. There what has erred less of late is
expected. Elsewhere it would drive a sensor on that has stopped where nothing tells of it.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import wrap_angle
from registration.laser.sweep import GAP

MEMORY = 50  # motions over which it is learned; 200 do about the same
FEWEST = 15  # motions before their median is made use of
APART = 0.7  # metres between scans from which on they are taken to be kept by distance
ROUNDED = 0.25  # stamps that jitter do not make two periods of one
UNTRIED = 0.5  # m and radians, deviation from a guess before any was tried


class Habit:
    """Median of the motions (3,) of sure steps, in the frame they start from, and how far off guesses have been.

    regular : whether scans are kept by distance, and that motion tells more about the next than the last one does.
    """

    def __init__(self) -> None:
        self._count = 0
        self._motions = np.zeros((MEMORY, 3))
        # Squared deviations of motions from what was typical before them, and from the motion before.
        self._errors = np.zeros((MEMORY, 2, 3))
        self._typical = np.zeros(3)
        self._times: deque[float] = deque(maxlen=MEMORY)  # s, between scans
        self.regular = False

    def periods(self, elapsed: float) -> int:
        """How many of the usual times between scans have passed in `elapsed` s, as scans were lost: one at least.

        Over a longer gap a motion does not go on.
        """
        if elapsed <= 0.0:
            return 1
        self._times.append(elapsed)
        usual = sorted(self._times)[len(self._times) // 2]
        return max(1, int(min(elapsed, GAP) / usual + ROUNDED))

    def learn(self, motion: FloatArray, last: FloatArray) -> None:
        """Take in a sure motion that followed `last`."""
        at = self._count % MEMORY
        self._motions[at] = motion
        self._errors[at] = _squares(motion, self._typical), _squares(motion, last)
        self._count += 1
        known = min(self._count, MEMORY)
        self._typical = _median(self._motions[:known])
        typical, before = _median(self._errors[:known].sum(axis=2))
        far = float(np.hypot(self._typical[0], self._typical[1])) > APART
        self.regular = known >= FEWEST and far and bool(typical < before)

    def expected(self, last: FloatArray) -> FloatArray:
        """The motion (3,) to expect after `last`."""
        return self._typical.copy() if self.regular else last

    @property
    def length(self) -> float:
        """Metres of a typical motion."""
        return float(np.hypot(self._typical[0], self._typical[1])) if self._count else UNTRIED

    @property
    def doubt(self) -> FloatArray:
        """(3, 3) covariance of a motion from what was expected."""
        known = min(self._count, MEMORY)
        total = self._errors[:known, 0 if self.regular else 1].sum(axis=0)
        return np.diag((UNTRIED**2 + total) / (1.0 + known))


def _median(values: FloatArray) -> FloatArray:
    """Median of each column; the upper of two in the middle."""
    middle = len(values) // 2
    return np.asarray(np.partition(values, middle, axis=0)[middle])


def _squares(motion: FloatArray, expected: FloatArray) -> FloatArray:
    """Squared deviations (3,) of a motion from what was expected, those of x and y alike."""
    x, y, turn = (motion - expected).tolist()
    across = 0.5 * (x * x + y * y)
    return np.array([across, across, wrap_angle(turn) ** 2])

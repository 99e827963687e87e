"""How noisy the ranges of a scanner are, learned from scan to scan."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from registration.laser.scan import Scan

MEMORY = 50  # scans of which the middle one counts
FEW = 20  # readings of a scan that tell nothing


class RangeNoise:
    """Deviation of a range; value : metres, never less than at first."""

    def __init__(self, least: float = 0.0) -> None:
        self._least = self.value = least
        self._told: deque[float] = deque(maxlen=MEMORY)

    def learn(self, scan: Scan) -> None:
        """A scan tells by how far its readings lie off straight lines through their neighbours.

        Along a straight line the inverse range is a sine of the bearing: two neighbours add up to 2 cos(step) times
        the one between them, however far the beams are apart. Most neighbours lie on one surface.
        """
        valid = scan.valid
        among = valid[:-2] & valid[1:-1] & valid[2:]
        count = int(np.count_nonzero(among))
        if count < FEW:
            return
        twice = 2.0 * math.cos(scan.angle_increment)
        inverse = 1.0 / np.where(valid, scan.ranges, 1.0)
        bent = inverse[:-2] - twice * inverse[1:-1] + inverse[2:]
        off = np.abs(bent[among]) * scan.ranges[1:-1][among] ** 2
        # A median over 0.6745 is a deviation; that of the sum is of 1, 2 and 1 ranges.
        median = float(np.partition(off, count // 2)[count // 2])
        self._told.append(median / (0.6745 * math.sqrt(2.0 + twice**2)))
        self.value = max(self._least, sorted(self._told)[(len(self._told) - 1) // 2])

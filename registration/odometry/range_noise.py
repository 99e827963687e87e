"""How noisy the ranges of a scanner are, learned from scan to scan where beams are nearer to each other than exact."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from registration.laser.scan import Scan

MEMORY = 50  # scans of which the middle one counts


class RangeNoise:
    """Deviation of a range; value : metres, never less than at first."""

    def __init__(self, least: float) -> None:
        self._least = self.value = least
        self._told: deque[float] = deque(maxlen=MEMORY)

    def learn(self, scan: Scan) -> None:
        """A scan tells by how far readings lie off the middle of their neighbours."""
        ranges = np.where(scan.valid, scan.ranges, np.nan)
        off = np.abs(ranges[:-2] - 2.0 * ranges[1:-1] + ranges[2:])
        with np.errstate(invalid="ignore"):
            # Where they are farther apart, surfaces bend as well.
            off = off[(ranges[1:-1] * abs(scan.angle_increment) < self._least) & np.isfinite(off)]
        # A few readings tell of what is close by.
        if 2 * len(off) <= len(scan):
            return
        # A median over 0.6745 is a deviation; that of the sum is of 1, 2 and 1 ranges.
        self._told.append(float(np.median(off)) / (0.6745 * math.sqrt(6.0)))
        self.value = max(self._least, float(np.quantile(self._told, 0.5, method="lower")))

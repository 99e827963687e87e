"""Parts of the robot that its own scanner sees: near returns that stay where they are while the robot moves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.geometry.poses import between
from registration.laser.scan import Scan

NEAR = 0.9  # metres; farther away nothing is a part of the robot
STEADY = 0.03  # metres a reading may change
TRAVEL = 1.0  # metres, or radians, after which a steady reading is believed


class OwnBody:
    """Learns, beam by beam, what moves with the scanner."""

    def __init__(self) -> None:
        self._ranges: FloatArray | None = None
        self._travel: FloatArray = np.zeros(0)
        self._pose: FloatArray | None = None

    def mask(self, scan: Scan, pose: FloatArray) -> npt.NDArray[np.bool_]:
        """Beams (N,) that end on the robot itself."""
        ranges = np.where(scan.valid, scan.ranges, np.inf)
        if self._ranges is None or len(self._ranges) != len(ranges) or self._pose is None:
            self._ranges, self._travel, self._pose = ranges.copy(), np.zeros(len(ranges)), pose.copy()
        motion = between(self._pose, pose)
        step = float(np.hypot(motion[0], motion[1]) + abs(motion[2]))
        # What a stop-and-go of a few millimetres adds up to is the noise of the pose.
        step = min(step, 0.3) if step > 0.02 else 0.0
        self._pose = pose.copy()
        with np.errstate(invalid="ignore"):
            same = (np.abs(ranges - self._ranges) < STEADY) & (ranges < NEAR)
        seen = np.isfinite(ranges)
        self._travel = np.where(
            same, self._travel + step, np.where(seen, 0.7 * self._travel - 0.1, self._travel)
        )
        self._travel = np.clip(self._travel, 0.0, 3.0 * TRAVEL)
        moved = seen & ~same & (self._travel < 0.3)
        self._ranges = np.where(moved, ranges, self._ranges)
        self._ranges = np.where(same, 0.9 * self._ranges + 0.1 * ranges, self._ranges)
        own = (self._travel > TRAVEL) & same
        # The edges of a part flicker.
        near, wider = ranges < NEAR, own.copy()
        for shift in (1, 2):
            wider[shift:] |= own[:-shift] & near[shift:]
            wider[:-shift] |= own[shift:] & near[:-shift]
        return np.asarray(wider)

"""The outline of a place: walls and free floor around the robot, from one scan or the last metres of path.

    around = LocalMap(length=10.0)
    around.add(scan, odometry_pose)                    # every scan, poses of the sensor in a frame that drifts slowly
    place = features_2d(scan, 50.0, around.outline())  # features of the newest scan, outline of the last metres

A scanner that looks ahead sees other walls when the robot comes back the other way; what it passed on its last metres
is the same from either side. An outline holds points within RADIUS (one per THIN metres) and which cells of 0.25 m were
seen to be free; `loop_closure.places.matching` lays one upon another.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_own, require_kind, require_positive
from estimation.errors import InputError
from estimation.geometry.poses import between
from loop_closure.places.outline_kernels import CELLS, RADIUS, mark_free, reach, thin
from registration.laser.scan import Scan

LENGTH = 10.0  # metres of path in an outline
THIN = 0.2
MOST_POINTS = 320
SECTORS = 720


@dataclass(frozen=True, eq=False)
class Outline:
    """Walls and free floor around a place, in its sensor's frame.

    points : (K, 2) metres, single precision, in an order that any first part of it is spread over the whole.
    free : packed bits, (CELLS² / 8,) bytes: cells seen to be free.
    """

    points: npt.NDArray[np.float32]
    free: npt.NDArray[np.uint8]

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        return int(self.points.nbytes + self.free.nbytes)


def outline_of_scan(scan: Scan) -> Outline:
    """The outline one scan sees; no points where it has no returns."""
    alone = LocalMap()
    alone.add(scan, np.zeros(3))
    return alone.outline()


class LocalMap:
    """Scans of the last metres of path, as one outline around the newest.

    Parameters
    ----------
    length : metres of path that are kept. step, turn : metres and radians after which a scan is added to those kept;
        the newest always counts.

    Raises
    ------
    InputError : a value not above 0.
    """

    def __init__(self, length: float = LENGTH, step: float = 0.4, turn: float = 0.35) -> None:
        self.length = require_positive("length", length)
        self.step, self.turn = require_positive("step", step), require_positive("turn", turn)
        self._kept: deque[tuple[Scan, FloatArray, FloatArray, float]] = deque()
        self._newest: tuple[Scan, FloatArray, FloatArray, float] | None = None
        self._travelled = 0.0

    def add(self, scan: Scan, pose: npt.ArrayLike) -> None:
        """Take in the next scan and the sensor's pose (3,), metres and radians, in a frame that drifts slowly."""
        require_kind("scan", scan, Scan)
        pose = as_own("pose", pose, (3,))
        if self._newest is not None:
            self._travelled += float(np.hypot(*(pose[:2] - self._newest[1][:2])))
        seen = reach(scan.ranges, scan.valid, scan.angle_min, scan.angle_increment, SECTORS)
        self._newest = (scan, pose, seen, self._travelled)
        if self._kept:
            moved = between(self._kept[-1][1], pose)
            if math.hypot(moved[0], moved[1]) < self.step and abs(moved[2]) < self.turn:
                return
        self._kept.append(self._newest)
        while self._travelled - self._kept[0][3] > self.length:
            self._kept.popleft()

    def clear(self) -> None:
        """Forget all scans, as after a jump of the odometry."""
        self._kept.clear()
        self._newest = None

    def outline(self) -> Outline:
        """The outline of the last metres in the frame of the newest scan. InputError before the first scan."""
        if self._newest is None:
            raise InputError("local map: no scan was added yet")
        scan, pose, seen, _ = self._newest
        free = np.zeros((CELLS, CELLS), dtype=np.uint8)
        mark_free(free, seen, 0.0, 0.0, 0.0)
        points = [scan.points()]
        for other, at, sight, _ in self._kept:
            if other is scan:
                continue
            x, y, yaw = between(pose, at)
            mark_free(free, sight, x, y, yaw)
            c, s = math.cos(yaw), math.sin(yaw)
            points.append(other.points() @ np.array([[c, s], [-s, c]]) + (x, y))
        walls = thin(np.concatenate(points), THIN, RADIUS)
        return Outline(walls[:MOST_POINTS], np.packbits(free.ravel()))

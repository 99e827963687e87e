"""How uncertain a robot's pose is, from what odometry or localisation says with its stamps.

Localisation's covariance is of the pose in the map. That of odometry grows for ever, and most of it is where the robot
was long before anything in view was there: over a window it is the uncertainty of the motion since.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_shape, require_finite
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance


@dataclass(frozen=True)
class _Known:
    stamp: float
    position: FloatArray
    covariance: FloatArray


class PoseUncertainty:
    """The covariance of x, y, yaw by stamp.

    window : seconds over which it counts; inf for localisation, and for odometry since it began. age : seconds for
    which the last one holds.
    """

    def __init__(self, window: float = np.inf, age: float = 2.0) -> None:
        if not (window > 0.0 and age >= 0.0):
            raise InputError(f"window: above 0 and age: at least 0 expected, got {window!r} and {age!r}")
        self.window, self.age = window, age
        self._known: deque[_Known] = deque()

    def add(self, stamp: float, pose: npt.ArrayLike, covariance: npt.ArrayLike) -> None:
        """A pose (3,) and its covariance (3, 3), m and rad. Raises InputError naming the argument."""
        position = require_finite("pose", as_shape("pose", pose, (3,)))[:2]
        P = repair_covariance(as_shape("covariance", covariance, (3, 3)), "covariance", definite=False)
        if self._known and stamp < self._known[-1].stamp:
            self._known.clear()
        self._known.append(_Known(stamp, position, P))
        # The one before the window stays: the window begins there.
        while len(self._known) > 1 and self._known[1].stamp <= stamp - self.window:
            self._known.popleft()

    def at(self, stamp: float, sensor: npt.ArrayLike | None = None) -> FloatArray | None:
        """Covariance (3, 3) at a stamp, of the pose, or of a sensor at a place (2,) or pose (3,) fixed to it.

        Places are in the frame of the poses. None where none is known, or the last one is too old.
        """
        known = [item for item in self._known if item.stamp <= stamp + self.age]
        if not known or abs(stamp - known[-1].stamp) > self.age:
            return None
        last, first = known[-1], known[0]
        P = last.covariance
        if stamp - first.stamp >= self.window:
            J = _lever(last.position - first.position)
            values, vectors = np.linalg.eigh(P - J @ first.covariance @ J.T)
            P = (vectors * np.maximum(values, 0.0)) @ vectors.T
        if sensor is None:
            return P
        J = _lever(np.asarray(sensor, dtype=np.float64)[:2] - last.position)
        return np.asarray(J @ P @ J.T)


def _lever(arm: FloatArray) -> FloatArray:
    """Jacobian (3, 3) of a pose at the end of an arm (2,) by the pose at its beginning."""
    J = np.eye(3)
    J[0, 2], J[1, 2] = -arm[1], arm[0]
    return J

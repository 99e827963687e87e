"""How far wheels are to be believed, learned from what the lines of scans say of them."""

from __future__ import annotations

import math

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import wrap_angle

SHARE = 0.2  # of a motion that any prediction of it may be off by
# Set on simulated floors of 3.5 m sight, where 25 to 100 scans and 9 to 25 do about the same.
MEMORY = 50  # scans over which it is learned
REFUTED = 16.0  # squared deviations from which on wheels were wrong, not just inexact


def prediction_covariance(motion: FloatArray) -> FloatArray:
    """(3, 3) doubt about any predicted motion, in the frame it starts from."""
    away = 0.05 + SHARE * math.hypot(motion[0], motion[1])
    turn = 0.03 + SHARE * abs(float(motion[2]))
    return np.array(((away**2, 0.0, 0.0), (0.0, away**2, 0.0), (0.0, 0.0, turn**2)))


class WheelDoubt:
    """The doubt about any prediction, less as far as wheels have proved to be better.

    share : (3,) of the variances of `prediction_covariance` that their errors had of late; all of it at first.
    """

    def __init__(self) -> None:
        self.share = np.ones(3)

    def covariance(self, motion: FloatArray) -> FloatArray:
        """(3, 3) of a motion (3,) that the wheels tell of, in the frame it starts from."""
        return prediction_covariance(motion) * self.share

    def learn(self, motion: FloatArray, moved: FloatArray) -> None:
        """The wheels told of `motion`, lines of `moved`, (3,) each, in the frame they start from."""
        error = moved - motion
        square = np.array([*np.full(2, 0.5 * (error[:2] @ error[:2])), wrap_angle(float(error[2])) ** 2])
        square /= np.diag(prediction_covariance(motion))
        self.share += (np.minimum(square, 1.0) - self.share) / MEMORY

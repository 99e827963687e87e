"""The motion model of the tracking filters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray, as_number, require_positive
from estimation.errors import InputError


@dataclass(frozen=True)
class ConstantVelocity:
    """State [x, y, vx, vy] moving straight on, disturbed by white acceleration.

    acceleration : root of the acceleration's power spectral density, m/s^1.5, the same in x and y: the
    velocity's standard deviation grows by acceleration · √dt. Raises InputError unless above 0.
    """

    acceleration: float

    def __post_init__(self) -> None:
        require_positive("acceleration", self.acceleration)

    def matrices(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """F and Q (4, 4) over dt ≥ 0, s; exact for any dt, so that two short steps equal one long one."""
        dt = check_step(dt)
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        q = self.acceleration**2
        Q = np.zeros((4, 4))
        Q[0, 0] = Q[1, 1] = q * dt**3 / 3
        Q[0, 2] = Q[2, 0] = Q[1, 3] = Q[3, 1] = q * dt**2 / 2
        Q[2, 2] = Q[3, 3] = q * dt
        return F, Q


def check_step(dt: float) -> float:
    """`dt` as a float; InputError unless finite and at least 0."""
    step = as_number("dt", dt)
    if step < 0.0:
        raise InputError(f"dt must be a finite number of at least 0 s, not {dt!r}")
    return step

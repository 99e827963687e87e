"""Social forces and the Kalman filter of section 4.5 as printed: (4.13) to (4.18), with Table 4.2.

Beside `tracking.prediction.social_forces`, which leaves out what somebody bears already, brakes at the goal
and takes the nearest obstacle only: here every person and obstacle pushes, always, and nobody stops. Three
things are not printed: the mass, which turns newtons into accelerations (80 kg here), the noises, and whether
newtons are per metre or per pixel in (4.18) (per metre here). Lengths are Table 4.2's pixels at 24.7 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray, require_positive
from estimation.filters import kalman

PIXEL = 0.0247  # m
NUDGE = 1e-5  # m and m/s, of a difference
H = np.eye(2, 4)
Acceleration = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class PrintedForces:
    """Table 4.2. mass : M, kg. q : N, f : m, radius : r, m, of (4.17). c : N/m, of (4.18). relaxation : τ, s, and
    speed : v̂, m/s, of (4.16). Raises InputError naming the field."""

    mass: float = 80.0
    q: float = 25.0
    f: float = 50.0 * PIXEL
    radius: float = 15.0 * PIXEL
    c: float = 2.5
    relaxation: float = 4.0
    speed: float = 40.0 * PIXEL

    def __post_init__(self) -> None:
        for name in ("mass", "f", "radius", "relaxation"):
            require_positive(name, getattr(self, name))

    def personal(self, x: FloatArray, goal: FloatArray) -> FloatArray:
        """F^pers, N (4.16), of a state (4,) x, y, vx, vy that wants to be at a goal (2,)."""
        ahead = goal - x[:2]
        away = float(np.hypot(*ahead))
        wanted = self.speed * ahead / away if away > 1e-9 else np.zeros(2)
        return np.asarray(self.mass * (wanted - x[2:]) / self.relaxation)

    def social(self, x: FloatArray, things: FloatArray, radii: FloatArray) -> FloatArray:
        """F^soc, N (4.17), by things at (W, 2) of radii (W,), which are added to the person's own."""
        n, d = _away(x, things)
        return np.asarray((self.q * np.exp((self.radius + radii - d) / self.f)) @ n)

    def physical(self, x: FloatArray, things: FloatArray, radii: FloatArray) -> FloatArray:
        """F^phys, N (4.18): of contact only, g(υ) = max(υ, 0)."""
        n, d = _away(x, things)
        return np.asarray((self.c * np.maximum(self.radius + radii - d, 0.0)) @ n)

    def acceleration(
        self, x: FloatArray, goal: FloatArray, things: FloatArray, radii: FloatArray
    ) -> FloatArray:
        """a, m/s², of (4.14) and (4.15) without its noise."""
        force = self.personal(x, goal) + self.social(x, things, radii) + self.physical(x, things, radii)
        return np.asarray(force / self.mass)


def _away(x: FloatArray, things: FloatArray) -> tuple[FloatArray, FloatArray]:
    """n (W, 2), from each thing to the person, and d (W,) m."""
    offsets = x[:2] - np.asarray(things, dtype=np.float64).reshape(-1, 2)
    d = np.hypot(*offsets.T)
    return offsets / np.maximum(d, 1e-9)[:, None], d


def step(x: FloatArray, a: FloatArray, dt: float) -> FloatArray:
    """The motion model (4.13), state (4,) and a (2,)."""
    return np.concatenate([x[:2] + x[2:] * dt + 0.5 * a * dt**2, x[2:] + a * dt])


def jacobian(x: FloatArray, acceleration: Acceleration, dt: float) -> FloatArray:
    """∂(4.13)/∂x (4, 4), forces included, by central differences."""
    columns = []
    for e in NUDGE * np.eye(4):
        ahead, behind = (step(at, acceleration(at), dt) for at in (x + e, x - e))
        columns.append((ahead - behind) / (2.0 * NUDGE))
    return np.stack(columns, axis=1)


class SocialForceFilter:
    """The Kalman filter of section 4.5, extended, as its motion model is not linear.

    state (4,) x, y, vx, vy; covariance (4, 4). noise : standard deviation of ζ / M, m/s², constant over a step.
    measurement_noise : m. Raises InputError naming the argument.
    """

    def __init__(
        self,
        state: FloatArray,
        covariance: FloatArray,
        noise: float = 0.5,
        measurement_noise: float = 0.05,
        dt: float = 0.1,
    ) -> None:
        self.state, self.covariance = np.array(state, dtype=float), np.array(covariance, dtype=float)
        self._noise = require_positive("noise", noise)
        self._R = require_positive("measurement_noise", measurement_noise) ** 2 * np.eye(2)
        self._dt = require_positive("dt", dt)

    def predict(self, seconds: float, acceleration: Acceleration) -> None:
        """On by some seconds, in steps of `dt` at most; `acceleration` of a state."""
        # Stamps of this century are exact to a quarter of a microsecond: by that no step is split.
        steps = max(1, int(np.ceil(seconds / self._dt - 1e-5)))
        dt = seconds / steps
        G = np.vstack([0.5 * dt**2 * np.eye(2), dt * np.eye(2)])
        for _ in range(steps):
            F = jacobian(self.state, acceleration, dt)
            self.state = step(self.state, acceleration(self.state), dt)
            self.covariance = F @ self.covariance @ F.T + self._noise**2 * G @ G.T

    def update(self, position: FloatArray) -> None:
        """Take in a measured position (2,)."""
        self.state, self.covariance, _ = kalman.update(self.state, self.covariance, position, H, self._R)

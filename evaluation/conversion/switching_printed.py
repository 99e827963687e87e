"""Algorithm 1 of chapter 6 as printed, with the particle weights of (6.16) to (6.18).

`estimation.conversion.switching` says what it does otherwise, and why. Where the text leaves a choice:

* K (6.12) is that of the converted polar measurement, with the heading's variance in the bearing's (6.6) and without
  the robot's position: with it scenario 1 could not reach 1.075 at all, as in the text scenario 2 always does.
* Line 35 draws from the measurement and line 36 converts with (6.3); the robot's pose is part of the measurement, so
  that it is drawn, too, and (6.5) converts.
* Mardia's test runs "at most at every k_mardia'th step", as the prose has it; the listing sets k_last only where the
  test is passed, and would then test at every step until it is.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from estimation.checks import FloatArray, as_shape, as_vectors, require_count, require_positive
from estimation.conversion.map_frame import convert_to_map, sample_in_map
from estimation.conversion.polar import condition_ratio
from estimation.errors import InputError
from estimation.filters import kalman
from estimation.filters.constant_velocity import ConstantVelocity, check_step
from estimation.filters.gaussians import repair_covariance
from estimation.filters.normality import mardia_test

ALPHA = 0.1  # 1/m, α of (6.18)
H = np.eye(2, 4)


def sample_weights(particles: FloatArray, samples: FloatArray, alpha: float = ALPHA) -> FloatArray:
    """Weights (N,) of particles at positions (N, 2) given converted measurement samples (S, 2), m: (6.16) to (6.18).

    The heaviest weighs 1; alpha : 1/m.
    """
    summed = cdist(particles, samples).sum(axis=1)
    return np.asarray(np.exp(alpha * (summed.min() - summed)))


class PrintedSwitchingFilter:
    """One target's filter by Algorithm 1; interface and arguments of `estimation.conversion.switching.SwitchingFilter`.

    alpha : 1/m, how fast weights fall (6.18). Raises InputError naming the argument.
    """

    def __init__(
        self,
        motion: ConstantVelocity,
        mean: npt.ArrayLike,
        covariance: npt.ArrayLike,
        k_crit: float = 1.075,
        particles: int = 1000,
        samples: int = 250,
        mardia_interval: int = 40,
        seed: int = 0,
        alpha: float = ALPHA,
    ) -> None:
        self._motion = motion
        self._mean = as_vectors("mean", mean, 4).copy()
        self._covariance = np.array(repair_covariance(covariance, "covariance"))
        if self._mean.shape != (4,) or self._covariance.shape != (4, 4):
            raise InputError("mean must have shape (4,) and covariance (4, 4)")
        if not float(k_crit) >= 0.0:
            raise InputError(f"k_crit must be a number of at least 0, not {k_crit!r}")
        self._k_crit, self._alpha = float(k_crit), require_positive("alpha", alpha)
        self._size = require_count("particles", particles, 10)
        self._samples = require_count("samples", samples, 2)
        self._interval = require_count("mardia_interval", mardia_interval)
        self._rng = np.random.default_rng(seed)
        self.particles: FloatArray | None = None
        self.ratio = math.nan
        self.switches = self.tests = 0
        self._since = 0

    @property
    def mode(self) -> Literal["kf", "pf"]:
        """ "kf" or "pf"."""
        return "kf" if self.particles is None else "pf"

    @property
    def mean(self) -> FloatArray:
        """(4,) [x, y, vx, vy] in the map frame; of particles by (6.14)."""
        return self._mean.copy() if self.particles is None else np.asarray(self.particles.mean(0))

    @property
    def covariance(self) -> FloatArray:
        """(4, 4); of particles by (6.15)."""
        return (
            self._covariance.copy()
            if self.particles is None
            else np.cov(self.particles, rowvar=False, ddof=1)
        )

    def predict(self, dt: float) -> None:
        """The standard prediction of either mode, dt ≥ 0 s."""
        F, Q = self._motion.matrices(check_step(dt))
        if self.particles is None:
            self._mean, self._covariance = kalman.predict(self._mean, self._covariance, F, Q)
        elif dt > 0.0:
            noise = self._rng.standard_normal(self.particles.shape) @ np.linalg.cholesky(Q).T
            self.particles = self.particles @ F.T + noise

    def update(
        self,
        robot_pose: npt.ArrayLike,
        robot_covariance: npt.ArrayLike,
        measurement: npt.ArrayLike,
        covariance: npt.ArrayLike,
    ) -> None:
        """Algorithm 1 for one measurement (range, bearing) of covariance (2, 2), diagonal; see `SwitchingFilter`."""
        z = as_shape("measurement", measurement, (2,))
        R = as_shape("covariance", covariance, (2, 2))
        pose = as_shape("robot_pose", robot_pose, (3,))
        P = as_shape("robot_covariance", robot_covariance, (3, 3))
        polar = (z[0], z[1], math.sqrt(R[0, 0]), math.sqrt(R[1, 1]))
        self.ratio = float(condition_ratio(*polar[:3], math.sqrt(R[1, 1] + P[2, 2])))
        gaussian = self.ratio < self._k_crit
        if self.particles is None:
            if gaussian:
                converted = convert_to_map(pose, P, *polar, "ucm")
                self._mean, self._covariance, _ = kalman.update(
                    self._mean, self._covariance, converted[0], H, converted[1]
                )
                return
            self._to_particles()
        assert self.particles is not None
        positions = self.particles[:, :2]
        if gaussian:
            mean, spread = convert_to_map(pose, P, *polar, "ucm")
            squares = np.einsum("ni,ij,nj->n", positions - mean, np.linalg.inv(spread), positions - mean)
            weights = np.exp(0.5 * (squares.min() - squares))
        else:
            drawn = sample_in_map(pose, P, *polar, self._samples, self._rng)
            weights = sample_weights(positions, drawn, self._alpha)
        chosen = self._rng.choice(self._size, self._size, p=weights / weights.sum())
        self.particles = self.particles[chosen]
        self._since += 1
        if self._since >= self._interval:
            self._test()

    def _to_particles(self) -> None:
        """Lines 11 to 20."""
        root = np.linalg.cholesky(repair_covariance(self._covariance))
        self.particles = self._mean + self._rng.standard_normal((self._size, 4)) @ root.T
        self.switches, self._since = self.switches + 1, 0

    def _test(self) -> None:
        """Lines 44 to 54."""
        assert self.particles is not None
        self.tests, self._since = self.tests + 1, 0
        if len(np.unique(self.particles[:, :2], axis=0)) > 6 and mardia_test(self.particles):
            self._mean, self._covariance = self.mean, np.array(repair_covariance(self.covariance))
            self.particles = None
            self.switches += 1

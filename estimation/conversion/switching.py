"""The switching converted-measurement filter: a Kalman filter while the measurement is Gaussian (Algorithm 1).

While K of (6.12) is below `k_crit` a target is a Gaussian; above, particles updated with converted samples.
Where it differs from the text:

* Samples are weighed by the likelihood they stand for, a mixture of small Gaussians, in place of (6.16)-(6.18),
  whose decay α is a free number that has nothing to do with the measurement's covariance.
* K compares the covariances in the map, the robot's position covariance in both (`position_in_ratio`). With the
  text's own localisation (6.20) the sum of banana and position error is close to a Gaussian where the banana
  alone is not; `whereabouts experiment conversion` measures both choices.
* The converted covariance lies along the predicted bearing (`decorrelated`), which spares both modes most of the
  bias that a covariance turned by the measurement's own error brings.
* Mardia's test runs only while K is below `k_crit`: back in Kalman mode any earlier, the next update would switch
  again. Its interval counts from the switch. By moments in place of all pairs the same test, with the same
  decisions, is cheap enough that no substitute for it is needed (`bench/bench_estimation.py`).
* Particles that were Gaussian when they were drawn stay so while nothing bends them. What bends is the arc over the
  places where the target may be: K of a measurement whose bearing is as uncertain as measurement and prediction are
  together. While that stays below `k_crit` the particles are moved as the Kalman filter moves its Gaussian (a square
  root filter, Whitaker and Hamill 2002), without the noise of weights, and they follow it exactly. It is what a
  Gaussian mixture between the two modes would do, with one component.
* Resampling is systematic, waits for the effective size to fall below 0.8 of the particles, and smooths: at 40
  updates a second copies of few particles lose a target that turns, and look less Gaussian than they are.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from estimation.checks import FloatArray, as_floats, as_number, as_points, as_shape, as_vectors, require_count
from estimation.conversion import switching_kernels as kernels
from estimation.conversion.conversion_kernels import to_map_ucm
from estimation.conversion.particles import STAGE_SMOOTHING, Particles, unrelated
from estimation.errors import InputError
from estimation.filters.constant_velocity import ConstantVelocity, check_step
from estimation.filters.gaussians import repair_covariance
from estimation.filters.normality import mardia_test

__all__ = ["ConstantVelocity", "SwitchingBank", "SwitchingFilter"]

Mode = Literal["kf", "pf"]

# Standard deviation of one sample's Gaussian, as a share of the measurement's: samples overlap, arcs stay bent.
SAMPLE_WIDTH = 0.4
# Standard deviations from the mean beyond which a thousand particles know nothing of the density's shape.
REACH = 3.5
# Effective size, as a share of the particles, below which they are resampled.
RESAMPLE_BELOW = 0.8
# Additive recurrence on the plastic number: each new point falls into the largest gap of those before it.
_STRIDES = 1.324717957244746 ** np.array([-1.0, -2.0])


class _Seen(NamedTuple):
    """One measurement z (2,) with R (2, 2), taken from a robot pose (3,) with P (3, 3)."""

    pose: FloatArray
    P: FloatArray
    z: FloatArray
    R: FloatArray

    def converted(self, direction: tuple[float, float] = (0.0, 0.0)) -> tuple[FloatArray, FloatArray]:
        """Position (2,) and covariance (2, 2) in the map, as the Kalman mode takes it; along a direction."""
        pose, P, z, R = self
        sr, sb = math.sqrt(R[0, 0]), math.sqrt(R[1, 1])
        x, y, xx, xy, yy, _ = to_map_ucm(pose, P, z[0], z[1], sr, sb, False, *direction)
        return np.array([x, y]), np.array([[xx, xy], [xy, yy]])


class _ParticleTarget:
    """One target in particle mode. straight : whether nothing has bent its particles since they were Gaussian."""

    def __init__(self, particles: Particles, since: int) -> None:
        self.particles = particles
        self.last_test = since
        self.straight = True


class SwitchingBank:
    """Many switching filters side by side, predicted and updated together.

    motion : the motion model. means (M, 4) [x, y, vx, vy] in the map frame, m and m/s; covariances (M, 4, 4).
    k_crit : K from which a target needs particles (6.13); 0 is an always-particle filter, inf a Kalman filter.
    particles, samples : sizes of the particle set and of the converted measurement sample.
    mardia_interval : updates in particle mode between normality tests.
    seed : of all draws; each target has a stream of its own, so that a bank of M equals M filters.
    position_in_ratio : whether K includes the robot's position covariance. decorrelated : whether the measurement's
    covariance lies along the predicted bearing, where that is the better known one. Raises InputError.
    """

    def __init__(
        self,
        motion: ConstantVelocity,
        means: npt.ArrayLike,
        covariances: npt.ArrayLike,
        k_crit: float = 1.075,
        particles: int = 1000,
        samples: int = 250,
        mardia_interval: int = 40,
        seed: int = 0,
        position_in_ratio: bool = True,
        decorrelated: bool = True,
    ) -> None:
        self._motion = motion
        self._means = as_points("mean", means, 4).copy()
        count = len(self._means)
        self._covariances = np.array(repair_covariance(covariances, "covariance"))
        if self._covariances.shape != (count, 4, 4):
            raise InputError(f"covariance must have shape (4, 4) per target, not {self._covariances.shape}")
        self._particles = require_count("particles", particles, 10)
        self._samples = require_count("samples", samples, 2)
        self._interval = require_count("mardia_interval", mardia_interval)
        self._limit = np.inf if k_crit == np.inf else as_number("k_crit", k_crit)
        if self._limit < 0.0:
            raise InputError(f"k_crit must be a number of at least 0, not {k_crit!r}")
        self._position_in_ratio, self._decorrelated = bool(position_in_ratio), bool(decorrelated)
        seed = require_count("seed", seed, 0)
        self._rngs = [np.random.default_rng([seed, index]) for index in range(count)]
        self._kalman = np.ones(count, dtype=np.bool_)
        self._targets: dict[int, _ParticleTarget] = {}
        self._everyone = np.arange(count)
        self._updates = 0
        self._lattice = np.arange(1, self._samples + 1)[:, None] * _STRIDES
        self._scratch = np.empty(self._samples)
        self.ratio: FloatArray = np.full(count, np.nan)
        """K (M,) of each target's last measurement."""
        self.switches = 0
        """Changes of mode so far, in both directions; `tests`: of normality."""
        self.tests = 0

    def __len__(self) -> int:
        return len(self._means)

    @property
    def in_kalman_mode(self) -> npt.NDArray[np.bool_]:
        """(M,): True for "kf", False for "pf"."""
        return self._kalman.copy()

    @property
    def means(self) -> FloatArray:
        """(M, 4) in the map frame."""
        for index, target in self._targets.items():
            self._means[index] = target.particles.mean
        return self._means.copy()

    @property
    def covariances(self) -> FloatArray:
        """(M, 4, 4) in the map frame."""
        for index, target in self._targets.items():
            self._covariances[index] = target.particles.covariance
        return self._covariances.copy()

    def predict(self, dt: float) -> None:
        """Move every target dt ≥ 0 seconds on."""
        dt, q = check_step(dt), self._motion.acceleration**2
        if dt == 0.0:
            return
        kernels.predict_kalman(self._means, self._covariances, self._kalman, dt, q)
        for index, target in self._targets.items():
            noise = self._rngs[index].standard_normal((self._particles, 4))
            if target.straight:
                noise = unrelated(noise, target.particles.states)
            kernels.predict_particles(target.particles.states, noise, dt, q)

    def update(
        self,
        robot_pose: npt.ArrayLike,
        robot_covariance: npt.ArrayLike,
        measurements: npt.ArrayLike,
        covariance: npt.ArrayLike,
        targets: npt.ArrayLike | None = None,
    ) -> None:
        """Algorithm 1 for every target, or for `targets` (m,), distinct indices.

        robot_pose (3,), robot_covariance (3, 3): of the sensor in the map. measurements (m, 2): range, m, and
        bearing, rad; covariance (2, 2) or (m, 2, 2), diagonal. Raises InputError naming the argument, and
        then leaves all targets as they were.
        """
        pose, P = (
            as_shape("robot_pose", robot_pose, (3,)),
            as_shape("robot_covariance", robot_covariance, (3, 3)),
        )
        chosen = self._everyone if targets is None else self._chosen(targets)
        z = as_shape("measurement", measurements, (len(chosen), 2))
        R = as_floats("covariance", covariance)
        R = (
            as_shape("covariance", R, (len(chosen), 2, 2))
            if R.ndim == 3
            else as_shape("covariance", R, (2, 2))[None]
        )
        problem = kernels.check(pose, P, z, R)
        if problem == kernels.ROUNDED:
            P = repair_covariance(P, "robot_covariance", definite=False)
        elif problem:
            raise InputError(kernels.PROBLEMS[problem])
        self.ratio[chosen] = K = self._update_kalman(chosen, pose, P, z, R, self._limit)
        self._updates += 1
        if not self._targets and (self._limit >= np.inf or not (self._limit <= K).any()):
            return
        for row, index in enumerate(chosen.tolist()):
            if not self._kalman[index] or K[row] >= self._limit:
                seen = _Seen(pose, P, z[row], R[row % len(R)])
                self._update_particles(index, seen, bool(K[row] < self._limit))

    def _update_kalman(
        self,
        chosen: npt.NDArray[np.int64],
        pose: FloatArray,
        P: FloatArray,
        z: FloatArray,
        R: FloatArray,
        limit: float,
    ) -> FloatArray:
        """Update those of the chosen that are in Kalman mode and have K below a limit; K (m,) of all."""
        K = np.empty(len(chosen))
        targets = self._means, self._covariances, self._kalman, chosen
        kernels.update_kalman(*targets, pose, P, z, R, limit, self._position_in_ratio, self._decorrelated, K)
        return K

    def _chosen(self, targets: npt.ArrayLike) -> npt.NDArray[np.int64]:
        chosen = np.asarray(targets, dtype=np.int64)
        if chosen.ndim != 1 or len(set(chosen.tolist())) != chosen.size:
            raise InputError("targets must be distinct indices (m,)")
        if chosen.size and not (chosen.min() >= 0 and chosen.max() < len(self)):
            raise InputError(f"targets must be from 0 to {len(self) - 1}")
        return chosen

    def _update_particles(self, index: int, seen: _Seen, gaussian: bool) -> None:
        if self._kalman[index]:
            self._to_particles(index)
        target, rng = self._targets[index], self._rngs[index]
        samples, direction = None, self._direction(target.particles, seen)
        bends = not gaussian and self._bends(target.particles, seen)
        if target.straight and not bends:
            target.particles.move(*seen.converted(direction))
            self._test_in_time(index, gaussian, bends)
            return
        target.straight = False
        if not gaussian:
            samples = np.empty((self._samples, 6))
            # Inverse transform sampling of an evenly filled square, shifted at random.
            uniform = np.clip((self._lattice + rng.uniform(size=2)) % 1.0, 1e-12, 1 - 1e-12)
            kernels.measurement_samples(ndtri(uniform), SAMPLE_WIDTH, *seen, samples)

        def log_likelihood(states: FloatArray) -> FloatArray:
            values = np.empty(len(states))
            if samples is None:
                kernels.gaussian_log_likelihood(states, *seen, *direction, values)
            else:
                kernels.sampled_log_likelihood(states, samples, self._scratch, values)
            return values

        stages = target.particles.assimilate(log_likelihood, rng, stages=1)
        if stages == 0 and self._within_reach(target.particles, seen):
            stages = target.particles.assimilate(log_likelihood, rng)
        if stages == 0:
            self._restart(index, seen)
        elif stages == 1:
            target.particles.resample(rng, below=RESAMPLE_BELOW, smooth=1.0)
        else:
            target.particles.resample(rng, below=0.5, smooth=STAGE_SMOOTHING)
        self._test_in_time(index, gaussian, bends)

    def _test_in_time(self, index: int, gaussian: bool, bends: bool) -> None:
        """Mardia's test at its interval, where its answer can change something."""
        target = self._targets.get(index)
        if target is None or bends or (target.straight and not gaussian):
            return
        if self._updates - target.last_test >= self._interval:
            target.last_test = self._updates
            self._try_kalman(index, gaussian)

    def _bends(self, particles: Particles, seen: _Seen) -> bool:
        """Whether the arc of the measurement bends within the places where the target may be."""
        m, C = particles.mean, particles.covariance
        return bool(
            kernels.ratio_where_expected(m[0], m[1], C[:2, :2], *seen, self._position_in_ratio) >= self._limit
        )

    def _direction(self, particles: Particles, seen: _Seen) -> tuple[float, float]:
        """Where the measurement's covariance points, as in Kalman mode."""
        if not self._decorrelated:
            return 0.0, 0.0
        m, C = particles.mean, particles.covariance
        place = m[0], m[1], C[0, 0], C[0, 1], C[1, 1]
        dx, dy = kernels.predicted_direction(*place, seen.pose, seen.P, seen.z[0], seen.R[1, 1])
        return dx, dy

    @staticmethod
    def _within_reach(particles: Particles, seen: _Seen) -> bool:
        """Whether the measurement lies among the particles, so that stages can concentrate them there."""
        position, spread = seen.converted()
        S = particles.covariance[:2, :2] + spread
        offset = particles.mean[:2] - position
        return bool(offset @ np.linalg.solve(S, offset) <= REACH**2)

    def _restart(self, index: int, seen: _Seen) -> None:
        """Kalman update of the particles' Gaussian, sampled anew: for measurements far from every particle."""
        particles = self._targets[index].particles
        self._means[index] = particles.mean
        self._covariances[index] = repair_covariance(particles.covariance)
        self._kalman[index] = True
        self._update_kalman(np.array([index]), seen.pose, seen.P, seen.z[None], seen.R[None], np.inf)
        self._to_particles(index)
        self.switches -= 1

    def _to_particles(self, index: int) -> None:
        """Samples of the Gaussian with exactly its mean and covariance, so that switching adds no error."""
        noise = self._rngs[index].standard_normal((self._particles, 4))
        noise -= noise.mean(0)
        factor = np.linalg.cholesky(noise.T @ noise / (len(noise) - 1))
        P = repair_covariance(self._covariances[index])
        states = self._means[index] + np.linalg.solve(factor, noise.T).T @ np.linalg.cholesky(P).T
        self._targets[index] = _ParticleTarget(Particles.equal(states), self._updates)
        self._kalman[index] = False
        self.switches += 1

    def _try_kalman(self, index: int, gaussian: bool) -> None:
        self.tests += 1
        target = self._targets[index]
        particles = target.particles
        if not target.straight:
            particles.resample(self._rngs[index], smooth=1.0)
        if not mardia_test(particles.states):
            return
        target.straight = True
        if not gaussian:
            return
        self._means[index] = particles.mean
        self._covariances[index] = particles.covariance
        del self._targets[index]
        self._kalman[index] = True
        self.switches += 1


class SwitchingFilter:
    """One target's switching filter, a `SwitchingBank` of one: arguments as there, for mean (4,), cov. (4, 4)."""

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
        position_in_ratio: bool = True,
        decorrelated: bool = True,
    ) -> None:
        mean = as_vectors("mean", mean, 4)
        if mean.shape != (4,):
            raise InputError(f"mean must have shape (4,), not {mean.shape}")
        spread = as_floats("covariance", covariance)[None]
        self._bank = SwitchingBank(
            motion,
            mean[None],
            spread,
            k_crit,
            particles,
            samples,
            mardia_interval,
            seed,
            position_in_ratio,
            decorrelated,
        )

    def predict(self, dt: float) -> None:
        """Move the target dt ≥ 0 seconds on."""
        self._bank.predict(dt)

    def update(
        self,
        robot_pose: npt.ArrayLike,
        robot_covariance: npt.ArrayLike,
        measurement: npt.ArrayLike,
        covariance: npt.ArrayLike,
    ) -> None:
        """Update with one measurement (range, bearing) of covariance (2, 2), diagonal, taken from `robot_pose`.

        robot_pose (3,) [x, y, yaw] and robot_covariance (3, 3), zero where exact, of the sensor in the map.
        Raises InputError naming the argument, and then leaves the filter as it was.
        """
        measurement = as_shape("measurement", measurement, (2,))
        self._bank.update(robot_pose, robot_covariance, measurement[None], covariance)

    @property
    def mode(self) -> Mode:
        """ "kf" or "pf"."""
        return "kf" if self._bank._kalman[0] else "pf"

    @property
    def mean(self) -> FloatArray:
        """(4,) [x, y, vx, vy] in the map frame."""
        return self._bank.means[0]

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) in the map frame."""
        return self._bank.covariances[0]

    @property
    def ratio(self) -> float:
        """K of the last measurement, NaN before the first."""
        return float(self._bank.ratio[0])

    @property
    def switches(self) -> int:
        """Changes of mode so far, in both directions."""
        return self._bank.switches

    @property
    def tests(self) -> int:
        """Normality tests so far."""
        return self._bank.tests

    @property
    def particles(self) -> Particles | None:
        """The particles in "pf" mode, else None."""
        return self._bank._targets[0].particles if self._bank._targets else None

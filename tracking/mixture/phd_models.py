"""The models of a PHD filter: motion with survival, birth and spawn (1), (17), (18); measurement (2); detection (5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from estimation.checks import FloatArray
from tracking.mixture.components import Components, IntArray
from tracking.mixture.phd_config import PhdConfig

# Scans' worth of prior returns behind a new target's rate and extent.
PRIOR_SCANS = 2.0


class Labels:
    """Numbers that are handed out once."""

    def __init__(self) -> None:
        self.next = 0

    def take(self, count: int) -> IntArray:
        """`count` unused numbers."""
        self.next += count
        return np.arange(self.next - count, self.next)


class ConstantVelocityMotion:
    """x' = F x + G w with w the acceleration, constant over the interval (Section 2, with Q of Table 1)."""

    def __init__(self, config: PhdConfig) -> None:
        self.config = config

    def matrices(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """F and the process noise G σ² Gᵀ (4, 4) over dt seconds."""
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        G = np.vstack([0.5 * dt**2 * np.eye(2), dt * np.eye(2)])
        return F, self.config.process_noise**2 * G @ G.T

    def predict(self, components: Components, dt: float, labels: Labels) -> Components:
        """Survivors, births and spawned components after dt ≥ 0 seconds: (6) one step on."""
        if dt == 0.0:
            return components
        scans = dt / self.config.scan_period
        survivors, moved = self.survivors(components, dt)
        return Components.join(
            [survivors, self.births(scans, labels), self.spawned(survivors, moved, scans, labels)]
        )

    def survivors(self, components: Components, dt: float) -> tuple[Components, FloatArray]:
        """Components dt seconds on, and their covariances (J, 4, 4) before process noise is added."""
        F, Q = self.matrices(dt)
        moved = F @ components.covariances @ F.T
        return self.surviving(components, dt, components.means @ F.T, moved + Q), moved

    def surviving(
        self, components: Components, dt: float, means: FloatArray, covariances: FloatArray
    ) -> Components:
        """Components at new means (J, 4) with covariances (J, 4, 4), less probable and less known dt seconds on."""
        scans = dt / self.config.scan_period
        # A gamma or Wishart density forgets by losing weight behind the same mean, down to that of a new target.
        keep = max(1.0 - 1.0 / self.config.memory, 0.0) ** scans
        return Components(
            components.weights * self.config.survival_probability**scans,
            means,
            covariances,
            components.labels,
            components.counts * keep,
            components.spread * keep,
            components.freedom * keep,
        )

    def births(self, scans: float, labels: Labels) -> Components:
        """The birth intensity (17) over `scans` scan periods, each component with a number of its own."""
        births = [birth for birth in self.config.births if birth[0] > 0]
        if not births:
            return Components.empty()
        return self.fresh(
            np.array([birth[0] for birth in births]) * scans,
            np.array([birth[1] for birth in births]),
            np.array([birth[2] for birth in births]),
            labels,
        )

    def spawned(self, survivors: Components, moved: FloatArray, scans: float, labels: Labels) -> Components:
        """The spawn intensity (18): around each target; not where pruning would drop it at once."""
        if self.config.spawn is None or len(survivors) == 0:
            return Components.empty()
        weight, covariance = self.config.spawn
        weights = weight * scans * survivors.weights
        chosen = weights > max(self.config.prune_weight, 1e-12)
        return self.fresh(weights[chosen], survivors.means[chosen], moved[chosen] + covariance, labels)

    def fresh(
        self, weights: FloatArray, means: FloatArray, covariances: FloatArray, labels: Labels
    ) -> Components:
        """Components of targets nobody has seen yet: rate and extent as configured."""
        count, gamma = len(weights), self.config.measurement_rate
        spread_of_rate = self.config.rate_spread
        shape = 1.0 / spread_of_rate**2 if spread_of_rate > 0.0 else PRIOR_SCANS * gamma
        freedom = max(PRIOR_SCANS * gamma, 2.0)
        spread = freedom * self.config.measurement_noise**2 * np.eye(2)
        return Components(
            weights,
            means,
            covariances,
            labels.take(count),
            np.tile([shape, shape / gamma], (count, 1)),
            np.tile(spread, (count, 1, 1)),
            np.full(count, freedom),
        )


class PositionMeasurement:
    """z = H x + e: the position, with covariance R = σ² I of each return (2)."""

    H = np.eye(2, 4)

    def __init__(self, config: PhdConfig) -> None:
        self.R = config.measurement_noise**2 * np.eye(2)


class Detection(Protocol):
    """p_D of every component (Assumption 3); `sensor_pose` (3,) is where the scan was taken, where known."""

    def __call__(self, means: FloatArray, sensor_pose: FloatArray | None) -> FloatArray:
        """Probabilities (J,) for the predicted means (J, 4)."""


@dataclass
class Sight:
    """What can be seen of J components.

    probability (J,) : p_D, over where it may be; share (J,) : of its returns a target gives where it is seen; means
    (J, 4), covariances (J, 4, 4) : its state given that it was not. at_return (J,) : p_D at a place that gave a return.
    """

    probability: FloatArray
    share: FloatArray
    means: FloatArray
    covariances: FloatArray
    at_return: FloatArray

    @classmethod
    def plain(cls, probability: FloatArray, components: Components) -> Sight:
        """p_D (J,) that says nothing of where a target is."""
        return cls(
            probability, np.ones(len(components)), components.means, components.covariances, probability
        )


class SceneDetection(Protocol):
    """p_D that also depends on the other targets; used in place of a plain call where a model has it."""

    def in_scene(
        self, components: Components, weights: FloatArray, tracks: int, sensor_pose: FloatArray | None
    ) -> Sight:
        """What can be seen of the components; the first `tracks` hide others, by `weights` (tracks,)."""


def detect(
    model: Detection | SceneDetection,
    components: Components,
    weights: FloatArray,
    tracks: int,
    sensor_pose: FloatArray | None,
) -> Sight:
    """What either kind of model says."""
    if hasattr(model, "in_scene"):
        found: Sight = model.in_scene(components, weights, tracks, sensor_pose)
        return found
    assert callable(model)
    return Sight.plain(model(components.means, sensor_pose), components)


class ConstantDetection:
    """The same p_D everywhere."""

    def __init__(self, config: PhdConfig) -> None:
        self.probability = config.detection_probability

    def __call__(self, means: FloatArray, sensor_pose: FloatArray | None) -> FloatArray:
        """Probabilities (J,)."""
        return np.full(len(means), self.probability)


class PoissonCount:
    """Γ of (9b): a detected extended target gives Poisson(γ) returns, fewer where a part of it is hidden."""

    def __init__(self, config: PhdConfig) -> None:
        self.gamma = config.measurement_rate

    def log_weight(self, counts: FloatArray, share: FloatArray) -> FloatArray:
        """log(e^-γ γ^n) (C, J) for cells of n (C,) returns of targets of which a share (J,) is visible."""
        gamma = self.gamma * share
        result: FloatArray = counts[:, None] * np.log(gamma) - gamma
        return result

    def seen(self, share: FloatArray) -> FloatArray:
        """Probability (J,) that a detected target gives a return at all."""
        result: FloatArray = -np.expm1(-self.gamma * share)
        return result


class OneReturn:
    """A point target gives exactly one return (Vo and Ma 2006)."""

    def log_weight(self, counts: FloatArray, share: FloatArray) -> FloatArray:
        """0 for one return, -inf for more, (C, 1)."""
        return np.where(counts == 1, 0.0, -np.inf)[:, None]

    def seen(self, share: FloatArray) -> FloatArray:
        """1, (J,)."""
        return np.ones(len(share))

"""The rule of chapter 3 as printed, (3.3) to (3.11), beside what `world_model.tasks.maintenance` made of it.

No anticipation, no stand-off, no tours: the robot drives to the object and looks at each time step on the way. An
action is worth what its predict-update cycles bring, each by (3.5), summed over the cycles and over all objects that
are in range. The text leaves three ways open to measure the gain of a way with several cycles: against the entropy
now, against the entropy that nobody looked would have led to, and cycle by cycle. The third is taken: of the three it
is the one with which distances fall where Figure 3.4 has them fall (`whereabouts experiment maintenance`).

Covariances are circular, a variance per object and axis, as in the text's simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray, require_positive
from estimation.errors import InputError
from evaluation.maintenance.maintenance_world import MaintenanceRoom, RoomPlan, TourAccount
from evaluation.maintenance.maintenance_world_kernels import RunRule
from world_model.tasks.looks import Sensor


@dataclass(frozen=True)
class PrintedRule:
    """Settings of section 3.7.1.

    threshold : IG_thr, nat (3.7). weight : ω, norm : IG_norm, nat (3.9). scale : C_scale, m (3.8). range_min,
    range_max : m, of the sensor. variance : σ_M, m² per axis of one look. speed : m/s, time_step : s; the text states
    neither. Raises InputError naming the field.
    """

    threshold: float = 8.0
    weight: float = 0.75
    norm: float = 5.0
    scale: float = 10.0
    range_min: float = 0.4
    range_max: float = 2.0
    variance: float = 0.01
    speed: float = 1.7
    time_step: float = 1.2

    def __post_init__(self) -> None:
        for name in ("norm", "scale", "variance", "speed", "time_step"):
            require_positive(name, getattr(self, name))
        if not 0.0 <= self.range_min < self.range_max < math.inf:
            raise InputError(
                f"range_min, range_max: 0 <= min < max expected, got {self.range_min!r}, {self.range_max!r}"
            )
        if not (self.threshold >= 0.0 and self.weight >= 0.0):
            raise InputError(
                f"threshold, weight: at least 0 expected, got {self.threshold!r}, {self.weight!r}"
            )

    @property
    def stride(self) -> float:
        """m in a time step."""
        return self.speed * self.time_step

    @property
    def numbers(self) -> FloatArray:
        """What the compiled functions take."""
        return np.array([self.threshold, self.weight, self.norm, self.scale])


def entropy(covariance: FloatArray) -> float:
    """H of a Gaussian of covariance (n, n), nat: (3.3)."""
    n = len(covariance)
    return 0.5 * n * (1.0 + math.log(2.0 * math.pi)) + 0.5 * float(np.linalg.slogdet(covariance)[1])


def room_of(rule: PrintedRule, seed: int, duration: float = 1000.0) -> MaintenanceRoom:
    """A room of 10 m with ten objects and σ_P from [0, 0.01] m² per time step (section 3.7.1); looks have no errors."""
    sensor = Sensor("camera", rule.range_min, rule.range_max, rule.variance * np.eye(2))
    plan = RoomPlan(
        rule.scale, noise=0.01 / rule.time_step, duration=duration, time_step=rule.time_step,
        speed=rule.speed, sensors=(sensor,),
    )  # fmt: skip
    made = MaintenanceRoom(plan, seed)
    made.truth.noise[:] = 0.0
    made.belief.means[:] = made.truth.positions
    return made


def simulate(
    rule: PrintedRule, seed: int, fixed: bool = False, idle: bool = False, duration: float = 1000.0
) -> TourAccount:
    """One run. fixed : the benchmark, from object to object. idle : looks, too, while there is nothing to go for."""
    order = np.arange(10 * fixed)
    return room_of(rule, seed, duration).ruled(RunRule(np.zeros(9), order, rule.numbers, idle))

"""The world of section 3.7.1: a square room, objects that grow uncertain while nobody looks, one robot.

The robot is perfectly localised and drives straight. Whatever is within range at a time step is measured and
filtered, whatever strategy drives it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.errors import InputError
from evaluation.maintenance.maintenance_world_kernels import Belief, RunRule, SimulatedRoom, run
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance_kernels import shortest_way
from world_model.tasks.maintenance_options import MaintenanceConfig

Array = np.ndarray


@dataclass(frozen=True)
class RoomPlan:
    """size : m, of the square room. objects : how many. noise : most process noise, m²/s. duration, time_step : s.

    speed : m/s. sensors : all look at each step.
    """

    size: float = 10.0
    objects: int = 10
    noise: float = 0.01
    duration: float = 1000.0
    time_step: float = 0.5
    speed: float = 0.5
    sensors: tuple[Sensor, ...] = (Sensor("camera", 0.4, 2.0, 0.01 * np.eye(2)),)


@dataclass
class TourAccount:
    """What a run came to: means over time of the largest and the summed entropy, nat; metres; looks, goals; way, m."""

    worst: float
    total: float
    distance: float
    updates: Array
    goals: Array
    path: Array


class MaintenanceRoom:
    """One run at its beginning: what of it is true, `truth`, and what is believed, `belief`.

    Raises
    ------
    InputError : a sensor whose errors are not alike along all axes.
    """

    def __init__(self, plan: RoomPlan, seed: int) -> None:
        sensors = np.array([_circular(sensor) for sensor in plan.sensors])
        rng, count, steps = np.random.default_rng(seed), plan.objects, round(plan.duration / plan.time_step)
        positions = rng.uniform(0.0, plan.size, (count, 2))
        growth = plan.time_step * rng.uniform(0.0, plan.noise, count)
        first = float(sensors[0, 2])
        means = positions + math.sqrt(first) * rng.standard_normal((count, 2))
        noise = rng.standard_normal((steps, len(sensors), count, 2))
        costs, start = np.array([sensor.cost for sensor in plan.sensors]), np.full(3, 0.5 * plan.size)
        start[2] = 0.0
        stride = plan.speed * plan.time_step
        self.truth = SimulatedRoom(positions, growth, noise, sensors, costs, stride, plan.time_step, start)
        self.belief = Belief(means, np.full(count, first), np.zeros(count, np.int64))

    def run(self, config: MaintenanceConfig, order: Sequence[int] | Array = ()) -> TourAccount:
        """By maintenance, or from object to object in an order."""
        settings = np.array([
            config.information_gain_threshold, config.weight, config.information_gain_norm, config.cost_scale,
            config.company, config.standoff, config.anticipation, config.tour, config.retry_after,
        ])  # fmt: skip
        return self.ruled(RunRule(settings, np.asarray(order, dtype=np.int64), np.zeros(0), True))

    def ruled(self, rule: RunRule) -> TourAccount:
        """By any rule."""
        belief = Belief(*(each.copy() for each in self.belief))
        worst, total, *rest = run(self.truth, belief, rule)
        steps = len(self.truth.noise)
        return TourAccount(worst / steps, total / steps, *rest)


def _circular(sensor: Sensor) -> tuple[float, float, float]:
    """range_min, range_max and the variance along each axis."""
    covariance = np.asarray(sensor.covariance, dtype=np.float64)
    if not np.allclose(covariance, covariance[0, 0] * np.eye(len(covariance))):
        raise InputError(f"sensor {sensor.name!r}: the simulated rooms know circular errors only")
    return sensor.range_min, sensor.range_max, float(covariance[0, 0])


def fixed_path(plan: RoomPlan, seed: int, order: str = "given") -> TourAccount:
    """The text's benchmark, from object to object over and over; `order` "given", or "tour": the shortest one."""
    room = MaintenanceRoom(plan, seed)
    return room.run(
        MaintenanceConfig(), range(plan.objects) if order == "given" else shortest_tour(room.truth.positions)
    )


def maintained(plan: RoomPlan, seed: int, config: MaintenanceConfig) -> TourAccount:
    """The proposed strategy, compiled."""
    return MaintenanceRoom(plan, seed).run(config)


def shortest_tour(points: Array) -> Array:
    """Order (N,) of the shortest round trip over points (N, 2), for some ten of them."""
    return np.asarray(shortest_way(points[0, 0], points[0, 1], points, 0))

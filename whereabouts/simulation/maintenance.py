"""The world of section 3.7.1: a square room, objects that grow uncertain while nobody looks, one robot.

The robot is perfectly localised and drives straight. Whatever is within range at a time step is measured and
filtered, whatever strategy drives it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from world_model.looks import Sensor
from world_model.maintenance import Maintenance, MaintenanceConfig
from world_model.state import WorldObject, WorldState

Array = np.ndarray
Planner = Callable[["MaintenanceRoom"], Array | None]


@dataclass(frozen=True)
class RoomPlan:
    """size : m, of the square room. objects : how many. noise : most process noise, m²/s. duration, time_step : s.

    speed : m/s. sensors : the first is what updates objects on the way unless a task names another.
    """

    size: float = 10.0
    objects: int = 10
    noise: float = 0.01
    duration: float = 1000.0
    time_step: float = 0.5
    speed: float = 0.5
    sensors: tuple[Sensor, ...] = (Sensor("camera", 0.4, 2.0, 0.01 * np.eye(2)),)


@dataclass
class Account:
    """What a run came to: means over time of the largest and the summed entropy, nat; metres; looks, goals."""

    worst: float
    total: float
    distance: float
    updates: Array
    goals: Array
    path: Array


@dataclass
class MaintenanceRoom:
    """State of one run; `positions` are true, `means` and `variances` (N, 2, 2) believed."""

    plan: RoomPlan
    rng: np.random.Generator
    positions: Array = field(init=False)
    growth: Array = field(init=False)
    means: Array = field(init=False)
    covariances: Array = field(init=False)
    seen_at: Array = field(init=False)
    pose: Array = field(init=False)
    time: float = 0.0

    def __post_init__(self) -> None:
        count, first = self.plan.objects, np.asarray(self.plan.sensors[0].covariance, dtype=np.float64)
        self.positions = self.rng.uniform(0.0, self.plan.size, (count, 2))
        self.growth = self.rng.uniform(0.0, self.plan.noise, count)
        noise = np.linalg.cholesky(first)
        self.means = self.positions + self.rng.standard_normal((count, 2)) @ noise.T
        self.covariances = np.repeat(first[None], count, axis=0)
        self.seen_at = np.zeros(count)
        self.pose = np.array([0.5 * self.plan.size, 0.5 * self.plan.size, 0.0])

    def step(self, sensor: Sensor) -> Array:
        """Time goes on by a step: beliefs blur, what is in range is measured; which objects were (N,)."""
        plan = self.plan
        self.time += plan.time_step
        self.covariances += (self.growth * plan.time_step)[:, None, None] * np.eye(2)
        away = np.hypot(*(self.positions - self.pose[:2]).T)
        visible = (away >= sensor.range_min) & (away <= sensor.range_max)
        R = np.asarray(sensor.covariance, dtype=np.float64)
        noise = self.rng.standard_normal((plan.objects, 2)) @ np.linalg.cholesky(R).T
        for k in np.flatnonzero(visible):
            P = self.covariances[k]
            gain = P @ np.linalg.inv(P + R)
            self.means[k] += gain @ (self.positions[k] + noise[k] - self.means[k])
            self.covariances[k] = P - gain @ P
        self.seen_at[visible] = self.time
        return visible

    def entropies(self) -> Array:
        """(N,) nat: (3.3)."""
        return 1.0 + math.log(2.0 * math.pi) + 0.5 * np.linalg.slogdet(self.covariances)[1]

    def state(self) -> WorldState:
        """What a world model would say, planar."""
        objects = tuple(
            WorldObject(
                f"thing-{k + 1}", np.array([*self.means[k], 0.0]), np.zeros(3), self._spatial(self.covariances[k]),
                {}, 1.0, False, float(self.seen_at[k]),
                process_noise=np.diag([self.growth[k], self.growth[k], 0.0]),
            )
            for k in range(self.plan.objects)
        )  # fmt: skip
        return WorldState(objects, 1.0, float(len(objects)), self.time)

    @staticmethod
    def _spatial(planar: Array) -> Array:
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = planar
        return covariance

    def drive_towards(self, goal: Array) -> float:
        """One time step's drive; the metres it took."""
        offset = goal[:2] - self.pose[:2]
        away = math.hypot(*offset)
        stride = min(away, self.plan.speed * self.plan.time_step)
        if away > 1e-9:
            self.pose = np.array(
                [*(self.pose[:2] + offset * (stride / away)), math.atan2(offset[1], offset[0])]
            )
        return stride


def fixed_path(plan: RoomPlan, seed: int, order: str = "given") -> Account:
    """The text's benchmark: from object to object over and over; `order` "given", or "tour" for a short round trip."""
    room = MaintenanceRoom(plan, np.random.default_rng(seed))
    sequence = np.arange(plan.objects) if order == "given" else short_tour(room.means)
    sensor, index = plan.sensors[0], 0
    ledger = _Ledger(room)
    goal = room.positions[sequence[0]]
    while room.time < plan.duration:
        stride = room.drive_towards(goal)
        ledger.take(room.step(sensor), stride)
        if np.allclose(room.pose[:2], goal):
            ledger.goals[sequence[index]] += 1
            index = (index + 1) % plan.objects
            goal = room.positions[sequence[index]]
    return ledger.account()


def maintained(plan: RoomPlan, seed: int, config: MaintenanceConfig) -> Account:
    """The proposed strategy, driven by `Maintenance`."""
    room = MaintenanceRoom(plan, np.random.default_rng(seed))
    maintenance = Maintenance(config)
    sensors = {sensor.name: sensor for sensor in plan.sensors}
    ledger = _Ledger(room)
    task = None
    while room.time < plan.duration:
        if task is None:
            task = maintenance.next_task(room.state(), room.pose, plan.sensors)
            if task is not None:
                ledger.goals[int(task.object_id.rpartition("-")[2]) - 1] += 1
        stride = room.drive_towards(task.goal) if task is not None else 0.0
        sensor = plan.sensors[0] if task is None else sensors[task.sensor]
        visible = room.step(sensor)
        ledger.take(visible, stride)
        if task is not None and np.allclose(room.pose[:2], task.goal[:2]):
            looked = visible[int(task.object_id.rpartition("-")[2]) - 1]
            maintenance.report(task, "found" if looked else "occluded", room.time)
            task = None
    return ledger.account()


def short_tour(points: Array) -> Array:
    """Order (N,) of a short round trip over points (N, 2): nearest neighbour, then 2-opt."""
    count = len(points)
    left, order = set(range(1, count)), [0]
    while left:
        here = points[order[-1]]
        order.append(min(left, key=lambda k: (math.hypot(*(points[k] - here)), k)))
        left.remove(order[-1])
    between = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    improved = True
    while improved:
        improved = False
        for i in range(1, count - 1):
            for j in range(i + 1, count):
                a, b, c, d = order[i - 1], order[i], order[j], order[(j + 1) % count]
                if between[a, c] + between[b, d] < between[a, b] + between[c, d] - 1e-9:
                    order[i : j + 1] = order[i : j + 1][::-1]
                    improved = True
    return np.array(order)


class _Ledger:
    """Sums over a run."""

    def __init__(self, room: MaintenanceRoom) -> None:
        self._room = room
        self._worst = self._total = self._distance = 0.0
        self._steps = 0
        self.goals = np.zeros(room.plan.objects, dtype=np.int64)
        self._updates = np.zeros(room.plan.objects, dtype=np.int64)
        self._path = [room.pose[:2].copy()]

    def take(self, visible: Array, stride: float) -> None:
        entropies = self._room.entropies()
        self._worst += float(entropies.max())
        self._total += float(entropies.sum())
        self._distance += stride
        self._updates += visible
        self._steps += 1
        self._path.append(self._room.pose[:2].copy())

    def account(self) -> Account:
        return Account(
            self._worst / self._steps, self._total / self._steps, self._distance, self._updates, self.goals,
            np.array(self._path),
        )  # fmt: skip

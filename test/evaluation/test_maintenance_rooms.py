"""The compiled rooms of maintenance against `Maintenance` itself, and what they are made of against brute force."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from estimation.errors import InputError
from evaluation.maintenance.maintenance_world import (
    MaintenanceRoom,
    RoomPlan,
    TourAccount,
    fixed_path,
    maintained,
    shortest_tour,
)
from evaluation.maintenance.maintenance_world_kernels import HERE, drive, look_around
from world_model.state import WorldObject, WorldState
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance import Maintenance, MaintenanceConfig
from world_model.tasks.maintenance_kernels import shortest_way

PLAN = RoomPlan(duration=150.0)
LASER = Sensor("laser", 0.2, 4.0, 0.09 * np.eye(2), cost=1.0)
# What it is told to look at is often not where it looks: it comes nearer, from another side.
NARROW = Sensor("narrow", 0.4, 0.8, 0.09 * np.eye(2))


def maintained_by(maintenance: Maintenance, plan: RoomPlan, seed: int) -> TourAccount:
    """The same room, where `Maintenance` itself says what to do; much slower."""
    room, time, task = MaintenanceRoom(plan, seed), 0.0, None
    pose = np.array([0.5 * plan.size, 0.5 * plan.size, 0.0])
    updates, goals, path = (
        np.zeros(plan.objects, np.int64),
        np.zeros(plan.objects, np.int64),
        [pose[:2].copy()],
    )
    worst = total = distance = 0.0
    for noise in room.truth.noise:
        if task is None:
            task = maintenance.next_task(_state(room, time), pose, plan.sensors)
            if task is not None:
                goals[int(task.object_id)] += 1
        if task is not None:
            distance += drive(pose, task.goal[:2], plan.speed * plan.time_step)
        time += plan.time_step
        before = updates.copy()
        summed, largest = look_around(room.truth, room.belief, pose, noise, updates, True)
        worst, total = worst + largest, total + summed
        path.append(pose[:2].copy())
        if task is not None and math.hypot(*(pose[:2] - task.goal[:2])) <= HERE:
            k = int(task.object_id)
            maintenance.report(task, "found" if updates[k] > before[k] else "occluded", time)
            task = None
    steps = len(room.truth.noise)
    return TourAccount(worst / steps, total / steps, distance, updates, goals, np.array(path))


def _state(room: MaintenanceRoom, time: float) -> WorldState:
    """What a world model would say, planar; objects are called after their numbers."""
    objects = tuple(
        WorldObject(
            str(k), np.array([*room.belief.means[k], 0.0]), np.zeros(3), np.diag([variance, variance, 0.0]), {}, 1.0,
            False, time, process_noise=np.diag([growth, growth, 0.0]) / room.truth.step,
        )
        for k, (variance, growth) in enumerate(zip(room.belief.variances, room.truth.growth, strict=True))
    )  # fmt: skip
    return WorldState(objects, 1.0, float(len(objects)), time)


@pytest.mark.parametrize("sensors", [PLAN.sensors, (*PLAN.sensors, LASER), (NARROW,)])
@pytest.mark.parametrize(("threshold", "tour"), [(2.0, 0.0), (5.0, 0.35), (9.0, 0.35)])
def test_the_compiled_run_is_that_of_maintenance(
    threshold: float, tour: float, sensors: tuple[Sensor, ...]
) -> None:
    config = MaintenanceConfig(information_gain_threshold=threshold, tour=tour)
    plan = replace(PLAN, sensors=sensors)
    for seed in (3, 4):
        fast, slow = maintained(plan, seed, config), maintained_by(Maintenance(config), plan, seed)
        np.testing.assert_allclose(fast.path, slow.path, atol=1e-9)
        np.testing.assert_array_equal(fast.updates, slow.updates)
        np.testing.assert_array_equal(fast.goals, slow.goals)
        assert fast.worst == pytest.approx(slow.worst, abs=1e-9)
        assert fast.total == pytest.approx(slow.total, abs=1e-9)
        assert fast.distance == pytest.approx(slow.distance)


def test_entropies_are_those_of_a_kalman_filter_where_nothing_moves() -> None:
    # One object next to the robot, seen at each step: the filter's variance has a closed form per step.
    plan = RoomPlan(objects=1, duration=20.0, size=1.6, sensors=(Sensor("near", 0.0, 2.0, 0.01 * np.eye(2)),))
    room = MaintenanceRoom(plan, 1)
    account = room.run(MaintenanceConfig(information_gain_threshold=1e6))
    variance, entropies = 0.01, []
    for _ in room.truth.noise:
        variance += room.truth.growth[0]
        variance = 1.0 / (1.0 / variance + 1.0 / 0.01)
        entropies.append(0.5 * np.log((2.0 * np.pi * np.e) ** 2 * variance**2))
    assert account.distance == 0.0
    assert account.total == pytest.approx(np.mean(entropies))
    assert account.worst == pytest.approx(np.mean(entropies))


def test_shortest_ways_and_tours_are_those_of_trying_every_order() -> None:
    rng = np.random.default_rng(5)
    for count in (1, 2, 5, 7):
        spots, start = rng.uniform(0.0, 10.0, (count, 2)), rng.uniform(0.0, 10.0, 2)

        def along(
            order: tuple[int, ...], closed: bool, spots: np.ndarray = spots, start: np.ndarray = start
        ) -> float:
            places = spots[list(order)]
            places = np.vstack([places, places[:1]]) if closed else np.vstack([start, places])
            return float(np.hypot(*np.diff(places, axis=0).T).sum())

        orders = list(itertools.permutations(range(count)))
        way = tuple(shortest_way(start[0], start[1], spots))
        assert sorted(way) == list(range(count))
        assert along(way, False) == pytest.approx(min(along(order, False) for order in orders))
        tour = tuple(shortest_tour(spots))
        assert sorted(tour) == list(range(count))
        assert along(tour, True) == pytest.approx(min(along(order, True) for order in orders))


def test_the_fixed_path_goes_from_object_to_object() -> None:
    account = fixed_path(PLAN, 0)
    room = MaintenanceRoom(PLAN, 0)
    assert account.goals.max() - account.goals.min() <= 1
    for spot in room.truth.positions[: account.goals.sum()]:
        assert np.hypot(*(account.path - spot).T).min() < 1e-6
    assert account.distance <= PLAN.speed * PLAN.duration


def test_tours_lower_the_worst_case_for_the_distance_they_take() -> None:
    """Held-out rooms; the figures of `whereabouts experiment maintenance` in small."""
    plan = RoomPlan()
    singly, touring = ([], [])
    for seed in range(700_000, 700_030):
        singly.append(maintained(plan, seed, MaintenanceConfig(9.0, tour=0.0)))
        touring.append(maintained(plan, seed, MaintenanceConfig(9.0)))
    worst = [np.mean([account.worst for account in accounts]) for accounts in (singly, touring)]
    distance = [np.mean([account.distance for account in accounts]) for accounts in (singly, touring)]
    assert worst[1] < worst[0] - 0.5
    assert distance[1] < 1.3 * distance[0]


def test_sensors_with_lopsided_errors_are_refused() -> None:
    with pytest.raises(InputError, match="circular"):
        MaintenanceRoom(replace(PLAN, sensors=(Sensor("odd", 0.0, 1.0, np.diag([1.0, 2.0])),)), 0)

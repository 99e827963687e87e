"""What to look at next: entropies and gains against plain Kalman algebra, triggers, bounds and outcomes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from world_model.state import WorldObject, WorldState
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance import Maintenance, MaintenanceConfig, Trigger, warm_up
from world_model.tasks.maintenance_kernels import looks_along, path_gain, shortest_way, single_gains

CAMERA = Sensor("camera", 0.4, 2.0, 0.01 * np.eye(3))
LASER = Sensor("laser", 0.1, 8.0, 0.04 * np.eye(3))
EAGER = MaintenanceConfig(information_gain_threshold=0.5)


def thing(name: str, x: float, y: float, variance: float = 0.5, **changes: object) -> WorldObject:
    item = WorldObject(
        name,
        np.array([x, y, 0.7]),
        np.zeros(3),
        variance * np.eye(3),
        {"class": {"cup": 1.0}},
        1.0,
        False,
        0.0,
        process_noise=1e-3 * np.eye(3),
    )
    return replace(item, **changes)  # type: ignore[arg-type]


def world(*objects: WorldObject, stamp: float = 0.0) -> WorldState:
    return WorldState(objects, 1.0, float(len(objects)), stamp)


def test_gain_along_a_path_is_that_of_a_kalman_filter_driven_along_it() -> None:
    rng = np.random.default_rng(0)
    path = np.column_stack([np.arange(9) * 0.25, np.zeros(9), np.zeros(9)])
    positions = rng.uniform([-1.0, -2.0], [4.0, 2.0], (12, 2))
    P = np.array([np.cov(rng.standard_normal((3, 9))) for _ in range(12)])
    Q = np.array([0.01 * np.cov(rng.standard_normal((3, 9))) for _ in range(12)])
    R = np.array([0.05 * np.cov(rng.standard_normal((3, 9))) for _ in range(12)])
    for opening, share in ((2.0 * math.pi, 1.0), (1.2, 0.7)):
        expected = np.zeros(12)
        seen = 0
        for n in range(12):
            now, hits = P[n].copy(), 0
            for k in range(1, 9):
                now = now + 0.5 * Q[n]
                dx, dy = positions[n] - path[k, :2]
                if 0.4 <= math.hypot(dx, dy) <= 2.0 and abs(math.atan2(dy, dx)) <= 0.5 * opening:
                    now = np.linalg.inv(np.linalg.inv(now) + np.linalg.inv(R[n]))
                    hits += 1
            blind = np.linalg.slogdet(P[n] + 4.0 * Q[n])[1]
            before = share * blind + (1.0 - share) * np.linalg.slogdet(P[n])[1]
            if hits:
                expected[n] = 0.5 * (before - np.linalg.slogdet(now)[1])
            seen += hits > 0
        own, total, count = path_gain(3, path, positions, P, Q, R, 0.4, 2.0, opening, 0.5, share)
        assert own == pytest.approx(expected[3], rel=1e-9, abs=1e-12)
        assert total == pytest.approx(expected.sum(), rel=1e-9)
        assert count == seen > 0


def test_goal_is_within_range_facing_the_object_and_the_region_holds_95_percent() -> None:
    task = Maintenance(EAGER).next_task(world(thing("cup-1", 5.0, 0.0, 0.25)), [0.0, 0.0, 1.0], [CAMERA])
    assert task is not None
    assert task.object_id == "cup-1"
    assert task.sensor == "camera"
    np.testing.assert_allclose(task.goal, [5.0 - EAGER.standoff * 2.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(task.region[0], [5.0, 0.0, 0.7])
    np.testing.assert_allclose(task.region[1], 2.0 * 1.96 * 0.5)
    assert "cup-1" in task.reason


def test_the_uncertain_object_is_preferred_and_the_near_one_among_equals() -> None:
    singly = replace(EAGER, tour=0.0)
    vague, sure = thing("cup-1", 6.0, 0.0, 0.8), thing("cup-2", -6.0, 0.0, 0.05)
    task = Maintenance(singly).next_task(world(sure, vague), np.zeros(3), [CAMERA])
    assert task is not None
    assert task.object_id == "cup-1"
    near = thing("cup-3", 0.0, 3.0, 0.8)
    task = Maintenance(singly).next_task(world(vague, near), np.zeros(3), [CAMERA])
    assert task is not None
    assert task.object_id == "cup-3"


@pytest.mark.parametrize("growth", [-1e-3, np.nan, np.eye(4), [[np.inf, 0.0], [0.0, 1.0]]])
def test_an_object_whose_growth_is_none_is_left_alone(growth: Any) -> None:
    odd, cup = thing("odd-1", 3.0, 0.0, process_noise=growth), thing("cup-1", 6.0, 0.0)
    maintenance = Maintenance(EAGER)
    assert maintenance.next_task(world(odd), np.zeros(3), [CAMERA]) is None
    assert "growth" in maintenance.idle_reason
    task = maintenance.next_task(world(odd, cup), np.zeros(3), [CAMERA])
    assert task is not None
    assert task.object_id == "cup-1"


@pytest.mark.parametrize("triggers", [(), ("cup-1",)])
def test_what_has_moved_meanwhile_is_looked_for_where_it_is(triggers: tuple[str, ...]) -> None:
    maintenance, here = Maintenance(EAGER), np.zeros(3)
    first = maintenance.next_task(world(thing("cup-1", -5.0, 0.0)), here, [CAMERA], triggers=triggers)
    again = maintenance.next_task(world(thing("cup-1", -5.1, 0.0)), here, [CAMERA])
    assert first is not None
    assert again is first
    moved = maintenance.next_task(world(thing("cup-1", 5.0, 5.0)), here, [CAMERA])
    assert moved is not None
    assert moved.covers(np.array([5.0, 5.0, 0.7]))
    assert moved.trigger == first.trigger
    assert not first.covers(np.array([5.0, 5.0, 0.7]))


def test_an_angle_of_view_in_degrees_is_refused() -> None:
    with pytest.raises(InputError, match="rad"):
        Maintenance().next_task(world(thing("cup-1", 3.0, 0.0)), np.zeros(3), [CAMERA], field_of_view=60.0)


def test_nothing_is_done_below_the_threshold_and_it_says_so() -> None:
    maintenance = Maintenance(MaintenanceConfig(information_gain_threshold=50.0))
    assert maintenance.next_task(world(thing("cup-1", 5.0, 0.0)), np.zeros(3), [CAMERA]) is None
    assert "below the threshold" in maintenance.idle_reason


def test_after_warming_up_nothing_is_compiled() -> None:
    def compiled() -> list[int]:
        return [len(kernel.signatures) for kernel in (path_gain, single_gains, shortest_way, looks_along)]

    warm_up()
    before = compiled()
    assert min(before) >= 1
    grid = OccupancyGrid.from_values(np.zeros((120, 120), dtype=np.int64), 0.1)
    state = world(thing("cup-1", 3.0, 2.0), thing("cup-2", 9.0, 2.0), thing("cup-3", 9.0, 9.0))
    for floor in (None, grid):
        maintenance = Maintenance(EAGER)
        task = maintenance.next_task(state, [1.0, 1.0, 0.0], [CAMERA, LASER], field_of_view=2.0, grid=floor)
        assert task is not None
        assert maintenance.tour
    assert compiled() == before


def test_thresholds_and_weights_hold_by_class() -> None:
    cup, key = thing("cup-1", 4.0, 0.0), thing("key-1", -4.0, 0.0, attributes={"class": {"key": 1.0}})
    state = world(cup, key)
    strict = MaintenanceConfig(information_gain_threshold=0.5, tour=0.0, class_thresholds={"cup": 50.0})
    task = Maintenance(strict).next_task(state, np.zeros(3), [CAMERA])
    assert task is not None
    assert task.object_id == "key-1"
    for weights, first in (({}, "cup-1"), ({"key": 2.0}, "key-1"), ({"cup": 0.1}, "key-1")):
        config = MaintenanceConfig(information_gain_threshold=0.5, tour=0.0, class_weights=weights)
        task = Maintenance(config).next_task(state, np.zeros(3), [CAMERA])
        assert task is not None
        assert task.object_id == first
    both = MaintenanceConfig(information_gain_threshold=0.5, class_thresholds={"cup": 50.0, "key": 50.0})
    assert Maintenance(both).next_task(state, np.zeros(3), [CAMERA]) is None


def test_of_two_sensors_the_one_that_pays_is_chosen() -> None:
    precise = replace(CAMERA, covariance=1e-4 * np.eye(3))
    state = world(thing("cup-1", 3.0, 0.0, 0.5))
    task = Maintenance(EAGER).next_task(state, np.zeros(3), [precise, LASER])
    assert task is not None
    assert task.sensor == "camera"
    # Far away, the drive costs more than the precision brings.
    state = world(thing("cup-1", 8.0, 0.0, 0.5))
    costly = MaintenanceConfig(information_gain_threshold=0.5, weight=6.0)
    task = Maintenance(costly).next_task(state, np.zeros(3), [precise, LASER])
    assert task is not None
    assert task.sensor == "laser"


def test_triggers_come_first_in_order_and_merge_with_what_is_pending() -> None:
    maintenance = Maintenance(EAGER)
    state = world(thing("cup-1", 5.0, 0.0, 0.9), thing("cup-2", 0.0, 6.0, 0.011), thing("cup-3", -5.0, 0.0))
    first = maintenance.next_task(
        state, np.zeros(3), [CAMERA], triggers=[Trigger("cup-2", "grasping"), "cup-3"]
    )
    assert first is not None
    assert first.object_id == "cup-2"
    assert "grasping" in first.reason
    assert not maintenance.trigger("cup-2", "somebody else")
    maintenance.report(first, "found")
    second = maintenance.next_task(state, np.zeros(3), [CAMERA])
    assert second is not None
    assert second.object_id == "cup-3"
    maintenance.report(second, "found")
    third = maintenance.next_task(state, np.zeros(3), [CAMERA])
    assert third is not None
    assert third.object_id == "cup-1"
    assert not third.trigger


def test_actions_of_table_3_1_ask_for_a_look_at_their_object() -> None:
    maintenance = Maintenance(EAGER)
    asked = {
        action: maintenance.before(action, "cup-1")
        for action in ("grab", "navigate_to_object", "navigate_to_location", "release")
    }
    assert asked == {
        "grab": True,
        "navigate_to_object": True,
        "navigate_to_location": False,
        "release": False,
    }
    other = Maintenance(MaintenanceConfig(verified_actions=("open",)))
    assert other.before("open", "cup-1")
    assert not other.before("grab", "cup-1")
    # Two actions on one object are one look.
    assert [trigger.object_id for trigger in maintenance.queue] == ["cup-1"]


def test_pending_task_is_kept_until_its_object_has_been_seen() -> None:
    maintenance = Maintenance(EAGER)
    state = world(thing("cup-1", 5.0, 0.0), thing("cup-2", 0.0, 5.1))
    task = maintenance.next_task(state, np.zeros(3), [CAMERA])
    assert task is not None
    assert task.object_id == "cup-1"
    # Half-way to it the other one is nearer, and still the robot does not turn round.
    assert maintenance.next_task(state, [0.0, 2.5, 0.0], [CAMERA]) is task
    seen = world(thing("cup-1", 5.0, 0.0, 0.009), thing("cup-2", 0.0, 5.1))
    after = maintenance.next_task(seen, [3.2, 0.0, 0.0], [CAMERA])
    assert after is not None
    assert after.object_id == "cup-2"


def test_several_looks_are_one_tour_along_the_shortest_way() -> None:
    # The best single look is at the far, vague one; the shortest way through all begins at the others.
    spots = {"cup-1": (9.0, 0.0, 2.0), "cup-2": (-3.0, 0.0, 0.6), "cup-3": (-3.0, 3.0, 0.6)}
    state = world(*(thing(name, *spot) for name, spot in spots.items()), thing("cup-4", 0.0, -9.0, 0.011))
    visits = {}
    for tour in (0.0, 0.5):
        maintenance = Maintenance(MaintenanceConfig(information_gain_threshold=3.0, weight=0.1, tour=tour))
        pose, left = np.zeros(3), dict(spots)
        order: list[str] = []
        while left:
            known = [thing(name, *spot) for name, spot in spots.items() if name in left]
            known += [thing(name, *spots[name][:2], 0.005) for name in spots if name not in left]
            task = maintenance.next_task(world(*known, stamp=float(len(order))), pose, [CAMERA])
            assert task is not None
            if tour and len(left) > 1:
                assert "tour" in task.reason
                assert maintenance.tour == set(left) - {task.object_id}
            order.append(task.object_id)
            del left[task.object_id]
            maintenance.report(task, "found")
            pose = task.goal
        visits[tour] = order
    assert maintenance.tour == frozenset()
    assert visits[0.0][0] == "cup-1"
    assert visits[0.5] == ["cup-2", "cup-3", "cup-1"]
    assert maintenance.next_task(state, np.zeros(3), [CAMERA]) is not None


def test_what_was_seen_in_passing_or_is_gone_leaves_the_tour() -> None:
    maintenance = Maintenance(MaintenanceConfig(information_gain_threshold=3.0))
    cups = [thing(f"cup-{k}", 3.0 * k, 0.0, 0.6) for k in (1, 2, 3)]
    first = maintenance.next_task(world(*cups), np.zeros(3), [CAMERA])
    assert first is not None
    assert first.object_id == "cup-1"
    assert maintenance.tour == {"cup-2", "cup-3"}
    maintenance.report(first, "found")
    seen = [replace(cups[0], covariance=0.005 * np.eye(3)), replace(cups[1], covariance=0.008 * np.eye(3))]
    second = maintenance.next_task(world(*seen, cups[2]), first.goal, [CAMERA])
    assert second is not None
    assert second.object_id == "cup-3"
    maintenance.report(second, "not_found", 1.0)
    maintenance.next_task(world(*seen, replace(cups[2], lost=True)), second.goal, [CAMERA])
    assert maintenance.tour == frozenset()
    # A tour is at an end where the base may not be moved, and a trigger comes in between.
    again = Maintenance(MaintenanceConfig(information_gain_threshold=3.0))
    task = again.next_task(world(*cups), np.zeros(3), [CAMERA])
    assert task is not None
    again.report(task, "found")
    asked = again.next_task(world(*cups), np.zeros(3), [CAMERA], triggers=["cup-3"])
    assert asked is not None
    assert asked.object_id == "cup-3"
    again.report(asked, "found")
    assert again.tour
    assert again.next_task(world(*cups), np.zeros(3), [CAMERA], base_available=False) is None
    assert again.tour == frozenset()


def test_without_the_base_only_what_is_in_view_is_looked_at() -> None:
    near, far = thing("cup-1", 1.0, 0.0, 0.2), thing("cup-2", 6.0, 0.0, 0.9)
    task = Maintenance(EAGER).next_task(world(near, far), np.zeros(3), [CAMERA], base_available=False)
    assert task is not None
    assert task.object_id == "cup-1"
    assert task.distance == 0.0
    np.testing.assert_allclose(task.goal, 0.0)
    behind = Maintenance(EAGER).next_task(
        world(near, far), [0.0, 0.0, math.pi], [CAMERA], field_of_view=1.0, base_available=False
    )
    assert behind is None


def test_outcomes_rest_an_object_until_there_is_news() -> None:
    maintenance = Maintenance(EAGER)
    cup = thing("cup-1", 5.0, 0.0)
    task = maintenance.next_task(world(cup), np.zeros(3), [CAMERA])
    assert task is not None
    maintenance.report(task, "occluded", 10.0)
    assert maintenance.next_task(world(cup, stamp=12.0), np.zeros(3), [CAMERA]) is None
    again = maintenance.next_task(world(cup, stamp=16.0), np.zeros(3), [CAMERA])
    assert again is not None
    # From nearer than before.
    assert np.hypot(*(again.goal[:2] - cup.position[:2])) < np.hypot(*(task.goal[:2] - cup.position[:2]))
    maintenance.report(again, "not_found", 20.0)
    assert maintenance.next_task(world(cup, stamp=500.0), np.zeros(3), [CAMERA]) is None
    moved = replace(cup, last_seen=501.0)
    assert maintenance.next_task(world(moved, stamp=502.0), np.zeros(3), [CAMERA]) is not None
    with pytest.raises(InputError, match="outcome"):
        maintenance.report(task, "perhaps")


@pytest.mark.parametrize("walled", [False, True])
def test_after_a_look_in_vain_the_object_is_looked_at_from_another_side(walled: bool) -> None:
    grid = None
    if walled:
        values = np.zeros((100, 100), dtype=int)
        values[0], values[-1], values[:, 0], values[:, -1] = 100, 100, 100, 100
        grid = OccupancyGrid.from_values(values, 0.1)
    maintenance = Maintenance(MaintenanceConfig(information_gain_threshold=0.1, retry_after=0.0))
    cup = np.array([5.0, 5.0])
    sensor = Sensor("camera", 0.4, 2.0, 0.01 * np.eye(2))
    pose, state = np.array([1.0, 5.0, 0.0]), world(thing("cup", *cup))
    first = maintenance.next_task(state, pose, [sensor], grid=grid)
    assert first is not None
    maintenance.report(first, "occluded", 0.0)
    second = maintenance.next_task(world(thing("cup", *cup), stamp=1.0), first.goal, [sensor], grid=grid)
    assert second is not None
    a, b = first.goal[:2] - cup, second.goal[:2] - cup
    turned = math.degrees(math.acos(a @ b / (np.hypot(*a) * np.hypot(*b))))
    assert turned >= 59.0
    assert np.hypot(*b) < np.hypot(*a)
    # It still faces the object.
    assert math.atan2(*(-b)[::-1]) == pytest.approx(second.goal[2], abs=1e-6)


def test_empty_and_lost_worlds_are_said_to_be_so() -> None:
    maintenance = Maintenance(EAGER)
    assert maintenance.next_task(world(), np.zeros(3), [CAMERA]) is None
    assert "empty" in maintenance.idle_reason
    assert maintenance.next_task(world(thing("cup-1", 1.0, 1.0, lost=True)), np.zeros(3), [CAMERA]) is None
    assert "lost" in maintenance.idle_reason
    # A trigger for what nobody knows is dropped, not waited for.
    good = thing("cup-2", 4.0, 0.0)
    task = maintenance.next_task(world(good), np.zeros(3), [CAMERA], triggers=["ghost-1"])
    assert task is not None
    assert task.object_id == "cup-2"
    assert maintenance.queue == ()


def test_walls_are_driven_around_and_what_is_walled_in_is_left_alone() -> None:
    values = np.zeros((120, 120), dtype=np.int64)
    values[:80, 60] = 100  # a wall with a way round it at the top
    grid = OccupancyGrid.from_values(values, 0.05)
    state = world(thing("cup-1", 5.0, 1.0))
    short = replace(CAMERA, range_max=1.0)
    task = Maintenance(EAGER).next_task(state, [1.0, 1.0, 0.0], [short], grid=grid)
    assert task is not None
    assert task.distance > 6.0  # 4 m straight, up to y = 4 m and back
    values[:, 60] = 100
    closed = OccupancyGrid.from_values(values, 0.05)
    maintenance = Maintenance(EAGER)
    assert maintenance.next_task(state, [1.0, 1.0, 0.0], [short], grid=closed) is None
    assert "reached" in maintenance.idle_reason


def asked_for(**changes: object) -> object:
    given = {"robot_pose": np.zeros(3), "sensors": [CAMERA], **changes}
    return Maintenance().next_task(world(thing("a-1", 1, 1)), **given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: Maintenance().next_task(world(thing("a-1", 1, 1)), np.zeros(3), []), "sensors"),
        (
            lambda: Maintenance().next_task(world(thing("a-1", 1, 1)), [0.0, np.nan, 0.0], [CAMERA]),
            "robot_pose",
        ),
        (lambda: MaintenanceConfig(speed=0.0), "speed"),
        (lambda: MaintenanceConfig(class_thresholds={"cup": -1.0}), "class_thresholds"),
        (lambda: Sensor("bad", 2.0, 1.0, np.eye(3)), "range_min"),
        (lambda: Sensor("bad", 0.0, 1.0, np.eye(4)), "covariance"),
        (lambda: Sensor("bad", 0.0, 1.0, -np.eye(3)), "covariance"),
        (lambda: Sensor("bad", 0.0, "1", np.eye(3)), "range_max"),
        (lambda: Sensor(3, 0.0, 1.0, np.eye(3)), "name"),
        (lambda: asked_for(triggers="a-1"), "triggers"),
        (lambda: asked_for(triggers=[3]), "triggers"),
        (lambda: asked_for(field_of_view="wide"), "field_of_view"),
        (lambda: asked_for(field_of_view={"angle": 1.0, "range": np.nan}), "field_of_view"),
        (lambda: asked_for(robot_pose=np.full(3, 1e300)), "robot_pose"),
        (lambda: asked_for(sensors=["camera"]), "sensors"),
    ],
)
def test_bad_input_is_named(call: object, named: str) -> None:
    with pytest.raises(InputError, match=named):
        call()  # type: ignore[operator]


def test_a_stamp_that_is_none_leaves_the_task_pending() -> None:
    maintenance = Maintenance(EAGER)
    task = maintenance.next_task(world(thing("a-1", 1, 1)), np.zeros(3), [CAMERA])
    assert task is not None
    for stamp in (np.nan, "now"):
        with pytest.raises(InputError, match="stamp"):
            maintenance.report(task, "not_found", stamp)  # type: ignore[arg-type]
    assert maintenance.next_task(world(thing("a-1", 1, 1)), np.zeros(3), [CAMERA]) is not None


def test_nobody_drives_to_the_end_of_the_world() -> None:
    state = world(thing("cup-1", 1e300, 0.0), thing("cup-2", 1.0, 1.0))
    task = Maintenance(EAGER).next_task(state, np.zeros(3), [CAMERA])
    assert task is not None
    assert task.object_id == "cup-2"


def test_a_sensor_keeps_its_own_covariance() -> None:
    given = 0.01 * np.eye(3)
    sensor = Sensor("camera", 0.4, 2.0, given)
    given[:] = 0.0
    np.testing.assert_array_equal(sensor.covariance, 0.01 * np.eye(3))


def test_one_bad_object_does_not_hide_the_others() -> None:
    broken = thing("cup-1", np.nan, 0.0)
    indefinite = thing("cup-2", 3.0, 3.0, covariance=np.diag([1.0, -1.0, 1.0]))
    task = Maintenance(EAGER).next_task(
        world(broken, indefinite, thing("cup-3", 4.0, 0.0)), np.zeros(3), [CAMERA]
    )
    assert task is not None
    assert task.object_id in ("cup-2", "cup-3")
    assert np.isfinite(task.gain)

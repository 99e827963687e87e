"""The robot that drives where it is told, among people who step aside and carry things about."""

from __future__ import annotations

import math

import numpy as np
import pytest

from whereabouts.simulation.home.apartment_day import MOVED, THINGS
from whereabouts.simulation.home.driving import Base, Driver, floor_plan
from whereabouts.simulation.home.floor_plan import apartment
from whereabouts.simulation.home.live_apartment import ASKED, ELBOW, HOME_OF, REACH, LiveDay, household, tour

NOBODY = np.zeros((0, 2))
STEP = 0.125


def driver() -> Driver:
    return Driver(floor_plan(apartment()), np.zeros(3))


def drive(robot: Driver, people: np.ndarray = NOBODY, seconds: float = 120.0) -> list[np.ndarray]:
    """Poses until the robot is there or has given up."""
    poses = [robot.pose.copy()]
    for _ in range(int(seconds / STEP)):
        if robot.status != "driving":
            break
        robot.step(STEP, people)
        poses.append(robot.pose.copy())
    return poses


def test_ways_keep_off_walls_and_furniture_and_end_where_they_should() -> None:
    robot, home = driver(), apartment()
    for goal in tour():
        before, driven = robot.pose[:2].copy(), robot.metres
        assert robot.go(goal)
        poses = drive(robot)
        assert robot.status == "reached"
        assert robot.pose[:2] == pytest.approx(goal[:2], abs=0.15)
        lengths = np.hypot(*np.diff(np.array(poses)[:, :2], axis=0).T)
        assert lengths.max() <= robot.base.speed * STEP + 1e-9
        # A corner within one step is cut off.
        assert robot.metres - driven == pytest.approx(lengths.sum(), rel=0.02)
        assert robot.metres - driven >= np.hypot(*(robot.pose[:2] - before)) - 1e-6
        assert min(home.outlines.distance(pose[:2]) for pose in poses) > 0.2


def test_a_goal_on_a_table_is_reached_from_its_side_and_one_outside_is_refused() -> None:
    robot = driver()
    cup = np.array(THINGS[ASKED][1])
    assert robot.go(np.array([*cup[:2], 1.0]))
    drive(robot)
    assert robot.status == "reached"
    assert np.hypot(*(robot.pose[:2] - cup[:2])) < REACH
    assert robot.pose[2] == pytest.approx(1.0)
    assert not robot.go(np.array([30.0, 30.0, 0.0]))
    assert robot.status == "failed"


def test_the_robot_keeps_off_what_it_is_about_to_take_and_faces_it() -> None:
    bag = np.array(THINGS[MOVED][1])
    for begin in ((0.0, 0.0), (7.0, 0.3)):
        robot = Driver(floor_plan(apartment()), np.array([*begin, 0.0]))
        assert robot.go(np.array([*bag[:2], math.nan]), apart=0.45)
        drive(robot)
        offset = bag[:2] - robot.pose[:2]
        assert 0.4 < np.hypot(*offset) < 0.7
        assert robot.pose[2] == pytest.approx(math.atan2(offset[1], offset[0]), abs=0.3)


def test_the_robot_stands_for_who_is_ahead_and_goes_on_when_he_has_left() -> None:
    robot = driver()
    robot.go(np.array([7.0, 0.0, 0.0]))
    # In a door nobody gets around anybody.
    people = np.array([[3.0, 0.0], [3.0, 0.7], [3.0, -0.7]])
    drive(robot, people, 20.0)
    assert robot.status == "driving"
    assert len(robot.stands) >= 1
    assert robot.base.stop - robot.base.speed * STEP <= robot.closest
    assert robot.pose[0] < 3.0 - robot.base.stop + 0.1
    drive(robot)
    assert robot.status == "reached"


def test_the_robot_finds_a_way_around_who_stays() -> None:
    robot = driver()
    robot.go(np.array([7.0, 0.0, 0.0]))
    drive(robot, np.array([[3.0, 0.1]]), 60.0)
    assert robot.status == "reached"
    assert len(robot.stands) >= 1


def test_a_goal_that_is_barred_for_long_is_given_up() -> None:
    robot = Driver(floor_plan(apartment()), np.zeros(3), Base(patience=5.0))
    robot.go(np.array([0.6, -2.5, 0.0]))
    drive(robot, np.array([[0.6, -1.1], [0.4, -1.1], [0.8, -1.1]]), 60.0)
    assert robot.status == "failed"
    assert robot.pose[1] > -1.0


def test_people_carry_six_things_to_places_of_their_own() -> None:
    for seed in range(4):
        home = household(seed, 900.0)
        first, last = home.things(0.0), home.things(900.0)
        moved = {name for _, name in home.moves}
        assert moved <= set(HOME_OF)
        assert {ASKED, MOVED} <= moved
        spots = [tuple(spot) for spot in last.values() if spot is not None]
        assert len(set(spots)) == len(spots)
        for name, spot in last.items():
            if name not in moved and spot is not None:
                assert spot == pytest.approx(first[name])
    assert home.moves == household(3, 900.0).moves
    assert home.moves != household(2, 900.0).moves


def test_people_go_around_the_robot() -> None:
    day = LiveDay(1, scans=True, clouds=False)
    walker = day.household.people[0].walker
    for time in np.arange(0.0, 60.0, 1.0):
        day._tick = int(time * 8)
        day.robot.pose[:2] = walker.position(float(time)) + np.array([0.05, 0.0])
        away = np.hypot(*(day.people - day.robot.pose[:2]).T)
        assert away.min() >= ELBOW - 1e-9


def test_the_robot_takes_what_is_in_reach_and_where_it_thinks() -> None:
    day = LiveDay(0, scans=False, clouds=False)
    cup = np.array(THINGS[ASKED][1])
    assert day.take(cup) is None
    day.robot.go(np.array([*cup[:2], math.nan]))
    while day.robot.status == "driving":
        day.step()
    assert day.take(cup + np.array([0.0, 0.5, 0.0])) is None
    assert day.take(cup + np.array([0.1, 0.0, 0.0])) == ASKED
    assert day.things[ASKED] is None


def test_the_same_goals_make_the_same_day() -> None:
    seen = []
    for _ in range(2):
        day = LiveDay(5, scans=True, clouds=False)
        day.robot.go(np.array([1.2, 2.5, 0.0]))
        moments = [day.step() for _ in range(24)]
        seen.append(moments)
    for first, second in zip(*seen, strict=True):
        assert first.pose == pytest.approx(second.pose)
        assert first.scan is not None
        assert second.scan is not None
        assert first.scan.ranges.tobytes() == second.scan.ranges.tobytes()
        assert first.wheels.tobytes() == second.wheels.tobytes()

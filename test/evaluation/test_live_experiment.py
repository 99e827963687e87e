"""The judge of beliefs, and the robots of the experiment `live`."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.demo.belief_judging import judged
from evaluation.demo.live.live_library import LibraryRobot
from evaluation.experiments.live import live_day
from whereabouts.simulation.home.apartment_day import THINGS
from whereabouts.simulation.home.live_apartment import HOME_OF, REACH, LiveDay
from world_model import WorldObject

SPOTS = {name: np.array(spot) for name, (_, spot) in THINGS.items()}


def believed(
    name: str, kind: str, spot: np.ndarray, existence: float = 0.9, lost: bool = False
) -> WorldObject:
    zero = np.zeros(3)
    return WorldObject(name, spot, zero, np.eye(3), {"class": {kind: 1.0}}, existence, lost, 0.0)


def test_a_belief_is_right_where_such_a_thing_lies() -> None:
    cup, bag = SPOTS["red cup"], SPOTS["red bag"]
    things = {"red cup": cup, "white cup": SPOTS["white cup"], "red bag": bag}
    near = cup + np.array([0.2, 0.0, 0.0])
    everything = [
        believed("cup-1", "cup", near),
        believed("cup-2", "cup", SPOTS["white cup"]),
        believed("bag-1", "bag", bag),
    ]
    found = judged(everything, things, 1.0)
    assert (found.wrong, found.unknown) == ((), ())
    # Carried away, of another class, doubled, and what nobody believes in or knows the place of.
    found = judged(everything, {**things, "red cup": None}, 1.0)
    assert (found.wrong, found.unknown) == (("cup-1",), ())
    found = judged([believed("bowl-1", "bowl", cup), *everything[1:]], things, 1.0)
    assert (found.wrong, found.unknown) == (("bowl-1",), ("red cup",))
    found = judged([*everything, believed("cup-3", "cup", near)], things, 1.0)
    assert len(found.wrong) == 1
    assert found.unknown == ()
    found = judged(
        [believed("bag-1", "bag", bag, 0.3), believed("cup-1", "cup", near, lost=True)], things, 1.0
    )
    assert (found.wrong, found.unknown) == ((), ("red bag", "red cup", "white cup"))
    assert judged([believed("person-1", "person", cup)], {}, 1.0).wrong == ()


def test_a_tour_shows_the_robot_everything() -> None:
    robot = LibraryRobot(LiveDay(0, scans=False, clouds=False))
    robot.tour()
    assert robot.state is not None
    found = judged(robot.state.objects, robot.day.things, robot.day.time)
    assert len(found.wrong) + len(found.unknown) <= 1


def test_all_robots_live_the_same_day_and_the_patrol_has_the_metres_of_maintenance() -> None:
    day = live_day(4, 60.0)
    ours, patrol = day.kept
    assert day.asked in HOME_OF
    assert len(ours.beliefs) == len(patrol.beliefs) == 60
    assert patrol.metres <= ours.metres + 1.0 + 0.5
    assert patrol.metres == pytest.approx(ours.metres, abs=4.0)
    for run in day.searched:
        assert run.seconds <= 260.0
        assert run.fetched is None or run.reached <= REACH or run.fetched != day.asked

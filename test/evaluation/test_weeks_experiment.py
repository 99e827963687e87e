"""The household that the experiment `weeks` lives in, and how a place to look at is chosen."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from estimation.geometry.places import Places
from evaluation.experiments.weeks import VisitingRobot
from evaluation.scenes.household_weeks import CARRIED, DAY, HOUR, IN_HAND, Weeks
from whereabouts.simulation.home.floor_plan import places_file


@pytest.fixture(scope="module")
def weeks() -> Weeks:
    return Weeks(Places.load(places_file()), 12, seed=3)


def test_things_go_by_habit_and_come_back(weeks: Weeks) -> None:
    moved = 0
    for name in CARRIED:
        home = weeks.where(name, weeks.begin)
        assert home
        away = np.zeros((12, 96), bool)
        for day in range(12):
            for k in range(96):
                stamp = weeks.begin + day * DAY + k * 0.25 * HOUR
                away[day, k] = weeks.where(name, stamp) not in ("", home)
            assert not away[day, :24].any(), "at night it is at home"
        usual = away.mean(0)
        # At some hour it is away on most days, though not on all of them.
        moved += usual.max() > 0.6
        assert 0.02 < away.mean() < 0.6
    assert moved == len(CARRIED)


def test_a_thing_is_nowhere_while_it_is_carried(weeks: Weeks) -> None:
    stamps = weeks.begin + np.arange(6.0 * HOUR, 22.0 * HOUR, 0.5 * IN_HAND)
    for name in CARRIED:
        where = [weeks.where(name, stamp) for day in range(3) for stamp in stamps + day * DAY]
        changes = [(a, b) for a, b in itertools.pairwise(where) if a != b]
        assert changes
        assert all("" in change for change in changes)


def test_what_lies_at_a_place_is_detected_from_where_the_robot_stands(weeks: Weeks) -> None:
    stamp = weeks.begin + 6.0 * HOUR
    for place in {weeks.where(name, stamp) for name in CARRIED}:
        lying = sum(weeks.where(name, stamp) == place for name in CARRIED)
        most = max(len(seen.objects) for k in range(5) for _, _, seen in weeks.look(place, stamp + 30.0 * k))
        assert most >= min(lying, 1)


def test_the_most_probable_place_is_first_then_the_longest_unseen() -> None:
    robot = VisitingRobot.__new__(VisitingRobot)
    robot.weeks = SimpleNamespace(looked_at=["desk", "shelf", "sink", "table"])  # type: ignore[assignment]
    robot._looked = {"desk": 30.0, "shelf": 10.0, "table": 20.0}
    found = SimpleNamespace(id="cup-1", place="table", usual={"sink": 0.3, "hall": 0.5, "table": 0.2})
    robot.believed = lambda name, stamp: found  # type: ignore[method-assign, assignment, return-value]
    assert robot.ranked("red cup", 40.0) == ["sink", "table", "shelf", "desk"]

"""The live demo's robot fetches: it goes where a thing is believed to be by now, and blames nothing it did not try."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from evaluation.demo.live.live_robot import LiveRobot, SearchRequest
from evaluation.demo.live.live_story import Script, Teller
from whereabouts.simulation.home.apartment_bag import START
from whereabouts.simulation.home.apartment_day import THINGS
from whereabouts.simulation.home.live_apartment import ASKED

TABLE, SHELF = np.array([4.0, 0.0, 0.7]), np.array([0.0, 5.0, 0.9])


class StoryDay:
    """The cup stands on the shelf; a robot that drives 0.5 m per moment, an eighth of a second each."""

    def __init__(self) -> None:
        self.time = 0.0
        self.robot = SimpleNamespace(pose=np.zeros(3), metres=0.0)
        self.household = SimpleNamespace(moves=[])
        self.people = np.zeros((0, 2))

    @property
    def things(self) -> dict[str, Any]:
        return {name: SHELF if name == ASKED else None for name in THINGS}

    def away(self, spot: Any) -> float:
        return float(np.hypot(*(spot[:2] - self.robot.pose[:2])))

    def take(self, spot: Any) -> str | None:
        near = np.linalg.norm(spot - SHELF) < 0.1 and self.away(SHELF) < 1.0
        return ASKED if near else None


class StoryRobot:
    """Believes the cup on the table until `corrected`, s; sees it where it is from a metre away."""

    def __init__(self, corrected: float) -> None:
        self.day, self.corrected = StoryDay(), corrected
        self.goals: list[Any] = []
        self.tasks: list[Any] = []
        self.missed: list[str] = []
        self.driving, self.goal = False, np.zeros(2)

    @property
    def world(self) -> Any:
        day = self.day
        place = SHELF if day.time >= self.corrected else TABLE
        seen = day.time if place is SHELF and day.away(SHELF) < 1.0 else 0.0
        lost = bool(self.missed) and place is TABLE
        cup = SimpleNamespace(
            id="cup-1", position=place, lost=lost, existence=0.9, last_seen=START + seen, predicates=()
        )
        return SimpleNamespace(objects=(), find=lambda name: cup)

    def look(self) -> None:
        day = self.day
        day.time += 0.125
        if self.driving:
            way = self.goal - day.robot.pose[:2]
            step = min(0.5, float(np.hypot(*way)))
            day.robot.pose[:2] += step * way / max(np.hypot(*way), 1e-9)
            self.driving = step > 1e-9

    def take_base(self, taken: bool) -> None: ...

    def stop(self) -> None:
        self.driving = False

    def send(self, kind: str, goal: Any, reason: str = "") -> bool:
        self.goals.append((kind, goal[:2].tolist()))
        self.goal, self.driving = goal[:2].copy(), True
        return True

    def miss(self, object_id: str) -> None:
        self.missed.append(object_id)

    def find(self, kind: str, predicates: tuple[str, ...], timeout: float) -> SearchRequest:
        return SearchRequest(
            result=SimpleNamespace(code=0, FOUND=0, object=[SimpleNamespace(id="cup-1")], message="")
        )


def lived(robot: StoryRobot, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The story of a robot that only fetches."""
    script = Script(maintained=0.0, toured=False, sought="", timeout=60.0)
    teller = Teller(cast(LiveRobot, robot), script)
    monkeypatch.setattr(teller, "_watch", lambda: None)
    while teller.go_on():
        pass
    return teller.story


def test_a_thing_that_is_believed_elsewhere_by_now_is_fetched_there(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = StoryRobot(corrected=0.5)
    story = lived(robot, monkeypatch)
    assert story.right
    assert robot.missed == []
    assert [goal for kind, goal in robot.goals if kind == "fetch"] == [TABLE[:2].tolist(), SHELF[:2].tolist()]


def test_a_thing_that_is_not_where_it_is_believed_to_be_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = StoryRobot(corrected=1e9)
    story = lived(robot, monkeypatch)
    assert not story.right
    assert robot.missed == ["cup-1"]

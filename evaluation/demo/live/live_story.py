"""What happens in the live demo: a tour, a while of looking again where it pays, and a cup that is fetched."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evaluation.demo.belief_judging import JudgedBeliefs, judged
from evaluation.demo.live.live_robot import DriveGoal, LiveRobot, SearchRequest
from whereabouts.simulation.home.apartment_bag import START
from whereabouts.simulation.home.apartment_day import MOVED, THINGS, TICKS
from whereabouts.simulation.home.live_apartment import ARM, ASKED, GLANCE, REACH, STARE, tour
from world_model import WorldObject

Array = NDArray[np.float64]
TRIES = 5


@dataclass(frozen=True)
class Script:
    """What the robot is told.

    toured : whether it sees the rooms first. maintained : s of looking again. sought : name of a thing that is then
    looked for, "" for none. asked : one that is fetched after that. timeout : s for each of both.
    """

    maintained: float = 200.0
    asked: str = ASKED
    timeout: float = 240.0
    toured: bool = True
    sought: str = MOVED


@dataclass
class Story:
    """What came of it; times are s of the day.

    phases : (begin, name). way : (s, x, y) twice a second. people : (s, positions (P, 2)). beliefs : once a second.
    searches : for the sought and the asked thing. objects : the world when the latter was asked for. sought : m from
    where the sought thing truly is to where it was found, nan where it was not. fetched : the name of what the robot
    took, None where it came back without anything. reached : m on the floor to the asked thing when the robot thought
    that it was there, nan where it never did.
    """

    script: Script
    phases: list[tuple[float, str]] = field(default_factory=list)
    way: list[tuple[float, float, float]] = field(default_factory=list)
    people: list[tuple[float, Array]] = field(default_factory=list)
    beliefs: list[JudgedBeliefs] = field(default_factory=list)
    goals: list[DriveGoal] = field(default_factory=list)
    tasks: list[tuple[float, str, str]] = field(default_factory=list)
    searches: list[SearchRequest] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    objects: tuple[WorldObject, ...] = ()
    fetched: str | None = None
    reached: float = float("nan")
    sought: float = float("nan")
    moved_seen: float = float("nan")
    metres: dict[str, float] = field(default_factory=dict)
    ended: float = 0.0

    @property
    def right(self) -> bool:
        """Whether the robot has what it was asked for."""
        return self.fetched == self.script.asked


class Teller:
    """Lets the story happen; `go_on` is called before each moment and answers False at the end."""

    def __init__(self, robot: LiveRobot, script: Script) -> None:
        self.story = Story(script, goals=robot.goals, tasks=robot.tasks)
        self._robot, self._day = robot, robot.day
        self._plot = self._told()

    def go_on(self) -> bool:
        """Hear what there is to hear, and do what is next."""
        self._robot.look()
        self._watch()
        more = next(self._plot, False)
        if not more:
            self._end_phase()
            self.story.ended = self._day.time
        return more

    def _told(self) -> Iterator[bool]:
        script = self.story.script
        self._robot.take_base(True)
        if script.toured:
            self._phase("tour")
            yield from self._tour()
        if script.maintained > 0.0:
            self._phase("maintenance")
            self._robot.take_base(False)
            yield from self._wait(script.maintained)
            self._robot.take_base(True)
            self._robot.stop()
        if script.sought:
            self._phase("sought")
            yield from self._seek(script.sought)
        self._phase("search")
        if self._robot.world is not None:
            self.story.objects = self._robot.world.objects
        yield from self._fetch()
        if self.story.fetched is not None:
            self._phase("home")
            yield from self._drive("home", np.zeros(3))

    def _while(self, going: Callable[[], bool]) -> Iterator[bool]:
        while going():
            yield True

    def _drive(
        self, kind: str, goal: Array, reason: str = "", going: Callable[[], bool] = lambda: True
    ) -> Iterator[bool]:
        if self._robot.send(kind, goal, reason):
            yield from self._while(lambda: self._robot.driving and going())
        if self._robot.driving:
            self._robot.stop()

    def _wait(self, seconds: float) -> Iterator[bool]:
        until = self._day.time + seconds
        yield from self._while(lambda: self._day.time < until)

    def _tour(self) -> Iterator[bool]:
        for stop in tour():
            yield from self._drive("tour", stop, "see every room once")
            yield from self._wait(GLANCE)

    def _seek(self, name: str) -> Iterator[bool]:
        """Have a thing found, without taking it."""
        search = yield from self._find(name, self._day.time + self.story.script.timeout)
        spot = self._day.things[name]
        if search is not None and spot is not None:
            there = search.result.pose.pose.position
            self.story.sought = float(np.hypot(there.x - spot[0], there.y - spot[1]))

    def _find(self, name: str, until: float) -> Generator[bool, None, SearchRequest | None]:
        """A search that has found something; None for one that has not, and says why among the failures."""
        story, item = self.story, THINGS[name][0]
        search = self._robot.find(item.kind, (item.color,), max(until - self._day.time, 1.0))
        if search is None:
            story.failures.append("nobody offers the action find_object")
            return None
        story.searches.append(search)
        while search.result is None and self._day.time < until + 5.0:
            yield True
        self._robot.stop()
        if search.result is None or search.result.code != search.result.FOUND:
            story.failures.append(search.result.message if search.result else "the search never ended")
            return None
        return search

    def _fetch(self) -> Iterator[bool]:
        """Find, drive there, look, take; once more where it is not there."""
        story = self.story
        until = self._day.time + story.script.timeout
        for _ in range(TRIES):
            search = yield from self._find(story.script.asked, until)
            if search is None:
                return
            found = search.result.object[0].id
            known = self._object(found)
            if known is not None:
                yield from self._go_to(found, known.position)
                if story.fetched is not None:
                    return
                story.failures.append(f"{found} was not where it was believed to be")
                # What is believed to be elsewhere by now the arm has not looked for.
                if self._is_at(found, known.position):
                    self._robot.miss(found)
            yield from self._wait(1.0)
            if self._day.time > until:
                return

    def _go_to(self, name: str, place: Array) -> Iterator[bool]:
        """Drive to an object as long as it is believed there, and take it once it has been seen from there."""
        began = self._day.time
        goal = np.array([*place[:2], np.nan])
        yield from self._drive("fetch", goal, f"fetch {name}", lambda: self._is_at(name, place))
        until, arrived = self._day.time + STARE, self._day.time
        yield from self._while(
            lambda: self._day.time < until and self._seen(name) < arrived - 1.0 and self._is_at(name, place)
        )
        known = self._object(name)
        if known is None or self._seen(name) < began:
            return
        spot = self._day.things[self.story.script.asked]
        if spot is not None:
            self.story.reached = self._day.away(spot)
        taken = self._day.take(known.position)
        if taken is None:
            self.story.failures.append(f"nothing to take where {name} is believed to be")
        else:
            self.story.fetched = taken

    def _object(self, name: str) -> WorldObject | None:
        state = self._robot.world
        item = None if state is None else state.find(name)
        return None if item is None or item.lost or item.existence < 0.5 else item

    def _is_at(self, name: str, place: Array) -> bool:
        """Whether an object is believed to be within an arm's length of a place (3,)."""
        item = self._object(name)
        return item is not None and float(np.linalg.norm(item.position - place)) < ARM

    def _seen(self, name: str) -> float:
        """s of the day at which an object was seen last."""
        item = self._object(name)
        return -np.inf if item is None else item.last_seen - START

    # The account.

    def _phase(self, name: str) -> None:
        self._end_phase()
        self.story.phases.append((self._day.time, name))

    def _end_phase(self) -> None:
        if self.story.phases:
            name = self.story.phases[-1][1]
            before = sum(self.story.metres.values())
            self.story.metres[name] = self._day.robot.metres - before

    def _watch(self) -> None:
        story, day = self.story, self._day
        ticks = round(day.time * TICKS)
        if ticks % (TICKS // 2) == 0:
            x, y = day.robot.pose[:2].tolist()
            story.way.append((day.time, x, y))
        state = self._robot.world
        if ticks % TICKS or state is None:
            return
        story.people.append((day.time, day.people))
        beliefs = judged(state.objects, day.things, day.time)
        story.beliefs.append(beliefs)
        moved = [when for when, name in day.household.moves if name == MOVED and when <= day.time]
        if moved and MOVED not in beliefs.unknown and np.isnan(story.moved_seen):
            story.moved_seen = day.time


def within_reach(story: Story) -> bool:
    """Whether the search has physically reached what was asked for."""
    return bool(story.reached <= REACH)

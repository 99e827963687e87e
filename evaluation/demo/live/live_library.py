"""The live day without ROS: the libraries beneath the nodes, beside a naive patrol and a direct search.

One robot, one world and one camera for all: what differs is who says where to drive. The robot knows its pose here, and
nobody is tracked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from evaluation.demo.belief_judging import JudgedBeliefs, judged
from evaluation.demo.live.live_suite import library_settings, placed
from whereabouts.parameters.object_search import BELIEVED
from whereabouts.simulation.home.apartment_day import ROUND, THINGS, TICKS
from whereabouts.simulation.home.live_apartment import ARM, ASKED, GLANCE, STARE, LiveDay, tour
from world_model import Maintenance, ObjectSearch, WorldModel, WorldObject, WorldState
from world_model.state import MOVED_ON
from world_model.tasks.growth import Growth
from world_model.tasks.search import SearchStep

Array = NDArray[np.float64]
PATIENCE = 25.0
"""s after which a goal that the robot does not reach is another dead end."""
SECOND = TICKS


@dataclass
class Outcome:
    """What a run came to.

    metres : driven while the beliefs were kept, and on the search. beliefs : once a second while they were kept.
    fetched : what the robot took, None for nothing. reached : m to the asked thing when the robot thought it was there.
    seconds : of the search. failures : sentences. closest : m to somebody.
    """

    metres: float = 0.0
    searched: float = 0.0
    seconds: float = 0.0
    beliefs: list[JudgedBeliefs] = field(default_factory=list)
    fetched: str | None = None
    reached: float = math.nan
    failures: list[str] = field(default_factory=list)
    looks: int = 0
    closest: float = math.inf

    @property
    def wrong(self) -> float:
        """Wrong beliefs at a time, mean."""
        return float(np.mean([len(one.wrong) for one in self.beliefs])) if self.beliefs else math.nan

    @property
    def unknown(self) -> float:
        """Things nobody knows the place of, mean."""
        return float(np.mean([len(one.unknown) for one in self.beliefs])) if self.beliefs else math.nan


class LibraryRobot:
    """The day, what the robot believes of it, and where it means to drive."""

    def __init__(self, day: LiveDay) -> None:
        self.day, self.outcome = day, Outcome()
        world, self._upkeep, self._search = library_settings()
        self.model = WorldModel(world.world, world.places, looks_back=False)
        sigmas = (world.position_sigma, world.position_sigma, world.heading_sigma)
        self._pose_covariance = np.diag(np.square(sigmas))
        self.state: WorldState | None = None
        self._growth = Growth(self._upkeep.maintenance.process_noise)
        self._keeping = False
        # The map that the planners have is the floor plan.
        self.grid = day.grid

    # Time.

    def moment(self) -> None:
        """Look, and let an eighth of a second pass."""
        told = self.day.step()
        if told.evidence is not None:
            evidence = placed(told.evidence, told.pose, told.pan, self._pose_covariance)
            self.state = self.model.update(evidence, told.time)
            self._growth.observe(self.state)
        if self._keeping and self.state is not None and round(self.day.time * TICKS) % SECOND == 0:
            self.outcome.beliefs.append(judged(self.state.objects, self.day.things, self.day.time))

    def until(self, done: Callable[[], bool], seconds: float = math.inf) -> None:
        """Let time pass until it is done, or for so many seconds."""
        end = self.day.time + seconds
        while self.day.time < end and not done():
            self.moment()

    def wait(self, seconds: float) -> None:
        """Stand and look."""
        self.until(lambda: False, seconds)

    def drive(
        self,
        goal: Array,
        going: Callable[[], bool] = lambda: True,
        limit: float = math.inf,
        apart: float = 0.0,
    ) -> bool:
        """Drive to (3,) as long as that makes sense; whether the robot got there. apart : as of `Driver.go`."""
        if not self.day.robot.go(goal, apart=apart):
            return False
        self.until(lambda: self.day.robot.status != "driving" or not going(), limit)
        there = self.day.robot.status == "reached"
        self.day.robot.stop()
        return there

    def tour(self) -> None:
        """See every room once."""
        for stop in tour():
            self.drive(stop)
            self.wait(GLANCE)

    # Keeping beliefs.

    def maintain(self, seconds: float) -> None:
        """Look again where it pays."""
        maintenance, before = Maintenance(self._upkeep.maintenance), self.day.robot.metres
        self._keeping, end = True, self.day.time + seconds
        while self.day.time < end:
            state = self.state
            assert state is not None
            task = maintenance.next_task(
                self._growth.ahead(state, self.day.time), self.day.robot.pose, self._upkeep.sensor_models,
                grid=self.grid,
            )  # fmt: skip
            if task is None:
                self.wait(1.0 / self._upkeep.rate)
                continue
            self.outcome.looks += 1
            left = min(self._upkeep.task_timeout, end - self.day.time)
            self.drive(task.goal, limit=left)
            begun, name = self.day.time, task.object_id
            self.until(partial(self._seen_since, name, begun), min(self._upkeep.verify_timeout, end - begun))
            maintenance.report(task, "found" if self._seen_since(name, begun) else "occluded", self.day.time)
        self._done_keeping(before)

    def patrol(self, seconds: float, metres: float) -> None:
        """Round after round through all rooms, with so many metres for all of the time."""
        before, begun = self.day.robot.metres, self.day.time
        self._keeping = True
        stops = _rounds()

        def spent() -> bool:
            share = (self.day.time - begun) / seconds
            return self.day.robot.metres - before > metres * share + 1.0

        while self.day.time < begun + seconds:
            self.drive(next(stops), limit=begun + seconds - self.day.time)
            # It looks about for as long as its metres have to last.
            self.until(lambda: not spent(), begun + seconds - self.day.time)
        self._done_keeping(before)

    def _done_keeping(self, before: float) -> None:
        self._keeping = False
        self.outcome.metres = self.day.robot.metres - before

    def _seen_since(self, name: str, moment: float) -> bool:
        item = None if self.state is None else self.state.find(name)
        return item is not None and item.last_seen >= moment

    # Fetching.

    def fetch(self, asked: str = ASKED, timeout: float = 240.0, direct: bool = False) -> None:
        """Find a thing, drive there, look, and take it; once more where it is not there.

        direct : drive to where it was seen last, then from room to room, the nearest first.
        """
        item, day, out = THINGS[asked][0], self.day, self.outcome
        before, begun = day.robot.metres, day.time
        end = begun + timeout
        finder = self._by_rooms(item.kind, item.color) if direct else self._by_search(item.kind, item.color)
        while day.time < end and out.fetched is None:
            found = self._believed(item.kind, item.color)
            if found is not None:
                self._go_to(found, asked, end)
                if out.fetched is None:
                    out.failures.append(f"{found.id} was not where it was believed to be")
                    self._missed(found.id, found.position)
            elif not next(finder, False):
                out.failures.append("nothing is left to try")
                break
        out.searched, out.seconds = day.robot.metres - before, day.time - begun
        out.closest = day.robot.closest

    def _go_to(self, found: WorldObject, asked: str, end: float) -> None:
        name, begun = found.id, self.day.time
        going = partial(self._is_believed, name, found.position)
        goal = np.array([*found.position[:2], self._towards(found.position)])
        self.drive(goal, going, end - begun, ARM)
        arrived = self.day.time
        self.until(lambda: self._seen_since(name, arrived) or not going(), STARE)
        if not self._seen_since(name, begun) or not going():
            return
        assert self.state is not None
        known, spot = self.state.find(name), self.day.things[asked]
        assert known is not None
        if spot is not None:
            self.outcome.reached = self.day.away(spot)
        self.outcome.fetched = self.day.take(known.position)

    def _missed(self, name: str, place: Array) -> None:
        """The arm finds nothing at a place (3,): tell the world model, unless it knows."""
        if self._is_believed(name, place):
            self.state = self.model.report(name, "not_found", self.day.time)
        self.wait(1.0)

    def _by_search(self, kind: str, color: str) -> Iterator[bool]:
        """Where ObjectSearch wants to look, as the node asks it: one goal until it is reached or another is better."""
        settings = self._search
        search = ObjectSearch(settings.relations, settings.search, settings.places, self.grid)
        while True:
            search.expect(self._expected(kind, color))
            step = search.next_goal(self._landmarks(kind), kind, self.day.robot.pose)
            if step.goal is None:
                return
            self._follow(search, step, kind, color)
            yield True

    def _follow(self, search: ObjectSearch, step: SearchStep, kind: str, color: str) -> None:
        """Drive to a goal of the search, until it would rather have another one."""
        goal, day, settings = step.goal, self.day, self._search
        assert goal is not None
        if not day.robot.go(np.array([*goal, self._towards(goal)])):
            search.reached(goal)
            return
        end = day.time + 4.0 * PATIENCE
        while day.time < end:
            self.until(lambda: False, 1.0 / settings.rate)
            if self._believed(kind, color) is not None:
                break
            if math.hypot(*(goal - day.robot.pose[:2])) <= settings.arrival_distance:
                self.wait(1.0)
                search.reached(day.robot.pose[:2])
                break
            if day.robot.status != "driving":
                search.reached(goal)
                break
            search.expect(self._expected(kind, color))
            now = search.next_goal(self._landmarks(kind), kind, day.robot.pose)
            if now.goal is None or math.hypot(*(now.goal - goal)) > 0.5:
                break
        day.robot.stop()

    def _by_rooms(self, kind: str, color: str) -> Iterator[bool]:
        """From room to room, the nearest first, with a look around in each."""
        places = self._search.places
        assert places is not None
        left = {room.name: np.asarray(room.center) for room in places.rooms}
        while left:
            here = self.day.robot.pose[:2]
            name = min(left, key=lambda name: math.hypot(*(left[name] - here)))
            goal = left.pop(name)
            self.drive(np.array([*goal, math.nan]), lambda: self._believed(kind, color) is None)
            self.until(lambda: self._believed(kind, color) is not None, STARE)
            yield True

    def _landmarks(self, kind: str) -> dict[str, Array]:
        """Where to find what is believed in, by name, the nearest of each; the asked kind is none."""
        here, found = self.day.robot.pose[:2], {}
        assert self.state is not None
        for item in sorted(self.state.objects, key=lambda item: -math.hypot(*(item.position[:2] - here))):
            name = item.most_probable("class")
            if name and name != kind and not item.lost and item.existence >= BELIEVED:
                found[name] = item.position
        return found

    def _expected(self, kind: str, color: str) -> dict[str, float]:
        """Where it probably is by now, if it is lost or has probably moved on."""
        assert self.state is not None
        return {
            item.place: item.existence * item.place_probability
            for item in self.state.objects
            if item.place and (item.lost or MOVED_ON in item.predicates) and _is(item, kind, color)
        }

    def _believed(self, kind: str, color: str) -> WorldObject | None:
        for item in () if self.state is None else self.state.objects:
            if self._is_believed(item.id) and _is(item, kind, color):
                return item
        return None

    def _is_believed(self, name: str, place: Array | None = None) -> bool:
        """Whether there is an object by all that is known, within an arm's length of a place (3,) if one is given."""
        item = None if self.state is None else self.state.find(name)
        if item is None or item.lost or MOVED_ON in item.predicates:
            return False
        near = place is None or float(np.linalg.norm(item.position - place)) < ARM
        return near and item.existence >= BELIEVED

    def _towards(self, spot: Array) -> float:
        offset = spot[:2] - self.day.robot.pose[:2]
        return math.atan2(offset[1], offset[0])


def _is(item: WorldObject, kind: str, color: str) -> bool:
    return item.most_probable("class") == kind and item.most_probable("color") == color


def _rounds() -> Iterator[Array]:
    while True:
        yield from (np.array([*stop[:2], math.nan]) for stop in ROUND)


def run_ours(seed: int, maintained: float = 200.0, timeout: float = 240.0) -> Outcome:
    """Tour, maintenance and search."""
    robot = LibraryRobot(LiveDay(seed, scans=False, clouds=False))
    robot.tour()
    robot.maintain(maintained)
    robot.fetch(timeout=timeout)
    return robot.outcome


def run_naive(seed: int, metres: float, maintained: float = 200.0, timeout: float = 240.0) -> Outcome:
    """Tour, patrol with so many metres, and direct search."""
    robot = LibraryRobot(LiveDay(seed, scans=False, clouds=False))
    robot.tour()
    robot.patrol(maintained, metres)
    robot.fetch(timeout=timeout, direct=True)
    return robot.outcome

"""Weeks of a robot in an apartment where people carry things about by habit: searches, memory, and the past.

Every twenty minutes of the day the robot looks at three pieces of furniture, in turn; its camera misses things, names
them wrong and sees some that are not there. Three times a day it is asked for a thing: it looks at the place where the
world model says that the thing most probably is by now, at most at three. Settings are those shipped,
but things do not come and go.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from evaluation.demo.live.live_suite import library_settings, placed
from evaluation.report import Part, Report, RunOptions
from evaluation.scenes.household_weeks import CARRIED, DAY, HOUR, MINUTE, Weeks
from whereabouts.simulation.home.apartment_day import THINGS
from whereabouts.system.progress import track
from world_model import WorldModel, WorldObject
from world_model.memory.store import Store
from world_model.queries import Words

DAYS, QUICK_DAYS = 60, 3
MOST_PLACES = 3
ASKED, QUESTIONS = 3, 5
"""Searches, and questions about the past, a day."""
MORNING, NIGHT, ROUND = 7.0 * HOUR, 22.0 * HOUR, 20.0 * MINUTE
AT_ONCE = 3
"""Places of a round."""
HISTORY = 2000
"""Rows of the store from which on old ones are thinned out: those of about ten days."""
NEAR = 0.4  # m
FLAT_FROM = 10
"""Day from which on nothing may grow."""


@dataclass
class Week:
    """searched : places until the thing was found, by search, 0 where it was not. moved : whether it was away from
    where it was last seen. answers : s of processor time by question about the past, right : whether the answer was.
    store, memory : MiB at the end of each day."""

    searched: list[int] = field(default_factory=list)
    moved: list[bool] = field(default_factory=list)
    answers: list[float] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    store: list[float] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    update_ms: list[float] = field(default_factory=list)


REMOVED, NEW = 1e-7, 1e-5
"""1/s: what leaves this home for ever, and what comes to it: next to nothing."""


class VisitingRobot:
    """What it believes, what it looks at, and how it searches."""

    def __init__(self, weeks: Weeks, store: Store) -> None:
        settings = library_settings()[0]
        self.weeks = weeks
        world = replace(settings.world, removed_per_second=REMOVED, new_objects_per_second=NEW)
        self.model = WorldModel(world, settings.places, store, looks_back=False)
        self.model.words = Words(settings.places, settings.symbols)
        sigmas = (settings.position_sigma, settings.position_sigma, settings.heading_sigma)
        self._pose_covariance = np.diag(np.square(sigmas))
        self.spent: list[float] = []
        self._looked: dict[str, float] = {}

    def look(self, place: str, stamp: float) -> float:
        """Look at a place; returns when it is done."""
        self._looked[place] = stamp
        for now, pose, evidence in self.weeks.look(place, stamp):
            seen = placed(evidence, pose, 0.0, self._pose_covariance)
            begun = time.process_time()
            self.model.update(seen, now)
            self.spent.append(1e3 * (time.process_time() - begun))
        return now

    def believed(self, name: str, stamp: float) -> WorldObject | None:
        """What the model takes for a thing, by class and colour."""
        item = THINGS[name][0]
        alike = [
            self.model.words.described(found)
            for found in self.model.propagate(stamp).objects
            if found.most_probable("class") == item.kind and found.most_probable("color") == item.color
        ]
        return max(alike, key=lambda found: (found.existence, found.last_seen), default=None)

    def ranked(self, name: str, stamp: float) -> list[str]:
        """Places to look at, the most probable first; of those of which nothing is known, the longest unseen."""
        found = self.believed(name, stamp)
        shares = dict.fromkeys(self.weeks.looked_at, 0.0)
        if found is not None:
            usual = found.usual or self.model.household.by_now(found.id, stamp)
            for place, share in {found.place: 1e-3, **usual}.items():
                if place in shares:
                    shares[place] += share
        return sorted(shares, key=lambda place: (-shares[place], self._looked.get(place, 0.0)))

    def search(self, name: str, stamp: float) -> int:
        """Places until the thing was found, 0 where it was not."""
        visited: list[str] = []
        while len(visited) < MOST_PLACES:
            place = next(place for place in self.ranked(name, stamp) if place not in visited)
            visited.append(place)
            begun, stamp = stamp, self.look(place, stamp) + 20.0
            found, spot = self.believed(name, stamp), self.weeks.things(begun)[name]
            if found is None or spot is None or found.last_seen < begun:
                continue
            if np.linalg.norm(found.position - np.array(spot)) < NEAR:
                return len(visited)
        return 0


def live_weeks(seed: int, days: int) -> Week:
    """So many days of one household."""
    weeks = Weeks(library_settings()[0].places, days, seed)
    rng, out = np.random.default_rng([seed, 63]), Week()
    with TemporaryDirectory() as folder, Store(Path(folder) / "world.sqlite", HISTORY) as store:
        robot, turn = VisitingRobot(weeks, store), 0
        for day in track(range(days), "days"):
            midnight = weeks.begin + day * DAY
            asked = set(rng.integers(3, int((NIGHT - MORNING) / ROUND), ASKED).tolist())
            for k, begun in enumerate(np.arange(midnight + MORNING, midnight + NIGHT, ROUND).tolist()):
                stamp = begun
                for _ in range(AT_ONCE):
                    stamp = robot.look(weeks.looked_at[turn % len(weeks.looked_at)], stamp) + 20.0
                    turn += 1
                if k in asked and day > 0:
                    _search(robot, rng, begun + 0.5 * ROUND, out)
            _ask(robot, rng, midnight + NIGHT, out)
            out.store.append(sum(path.stat().st_size for path in Path(folder).iterdir()) / 2**20)
            out.memory.append(_memory())
        out.update_ms = robot.spent
    return out


def _search(robot: VisitingRobot, rng: np.random.Generator, stamp: float, out: Week) -> None:
    lies = [name for name in CARRIED if robot.weeks.where(name, stamp)]
    name = str(rng.choice(lies))
    known = robot.believed(name, stamp)
    out.moved.append(known is None or known.place != robot.weeks.where(name, stamp))
    out.searched.append(robot.search(name, stamp))


def _ask(robot: VisitingRobot, rng: np.random.Generator, stamp: float, out: Week) -> None:
    """Where things were, at times that are drawn from the last week."""
    for name in rng.choice(CARRIED, QUESTIONS).tolist():
        since = max(robot.weeks.begin + MORNING + HOUR, stamp - 7.0 * DAY)
        at, item = float(rng.uniform(since, stamp)), THINGS[name][0]
        begun = time.perf_counter()
        answers = robot.model.query(class_name=item.kind, stamp=at)
        out.answers.append(time.perf_counter() - begun)
        mine = [a.object for a in answers if a.object.most_probable("color") == item.color]
        out.right.append(any(found.place == robot.weeks.where(name, at) for found in mine))


def _memory() -> float:
    """MiB that the process holds now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 2**20


def _weeks(options: RunOptions, report: Report) -> None:
    """Searches, answers, store and memory."""
    days = QUICK_DAYS if options.quick else DAYS
    (seed,) = options.draws(60)
    found = live_weeks(seed, days)
    searched, moved = np.array(found.searched), np.array(found.moved)
    rows = []
    for name, asked in (("all", searched), ("moved unseen", searched[moved])):
        if len(asked):
            places = asked[asked > 0]
            visits = float(places.mean()) if len(places) else float("nan")
            rows.append([name, len(asked), 100.0 * len(places) / len(asked), visits])
    columns = ["thing", "searches", f"found within {MOST_PLACES} places, % ↑", "places looked at ↓"]
    note = f"{days} days, {len(CARRIED)} things, {ASKED} searches a day. A published system: 72.7 % over 60 days."
    report.add("Searches", columns, rows, note, "searches", data="simulated", samples=len(searched))
    early = min(FLAT_FROM, days) - 1
    growth = [
        [name, kept[early], kept[-1]] for name, kept in (("store", found.store), ("memory", found.memory))
    ]
    columns = ["", f"day {early + 1}, MiB ↓", "last day, MiB ↓"]
    note = f"Of {HISTORY} rows the older half is thinned out."
    report.add("What is kept", columns, growth, note, "kept", data="simulated", samples=1)
    times = 1e3 * np.array(found.answers)
    row = ["where was it", float(np.mean(times)), float(times.max()), 100.0 * float(np.mean(found.right))]
    columns = ["question about the past", "mean, ms ↓", "slowest, ms ↓", "right place, % ↑"]
    note = f"Of the last seven days. An update takes {np.mean(found.update_ms):.1f} ms."
    report.add("Answers", columns, [row], note, "answers", data="simulated", samples=len(times))


PARTS = {"weeks": Part(_weeks, quick_seeds=1)}

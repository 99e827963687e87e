"""Questions in plain words about two simulated weeks at home, answered from what was seen, beside the exact truth.

A robot looks at one piece of furniture every two minutes of the day; things are moved by habits, carried and forgotten,
people sit down here and there. Each evening it is asked.
"""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import datetime
from importlib.resources import files
from pathlib import Path

import numpy as np

from estimation.errors import InputError
from estimation.geometry.places import Places
from evaluation.report import Part, Report, RunOptions
from whereabouts.system.progress import track
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldObject, WorldState
from world_model.memory.store import Store
from world_model.questions import Answer, ask, recall

HOME = Places.load(str(files("world_model").joinpath("defaults/home.yaml")))
SPOTS = ("kitchen_table", "counter", "sofa", "low_table", "desk", "shelf", "bed")
BEGIN = datetime(2026, 11, 2).timestamp()  # a Monday
DAY, HOUR = 86400.0, 3600.0
LOOK = 120.0  # s between looks
DAYLIGHT = (7.0, 22.5)  # hours in which the robot looks
REGION = ((-0.5, 10.0), (-0.5, 9.0), (0.0, 2.5))
SURE = 0.9
FRAMES = 2  # of one look, a second apart
NOISE = 0.02  # m
MISSED = 0.05
UNSEEN = 261_123
"""Begins the seeds that judge: no household with it was looked at while the answers were made better."""
LOST = ""
"""Place of what is out of the house."""
THINGS = {
    "red cup": ((7.4, "kitchen_table"), (9.0, "counter"), (15.0, "low_table"), (20.5, "counter")),
    "blue cup": ((8.2, "desk"), (12.3, "counter")),
    "book": ((13.0, "sofa"), (19.0, "bed")),
    "laptop": ((9.2, "desk"), (18.0, "low_table")),
    "white plate": ((12.0, "kitchen_table"), (13.4, "counter")),
    "bag": ((8.6, LOST), (17.2, "sofa")),
    "remote": ((19.5, "low_table"), (21.8, "sofa")),
    "green bottle": ((10.0, "shelf"), (16.0, "kitchen_table")),
    "glass": ((11.0, "counter"), (14.2, "desk"), (17.5, "counter")),
    "black box": (),
}
"""Hours of the day and where each thing goes then, on most days."""
Checked = Callable[[Answer], bool]


def spot(name: str, rng: np.random.Generator) -> np.ndarray:
    """A position (3,) on a piece of furniture, m."""
    place = HOME[name]
    low, high = place.polygon.min(0), place.polygon.max(0)
    while True:
        xy = rng.uniform(low + 0.12, high - 0.12)
        inner = xy + 0.1 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
        if place.contains(inner).all():
            return np.array([*xy, 0.5 * (max(place.height[0], 0.4) + place.height[1])])


def kind_of(name: str) -> str:
    """Class of a thing."""
    return name.split()[-1]


@dataclass
class AskedHome:
    """Where everything truly is. moves : by thing, [(stamp, place, position)]. visits : (person, place, from, to)."""

    moves: dict[str, list[tuple[float, str, np.ndarray]]]
    visits: list[tuple[str, str, float, float]] = field(default_factory=list)

    @classmethod
    def living(cls, days: int, rng: np.random.Generator) -> AskedHome:
        """So many days of habits, of which each is kept in 85 of 100 cases."""
        moves: dict[str, list[tuple[float, str, np.ndarray]]] = {}
        visits = []
        for name, plan in THINGS.items():
            first = plan[-1][1] if plan else "shelf"
            known = [(BEGIN, first, spot(first, rng))]
            for day in range(days):
                for hour, place in plan:
                    if rng.random() < 0.15:
                        place = str(rng.choice(SPOTS))
                    stamp = BEGIN + day * DAY + (hour + rng.normal(0.0, 0.15)) * HOUR
                    if place != known[-1][1] and stamp > known[-1][0] + HOUR / 2:
                        known.append((stamp, place, spot(place, rng) if place else np.zeros(3)))
            moves[name] = known
        for day in range(days):
            for hour in rng.choice(np.arange(8, 21), 5, replace=False):
                begin = BEGIN + day * DAY + (hour + rng.uniform(0.0, 0.3)) * HOUR
                person = str(rng.choice(["anna", "ben"]))
                at = str(rng.choice(["kitchen_table", "sofa", "desk"]))
                visits.append((person, at, begin, begin + rng.uniform(20.0, 35.0) * 60.0))
        return cls(moves, visits)

    def at(self, name: str, stamp: float) -> tuple[str, np.ndarray]:
        """Place and position at a moment."""
        found = [(place, position) for then, place, position in self.moves[name] if then <= stamp]
        return found[-1]

    def began(self, name: str, stamp: float) -> float:
        """When it came to where it is at a moment."""
        return [then for then, _, _ in self.moves[name] if then <= stamp][-1]

    def times(self, name: str, start: float, end: float, place: str | None = None) -> int:
        """How often it was moved from place to place in the house, or came to one, within a span."""
        inside = [move for move in self.moves[name] if move[1]]
        return sum(
            start < then <= end and (to == place if place is not None else to != before)
            for (_, before, _), (then, to, _) in itertools.pairwise(inside)
        )

    def is_visited(self, place: str, stamp: float) -> bool:
        """Whether somebody is at a piece of furniture: the robot looks some seconds longer then."""
        return any(where == place and start <= stamp <= end for _, where, start, end in self.visits)


def looks_of(days: int) -> Iterator[tuple[float, str]]:
    """Stamp and furniture of every look."""
    for day in range(days):
        begin = BEGIN + day * DAY + DAYLIGHT[0] * HOUR
        for step in range(round((DAYLIGHT[1] - DAYLIGHT[0]) * HOUR / LOOK)):
            yield begin + step * LOOK, SPOTS[step % len(SPOTS)]


def sensor_at(place: str) -> dict[str, object]:
    """A look at a piece of furniture from above."""
    center, size = HOME[place].center, np.ptp(HOME[place].polygon, axis=0)
    reach = 0.5 * float(np.hypot(*size)) + 0.1
    return {"pose": (*center, 1.0, 0.0), "range": reach, "angle": 2.0 * np.pi}


def seen_at(place: str, position: np.ndarray) -> bool:
    """Whether a position is within the look at a piece of furniture."""
    sensor = sensor_at(place)
    return bool(np.hypot(*(position[:2] - HOME[place].center)) < float(sensor["range"]))  # type: ignore[arg-type]


def evidence_of(name: str, position: np.ndarray, rng: np.random.Generator) -> ObjectEvidence:
    """A detection of a thing; its name says class and colour."""
    kind, color = kind_of(name), name.split()[0] if " " in name else ""
    attributes = {"class": {kind: 0.95, "book" if kind != "book" else "bag": 0.05}}
    if color:
        attributes["color"] = {color: 0.95, "gray": 0.05}
    return ObjectEvidence(position + rng.normal(0.0, NOISE, 3), NOISE**2 * np.eye(3), attributes)


def settings() -> WorldModelConfig:
    """Of a robot that looks every two minutes, at things that are seldom taken out of the house."""
    return WorldModelConfig(
        region=REGION, removed_per_second=1e-6, new_objects_per_second=1e-4, clutter_per_frame=0.02
    )


def look(home: AskedHome, place: str, stamp: float, rng: np.random.Generator) -> WorldEvidence:
    """What one look finds."""
    found = []
    for name in home.moves:
        there, position = home.at(name, stamp)
        if there and seen_at(place, position) and rng.random() >= MISSED:
            found.append(evidence_of(name, position, rng))
    for _, where, start, end in home.visits:
        if where == place and start <= stamp <= end:
            beside = np.array([HOME[place].center[0], HOME[place].polygon[:, 1].max() + 0.3, 1.0])
            found.append(ObjectEvidence(beside, 0.01 * np.eye(3), {"class": {"person": 1.0}}))
    return WorldEvidence(found, sensor_at(place))


@dataclass
class AnswerTally:
    """Answers to one kind of question; wrong: in words."""

    right: list[bool] = field(default_factory=list)
    probability: list[float] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    def add(self, right: bool, probability: float) -> None:
        self.right.append(right)
        self.probability.append(probability)

    @property
    def brier(self) -> float:
        """Mean squared difference of the probability told and whether it was right."""
        return float(np.mean((np.array(self.probability) - np.array(self.right)) ** 2))


def said(place: str) -> str:
    """A place in words."""
    return place.replace("_", " ")


def asked(home: AskedHome, now: float, rng: np.random.Generator) -> Iterator[tuple[str, str, Checked]]:
    """Kind, question and check, drawn at random, without end."""
    kinds = list(QUESTIONS)
    while True:
        kind = str(rng.choice(kinds))
        made = QUESTIONS[kind](home, now, rng)
        if made is not None:
            yield kind, *made


def _thing(rng: np.random.Generator) -> str:
    return str(rng.choice(list(THINGS)))


def _when(now: float, rng: np.random.Generator) -> tuple[str, float]:
    """A moment in words, and itself."""
    day, half = rng.integers(0, max(int((now - BEGIN) / DAY), 1)), rng.integers(16, 44)
    at = BEGIN + float(day) * DAY + float(half) * HOUR / 2
    at = min(at, now - HOUR)
    form = rng.integers(3)
    then, today = datetime.fromtimestamp(at), datetime.fromtimestamp(now)
    back = (today.date() - then.date()).days
    if form == 0 and back == 1:
        return f"yesterday at {then:%H:%M}", at
    if form == 1 and back < 7:
        return f"on {then:%A} at {then:%H:%M}", at
    return f"at {then:%Y-%m-%dT%H:%M}", at


def _where_is(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    name = _thing(rng)
    place, _ = home.at(name, now)
    return f"where is the {name}?", lambda answer: (answer.value or LOST) == place


def _where_was(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    name = _thing(rng)
    words, at = _when(now, rng)
    place, _ = home.at(name, at)
    if at < BEGIN + 8 * HOUR:
        return None
    return f"where was the {name} {words}?", lambda answer: (answer.value or LOST) == place


def _is_at(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    name = _thing(rng)
    truly, _ = home.at(name, now)
    place = truly if truly and rng.random() < 0.5 else str(rng.choice(SPOTS))
    return (
        f"is the {name} {HOME[place].preposition} the {said(place)}?",
        lambda answer: answer.value is (place == truly),
    )


def _how_often(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    name = _thing(rng)
    day = datetime.fromtimestamp(now).replace(hour=0, minute=0, second=0).timestamp()
    if now - day < 8 * HOUR:
        return None
    count = home.times(name, day, now)
    return f"how often was the {name} moved today?", lambda answer: answer.value == count


def _how_long(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    name = _thing(rng)
    long = now - home.began(name, now)
    if long > now - BEGIN - 8 * HOUR or long < 0.5 * HOUR:
        return None  # since before anything was seen
    return (
        f"how long has the {name} been there?",
        lambda answer: abs((answer.value or 0.0) - long) <= 2 * len(SPOTS) * LOOK,
    )


def _last_seen(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    name = _thing(rng)
    left = home.began(name, now) if not home.at(name, now)[0] else now

    def check(answer: Answer) -> bool:
        stamp = datetime.fromisoformat(answer.value).timestamp()
        return stamp <= left + 1.0 and stamp >= left - 3 * len(SPOTS) * LOOK

    return f"when was the {name} last seen?", check


def _what_changed(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    hours = int(rng.integers(2, 7))
    start = now - hours * HOUR
    if start < BEGIN + 9 * HOUR or datetime.fromtimestamp(start).hour < 8:
        return None
    changed = {
        name: home.at(name, now)[0] for name in THINGS if home.at(name, start)[0] != home.at(name, now)[0]
    }
    edge = 2 * len(SPOTS) * LOOK
    recent = {n for n in THINGS if any(abs(t - start) < edge or t > now - edge for t, _, _ in home.moves[n])}

    def check(answer: Answer) -> bool:
        told = {by_id(key): after or LOST for key, (_, after) in answer.value.items()}
        sure = {name: place for name, place in changed.items() if name not in recent}
        return all(told.get(name) == place for name, place in sure.items()) and not (
            told.keys() - changed.keys() - recent
        )

    return f"what has changed in the last {hours} hours?", check


def by_id(name: str) -> str:
    """The thing with an id such as book-1; classes with several are told apart elsewhere."""
    kind = name.rpartition("-")[0]
    found = [thing for thing in THINGS if kind_of(thing) == kind]
    return found[0] if len(found) == 1 else IDS.get(name, name)


IDS: dict[str, str] = {}
"""Things by id where classes have several; of the household that is asked about."""


def _what_is_at(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    place = str(rng.choice(SPOTS))
    there = {name for name in THINGS if home.at(name, now)[0] == place}
    verb = HOME[place].preposition
    return (
        f"what is {verb} the {said(place)}?",
        lambda answer: {by_id(each) for each in answer.value} == there,
    )


def _usually(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    if now - BEGIN < 5 * DAY:
        return None
    name = _thing(rng)
    spent: dict[str, float] = {}
    stamps = np.arange(BEGIN + 8 * HOUR, now, 600.0)
    for stamp in stamps:
        place = home.at(name, stamp)[0]
        spent[place] = spent.get(place, 0.0) + 1.0
    spent.pop(LOST, None)
    order = sorted(spent, key=lambda place: -spent[place])
    if len(order) > 1 and spent[order[0]] < 1.15 * spent[order[1]]:
        return None  # nobody could say
    return f"where is the {name} usually?", lambda answer: answer.value == order[0]


def _missing(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    gone = {name for name in THINGS if not home.at(name, now)[0]}
    return "what is missing?", lambda answer: {by_id(each) for each in answer.value} == gone


def _who(home: AskedHome, now: float, rng: np.random.Generator) -> tuple[str, Checked] | None:
    place = str(rng.choice(["kitchen_table", "sofa", "desk"]))
    today = datetime.fromtimestamp(now).replace(hour=0, minute=0, second=0).timestamp()
    visits = [
        (start, end)
        for _, where, start, end in home.visits
        if where == place and start >= today and end <= now
    ]

    def check(answer: Answer) -> bool:
        told = [[datetime.fromisoformat(each).timestamp() for each in row[1:3]] for row in answer.value]
        met = all(any(a <= end + 60 and b >= start - 60 for a, b in told) for start, end in visits)
        return met and all(any(a <= end + 60 and b >= start - 60 for start, end in visits) for a, b in told)

    late = any(where == place and start < now < end + 1 for _, where, start, end in home.visits)
    return None if late else (f"who was {HOME[place].preposition} the {said(place)} today?", check)


Maker = Callable[[AskedHome, float, np.random.Generator], "tuple[str, Checked] | None"]
QUESTIONS: dict[str, Maker] = {
    "where is": _where_is,
    "where was": _where_was,
    "is it there": _is_at,
    "how often": _how_often,
    "how long": _how_long,
    "last seen": _last_seen,
    "what changed": _what_changed,
    "what is there": _what_is_at,
    "usually": _usually,
    "missing": _missing,
    "who": _who,
}


def two_weeks(options: RunOptions, days: int, count: int) -> dict[str, AnswerTally]:
    """Live through the days, ask each afternoon or evening."""
    rng = np.random.default_rng([options.seed, UNSEEN])
    home = AskedHome.living(days, rng)
    tallies: dict[str, AnswerTally] = {}
    asking = {day: BEGIN + day * DAY + rng.uniform(15.0, 22.4) * HOUR for day in range(days)}
    per_day = -(-count // days)
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder) / "home.sqlite") as store:
        model = WorldModel(settings(), HOME, store, looks_back=False)
        for stamp, place in track(list(looks_of(days)), "looks"):
            for again in range(5 if home.is_visited(place, stamp) else FRAMES):
                model.update(look(home, place, stamp, rng), stamp + again)
            day = int((stamp - BEGIN) // DAY)
            if day in asking and stamp >= asking[day]:
                del asking[day]
                _named(model, home, stamp)
                _interview(store, home, stamp, per_day, rng, tallies)
    return tallies


def _named(model: WorldModel, home: AskedHome, now: float) -> None:
    """Which id each thing has of those whose class several have."""
    IDS.clear()
    for item in model.propagate(now).objects:
        kind, color = item.most_probable("class"), item.most_probable("color")
        if f"{color} {kind}" in THINGS:
            IDS[item.id] = f"{color} {kind}"


def _interview(
    store: Store,
    home: AskedHome,
    now: float,
    count: int,
    rng: np.random.Generator,
    tallies: dict[str, AnswerTally],
) -> None:
    asking = asked(home, now, rng)
    for _ in range(count):
        kind, question, check = next(asking)
        answer = ask(store, question)
        try:
            right = check(answer)
        except (TypeError, AttributeError, ValueError):
            right = False
        tally = tallies.setdefault(kind, AnswerTally())
        tally.add(right, answer.probability)
        if not right:
            tally.wrong.append(f"{datetime.fromtimestamp(now):%d %H:%M} {question} {answer.sentence}")


def _answers(options: RunOptions, report: Report) -> None:
    """Right answers and how far their probabilities can be believed."""
    tallies = two_weeks(options, 5 if options.quick else 14, 110 if options.quick else 300)
    rows: list[list[object]] = []
    everything = AnswerTally()
    for kind in QUESTIONS:
        if kind in tallies:
            tally = tallies[kind]
            rows.append([kind, len(tally.right), 100.0 * float(np.mean(tally.right)), tally.brier])
            everything.right += tally.right
            everything.probability += tally.probability
    rows.append(["all", len(everything.right), 100.0 * float(np.mean(everything.right)), everything.brier])
    wrong = [line for tally in tallies.values() for line in tally.wrong]
    report.notes += [f"Wrong: {line}" for line in wrong[:5]]
    report.add(
        "Questions about two weeks",
        ["question", "asked", "right, % ↑", "Brier ↓"],
        rows,
        "Ten things, seven pieces of furniture, each looked at every 14 minutes of the day. How often is right to "
        "the number, how long and last seen to within two or three rounds. Wanted: 95 % right, Brier 0.05.",
        "answers",
        data="simulated",
    )


# What robots get wrong: things exchanged, removed, carried, twins.


def _puzzle(kind: str, seed: int) -> tuple[int, int, int]:
    """Ghosts and exchanges told as sure, and questions, of one scene."""
    rng = np.random.default_rng([seed, len(kind)])
    names = ["red cup", "red cup" if "twin" in kind else "blue cup", "book"]
    places = list(rng.choice(SPOTS, 4, replace=False))
    at = {index: spot(str(places[index]), rng) for index in range(3)}
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder) / "home.sqlite") as store:
        model = WorldModel(settings(), HOME, store, looks_back=False)
        stamp = BEGIN + 9 * HOUR
        stamp = _watch(model, names, at, stamp, 4, rng)
        before = {item.id: _nearest(at, item) for item in model.propagate(stamp).objects}
        if kind.startswith("removed"):
            at.pop(0)
        elif kind.startswith("carried"):
            at[0] = spot(str(places[3]), rng)
        else:
            at[0], at[1] = at[1].copy(), at[0].copy()
        stamp = _watch(model, names, at, stamp, 5, rng)
        ghosts = swaps = asked_for = 0
        for name, index in before.items():
            answer = ask(store, f"where is {name}?")
            asked_for += 1
            if answer.value is None or answer.probability < SURE:
                continue
            here = [k for k, position in at.items() if HOME[str(answer.value)].contains(position[:2])]
            ghosts += not here
            swaps += bool(here) and index not in here
        for name in set(names):
            answer = ask(store, f"where is the {name}?")
            asked_for += 1
            if not isinstance(answer.value, str) or answer.probability < SURE or answer.value not in HOME:
                continue
            here = [k for k, position in at.items() if HOME[answer.value].contains(position[:2])]
            ghosts += not any(names[k] == name for k in here)
    return ghosts, swaps, asked_for


def _nearest(at: dict[int, np.ndarray], item: WorldObject) -> int:
    return min(at, key=lambda k: float(np.linalg.norm(at[k] - item.position)))


def _watch(
    model: WorldModel,
    names: list[str],
    at: dict[int, np.ndarray],
    stamp: float,
    rounds: int,
    rng: np.random.Generator,
) -> float:
    for _ in range(rounds):
        for place in SPOTS:
            stamp += LOOK
            found = [evidence_of(names[k], p, rng) for k, p in at.items() if seen_at(place, p)]
            model.update(WorldEvidence(found, sensor_at(place)), stamp)
    return stamp


PUZZLES = ("exchanged", "removed", "carried", "exchanged twins", "removed of twins", "carried of twins")


def _puzzles(options: RunOptions, report: Report) -> None:
    """Ghosts and exchanges that are told as sure."""
    rows: list[list[object]] = []
    scenes = 3 if options.quick else 20
    for kind in PUZZLES:
        found = [_puzzle(kind, UNSEEN + 1000 * options.seed + k) for k in range(scenes)]
        ghosts, swaps, count = (sum(column) for column in zip(*found, strict=True))
        rows.append([kind, count, ghosts, swaps])
    report.add(
        "Told as sure, and wrong",
        ["out of sight", "asked", "ghosts ↓", "exchanges ↓"],
        rows,
        f"Sure: a probability of at least {SURE:g}. Ghost: nothing like it is there. "
        "Exchange: another one is there.",
        "puzzles",
        data="simulated",
    )


# Time.


DAYS = 365
YEAR_KINDS = ("cup", "book", "bag", "glass", "plate")
"""Classes of the things in the store of a year, four of each."""


def year(path: Path, rng: np.random.Generator, days: int = DAYS) -> Store:
    """A store with so many days: twenty things, moved six times a day each, and people."""
    store = Store(path)
    store.keep_places(HOME)
    things = {f"{YEAR_KINDS[k % 5]}-{k // 5 + 1}": spot("shelf", rng) for k in range(20)}
    known: dict[str, WorldObject] = {}
    for step in range(days * 48):
        stamp = BEGIN + step * 1800.0
        for name in things:
            if name not in known or rng.random() < 6 / 48:
                things[name] = spot(str(rng.choice(SPOTS)), rng)
            known[name] = _object(name, things[name], stamp, known.get(name))
        people = [_object(f"person-{step}", spot("sofa", rng), stamp, None)] if step % 8 == 0 else []
        store.record(WorldState((*known.values(), *people), 1.0, 20.0, stamp))
    return store


def _object(name: str, position: np.ndarray, stamp: float, before: WorldObject | None) -> WorldObject:
    first = stamp if before is None else before.first_seen
    attributes = {"class": {name.rpartition("-")[0]: 1.0}}
    return WorldObject(name, position, np.zeros(3), 1e-3 * np.eye(3), attributes, 0.99, False, stamp, first)


TIMES_ASKED = 3
"""What one question costs is the median of so many."""
KINDS = {
    "where is": ("where is {thing}", "which room is {thing} in", "where is the {kind}"),
    "where are": ("where are the {kinds}",),
    "where was": ("where was {thing} {moment}", "where was the {kind} {moment}", "where was {thing} {span}"),
    "where usually": ("where is {thing} usually",),
    "where will it be": ("where will {thing} be tomorrow at eight",),
    "is it there": ("is {thing} {place}", "is the {kind} {place}"),
    "last seen": ("when was {thing} last seen",),
    "when moved": ("when was {thing} moved",),
    "how often": ("how often was {thing} moved", "how often was {thing} moved since {since}",
                  "how often was {thing} {place} {span}"),
    "how long": ("how long has {thing} been there",),
    "how many": ("how many {kinds} are in the kitchen", "how many {kinds} are {place}"),
    "what happened": ("what happened to {thing}", "what happened to {thing} since {since}"),
    "what changed": ("what has changed since {since}",),
    "what has left": ("what has left {furniture} since {since}",),
    "what is missing": ("what is missing",),
    "what is there": ("what is {place}",),
    "what was there": ("what was {place} {moment}",),
    "what is usually there": ("what is usually {place}",),
    "who": ("who was {place} {span}", "who was here", "who moved {thing}"),
    "needed next": ("what will be needed next",),
}  # fmt: skip
"""Forms of each kind of question."""


def worded(form: str, now: float, rng: np.random.Generator) -> str:
    """A question about a thing, place and time of the year, drawn at random."""
    spot_name = str(rng.choice(SPOTS))
    kind, then = str(rng.choice(YEAR_KINDS)), datetime.fromtimestamp(now - rng.uniform(0.0, DAYS) * DAY)
    moments = ("yesterday at 9:00", "on monday at 14:00", f"at {then:%Y-%m-%dT%H:%M}")
    return form.format(
        thing=f"{kind}-{rng.integers(1, 5)}",
        kind=kind,
        kinds=f"{kind}es" if kind.endswith("s") else f"{kind}s",
        furniture=f"the {said(spot_name)}",
        place=f"{HOME[spot_name].preposition} the {said(spot_name)}",
        moment=str(rng.choice(moments)),
        span=str(rng.choice(["today", "yesterday", "this week", "last week"])),
        since=str(rng.choice(["yesterday", "monday", f"{then:%Y-%m-%d}"])),
    )


class Costs:
    """What questions cost on a store of a year that another process goes on writing; times in ms.

    writer : open, with all the history. Close it with `close`.
    """

    def __init__(self, writer: Store, rng: np.random.Generator) -> None:
        self.writer, self._rng = writer, rng
        self.reader = Store(writer.path, read_only=True)  # held open all the while
        self.now = recall(self.reader).now

    def close(self) -> None:
        self.reader.close()
        self.writer.close()

    def message(self) -> None:
        """Something was moved, all was seen again, and is written."""
        self.now += LOOK
        items = [replace(item, last_seen=self.now) for item in self.writer.present()]
        moved = int(self._rng.integers(len(items)))
        items[moved] = replace(items[moved], position=spot(str(self._rng.choice(SPOTS)), self._rng))
        self.writer.record(WorldState(tuple(items), 1.0, 20.0, self.now))

    def of(self, question: str) -> tuple[float, float, float]:
        """As the first question to a store that was just opened, after a new message, and asked once more; medians."""
        spent: list[tuple[float, float, float]] = []
        for _ in range(TIMES_ASKED):
            self.reader.recalled = None  # all that was read of it before; its places and words, too
            first = self._ask(question)
            self.message()
            spent.append((first, self._ask(question), self._ask(question)))
        first, later, again = np.median(spent, axis=0).tolist()
        return first, later, again

    def _ask(self, question: str) -> float:
        begun = time.perf_counter()
        answer = ask(self.reader, question)
        spent = 1e3 * (time.perf_counter() - begun)
        if not answer.understood:
            raise InputError(f"not understood: {question}")
        return spent


def _times(options: RunOptions, report: Report) -> None:
    """What a question costs on a store of a year."""
    rng = np.random.default_rng([options.seed, UNSEEN])
    each = (100 if options.quick else 300) // len(KINDS)
    rows: list[list[object]] = []
    slowest: list[list[float]] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(Costs(year(Path(folder) / "year.sqlite", rng), rng)) as costs,
    ):
        history = costs.writer.rows
        for kind, forms in track(list(KINDS.items()), "kinds of question"):
            found = [costs.of(worded(forms[k % len(forms)], costs.now, rng)) for k in range(each)]
            slowest.append(np.max(found, axis=0).tolist())
            rows.append([kind, each, *slowest[-1]])
    rows.append(["slowest", each * len(KINDS), *np.max(slowest, axis=0).tolist()])
    report.add(
        "Time of a question, store of a year",
        ["question", "asked", "first, ms ↓", "after a message, ms ↓", "again, ms ↓"],
        rows,
        f"{DAYS} days of twenty things that are moved six times a day each: {history} rows of history, as many "
        f"as a store keeps. The slowest of each kind; one question is the median of {TIMES_ASKED}. First: nothing "
        "has been read yet of the store, which is held open. After a message: something was moved and written "
        "since the last question. Again: the same question once more. Wanted: 50 ms.",
        "times",
        data="simulated",
    )


PARTS = {
    "answers": Part(_answers, quick_seeds=1),
    "puzzles": Part(_puzzles, quick_seeds=1),
    "times": Part(_times, random=False),
}

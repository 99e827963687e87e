"""Where all things were in the last weeks, read at once: what habits and routines are made of."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from world_model.questions.recall import BELIEVED, PERSON, Recall, Timeline, of_all

MOST = 25_000  # Rows of history that are looked through: some weeks of a busy home


Sight = tuple[float, str, bytes, float, int, float, float]


@dataclass(frozen=True)
class PlaceCourse:
    """One object: from each of `stamps` (N,), s, on it was at `places` (N,), None where it was nowhere."""

    stamps: FloatArray
    places: tuple[str | None, ...]
    seen: float

    def shares(self, start: float, end: float, absent: bool = False) -> dict[str, float]:
        """Share of the time between two moments by place; `absent` as of `Timeline.shares`."""
        spent: dict[str, float] = {}
        edges = np.clip([*self.stamps, end], start, end)
        for place, seconds in zip(self.places, np.diff(edges).tolist(), strict=True):
            if place is not None and seconds > 0.0:
                spent[place] = spent.get(place, 0.0) + seconds
        return of_all(spent, end - max(start, float(self.stamps[0])) if absent and len(self.stamps) else 0.0)


@dataclass(frozen=True)
class Presence:
    """The courses of all things, by newest id, between `start` and `end`, s."""

    start: float
    end: float
    courses: dict[str, PlaceCourse]

    def shares(self, name: str, absent: bool = False) -> dict[str, float]:
        """Share of the time by place of one object, {} where it was not seen."""
        course = self.courses.get(name)
        return {} if course is None else course.shares(self.start, self.end, absent)


def presence_of(world: Recall, start: float) -> Presence:
    """Where all that is no person was since a moment, or since what `MOST` rows tell; read once."""
    return world.once(f"presence {start}", lambda: _read(world, start))


def course_of(world: Recall, name: str, start: float) -> PlaceCourse | None:
    """Where one object was since a moment, None where it was not seen: of few objects cheaper than `presence_of`."""
    whole = world.kept.get(f"presence {start}")
    if isinstance(whole, Presence):
        return whole.courses.get(name)
    return world.once(f"course {name} {start}", lambda: _of_one(world, name, start))


def _of_one(world: Recall, name: str, start: float) -> PlaceCourse | None:
    if world.store is None:
        line = world.timeline(name)
        return _of_line(line) if line.stays else None
    rows: list[Sight] = []
    for known in world.names_of(name):
        rows += world.store.sights(known, world.epoch, start, again=False)
    rows.sort(key=lambda row: row[0])
    words = world.words(np.frombuffer(b"".join(row[2] for row in rows), "<f8").reshape(-1, 3))
    stamps = [row[0] for row in rows]
    places = [word if _is_there(row) else None for word, row in zip(words, rows, strict=True)]
    if not stamps or stamps[0] > start:
        before = world.store.sights(name, world.epoch, end=start, most=1)
        if before:
            stamps, places = [start, *stamps], [_place(world, before[0]), *places]
    item = world.present.get(name)
    seen = item.last_seen if item is not None else max((row[5] for row in rows), default=start)
    return _course(stamps, places, seen) if stamps else None


def _read(world: Recall, start: float) -> Presence:
    if world.store is None:
        lines = {name: _of_line(world.timeline(name)) for name in world.things()}
        return Presence(start, world.now, lines)
    names, rows, start = world.store.happened(start, MOST, PERSON)
    by_key: dict[int, list[int]] = {}
    for index, row in enumerate(rows):
        by_key.setdefault(row[0], []).append(index)
    by_name: dict[str, list[int]] = {name: [] for name in world.heads(world.present)}
    for key, found in by_key.items():
        by_name.setdefault(world.individual(names[key])[0], []).extend(found)
    before: dict[str, Sight] = {}
    for name, found in by_name.items():
        found.sort()
        if not found or rows[found[0]][1] > start:
            earlier = world.store.sights(name, world.epoch, end=start, most=1)
            if earlier:
                before[name] = earlier[0]
    positions = b"".join([*(row[3] for row in rows), *(row[2] for row in before.values())])
    words = world.words(np.frombuffer(positions, "<f8").reshape(-1, 3))
    first = dict(zip(before, words[len(rows) :], strict=True))
    courses: dict[str, PlaceCourse] = {}
    for name, found in by_name.items():
        stamps = [rows[index][1] for index in found]
        places = [words[index] if _is_there(rows[index][1:]) else None for index in found]
        if name in before:
            stamps, places = [start, *stamps], [first[name] if _is_there(before[name]) else None, *places]
        item = world.present.get(name)
        seen = item.last_seen if item is not None else max((rows[index][6] for index in found), default=start)
        if stamps:
            courses[name] = _course(stamps, places, seen)
    return Presence(start, world.now, courses)


def _place(world: Recall, row: Sight) -> str | None:
    """Where an object was by one row of its history."""
    return world.words(np.frombuffer(row[2], "<f8").reshape(1, 3))[0] if _is_there(row) else None


def _is_there(row: tuple[Any, ...]) -> bool:
    """By a row of history from its stamp on: stamp, event, position, existence, lost."""
    return row[1] != "gone" and not row[4] and row[3] >= BELIEVED


def _course(stamps: list[float], places: list[str | None], seen: float) -> PlaceCourse:
    """Only where the place is another than before."""
    kept = [index for index in range(len(places)) if index == 0 or places[index] != places[index - 1]]
    return PlaceCourse(
        np.array([stamps[index] for index in kept]), tuple(places[index] for index in kept), seen
    )


def _of_line(line: Timeline) -> PlaceCourse:
    stamps: list[float] = []
    places: list[str | None] = []
    for stay in line.stays:
        stamps.append(stay.since)
        places.append(stay.place)
        if stay.gone and stay.left_by is not None:
            stamps.append(stay.left_by)
            places.append(None)
    return _course(stamps, places, line.stays[-1].until if line.stays else -math.inf)

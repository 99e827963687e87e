"""Where things were, by the names of places, read from a store's history; and the routines that this teaches."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.places import Place
from world_model.memory.routines import FORMAT, VERSION, Routines, RoutinesConfig
from world_model.memory.store import Store
from world_model.state import BELIEVED, DAY, PERSON, WorldObject

MOST = 25_000  # Rows of history that are looked through: some weeks of a busy home
STEP = 0.005  # m: what moves less from row to row rests

Sight = tuple[float, str, bytes, float, int, float]
"""Stamp, event, position (3 × 8 bytes), existence, whether it is lost, when it was seen last."""


class PlaceWords:
    """Names of the places around positions: the smallest piece of furniture, or room, "" where there is none."""

    def __init__(self, places: Iterable[Place]) -> None:
        # What is found last is said: the smallest furniture.
        self._ordered = sorted(places, key=lambda place: (place.kind != "room", -place.area))
        self._names = ["", *(place.name for place in self._ordered)]
        boxes = [
            (*place.polygon.min(0), place.height[0], *place.polygon.max(0), place.height[1])
            for place in self._ordered
        ]
        self._lows, self._highs = np.hsplit(np.array(boxes).reshape(-1, 6), 2)

    def __call__(self, positions: FloatArray) -> list[str]:
        """Of each position (N, 3), m; rows that rest share theirs."""
        if not len(positions):
            return []
        steps = np.concatenate([[True], np.abs(np.diff(positions, axis=0)).max(1) > STEP])
        firsts = positions[steps]
        last = np.zeros(len(firsts), np.int64)
        near = ((firsts[:, None] >= self._lows) & (firsts[:, None] <= self._highs)).all(2)
        for number in np.flatnonzero(near.any(0)).tolist():
            rows = np.flatnonzero(near[:, number])
            last[rows[self._ordered[number].contains(firsts[rows])]] = number + 1
        return [self._names[index] for index in last[np.cumsum(steps) - 1].tolist()]


def is_there(row: tuple[Any, ...]) -> bool:
    """By a row of history (`Sight`) whether the object was at its position, from the stamp on."""
    return row[1] != "gone" and not row[4] and row[3] >= BELIEVED


@dataclass(frozen=True)
class PlaceCourse:
    """One object: from each of `stamps` (N,), s, on it was at `places` (N,), None where it was nowhere. seen : s, when
    last."""

    stamps: FloatArray
    places: tuple[str | None, ...]
    seen: float

    @classmethod
    def of(cls, stamps: list[float], places: list[str | None], seen: float) -> PlaceCourse:
        """Only where the place is another than before."""
        kept = [index for index in range(len(places)) if index == 0 or places[index] != places[index - 1]]
        return cls(np.array([stamps[index] for index in kept]), tuple(places[index] for index in kept), seen)

    def shares(self, start: float, end: float, absent: bool = False) -> dict[str, float]:
        """Share of the time between two moments by place; `absent` as of `of_all`."""
        spent: dict[str, float] = {}
        edges = np.clip([*self.stamps, end], start, end)
        for place, seconds in zip(self.places, np.diff(edges).tolist(), strict=True):
            if place is not None and seconds > 0.0:
                spent[place] = spent.get(place, 0.0) + seconds
        return of_all(spent, end - max(start, float(self.stamps[0])) if absent and len(self.stamps) else 0.0)


def of_all(spent: dict[str, float], least: float) -> dict[str, float]:
    """Shares of their sum, or of `least` s where that is more: of the time that a thing was absent, too."""
    total = max(sum(spent.values()), least)
    return {place: seconds / total for place, seconds in spent.items()} if total > 0.0 else {}


def courses_of(
    store: Store,
    words: Callable[[FloatArray], list[str]],
    present: Mapping[str, WorldObject],
    start: float,
    individual: Callable[[str], str] = str,
) -> dict[str, PlaceCourse]:
    """Of all that is no person and was there since `start`, s, or since what `MOST` rows tell.

    present : what is known of now. individual : the newest id of an object by one that it had.
    """
    names, rows, start = store.happened(start, MOST, PERSON)
    things = (item for item in present.values() if item.most_probable("class") != PERSON)
    by_name: dict[str, list[Sight]] = {individual(item.id): [] for item in things}
    by_key: dict[int, list[Sight]] = {}
    for key, *row in rows:
        by_key.setdefault(key, []).append(tuple(row))  # type: ignore[arg-type]
    for key, found in by_key.items():
        by_name.setdefault(individual(names[key]), []).extend(found)
    return courses_of_rows(store, by_name, words, present, start)


def courses_of_rows(
    store: Store,
    rows: Mapping[str, list[Sight]],
    words: Callable[[FloatArray], list[str]],
    present: Mapping[str, WorldObject],
    start: float,
) -> dict[str, PlaceCourse]:
    """The courses of objects by name from their rows since `start`, s, and where they were before that."""
    epoch, known = store.newest()[0], {}
    for name, found in rows.items():
        found = sorted(found, key=lambda row: row[0])
        if not found or found[0][0] > start:
            before = store.sights(name, epoch, end=start, most=1)
            found = [(start, *row[1:6]) for row in before] + found
        if found:
            known[name] = found
    positions = b"".join(row[2] for found in known.values() for row in found)
    said = iter(words(np.frombuffer(positions, "<f8").reshape(-1, 3)))
    courses = {}
    for name, found in known.items():
        places = [place if is_there(row) else None for row, place in zip(found, said, strict=False)]
        item = present.get(name)
        seen = item.last_seen if item is not None else max(row[5] for row in found)
        courses[name] = PlaceCourse.of([row[0] for row in found], places, seen)
    return courses


def routines_of(courses: Mapping[str, PlaceCourse], start: float, now: float, days: int) -> Routines:
    """What so many days of history since `start`, s, teach."""
    config = RoutinesConfig(days=days)
    begun = min((float(course.stamps[0]) for course in courses.values()), default=now)
    first = math.floor(max(start, begun) / config.slot)
    last = math.floor(now / config.slot)
    names = list(
        dict.fromkeys(place for course in courses.values() for place in course.places if place is not None)
    )
    number = {name: index for index, name in enumerate(names)}
    moves, things = 0, []
    for name, course in courses.items():
        runs = [[first, first, -1, -1]]
        for stamp, place in zip(course.stamps.tolist(), course.places, strict=True):
            # What has gone is still there in the slot in which it went.
            slot = math.floor(stamp / config.slot) + (place is None)
            before = runs[-1][2] if runs[-1][2] >= 0 else runs[-1][3]
            row = [max(slot, first), slot, -1 if place is None else number[place], before]
            moves += place is not None and row[0] > first and row[3] not in (-1, row[2])
            if runs[-1][0] == row[0]:
                runs.pop()
            runs.append(row)
        things.append({"name": name, "seen": course.seen, "stays": runs})
    data = {
        "format": FORMAT, "version": VERSION, "config": config.__dict__, "stamp": now, "first": first, "last": last,
        "moves": float(moves), "exposure": float(len(courses) * (last - first)), "places": dict.fromkeys(names),
        "objects": things,
    }  # fmt: skip
    return Routines.from_dict(data)


def days_moved(course: PlaceCourse) -> list[int]:
    """The days, UTC, on which a thing was found at another place than before, oldest first."""
    there = [
        (stamp, place)
        for stamp, place in zip(course.stamps.tolist(), course.places, strict=True)
        if place is not None
    ]
    days = [int(now // DAY) for (_, was), (now, place) in itertools.pairwise(there) if place != was]
    return list(dict.fromkeys(days))

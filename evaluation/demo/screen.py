"""The first screen of every report: one picture with a slider of time, and four questions that it answers.

Where is it, who is there, what is where, what happened: all of it is data in the page, drawn by the page itself, so
that text is text, and nothing is fetched from anywhere.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.places import Place, Places
from whereabouts.console.shown import map_picture
from world_model import WorldObject

Array = NDArray[np.float64]
HERE, LOST, GONE = "here", "lost", "gone"
BELIEVED = 0.5
"""What less probably exists counts for nothing."""
NOBODY = ("person", "other")
"""Classes of what moves by itself; it comes by `targets` and is shown and judged as that."""
MARGIN = 0.4
"""m around what is shown."""


@dataclass(frozen=True)
class KnownThing:
    """What was known of a thing from `stamp`, s, on. name : "red cup". state : HERE, LOST or GONE. place : "on the
    counter", "" for none. seen : s, its last measurement."""

    stamp: float
    name: str
    position: Array
    probability: float
    state: str
    place: str
    seen: float

    def is_news(self, before: KnownThing) -> bool:
        """Whether it says something else than `before`, but for how long ago that was."""
        said, then = (self.name, self.state, self.place), (before.name, before.state, before.place)
        moved = bool(np.abs(self.position[:2] - before.position[:2]).max() > 0.05)
        seen = self.seen - before.seen > 2.0 or abs(self.probability - before.probability) > 0.05
        return said != then or moved or seen


@dataclass
class Screen:
    """Everything that the first screen tells; stamps in s, positions in m, in the map.

    days : whether times are told as days and hours, else as minutes since the beginning. robot : (stamp, x, y, yaw).
    people : by label, (stamp, x, y, out of sight, nobody is there). true_people : (stamp, positions). goals : (from,
    to, x, y, what for). events : (stamp, sentence, id of the thing or ""). fresh : s for which a person is shown.
    """

    begin: float
    end: float
    places: Places
    days: bool = False
    robot: list[tuple[float, float, float, float]] = field(default_factory=list)
    people: dict[str, list[tuple[float, float, float, bool, bool]]] = field(default_factory=dict)
    things: dict[str, list[KnownThing]] = field(default_factory=dict)
    true_things: dict[str, list[tuple[float, Array | None]]] = field(default_factory=dict)
    true_people: list[tuple[float, Array]] = field(default_factory=list)
    goals: list[tuple[float, float, float, float, str]] = field(default_factory=list)
    events: list[tuple[float, str, str]] = field(default_factory=list)
    cells: NDArray[np.int8] | None = None
    extent: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    chosen: str = ""
    fresh: float = 1.0
    nobody: str = "Nobody that the robot knows of."
    nothing: str = "Nothing is known yet."

    def note(self, object_id: str, known: KnownThing) -> None:
        """What is known of a thing now, kept where it is news."""
        rows = self.things.setdefault(object_id, [])
        if not rows or known.is_news(rows[-1]):
            rows.append(known)

    def take(
        self, stamp: float, objects: Iterable[WorldObject], place_of: Callable[[WorldObject], str]
    ) -> None:
        """What is known of every thing at a moment. place_of : the name of the place it is at, "" for none."""
        here = {item.id: item for item in objects if item.most_probable("class") not in NOBODY}
        for own, item in here.items():
            before = self.things.get(own)
            gone = item.existence < BELIEVED
            if gone and not before:
                continue
            place, spot = at_place(self.places, place_of(item)), item.position
            if item.lost and before:  # the place is where it was
                place, spot = before[-1].place, before[-1].position
            state = GONE if gone else LOST if item.lost else HERE
            probability, seen = item.existence, item.last_seen
            if self.days:
                # Every look says that it was seen again: told once in an hour.
                probability = round(probability, 1)
                seen = before[-1].seen if before and seen - before[-1].seen < 3600.0 else seen
            self.note(own, KnownThing(stamp, called(item), spot, probability, state, place, seen))
        for own, rows in self.things.items():
            if own not in here and rows[-1].state != GONE:
                rows.append(replace(rows[-1], stamp=stamp, probability=0.0, state=GONE))

    def tell_things(self) -> None:
        """Events for what was found, moved and lost, from what was known."""
        for object_id, rows in self.things.items():
            for before, row in zip([None, *rows], rows, strict=False):
                sentence = _news(before, row)
                if sentence:
                    self.events.append((row.stamp, sentence, object_id))
        self.events.sort(key=lambda event: event[0])

    def html(self) -> str:
        """The section of the page."""
        page = (files("evaluation.demo") / "screen.html").read_text(encoding="utf-8")
        # Names come from detectors: nothing in them may end the script.
        text = json.dumps(self._data(), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        return page.replace("DATA", text, 1)

    def _data(self) -> dict[str, Any]:
        rooms = [_outline(place) for place in self.places if place.kind == "room"]
        furniture = [_outline(place) for place in self.places if place.kind != "room"]
        return {
            "begin": self.begin, "end": self.end, "days": self.days, "fresh": self.fresh,
            "box": self._box(), "map": self._map(), "rooms": rooms, "furniture": furniture,
            "robot": [_rounded(row) for row in self.robot],
            "people": {
                label: [[*_rounded(row[:3]), int(row[3]), int(row[4])] for row in rows]
                for label, rows in self.people.items()
            },
            "things": {name: [_row(row) for row in rows] for name, rows in self.things.items()},
            "true_things": {
                name: [[round(at, 2), *([None, None] if spot is None else _rounded(spot[:2]))] for at, spot in rows]
                for name, rows in self.true_things.items()
            },
            "true_people": [[round(at, 2), np.round(spots, 2).tolist()] for at, spots in self.true_people],
            "goals": [[*_rounded(goal[:4]), goal[4]] for goal in self.goals],
            "events": [[round(at, 2), text, name] for at, text, name in self.events],
            "chosen": self.chosen, "nobody": self.nobody, "nothing": self.nothing,
        }  # fmt: skip

    def _map(self) -> dict[str, Any] | None:
        if self.cells is None:
            return None
        x0, x1, y0, _ = self.extent
        size = (x1 - x0) / self.cells.shape[1]
        picture, box = map_picture(self.cells, size, x0, y0)
        return {"src": "data:image/png;base64," + base64.b64encode(picture).decode(), "box": box}

    def _box(self) -> list[float]:
        """x0, x1, y0, y1 around all that is shown; of a map what is known of it."""
        spots = [place.polygon for place in self.places]
        spots += [np.array([row[1:3] for row in self.robot]).reshape(-1, 2)]
        if self.cells is not None and (self.cells >= 0).any():
            rows, columns = np.nonzero(self.cells >= 0)
            x0, x1, y0, y1 = self.extent
            high, wide = self.cells.shape
            ends = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])
            spots.append(np.array([x0, y0]) + ends * [(x1 - x0) / wide, (y1 - y0) / high])
        spots += [row.position[None, :2] for rows in self.things.values() for row in rows]
        given = np.vstack(spots) if spots else np.zeros((0, 2))
        low, high = (given.min(0), given.max(0)) if len(given) else (np.zeros(2), np.ones(2))
        return _rounded((low[0] - MARGIN, high[0] + MARGIN, low[1] - MARGIN, high[1] + MARGIN))


def _news(before: KnownThing | None, row: KnownThing) -> str:
    """A sentence about a thing, "" where nothing happened to it."""
    if before is None or before.state == GONE:
        return f"found the {row.name}{' ' if row.place else ''}{row.place}" if row.state == HERE else ""
    if row.state == LOST and before.state == HERE:
        return f"the {before.name} is no longer {before.place or 'where it was'}"
    if row.state == HERE and before.state == LOST:
        return f"found the {row.name} again{', ' if row.place else ''}{row.place}"
    if row.state == HERE and row.place != before.place and row.place:
        moved = float(np.linalg.norm(row.position[:2] - before.position[:2]))
        return f"the {row.name} is {row.place} now" if moved > 0.5 else ""
    return ""


def _outline(place: Place) -> dict[str, Any]:
    return {
        "name": place.name.replace("_", " "),
        "polygon": np.round(place.polygon, 2).tolist(),
        "middle": _rounded(place.center),
    }


def _row(row: KnownThing) -> list[object]:
    x, y = _rounded(row.position[:2])
    return [
        round(row.stamp, 2),
        row.name,
        x,
        y,
        round(row.probability, 2),
        row.state,
        row.place,
        round(row.seen, 2),
    ]


def _rounded(values: Iterable[float]) -> list[float]:
    return [round(float(value), 2) for value in values]


def called(item: WorldObject) -> str:
    """ "red cup"."""
    color = item.most_probable("color")
    likely = item.attributes.get("color", {}).get(color, 0.0) >= BELIEVED
    return f"{color if likely else ''} {item.most_probable('class')}".strip() or item.id


def place_around(places: Places, position: Array) -> str:
    """Name of the smallest place around a position (3,), furniture before rooms; "" for none."""
    around = [place for place in places if place.contains(position)]
    return min(around, key=lambda place: (place.kind == "room", place.area)).name if around else ""


def at_place(places: Places, name: str) -> str:
    """ "on the counter"; the name where no place is called so, "" for none."""
    if not name:
        return ""
    if name not in places:
        return name.replace("_", " ")
    return f"{places[name].preposition} the {name.replace('_', ' ')}"


def thinned(stamps: Iterable[float], period: float) -> list[float]:
    """Of these stamps some that lie at least a period apart, the last one among them."""
    kept: list[float] = []
    ordered = sorted(stamps)
    for stamp in ordered:
        if not kept or stamp - kept[-1] >= period - 1e-6:
            kept.append(stamp)
    return kept if not ordered or kept[-1] == ordered[-1] else [*kept, ordered[-1]]

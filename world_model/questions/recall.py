"""What questions are answered from: the present, and for each object the stays that its history is made of."""

from __future__ import annotations

import math
import re
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from estimation.places import Place, Places
from world_model.state import WorldObject
from world_model.store import Store
from world_model.symbols import Symbols, default_symbols, parse_symbol

if TYPE_CHECKING:
    from world_model.world import WorldModel

PERSON = "person"
APART = 0.5
"""m: so far from where it was something has been moved, where no other place says so."""
AWAY = 900.0
"""s: what was missing for longer and is back began another stay."""
BELIEVED = 0.5
"""Existence below which something is not told of as being there."""
LOOKS_ALIKE = 0.6
"""Overlap of the distributions of all attributes from which on two objects can be taken for each other."""
DAY = 86400.0
PRIOR_MOVES, PRIOR_TIME = 0.5, 2.0 * DAY
"""What is taken to be known of the rate of moves of anything."""
BACK_AGAIN = 0.25
"""Share of moves between two looks that lead back before the second."""
KEPT = 256


@dataclass(frozen=True)
class Stay:
    """An object at one place. place : name, "" where no place is named. came_after, since : between these it came.
    until, left_by : between these it went, None while it is there. position : (3,) m. p : of the place, where it was.
    gone : it was then out of the world, or lost, before it was seen anywhere else."""

    place: str
    came_after: float
    since: float
    until: float
    left_by: float | None
    position: FloatArray
    gone: bool = False
    seen: int = 1


@dataclass(frozen=True)
class Timeline:
    """The stays of one object, oldest first. lost : nobody knows where it is now."""

    id: str
    stays: tuple[Stay, ...]
    lost: bool

    @property
    def rate(self) -> float:
        """1/s, at which it moves, with what is known of anything."""
        if not self.stays:
            return PRIOR_MOVES / PRIOR_TIME
        known = self.stays[-1].until - self.stays[0].since
        return (len(self.stays) - 1 + PRIOR_MOVES) / (known + PRIOR_TIME)

    def at(self, stamp: float) -> tuple[dict[str, float], Stay | None]:
        """Probability by place at a moment, and the stay that is most probable; {} before it was first seen.

        Between two looks that found it at different places it may have gone at any moment; what is not told for is
        that nobody knows.
        """
        index = self._index(stamp)
        if index < 0:
            return {}, None
        stay = self.stays[index]
        if stamp <= stay.until:
            return {stay.place: 1.0 - self._doubt(stay)}, stay
        after = self.stays[index + 1] if index + 1 < len(self.stays) else None
        if after is None:
            return self._later(stay, stamp)
        left = after.since if stay.left_by is None else min(stay.left_by, after.since)
        gap = max(left - stay.until, 1e-6)
        stays_yet = max(1.0 - (stamp - stay.until) / gap, 0.0)
        known = max((stamp - left) / max(after.since - left, 1e-6), 0.0) if stay.gone else 1.0
        there = (1.0 - stays_yet) * (1.0 if not stay.gone else 0.3 + 0.6 * min(known, 1.0))
        chances = {stay.place: stays_yet}
        chances[after.place] = chances.get(after.place, 0.0) + there
        return chances, stay if stays_yet >= there else after

    def _doubt(self, stay: Stay) -> float:
        """That it was elsewhere for a while during a stay, and nobody saw."""
        gap = (stay.until - stay.since) / max(stay.seen - 1, 1)
        return min(BACK_AGAIN * (1.0 - math.exp(-self.rate * gap)), 0.3)

    def _later(self, stay: Stay, stamp: float) -> tuple[dict[str, float], Stay]:
        if stay.left_by is not None and stamp >= stay.left_by:
            return {}, stay
        if stay.left_by is not None:
            share = 1.0 - (stamp - stay.until) / max(stay.left_by - stay.until, 1e-6)
            return {stay.place: max(share, 0.0)}, stay
        return {stay.place: math.exp(-self.rate * (stamp - stay.until))}, stay

    def _index(self, stamp: float) -> int:
        return int(np.searchsorted([stay.since for stay in self.stays], stamp, side="right")) - 1

    def shares(self, start: float, end: float) -> dict[str, float]:
        """Share of the known time between two moments that it was at each place."""
        spent: dict[str, float] = {}
        for stay, after in zip(self.stays, [*self.stays[1:], None], strict=True):
            until = stay.until if stay.gone or after is None else 0.5 * (stay.until + after.since)
            if stay.left_by is None and after is None:
                until = end
            long = min(until, end) - max(stay.since, start)
            if long > 0.0:
                spent[stay.place] = spent.get(stay.place, 0.0) + long
        total = sum(spent.values())
        return {place: seconds / total for place, seconds in spent.items()} if total > 0.0 else {}


@dataclass
class Recall:
    """The world as a store or a model remembers it, for questions.

    now : s, the newest moment that is known. epoch : the run. present : objects by id. places, symbols : its words.
    """

    now: float
    epoch: int
    present: dict[str, WorldObject]
    places: Places
    symbols: Symbols
    store: Store | None = None
    sequence: int = -1
    _timelines: OrderedDict[tuple[str, int], Timeline] = field(default_factory=OrderedDict, repr=False)
    kept: dict[str, object] = field(default_factory=dict, repr=False)

    @classmethod
    def of_store(cls, store: Store, places: Places | None = None, symbols: Symbols | None = None) -> Recall:
        """As the file says now. places, symbols : words that differ from those of the store, and the shipped ones."""
        epoch, stamp, sequence = store.newest()
        present = {item.id: item for item in store.present()}
        now = stamp if stamp is not None else max((item.last_seen for item in present.values()), default=0.0)
        here = places if places else store.places()
        return cls(now, epoch, present, here, symbols or default_symbols(), store, sequence)

    @classmethod
    def of_model(cls, model: WorldModel) -> Recall:
        """As a model believes; the past from its store, where it has one."""
        now = model.stamp if math.isfinite(model.stamp) else 0.0
        objects = model.propagate(now).objects if math.isfinite(model.stamp) else ()
        places = model.places or (model.store.places() if model.store is not None else Places())
        present = {item.id: item for item in objects}
        return cls(now, model.epoch, present, places, model.words.symbols, model.store)

    @cached_property
    def epochs(self) -> dict[str, int]:
        """The newest run of every object that was ever known."""
        known = {} if self.store is None else self.store.names()
        return known | dict.fromkeys(self.present, self.epoch)

    def kind(self, object_id: str) -> str:
        """Most probable class of an object, also of one that is no longer there."""
        item = self.present.get(object_id)
        if item is not None:
            return item.most_probable("class")
        parsed = parse_symbol(object_id)
        if parsed is not None:
            return parsed[0]
        seen = self.item(object_id)
        return seen.most_probable("class") if seen is not None else ""

    def item(self, object_id: str) -> WorldObject | None:
        """An object as it was known last."""
        known = self.present.get(object_id)
        if known is None and self.store is not None and object_id in self.epochs:
            return self.store.look(object_id, self.epochs[object_id])
        return known

    def things(self) -> list[str]:
        """Ids of all that is no person, of this run."""
        return [
            name for name, epoch in self.epochs.items() if epoch == self.epoch and self.kind(name) != PERSON
        ]

    def timeline(self, object_id: str, epoch: int | None = None) -> Timeline:
        """The stays of an object, {} where it is unknown."""
        run = self.epochs.get(object_id, self.epoch) if epoch is None else epoch
        key = (object_id, run)
        if key not in self._timelines:
            self._timelines[key] = self._read(object_id, run)
            if len(self._timelines) > KEPT:
                self._timelines.popitem(last=False)
        return self._timelines[key]

    def _read(self, object_id: str, run: int) -> Timeline:
        item = self.present.get(object_id) if run == self.epoch else None
        rows = [] if self.store is None else self.store.sights(object_id, run)
        stamps = [row[0] for row in rows]
        here = [row[1] != "gone" and not row[4] and row[3] >= BELIEVED for row in rows]
        seen = [row[5] for row in rows]
        numbers = np.frombuffer(b"".join(row[2] for row in rows), "<f8").reshape(-1, 24)
        positions = numbers[:, :3]
        if item is not None:
            stamps.append(max(self.now, stamps[-1]) if stamps else self.now)
            here.append(not item.lost and item.existence >= BELIEVED)
            seen.append(item.last_seen)
            positions = np.vstack([positions, item.position[None]])
        if not rows and item is not None:  # no history: all that is known is the present
            stamps, here, seen = [item.first_seen, *stamps], [True, *here], [item.first_seen, *seen]
            positions = np.vstack([positions[:1], positions])
        words = self.words(positions)
        stays = _stays(stamps, here, seen, positions, words)
        return Timeline(object_id, stays, not here[-1] if here else True)

    def words(self, positions: FloatArray) -> list[str]:
        """Name of the place around each position (N, 3): the smallest piece of furniture, or room."""
        return _words(self.places, positions)

    def place_probability(self, item: WorldObject, place: str) -> float:
        """That an object which exists, and is where it was measured, is at a place."""
        if place not in self.places:
            return 1.0
        return self.places[place].probability(item.position, item.covariance)

    def contains(self, outer: str, inner: str) -> bool:
        """Whether a place is, or lies in, another."""
        if outer == inner:
            return True
        if outer not in self.places or inner not in self.places:
            return False
        within, around = self.places[inner], self.places[outer]
        if around.kind != "room" or within.kind == "room":
            return False
        return bool(around.contains(within.center))

    def alike(self, object_id: str) -> list[str]:
        """Other present objects that cannot be told from one by what they look like."""
        mine = self.present.get(object_id)
        if mine is None:
            return []
        others = (
            item for item in self.present.values() if item.id != object_id and item.existence >= BELIEVED
        )
        return [item.id for item in others if likeness(mine.attributes, item.attributes) >= LOOKS_ALIKE]


def likeness(mine: Mapping[str, Mapping[str, float]], others: Mapping[str, Mapping[str, float]]) -> float:
    """Product over the attributes both have of the overlap (Bhattacharyya) of their distributions, in [0, 1]."""
    product = 1.0
    for name in mine.keys() & others.keys():
        product *= sum(math.sqrt(p * others[name].get(value, 0.0)) for value, p in mine[name].items())
    return product


def _words(places: Places, positions: FloatArray) -> list[str]:
    found = [""] * len(positions)
    ordered: Iterable[Place] = sorted(places, key=lambda place: (place.kind != "room", -place.area))
    for place in ordered:
        for index in np.flatnonzero(place.contains(positions)) if len(positions) else ():
            found[int(index)] = place.name
    return found


def _stays(
    stamps: list[float], here: list[bool], seen: list[float], positions: FloatArray, words: list[str]
) -> tuple[Stay, ...]:
    """Rows of history joined where an object is still at the same place."""
    stays: list[Stay] = []
    for stamp, is_here, last, position, word in zip(stamps, here, seen, positions, words, strict=True):
        current = stays[-1] if stays else None
        if not is_here:
            if current is not None and current.left_by is None:
                # A measurement up to here still found it there.
                until = min(max(current.until, last), stamp)
                stays[-1] = replace(current, until=until, left_by=stamp, gone=True)
            continue
        same = current is not None and current.place == word
        if same and (not word or (current is not None and current.gone)):
            assert current is not None
            same = bool(np.linalg.norm(position[:2] - current.position[:2]) < APART)
        if same and current is not None and current.left_by is not None:
            same = stamp - current.left_by < AWAY
        if same and current is not None:
            stays[-1] = replace(
                current,
                until=max(current.until, min(last, stamp)),
                left_by=None,
                gone=False,
                seen=current.seen + 1,
            )
            continue
        after = current.until if current is not None else -math.inf
        since = min(last, stamp) if last > after else stamp
        stays.append(Stay(word, after, since, max(since, min(last, stamp)), None, position))
    return tuple(stays)


def recall(source: object, places: Places | None = None, symbols: Symbols | None = None) -> Recall:
    """What a `Store` or a `WorldModel` knows. places, symbols : in place of those that the store knows.

    Raises InputError for anything else.
    """
    if isinstance(source, Recall):
        return source
    if isinstance(source, Store):
        kept = source.recalled
        if isinstance(kept, Recall) and kept.sequence == source.newest()[2] and not places and not symbols:
            return kept
        made = Recall.of_store(source, places, symbols)
        source.recalled = None if places or symbols else made
        return made
    if hasattr(source, "propagate") and hasattr(source, "words"):
        return Recall.of_model(source)  # type: ignore[arg-type]
    raise InputError(f"a Store, its path or a WorldModel is asked, not {type(source).__name__}")


_SINGULAR = ((r"(ss|x|ch|sh)es$", r"\1"), (r"ies$", "y"), (r"ves$", "f"), (r"([^s])s$", r"\1"))


def singulars(word: str) -> list[str]:
    """A word and what it may be the plural of."""
    return list(dict.fromkeys([word, *(re.sub(a, b, word) for a, b in _SINGULAR)], None))

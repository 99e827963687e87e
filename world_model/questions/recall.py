"""What questions are answered from: the present, and for each object the stays that its history is made of."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, wraps
from types import NoneType
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar

import numpy as np

from estimation.checks import require_kind
from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model.memory.stays import APART, AWAY, MOST, PlaceWords, Timeline, timeline_of
from world_model.memory.store import Store
from world_model.memory.store_records import Sight
from world_model.state import BELIEVED, DAY, PERSON, WorldObject
from world_model.symbols import Symbols, default_symbols, parse_symbol

if TYPE_CHECKING:
    from world_model.model import WorldModel

P = ParamSpec("P")
T = TypeVar("T")
LOOKS_ALIKE = 0.6
"""Overlap of the distributions of all attributes from which on two objects can be taken for each other."""
LATELY = 3.0 * DAY  # s: of the past that a question about the present reads first
LONGER = 8.0  # times as much it reads next
RECENT = 60  # Objects of a class that ended last, among which doubles are looked for
AROUND = 1.5 * DAY  # s: of the history that says where something was at a moment
SAME = 0.93  # That what looks like something that went, and came since, is the same
WEEK = 7.0 * DAY  # s: what was away for longer is another one


class Trust:
    """Probabilities that an answer is right, rounded from the first households of `experiment questions`."""

    SEEN = 0.97  # it says what was seen, moved or changed
    NOT_SEEN = 0.9  # it says that something was not, as nobody saw it
    EACH = 0.99  # factor for each thing that it lists
    PROBABLY = 0.7  # it says what is rather so than not
    TWIN = 0.85  # of two that look alike it is this one, which were never both out of sight while both moved
    NAMED = 0.02  # least of a place or a thing that is told of beside others


class Life(NamedTuple):
    """One id: when it was first and last seen, s, whether it has ended, and what it looks like."""

    id: str
    first: float
    last: float
    ended: bool
    attributes: Mapping[str, Mapping[str, float]]


def remembered(made: Callable[P, T]) -> Callable[P, T]:
    """A function of a `Recall`, and of what can be a key, that is asked once as long as nothing new is known."""

    @wraps(made)
    def once(*given: P.args, **named: P.kwargs) -> T:
        world, *rest = given
        assert isinstance(world, Recall)
        key = (made.__qualname__, *rest, *named.items())
        if key not in world.kept:
            world.kept[key] = made(*given, **named)
        return world.kept[key]

    return once


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
    kept: dict[tuple[Any, ...], Any] = field(default_factory=dict, repr=False)

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
        places = model.places or (model.store.places() if model.store is not None else Places())
        present = {item.id: item for item in model.world.objects}
        return cls(now, model.epoch, present, places, model.words.symbols, model.store)

    @property
    def damage(self) -> str:
        """What is wrong with the file that is read, a sentence; "" while all is well, or was put right."""
        return self.store.damages[0] if self.store and self.store.read_only and self.store.damages else ""

    def is_now(self, stamp: float) -> bool:
        """Whether a moment is no earlier than a second before the newest that is known."""
        return stamp >= self.now - 1.0

    @cached_property
    def epochs(self) -> dict[str, int]:
        """The newest run of every object that was ever known."""
        known = {} if self.store is None else self.store.names()
        return known | dict.fromkeys(self.present, self.epoch)

    def kind(self, object_id: str) -> str:
        """Most probable class of an object, also of one that is no longer there."""
        parsed = None if object_id in self.present else parse_symbol(object_id)
        return self.likely_kind(object_id) if parsed is None else parsed[0]

    def likely_kind(self, object_id: str) -> str:
        """Most probable class of an object as it was known last, whatever its id says."""
        item = self.item(object_id)
        return "" if item is None else item.most_probable("class")

    def item(self, object_id: str) -> WorldObject | None:
        """An object as it was known last."""
        known = self.present.get(object_id)
        if known is None and self.store is not None and object_id in self.epochs:
            return self.store.look(object_id, self.epochs[object_id])
        return known

    def things(self) -> list[str]:
        """Ids of all that is no person, of this run."""
        people = f"{PERSON}-"
        return self.heads(
            name
            for name, epoch in self.epochs.items()
            if epoch == self.epoch and (name in self.present or not name.startswith(people))
        )

    def heads(self, names: Iterable[str]) -> list[str]:
        """Those of them that are no people, each by its newest id."""
        return list(dict.fromkeys(self.individual(name)[0] for name in names if self.kind(name) != PERSON))

    def individual(self, object_id: str) -> tuple[str, float]:
        """The newest id of an object, and how probably that is the same one.

        What was carried out of sight may have another id where it is found again: what looks like something that went,
        and came since, is taken for it.
        """
        links = self._links(self.kind(object_id))
        certain = 1.0
        while object_id in links:
            object_id, share = links[object_id]
            certain *= share
        return object_id, certain

    @remembered
    def _links(self, kind: str) -> dict[str, tuple[str, float]]:
        """For ids of a class that ended the id that goes on, with its probability.

        What ended where another one like it is from then on was that one, with an id of its own for a while.
        """
        lives, links = self._lives(kind), dict(self._successors(kind))
        doubles: dict[str, tuple[str, float]] = {}
        for life in [each for each in lives if each.ended and each.id not in links][-RECENT:]:
            stays = self._read(life.id, self.epoch).stays
            for other in lives if stays else ():
                if other.id == life.id or other.id in doubles or not other.first <= life.last <= other.last:
                    continue
                if likeness(life.attributes, other.attributes) < LOOKS_ALIKE:
                    continue
                there = self._read(other.id, self.epoch, stays[-1].since - AWAY, stays[-1].until + AWAY).stays
                spot = stays[-1].position[:2]
                if any(np.linalg.norm(stay.position[:2] - spot) < APART for stay in there):
                    doubles[life.id] = (other.id, SAME)
                    break
        return links | doubles

    @remembered
    def _successors(self, kind: str) -> dict[str, tuple[str, float]]:
        return _followed(self._lives(kind))

    @remembered
    def _lives(self, kind: str) -> list[Life]:
        """Of all ids of a class, in order of their beginning; of people, who look alike, none."""
        lives = []
        for name, first, last, text in self.store.lives(f"{kind}-") if self.store and kind != PERSON else ():
            item = self.present.get(name)
            ended = item is None or item.lost
            if last - first > 0.0 or not ended:
                lives.append(Life(name, first, last, ended, _attributes(text)))
        return sorted(lives, key=lambda life: life.first)

    def names_of(self, object_id: str) -> list[str]:
        """The newest id of an object, then its earlier ones."""
        names = [self.individual(object_id)[0]]
        previous = {after: name for name, (after, _) in self._successors(self.kind(names[0])).items()}
        while names[-1] in previous:
            names.append(previous[names[-1]])
        return names

    @remembered
    def line(
        self, object_id: str, start: float = -math.inf, end: float = math.inf, coarse: bool = False
    ) -> Timeline:
        """Where an object was between two moments, s, some time around them and from where it was seen last before;
        with what it did under its earlier ids in this run. coarse : as of `timeline_of`; up to now."""
        run = self.epochs.get(object_id, self.epoch)
        if run != self.epoch:
            return self._read(object_id, run)
        until = math.inf if end + AROUND >= self.now else end + AROUND
        name, *earlier = self.names_of(object_id)
        line = self._read(name, run, start - AROUND, until, coarse)
        for before in earlier:
            if line.stays and line.stays[0].since <= start:
                return replace(line, cut=True)
            line = line.after(self._read(before, run, start - AROUND, until, coarse))
        return line

    def latest(self, object_id: str, start: float = -math.inf, end: float = math.inf) -> Timeline:
        """The newest part of an object's timeline before `end`, with a stay where there is one since `start`: what a
        question about the present needs, however long it is known."""
        for line in self.back(object_id, start, end):
            if line.stays:
                break
        return line

    def back(self, object_id: str, start: float = -math.inf, end: float = math.inf) -> Iterator[Timeline]:
        """The part of an object's timeline before `end`, then longer and longer ones, until all since `start` is there:
        what is looked for is most often found in the first."""
        long, last = LATELY, min(end, self.now)
        while True:
            line = self.line(object_id, max(start, last - long), end)
            yield line
            if not line.cut or last - long <= start:
                return
            long *= LONGER

    def has_changed(self, object_id: str) -> bool:
        """Whether an object looks otherwise than when it was first seen: others may have changed places with it."""
        item, first = self.present.get(object_id), self._first_look(object_id)
        if item is None or first is None:
            return False
        return likeness(first.attributes, item.attributes) < LOOKS_ALIKE

    def took_over(self, object_id: str) -> str:
        """What looks now as an object did that has changed, "" where there is none."""
        alike = [
            item.id for item in self._looking_as(self._first_look(object_id), object_id) if not item.lost
        ]
        return alike[0] if len(alike) == 1 else ""

    def _first_look(self, object_id: str) -> WorldObject | None:
        return None if self.store is None else self.store.look(object_id, self.epoch, first=True)

    @remembered
    def active(self, start: float, end: float) -> list[str]:
        """Objects of this run of which anything is known between two moments."""
        return list(self.present) if self.store is None else self.store.active(start, end)

    def departed(self, ago: float) -> list[str]:
        """Objects that went from where they were no longer than `ago` s before now."""
        return [] if self.store is None else self.store.departed(self.now - ago)

    def _read(
        self,
        object_id: str,
        run: int,
        start: float = -math.inf,
        end: float = math.inf,
        coarse: bool = False,
    ) -> Timeline:
        """The stays of one id in a run."""
        item = self.present.get(object_id) if run == self.epoch and end >= self.now else None
        rows: list[Sight] = []
        if self.store is not None:
            swept, start = self._happened(start) if coarse else ({}, start)
            rows = self.store.sights(object_id, run, start, start if coarse else end)
            rows = rows + swept.get(object_id, [])
        return timeline_of(object_id, rows, self.words, item, self.now, start, coarse)

    @remembered
    def _happened(self, start: float) -> tuple[dict[str, list[Sight]], float]:
        assert self.store is not None
        return self.store.happened(start, MOST)

    @cached_property
    def words(self) -> PlaceWords:
        """Says the name of the place around each position (N, 3): the smallest piece of furniture, or room."""
        return PlaceWords(self.places)

    def place_probability(self, item: WorldObject, place: str) -> float:
        """That an object which exists, and is where it was measured, is at a place."""
        if place not in self.places:
            return 1.0
        return self.places[place].probability(item.position, item.covariance)

    def contains(self, outer: str, inner: str) -> bool:
        """Whether a place is, or lies in, another; "" is everywhere."""
        if not outer or outer == inner:
            return True
        if outer not in self.places or inner not in self.places:
            return False
        within, around = self.places[inner], self.places[outer]
        if around.kind != "room" or within.kind == "room":
            return False
        return bool(around.contains(within.center))

    def rooms_of(self, place: str) -> list[str]:
        """Names of the rooms that a place is, or lies in."""
        return [each.name for each in self.places if each.kind == "room" and self.contains(each.name, place)]

    def inside(self, outer: str, by_place: Mapping[str, float]) -> float:
        """Sum of what is told of places that are, or lie in, another."""
        return sum(value for place, value in by_place.items() if self.contains(outer, place))

    def alike(self, object_id: str) -> list[str]:
        """Other present objects that cannot be told from one by what they look like."""
        alike = self._looking_as(self.present.get(object_id), object_id)
        return [item.id for item in alike if item.existence >= BELIEVED]

    def _looking_as(self, seen: WorldObject | None, apart_from: str) -> list[WorldObject]:
        """Present objects that look as one that was seen."""
        if seen is None:
            return []
        others = (item for item in self.present.values() if item.id != apart_from)
        return [item for item in others if likeness(seen.attributes, item.attributes) >= LOOKS_ALIKE]


_attributes = lru_cache(4096)(json.loads)


def _followed(lives: list[Life]) -> dict[str, tuple[str, float]]:
    """Each that begins with the one like it that ended last before that; lives in order of their beginning."""
    links: dict[str, tuple[str, float]] = {}
    open_ends: list[Life] = []
    for life in lives:
        open_ends = [each for each in open_ends if life.first - each.last < WEEK]
        fitting = [
            each
            for each in open_ends
            if each.last <= life.first and likeness(each.attributes, life.attributes) >= LOOKS_ALIKE
        ]
        if fitting:
            before = max(fitting, key=lambda each: each.last)
            recent = sum(before.last - each.last < DAY for each in fitting)
            links[before.id] = (life.id, SAME / recent)
            open_ends.remove(before)
        if life.ended:
            open_ends.append(life)
    return links


def ranked(shares: Mapping[str, float]) -> list[str]:
    """Names, that of the largest value first."""
    return sorted(shares, key=lambda name: -shares[name])


def likeness(mine: Mapping[str, Mapping[str, float]], others: Mapping[str, Mapping[str, float]]) -> float:
    """Product over the attributes both have of the overlap (Bhattacharyya) of their distributions, in [0, 1]."""
    product = 1.0
    for name in mine.keys() & others.keys():
        product *= sum(math.sqrt(p * others[name].get(value, 0.0)) for value, p in mine[name].items())
    return product


def recall(source: object, places: Places | None = None, symbols: Symbols | None = None) -> Recall:
    """What a `Store` or a `WorldModel` knows. places, symbols : in place of those that the store knows.

    Raises InputError for anything else.
    """
    require_kind("places", places, Places, NoneType)
    require_kind("symbols", symbols, Symbols, NoneType)
    if isinstance(source, Recall):
        return source
    if isinstance(source, Store):
        if places or symbols:
            return Recall.of_store(source, places, symbols)
        if not isinstance(source.recalled, Recall) or source.recalled.sequence != source.newest()[2]:
            source.recalled = Recall.of_store(source)
        return source.recalled
    if hasattr(source, "propagate") and hasattr(source, "words"):
        return Recall.of_model(source)  # type: ignore[arg-type]
    raise InputError(f"a Store, its path or a WorldModel is asked, not {type(source).__name__}")


_SINGULAR = ((r"(ss|x|ch|sh)es$", r"\1"), (r"ies$", "y"), (r"ves$", "f"), (r"([^s])s$", r"\1"))


def singulars(word: str) -> list[str]:
    """A word and what it may be the plural of."""
    return list(dict.fromkeys([word, *(re.sub(a, b, word) for a, b in _SINGULAR)], None))

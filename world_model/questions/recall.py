"""What questions are answered from: the present, and for each object the stays that its history is made of."""

from __future__ import annotations

import itertools
import json
import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, wraps
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model.memory.courses import PlaceWords, is_there, of_all
from world_model.memory.store import Store
from world_model.state import BELIEVED, DAY, PERSON, WorldObject
from world_model.symbols import Symbols, default_symbols, parse_symbol

if TYPE_CHECKING:
    from world_model.world import WorldModel

P = ParamSpec("P")
T = TypeVar("T")
APART = 0.5  # m: so far from where it was something has been moved, where no other place says so
AWAY = 900.0  # s: what was missing for longer and is back began another stay
LOOKS_ALIKE = 0.6
"""Overlap of the distributions of all attributes from which on two objects can be taken for each other."""
PRIOR_MOVES, PRIOR_TIME = 0.5, 2.0 * DAY  # What is taken to be known of the rate of moves of anything
BACK_AGAIN = 0.25  # Share of moves between two looks that lead back before the second
NEWEST = 400  # Rows of an object's history that a question about the present reads
RECENT = 60  # Objects of a class that ended last, among which doubles are looked for
AROUND = 1.5 * DAY  # s: of the history that says where something was at a moment
FOUND_AFTER = 1200.0  # s: what was missing is found about so long after it came back
SAME = 0.93  # That what looks like something that went, and came since, is the same
RETURNS = 7.0 * DAY  # s: what was away for longer is another one


class Trust:
    """Probabilities that an answer is right, rounded from the first households of `experiment questions`."""

    SEEN = 0.97  # it says what was seen
    CHANGED = 0.98  # it says all that changed
    STORY = 0.95  # it says when something was moved, or all that was done with it
    NOT_SEEN = 0.9  # it says that something was not, as nobody saw it
    EACH = 0.99  # factor for each thing that it lists
    NEAR_BY, NOBODY = 0.7, 0.6  # who was where something was moved had to do with it; that nobody had


@dataclass(frozen=True)
class ObjectStay:
    """An object at one place. place : name, "" where no place is named. came_after, since : between these it came.
    until, left_by : between these it was found to have gone, None where it was not missed before it was seen elsewhere.
    position : (3,) m. seen : how often it was seen."""

    place: str
    came_after: float
    since: float
    until: float
    left_by: float | None
    position: FloatArray
    seen: int = 1

    @property
    def gone(self) -> bool:
        """Whether it was out of the world, or lost, before it was seen anywhere else."""
        return self.left_by is not None


class Life(NamedTuple):
    """One id: when it was first and last seen, s, whether it has ended, and what it looks like."""

    id: str
    first: float
    last: float
    ended: bool
    attributes: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Timeline:
    """The stays of one object, oldest first. lost : nobody knows where it is now. cut : whether there is more of it,
    before these stays, that was not read."""

    id: str
    stays: tuple[ObjectStay, ...]
    lost: bool
    cut: bool = False

    @property
    def rate(self) -> float:
        """1/s, at which it moves, with what is known of anything."""
        if not self.stays:
            return PRIOR_MOVES / PRIOR_TIME
        known = self.stays[-1].until - self.stays[0].since
        return (len(self.stays) - 1 + PRIOR_MOVES) / (known + PRIOR_TIME)

    def at(self, stamp: float) -> tuple[dict[str, float], ObjectStay | None]:
        """Probability by place at a moment, and the stay that is most probable; {} before it was first seen.

        Between two looks that found it at different places it may have gone at any moment; what is not told for is
        that nobody knows.
        """
        index = bisect_right(self.stays, stamp, key=lambda stay: stay.since) - 1
        if index < 0:
            return {}, None
        stay = self.stays[index]
        if stamp <= stay.until:
            return {stay.place: 1.0 - self._doubt(stay)}, stay
        if index + 1 == len(self.stays):
            return self._later(stay, stamp), stay
        after = self.stays[index + 1]
        left = after.since if stay.left_by is None else min(stay.left_by, after.since)
        gap = max(left - stay.until, 1e-6)
        stays_yet = max(1.0 - (stamp - stay.until) / gap, 0.0)
        back = math.exp(-(after.since - stamp) / FOUND_AFTER) if stay.gone else 1.0
        there = (1.0 - stays_yet) * back
        chances = {stay.place: stays_yet}
        chances[after.place] = chances.get(after.place, 0.0) + there
        return chances, stay if stays_yet >= there else after

    def _doubt(self, stay: ObjectStay) -> float:
        """That it was elsewhere for a while during a stay, and nobody saw."""
        gap = (stay.until - stay.since) / max(stay.seen - 1, 1)
        return min(BACK_AGAIN * (1.0 - math.exp(-self.rate * gap)), 0.3)

    def _later(self, last: ObjectStay, stamp: float) -> dict[str, float]:
        """Probability by place after its last stay."""
        if last.left_by is None:
            return {last.place: math.exp(-self.rate * (stamp - last.until))}
        if stamp >= last.left_by:
            return {}
        share = 1.0 - (stamp - last.until) / max(last.left_by - last.until, 1e-6)
        return {last.place: max(share, 0.0)}

    def within(self, start: float, end: float) -> list[ObjectStay]:
        """The stays that overlap a span."""
        return [stay for stay in self.stays if stay.until >= start and stay.since <= end]

    def shares(self, start: float, end: float, absent: bool = False) -> dict[str, float]:
        """Share of the time between two moments that it was at each place.

        absent : of all the time since it was first seen, else of that in which it was anywhere.
        """
        return of_all(
            self.spent(start, end), end - max(start, self.stays[0].since) if absent and self.stays else 0.0
        )

    def spent(self, start: float, end: float) -> dict[str, float]:
        """s between two moments by place; of what passed between two stays half each."""
        spent: dict[str, float] = {}
        around = zip([None, *self.stays[:-1]], self.stays, [*self.stays[1:], None], strict=True)
        for before, stay, after in around:
            since = stay.since if before is None or before.gone else 0.5 * (before.until + stay.since)
            until = stay.until if stay.gone or after is None else 0.5 * (stay.until + after.since)
            if stay.left_by is None and after is None:
                until = end
            long = min(until, end) - max(since, start)
            if long > 0.0:
                spent[stay.place] = spent.get(stay.place, 0.0) + long
        return spent


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
    whole: dict[str, Timeline] = field(default_factory=dict, repr=False)

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
            stays = self.read(life.id, self.epoch).stays
            for other in lives if stays else ():
                if other.id == life.id or other.id in doubles or not other.first <= life.last <= other.last:
                    continue
                if likeness(life.attributes, other.attributes) < LOOKS_ALIKE:
                    continue
                there = self.read(other.id, self.epoch, stays[-1].since - AWAY, stays[-1].until + AWAY).stays
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

    def timeline(self, object_id: str) -> Timeline:
        """All stays of an object, in the newest run that knew it; with those of its earlier ids in this run."""
        run = self.epochs.get(object_id, self.epoch)
        if run != self.epoch:
            return self.read(object_id, run)
        name, *earlier = self.names_of(object_id)
        if name not in self.whole:
            line = self.read(name, run)
            for before in earlier:
                line = _joined(self.read(before, run), line)
            self.whole[name] = line
        return self.whole[name]

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

    def latest(self, object_id: str, most: int = NEWEST) -> Timeline:
        """The newest part of an object's timeline: what a question about the present needs, however long it is known.

        most : rows of history to read.
        """
        name = self.individual(object_id)[0]
        return self.whole.get(name) or self._latest(name, most)

    @remembered
    def _latest(self, name: str, most: int) -> Timeline:
        line = self.read(name, self.epoch, most=most)
        return line if line.cut and line.stays else self.timeline(name)

    def window(self, object_id: str, start: float, end: float = math.inf) -> Timeline:
        """The part of an object's timeline around a span of time, from where it was seen last before that on, with that
        of its earlier ids."""
        name, begin = self.individual(object_id)[0], start - AROUND
        if (
            name in self.whole
            or self.epochs.get(name, self.epoch) != self.epoch
            or not 0.0 <= begin < math.inf
        ):
            return self.timeline(name)
        return self._around(name, start, math.inf if end + AROUND >= self.now else end + AROUND)

    @remembered
    def _around(self, name: str, start: float, until: float) -> Timeline:
        known = self.read(name, self.epoch, start - AROUND, until)
        if not (known.stays and known.stays[0].since <= start) and self.store is not None:
            # It was not looked at for long before: from when it was seen last.
            earlier = self.store.sights(name, self.epoch, end=start - AROUND, most=1)
            known = self.read(name, self.epoch, earlier[0][0], until) if earlier else known
        for before in self.names_of(name)[1:]:
            if known.stays and known.stays[0].since <= start:
                break
            known = _joined(self.read(before, self.epoch, start - AROUND, until), known)
        return known

    @remembered
    def active(self, start: float, end: float) -> list[str]:
        """Objects of this run of which anything is known between two moments."""
        return list(self.present) if self.store is None else self.store.active(start, end)

    def departed(self, ago: float) -> list[str]:
        """Objects that went from where they were no longer than `ago` s before now."""
        return [] if self.store is None else self.store.departed(self.now - ago)

    def read(
        self, object_id: str, run: int, start: float = -math.inf, end: float = math.inf, most: int = -1
    ) -> Timeline:
        """The stays of one id in a run, between two moments, s, or the newest rows."""
        item = self.present.get(object_id) if run == self.epoch and end >= self.now else None
        rows = [] if self.store is None else self.store.sights(object_id, run, start, end, most)
        cut = 0 < most <= len(rows)
        stamps = [row[0] for row in rows]
        here = [is_there(row) for row in rows]
        seen = [row[5] for row in rows]
        if rows and here[0] and start == -math.inf and not cut:  # believed in only after some looks
            seen[0], stamps[0] = rows[0][6], rows[0][6]
        positions = np.frombuffer(b"".join(row[2] for row in rows), "<f8").reshape(-1, 3)
        if item is not None and not rows:  # all that is known is the present
            stamps, here, seen, positions = [item.first_seen], [True], [item.first_seen], item.position[None]
        if item is not None:
            stamps.append(max(self.now, stamps[-1]))
            here.append(not item.lost and item.existence >= BELIEVED)
            seen.append(item.last_seen)
            positions = np.vstack([positions, item.position[None]])
        words = self.words(positions)
        stays = _stays(stamps, here, seen, positions, words)
        return Timeline(object_id, stays, not here[-1] if here else True, cut)

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
        open_ends = [each for each in open_ends if life.first - each.last < RETURNS]
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


def _joined(before: Timeline, line: Timeline) -> Timeline:
    """The timeline of an object with that of its earlier id."""
    if not before.stays or not line.stays:
        return replace(line, stays=before.stays + line.stays)
    last, first = before.stays[-1], line.stays[0]
    if last.place == first.place and last.place and first.since - last.until < AWAY:
        first = replace(first, came_after=last.came_after, since=last.since, seen=last.seen + first.seen)
        return replace(line, stays=(*before.stays[:-1], first, *line.stays[1:]))
    last = replace(last, left_by=min(last.left_by or first.since, first.since))
    first = replace(first, came_after=last.until)
    return replace(line, stays=(*before.stays[:-1], last, first, *line.stays[1:]))


def ranked(shares: Mapping[str, float]) -> list[str]:
    """Names, that of the largest value first."""
    return sorted(shares, key=lambda name: -shares[name])


def likeness(mine: Mapping[str, Mapping[str, float]], others: Mapping[str, Mapping[str, float]]) -> float:
    """Product over the attributes both have of the overlap (Bhattacharyya) of their distributions, in [0, 1]."""
    product = 1.0
    for name in mine.keys() & others.keys():
        product *= sum(math.sqrt(p * others[name].get(value, 0.0)) for value, p in mine[name].items())
    return product


def _stays(
    stamps: list[float], here: list[bool], seen: list[float], positions: FloatArray, words: list[str]
) -> tuple[ObjectStay, ...]:
    """Rows of history joined where an object is still at the same place."""
    stays: list[ObjectStay] = []
    for begin, end in _runs(here, positions, words):
        stamp, position, word = stamps[begin], positions[begin], words[begin]
        current = stays[-1] if stays else None
        if not here[begin]:
            if current is not None and not current.gone:
                # A measurement up to here still found it there.
                until = min(max(current.until, seen[begin]), stamp)
                stays[-1] = replace(current, until=until, left_by=stamp)
            continue
        until = min(seen[end - 1], stamps[end - 1])
        if current is not None and _goes_on(current, word, position, stamp):
            until, seen_now = max(current.until, until), current.seen + end - begin
            stays[-1] = replace(current, until=until, left_by=None, seen=seen_now)
            continue
        after = current.until if current is not None else -math.inf
        since = min(seen[begin], stamp) if seen[begin] > after else stamp
        stays.append(ObjectStay(word, after, since, max(since, until), None, position, end - begin))
    return tuple(stays)


def _runs(here: list[bool], positions: FloatArray, words: list[str]) -> list[tuple[int, int]]:
    """From, to of rows that tell the same."""
    if not here:
        return []
    number = {word: index for index, word in enumerate(dict.fromkeys(words))}
    codes = np.array([number[word] if is_here else -1 for word, is_here in zip(words, here, strict=True)])
    steps = np.linalg.norm(np.diff(positions[:, :2], axis=0), axis=1)
    nameless = codes == number.get("", -2)
    changed = (np.diff(codes) != 0) | (nameless[1:] & (steps > 0.2 * APART))
    edges = [0, *(np.flatnonzero(changed) + 1).tolist(), len(codes)]
    return list(itertools.pairwise(edges))


def _goes_on(current: ObjectStay, word: str, position: FloatArray, stamp: float) -> bool:
    """Whether what is seen still belongs to a stay."""
    if current.place != word:
        return False
    near = bool(np.linalg.norm(position[:2] - current.position[:2]) < APART)
    if (not word or current.gone) and not near:
        return False
    return current.left_by is None or stamp - current.left_by < AWAY


def recall(source: object, places: Places | None = None, symbols: Symbols | None = None) -> Recall:
    """What a `Store` or a `WorldModel` knows. places, symbols : in place of those that the store knows.

    Raises InputError for anything else.
    """
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

"""Questions to the world model, answered with probabilities: which objects, where, now or in the past.

An object meets a request with the probability that it exists, is of the class, that each predicate holds, and that it
is in the region; for the present this is summed over all hypotheses.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import require_count, require_within, require_word
from estimation.errors import InputError
from estimation.geometry.places import LIKELY, Place, Places
from world_model.describing import ago, named
from world_model.memory.store import Store
from world_model.state import MOVED_ON, WorldObject
from world_model.symbols import Symbols, default_symbols

NEAR = 0.75  # m: what is this close to an object is there, where a region is named by an object
CORNERS = 24
LAST_SEEN = "last_seen"
World = tuple[float, Sequence[WorldObject]]  # Probability and objects of one hypothesis


@dataclass(frozen=True)
class QueryAnswer:
    """One object. probability : that it meets the request. places : probability by name of place. description : in
    words, "the red cup (cup-3): on the kitchen table, p = 0.68". stamp : the moment that was asked about, s."""

    object: WorldObject
    probability: float
    stamp: float
    places: Mapping[str, float]
    description: str


@dataclass(frozen=True)
class Request:
    """What is asked for; what is left empty does not restrict the answer.

    class_name : class. predicates : symbols that all hold. region : name of a place or of an object (what is near
    it), a `Place`, or corners (N, 2) in m. object_id : one object. min_probability : objects below it are left out.
    limit : most objects in the answer.
    """

    class_name: str = ""
    predicates: tuple[str, ...] = ()
    region: str | Place | npt.ArrayLike | None = None
    object_id: str = ""
    min_probability: float = 0.05
    limit: int | None = None

    @classmethod
    def checked(cls, **given: Any) -> Request:
        """From the keyword arguments of `WorldModel.query`. Raises InputError naming the argument."""
        predicate = given.pop("predicate", None)
        words = (predicate,) if isinstance(predicate, str) else () if predicate is None else predicate
        if not isinstance(words, Collection) or not all(isinstance(word, str) for word in words):
            raise InputError(f"predicate must be one symbol or several, not {predicate!r}")
        words = tuple(word for word in words if word)
        for name in ("class_name", "object_id"):
            given[name] = "" if given.get(name) is None else require_word(name, given[name])
        if "min_probability" in given:
            given["min_probability"] = require_within("min_probability", given["min_probability"], 0.0, 1.0)
        if given.get("limit") is not None:
            given["limit"] = require_count("limit", given["limit"])
        return cls(predicates=words, **given)


@dataclass
class Words:
    """Says where objects are and which symbols hold of them; remembers this for objects that have not changed."""

    places: Places = field(default_factory=Places)
    symbols: Symbols = field(default_factory=default_symbols)
    _known: dict[str, tuple[WorldObject, WorldObject]] = field(default_factory=dict, repr=False)

    def described(self, item: WorldObject) -> WorldObject:
        """The object with its `place`, `place_probability` and `predicates`."""
        known = self._known.get(item.id)
        if known is not None and known[0] is item:
            return known[1]
        place, probability = self.places.word(self.where(item))
        moved_on = (MOVED_ON,) if item.usual and not item.lost else ()
        made = replace(
            item,
            place=place,
            place_probability=probability,
            predicates=(*self.symbols.holding(item.attributes, item.quantities), *moved_on),
        )
        self._known[item.id] = (item, made)
        return made

    def keep(self, objects: Iterable[WorldObject]) -> None:
        """Forget all other objects."""
        ids = {item.id for item in objects}
        self._known = {name: known for name, known in self._known.items() if name in ids}

    def where(self, item: WorldObject) -> dict[str, float]:
        """Probability by name of place, given that it exists."""
        if item.usual:
            return dict(item.usual)
        if item.lost and item.region is not None:
            return self.places.shares(item.region)
        return self.places.probabilities(item.position, item.covariance)

    def name(self, item: WorldObject) -> str:
        """ "the small red cup (cup-3)"; see `world_model.describing`."""
        left_out = {MOVED_ON, *(name for name, known in self.symbols.predicates.items() if known.any)}
        return named(item, (word for word in self.described(item).predicates if word not in left_out))

    def sentence(self, item: WorldObject, stamp: float | None = None) -> str:
        """ "the red cup (cup-3): on the kitchen table, p = 0.68, seen 3 min ago"; p includes that of its existence.

        stamp : s, of the one who asks; without it nothing is said about when it was seen.
        """
        told = self.described(item)
        if told.place:
            by_now = "probably by now " if item.usual and not item.lost else ""
            where = (
                f"{by_now}{self.places[told.place].spoken}, p = {item.existence * told.place_probability:.2f}"
            )
        elif item.lost:
            where = f"anywhere, p = {item.existence:.2f}"
        else:
            x, y, z = item.position
            sigma = float(np.sqrt(max(np.linalg.eigvalsh(item.covariance)[-1], 0.0)))
            where = f"at ({x:.2f}, {y:.2f}, {z:.2f}) m ± {sigma:.2f} m, p = {item.existence:.2f}"
        seen = "" if stamp is None else f", seen {ago(stamp - item.last_seen)}"
        return f"{self.name(item)}: {'moved away, ' if item.lost else ''}{where}{seen}"


def ask(worlds: Sequence[World], request: Request, stamp: float, words: Words) -> list[QueryAnswer]:
    """Objects that meet a request, the most probable first; `worlds` are all hypotheses, the most probable first.

    Raises InputError for a place, class or predicate nobody knows of.
    """
    # Words that nobody knows are a mistake; a known word that nothing meets is an empty answer.
    known = {
        value
        for _, objects in (worlds if request.predicates else ())
        for item in objects
        for distribution in item.attributes.values()
        for value in distribution
    }
    for symbol in request.predicates:
        words.symbols.require(symbol, known)
    region = _region(worlds, request.region, words)
    meets: dict[int, float] = {}
    totals: dict[str, float] = {}
    first: dict[str, WorldObject] = {}
    for share, objects in worlds:
        for item in objects:
            if request.object_id and item.id != request.object_id:
                continue
            first.setdefault(item.id, item)
            if id(item) not in meets:
                meets[id(item)] = _probability(item, request, region, words)
            totals[item.id] = totals.get(item.id, 0.0) + share * meets[id(item)]
    order = sorted((-p, name) for name, p in totals.items() if p >= max(request.min_probability, 1e-6))
    found = [(-p, first[name]) for p, name in order[: request.limit]]
    return [
        QueryAnswer(words.described(item), p, stamp, words.where(item), words.sentence(item, stamp))
        for p, item in found
    ]


def last_seen(
    worlds: Sequence[World], store: Store | None, region: str | Place | npt.ArrayLike | None, words: Words
) -> float:
    """The newest stamp at which something was measured in a region, or the object that it is named by.

    Raises InputError where nothing ever was.
    """
    if region is None:
        raise InputError(f'stamp "{LAST_SEEN}" needs a region: when was what last seen?')
    objects = worlds[0][1]
    if isinstance(region, str) and region not in words.places:
        named = next((item for item in objects if item.id == region), None)
        if named is not None:
            return named.last_seen
    place = _region(worlds, region, words)
    assert place is not None
    stamps = [
        item.last_seen
        for item in objects
        if not item.lost and place.probability(item.position, item.covariance) > LIKELY
    ]
    past = None if store is None else store.last_seen(place)
    stamps += [] if past is None else [past]
    if not stamps:
        raise InputError(f"stamp: nothing was ever seen at {place.name!r}")
    return max(stamps)


def _probability(item: WorldObject, request: Request, region: Place | None, words: Words) -> float:
    probability = item.existence
    if request.class_name:
        probability *= float(item.attributes.get("class", {}).get(request.class_name, 0.0))
    for symbol in request.predicates:
        probability *= words.symbols.probability(symbol, item.attributes, item.quantities)
    if region is not None:
        if item.id == region.name:
            return 0.0
        if region.name in item.usual:
            probability *= item.usual[region.name]
        elif item.lost and item.region is not None:
            probability *= region.share(item.region)
        else:
            probability *= region.probability(item.position, item.covariance)
    return probability


def _region(worlds: Sequence[World], given: str | Place | npt.ArrayLike | None, words: Words) -> Place | None:
    if given is None or isinstance(given, Place):
        return given
    if not isinstance(given, str):
        return Place.checked("region", {"polygon": given})
    if given in words.places:
        return words.places[given]
    for _, objects in worlds:
        for item in objects:
            if item.id == given:
                return _around(item)
    return words.places[given]


def _around(item: WorldObject) -> Place:
    """The surroundings of an object, as a place."""
    angles = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    circle = NEAR * np.column_stack([np.cos(angles), np.sin(angles)])
    return Place(item.id, item.position[:2] + circle, "furniture", item.id)

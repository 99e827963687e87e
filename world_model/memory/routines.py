"""Routines: where things are by now and what moves next, learned from looks at places.

    routines = Routines()
    routines.look("table", ["mug", "plate"], stamp)     # all that is there now: what was there and is absent has gone
    routines.where("mug", stamp + 3 * 3600)             # {"table": 0.1, "sink": 0.9}
    routines.moves(stamp, 1800)                         # {"mug": ("sink", 0.7)}
    routines.explain("mug", stamp)                      # "mug usually goes from table to sink about 20 min after ..."

A forecast is a vote of past moments: those at about the same time of day at which the thing was at the same place. A
moment counts the more, the closer its time of day is, the fewer things were elsewhere than now, the more alike the
length of the thing's own stay is, and the more recent it is. What came after these moments is the forecast; where few
moments speak, it yields to how often things move at all.

Time is cut into slots of ten minutes. A moment's neighbours are found by the time that passed, in whole days and some
minutes, so that no day has to begin anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from estimation.checks import as_number, as_stamp
from estimation.errors import InputError
from world_model.describing import spoken_time
from world_model.memory.remembered import Remembered, RoutinesConfig
from world_model.memory.routine_kernels import fill, moments, outcomes, stays
from world_model.state import DAY, HOUR

__all__ = ["FEWEST_DAYS", "FORMAT", "VERSION", "Routines", "RoutinesConfig"]

Array = np.ndarray
FORMAT = "whereabouts.routines"
VERSION = 1
FEWEST_DAYS = 3  # on which a thing moved, before it usually does anything
EMPTY_HALF_LIFE = HOUR  # s, in which a look that did not find a thing says half as much


class Routines:
    """Learns while running; its memory is `days` times 24 h of slots for each thing, whatever is looked at how often.

    config : what past moments count.
    """

    def __init__(self, config: RoutinesConfig | None = None) -> None:
        self.config = config or RoutinesConfig()
        self._known = Remembered(self.config)
        self._alike: tuple[int, tuple[Array, Array]] | None = None
        self._days: dict[str, int] = {}

    @property
    def places(self) -> tuple[str, ...]:
        """Places known, in the order in which they were first looked at."""
        return tuple(self._known.places)

    @property
    def objects(self) -> tuple[str, ...]:
        """Objects remembered."""
        return tuple(self._known.things)

    @property
    def to_stamp(self) -> float | None:
        """Newest look, s; None before the first."""
        return self._known.stamp if self._known.last >= 0 else None

    def are_known_of(self, object: str) -> bool:
        """Whether an object was seen to have moved on `FEWEST_DAYS`: what has not may do anything."""
        if object not in self._days and object in self._known.things:
            self._days[object] = self._known.days_moved(self._known.things[object])
        return self._days.get(object, 0) >= FEWEST_DAYS

    def rename(self, object: str, new: str) -> None:
        """An object has another name; one that has it already stays as it is."""
        things = self._known.things
        if object in things and _name("object", new) not in things:
            things[new] = things.pop(object)
            self._days = {}

    def know(self, places: Iterable[str]) -> None:
        """There are these places, though nobody has looked at them yet."""
        for name in places:
            self._known.place(_name("places", name))

    def look(self, place: str, objects: Iterable[str], stamp: float) -> None:
        """All things that are at `place` at `stamp` (UTC, s): what was there and is absent has gone.

        Raises InputError: an empty name, a stamp that is not finite or before the newest look.
        """
        named, _ = _names(objects), _name("place", place)
        self._known.advance(self._checked(stamp))
        self._known.look(place, named)
        self._alike, self._days = None, {}

    def where(
        self, object: str, stamp: float, left: bool = False, alike: Iterable[str] = ()
    ) -> dict[str, float]:
        """Probability of each place known at `stamp` (UTC, s; not before the newest look); {} for an unknown object.

        left : it is not where it was seen last, as the one who asks knows. alike : objects of its kind; what is little
        known, or not at all, goes where these are.
        """
        stamp, known = self._checked(stamp), self._known
        chance = self._expected(object, known.slot(stamp), left, alike)
        if object in known.things:
            seen = known.slot(known.seen[known.things[object]])
            chance = _unseen(chance, seen, known.looked_at, self.config.slot, stamp)
        return self._named(chance)

    def goes(self, object: str, stamp: float, alike: Iterable[str] = ()) -> dict[str, float]:
        """Probability of each place for an object that is not where it was seen last, whoever has looked there since.

        alike : as of `where`.
        """
        return self._named(self._expected(object, self._known.slot(self._checked(stamp)), True, alike))

    def _expected(self, object: str, now: int, left: bool, alike: Iterable[str]) -> Array:
        """Where an object is in slot `now` (P,), by where it was seen last; empty where nothing is known."""
        known, count = self._known, len(self._known.places)
        thing = known.things.get(object)
        if thing is None:
            like = [name for name in alike if name in known.things]
            return self._base(like, now) if like else np.zeros(0)
        slot, place = known.last_seen(thing)
        ahead = self._within_reach(now - slot)
        missing = int(known.history.place[known.last % len(known.looked), thing]) < 0
        if ahead <= 0 and not (left or missing):
            return np.eye(count)[place]
        base = self._base(alike, now)
        if place < 0 or not (left or missing):
            return self._forecast(thing, slot, place, ahead, self._prior(base, place, ahead), moving=False)
        away = self._next(thing, slot, place, base)
        if ahead <= 0:
            return away
        chance = self._forecast(thing, slot, place, ahead, away, moving=False)
        # Where it was it may be back, but has not stayed.
        stayed = self._forecast(thing, slot, place, ahead, self._prior(base, place, ahead), moving=True)
        chance[place] = max(chance[place] - stayed[place], 0.0)
        total = float(chance.sum())
        return chance / total if total > 0.0 else away

    def _named(self, chance: Array) -> dict[str, float]:
        return dict(zip(self._known.places, chance.tolist(), strict=False))

    def _next(self, thing: int, slot: int, place: int, base: Array) -> Array:
        """Where it goes when it leaves `place`, whenever that is within a day (P,)."""
        elsewhere = self._prior(base, place, math.inf)
        chance = self._forecast(thing, slot, place, self._known.day, elsewhere, moving=True)
        chance[place] = 0.0
        return chance if chance.any() else elsewhere

    def _base(self, alike: Iterable[str], slot: int) -> Array:
        """Where anything is (P,): each place counts as much as one of the objects `alike` at this time of day."""
        count = len(self._known.places)
        found, shares = np.full(count, 1.0 / max(count, 1)), 1
        for thing in [self._known.things[name] for name in alike if name in self._known.things]:
            found += self._shares(thing, slot)
            shares += 1
        return found / shares

    def _shares(self, thing: int, slot: int) -> Array:
        """Share of the time that it was at each place at about this time of day (P,); anywhere where it never was."""
        known, count, window = self._known, len(self._known.places), self.config.reach
        days = slot - known.day * np.arange(self.config.days + 2)
        slots = (days[:, None] + np.arange(-window, window + 1)).ravel()
        slots = slots[(slots >= known.oldest(known.last)) & (slots <= known.last)]
        there = known.history.place[slots % len(known.looked), thing]
        counted = np.bincount(there[there >= 0], minlength=count)
        return counted / counted.sum() if counted.any() else np.full(count, 1.0 / count)

    def moves(self, stamp: float, horizon: float) -> dict[str, tuple[str, float]]:
        """Objects expected to move within `horizon` s after `stamp`, where the first move leads to, and how probably.

        Only moves with at least the configured probability. What is out of sight, nobody knows where, is not told of.
        """
        stamp = self._checked(stamp)
        if as_number("horizon", horizon) < 0.0:
            raise InputError(f"horizon must be finite and not negative, s, not {horizon}")
        known, ahead = self._known, self._within_reach(round(horizon / self.config.slot))
        if known.last < 0 or ahead < 1:
            return {}
        slot = known.last + self._within_reach(known.slot(stamp) - known.last)
        fill(known.history, known.last, slot)  # until something else is seen, all is as it was
        base = self._base((), slot)
        now = known.history.place[slot % len(known.looked)]
        expected = {}
        for name, thing in known.things.items():
            place = int(now[thing])
            if place < 0:
                continue
            chance = self._forecast(thing, slot, place, ahead, self._prior(base, place, ahead), moving=True)
            chance[place] = 0.0
            to = int(chance.argmax())
            if chance[to] >= self.config.threshold:
                expected[name] = (self.places[to], float(chance[to]))
        return expected

    def explain(self, object: str, stamp: float) -> str:
        """One sentence: what the object usually does where it was last seen, and on how many days it did.

        Only stays count that lasted into the hour around the time of day of `stamp`, or all where there is none.
        """
        slot, known = self._known.slot(self._checked(stamp)), self._known
        thing = known.things.get(object)
        if thing is None:
            return f"{object} has not been seen."
        _, place = known.last_seen(thing)
        if place < 0:
            return f"Nobody knows where {object} is."
        ended = stays(known.history, thing, place, known.oldest(known.last), known.last)
        return usual_move(object, place, ended, slot, self.config.slot, self.places)

    def to_dict(self) -> dict[str, Any]:
        """All that was learned, as JSON-able data; see `Remembered.to_dict`."""
        return {"format": FORMAT, "version": VERSION, **self._known.to_dict()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Routines:
        """What `to_dict` gave: the same answers, the same learning.

        Raises InputError: the data is not of this format and version.
        """
        if data.get("format") != FORMAT or data.get("version") != VERSION:
            raise InputError(f"not {FORMAT} of version {VERSION}")
        try:
            # Older files name weights that had no effect.
            config = {each.name: data["config"][each.name] for each in fields(RoutinesConfig)}
            made = cls(RoutinesConfig(**config))
            made._known.restore(data)
        except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
            raise InputError(f"{FORMAT}: {error!r}") from error
        return made

    def _checked(self, stamp: float) -> float:
        stamp = as_stamp("stamp", stamp)
        if stamp < self._known.stamp:
            raise InputError(f"stamp {stamp} is before the newest look, {self._known.stamp}")
        return stamp

    def _within_reach(self, slots: int) -> int:
        """The same time of day within the next 24 h: further ahead a day is like another."""
        day = self._known.day
        return slots if slots <= day else (slots - 1) % day + 1

    def _moments(self, slot: int) -> tuple[Array, Array]:
        """Past moments like `slot` with their log weights, both (E,)."""
        known = self._known
        if self._alike is None or self._alike[0] != slot:
            first = known.oldest(max(slot, known.last))
            self._alike = slot, moments(known.history, slot, first, known.last, known.day, self.config)
        return self._alike[1]

    def _forecast(self, thing: int, slot: int, place: int, ahead: int, prior: Array, moving: bool) -> Array:
        """Probabilities (P,) of where the thing is, or first moves to, `ahead` slots after it was at a place."""
        if place < 0:
            return prior
        known, alike = self._known, self._moments(slot)
        votes, days = outcomes(
            known.history, thing, slot, alike, (known.last, ahead, known.day), moving, self.config, len(prior)
        )
        if days <= 0.0:
            return prior
        chance: Array = (votes / votes.sum() * days + self.config.prior * prior) / (days + self.config.prior)
        return chance

    def _prior(self, base: Array, place: int, ahead: float) -> Array:
        """What is expected of anything: it stays with the rate at which things move, or goes where `base` (P,) says."""
        if place < 0 or len(base) == 1:
            return base
        prior = base.copy()
        prior[place] = 0.0
        stays_here = math.exp(-self._known.rate * ahead)
        prior *= (1.0 - stays_here) / prior.sum()
        prior[place] = stays_here
        return prior


def _unseen(chance: Array, seen: int, looked: Array, slot: float, stamp: float) -> Array:
    """Less where somebody looked, at `looked` (P,) s, since slot `seen`, and did not find it; fades with time."""
    left = np.where(np.floor(looked / slot) > seen, 1.0 - 0.5 ** ((stamp - looked) / EMPTY_HALF_LIFE), 1.0)
    rest = chance * left
    total = rest.sum()
    return rest / total if total > 0.0 else chance / chance.sum()


def _name(what: str, name: str) -> str:
    if not isinstance(name, str) or not name:
        raise InputError(f"{what} must be a name, not {name!r}")
    return name


def _names(objects: Iterable[str]) -> list[str]:
    """The names, each once."""
    if isinstance(objects, str):
        raise InputError("objects must be several names, not one text")
    return list(dict.fromkeys(_name("objects", name) for name in objects))


def usual_move(name: str, place: int, ended: Array, slot: int, length: float, places: Sequence[str]) -> str:
    """Where a thing goes from `place`, when, and on how many of the days.

    ended : (M, 3) stays there: slots in which it came and had gone, and the place it went to, or -1. slot : of the
    question. length : of a slot, s. places : names.
    """
    here = places[place]
    ended = _at_this_time(ended[ended[:, 2] >= 0], slot, length)
    day = round(DAY / length)
    days = len(np.unique(ended[:, 1] // day))
    if days < FEWEST_DAYS:
        return (
            f"{name} has left {here} on {days} of the days remembered: too few to tell what it usually does."
        )
    to = int(np.bincount(ended[:, 2]).argmax())
    chosen = ended[ended[:, 2] == to]
    on = len(np.unique(chosen[:, 1] // day))
    return f"{name} usually goes from {here} to {places[to]} {_when(chosen, length)}; {on} of {days} days."


def _at_this_time(ended: Array, slot: int, length: float) -> Array:
    """Of stays (M, 3) those that lasted into the hour around this time of day; all where none did."""
    hour = round(HOUR / length)
    since = (slot + hour // 2 - ended[:, 0]) % round(DAY / length)
    chosen = ended[since <= ended[:, 1] - ended[:, 0] + hour]
    return chosen if len(chosen) else ended


def _when(chosen: Array, length: float) -> str:
    """After so long a stay, or at a time of day: whichever varies less. chosen : (M, 3) stays."""
    lasted = (chosen[:, 1] - chosen[:, 0]) * length
    middle = float(np.median(lasted))
    turn = np.exp(2j * np.pi * (chosen[:, 1] * length % DAY) / DAY)
    clock = float(np.angle(turn.mean())) / (2.0 * np.pi) * DAY % DAY
    off = (chosen[:, 1] * length - clock + DAY / 2.0) % DAY - DAY / 2.0
    if np.median(np.abs(lasted - middle)) <= np.median(np.abs(off)):
        return f"about {spoken_time(middle)} after it came"
    return f"at about {int(clock // HOUR):02d}:{int(clock % HOUR // 60):02d} UTC"

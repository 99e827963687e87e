"""Routines: where things are by now and what moves next, learned from looks at places.

    routines = Routines()
    routines.look("table", ["mug", "plate"], stamp)     # all that is there now: what was there and is absent has gone
    routines.where("mug", stamp + 3 * 3600)             # {"table": 0.1, "sink": 0.9}
    routines.moves(stamp, 1800)                         # {"mug": ("sink", 0.7)}
    routines.explain("mug", stamp)                      # "mug usually goes from table to sink about 20 min after ..."

A forecast is a vote of past moments: those at about the same time of day at which the thing was at the same place. A
moment counts the more, the closer its time of day is, the fewer things were elsewhere than now, the more alike the
thing's own stay is (how long, where it came from), and the more recent it is. What came after these moments is the
forecast; where few moments speak, it yields to how often things move at all.

Time is cut into slots of ten minutes. A moment's neighbours are found by the time that passed, in whole days and some
minutes, so that no day has to begin anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from estimation.errors import InputError
from world_model.memory.routine_kernels import (
    GAP,
    History,
    Remembered,
    RoutinesConfig,
    fill,
    moments,
    outcomes,
    stays,
    unpacked,
)
from world_model.state import DAY, HOUR

__all__ = ["FEWEST_DAYS", "FORMAT", "VERSION", "Routines", "RoutinesConfig"]

Array = np.ndarray
FORMAT = "whereabouts.routines"
VERSION = 1
FEWEST_DAYS = 3  # on which a thing left a place, before it usually does anything
EMPTY_HALF_LIFE = HOUR  # s, in which a look that did not find a thing says half as much


class Routines:
    """Learns while running; its memory is `days` times 24 h of slots for each thing, whatever is looked at how often.

    Parameters
    ----------
    config : what past moments count.
    """

    def __init__(self, config: RoutinesConfig | None = None) -> None:
        self.config = config or RoutinesConfig()
        self._day = round(DAY / self.config.slot)
        self._places: dict[str, int] = {}
        self._place_names: list[str] = []
        # A day more than is remembered: a forecast fills in what is not yet known.
        self._known = Remembered((self.config.days + 2) * self._day)
        # Moves of anything, and slots times things, both forgotten by half-life.
        self._moves = self._exposure = 0.0
        self._first = self._last = -1
        self._stamp = -math.inf
        self._looked = np.full(0, -np.inf)  # (P,) s, newest look at each place
        self._version = 0
        self._alike: tuple[tuple[int, int], tuple[Array, Array]] | None = None

    @property
    def _things(self) -> dict[str, int]:
        return self._known.things

    @property
    def _history(self) -> History:
        return self._known.history

    @property
    def _seen(self) -> Array:
        return self._known.seen

    @property
    def places(self) -> tuple[str, ...]:
        """Places known, in the order in which they were first looked at."""
        return tuple(self._place_names)

    @property
    def objects(self) -> tuple[str, ...]:
        """Objects remembered."""
        return tuple(self._things)

    @property
    def to_stamp(self) -> float | None:
        """Newest look, s; None before the first."""
        return self._stamp if self._last >= 0 else None

    def last_place(self, object: str) -> str:
        """Where an object was seen last, "" where that is not known."""
        thing = self._things.get(object)
        place = -1 if thing is None else self._last_seen(thing)[1]
        return self._place_names[place] if place >= 0 else ""

    def rename(self, object: str, new: str) -> None:
        """An object has another name; one that has it already stays as it is."""
        _name("object", new)
        if object in self._things and new not in self._things:
            self._things[new] = self._things.pop(object)

    def know(self, places: Iterable[str]) -> None:
        """There are these places, though nobody has looked at them yet."""
        for name in places:
            self._place(_name("places", name))

    def look(self, place: str, objects: Iterable[str], stamp: float) -> None:
        """All things that are at `place` at `stamp` (UTC, s): what was there and is absent has gone.

        Raises
        ------
        InputError : an empty name, a stamp that is not finite or before the newest look.
        """
        named = _names(objects)
        _name("place", place)
        self._advance(self._checked(stamp))
        index = self._place(place)
        present = np.array([self._known.column(name) for name in named], np.int64)
        row = self._last % len(self._history.place)
        now = self._history.place[row]
        absent = now == index
        absent[present] = False
        for thing in np.flatnonzero(absent).tolist():
            self._moves += self._known.set(self._last, thing, -1)
        for thing in present[now[present] != index].tolist():
            self._moves += self._known.set(self._last, thing, index)
        self._known.sure[row, absent], self._known.sure[row, present] = False, True
        self._known.looked[row, index] = True
        for name in named:
            self._recall(name)
        self._seen[present] = self._looked[index] = self._stamp
        self._version += 1

    def where(
        self, object: str, stamp: float, left: bool = False, alike: Iterable[str] = ()
    ) -> dict[str, float]:
        """Probability of each place known at `stamp` (UTC, s; not before the newest look); {} for an unknown object.

        left : it is not where it was seen last, as the one who asks knows. alike : objects of its kind; what is little
        known, or not at all, goes where these are.
        """
        stamp = self._checked(stamp)
        thing = self._things.get(object)
        chance = self._expected(object, self._slot(stamp), left, alike)
        if thing is not None:
            chance = _unseen(chance, self._slot(self._seen[thing]), self._looked, self.config.slot, stamp)
        return self._named(chance)

    def goes(self, object: str, stamp: float, alike: Iterable[str] = ()) -> dict[str, float]:
        """Probability of each place for an object that is not where it was seen last, whoever has looked there since.

        alike : as of `where`.
        """
        return self._named(self._expected(object, self._slot(self._checked(stamp)), True, alike))

    def _expected(self, object: str, now: int, left: bool, alike: Iterable[str]) -> Array:
        """Where an object is in slot `now` (P,), by where it was seen last; empty where nothing is known."""
        thing = self._things.get(object)
        if thing is None:
            like = [name for name in alike if name in self._things]
            return self._base(like, now) if like else np.zeros(0)
        slot, place = self._last_seen(thing)
        ahead = self._within_reach(now - slot)
        missing = int(self._history.place[self._last % len(self._history.place), thing]) < 0
        if ahead <= 0 and not (left or missing):
            chance = np.zeros(len(self._place_names))
            chance[place] = 1.0
            return chance
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
        return dict(zip(self._place_names, chance.tolist(), strict=False))

    def _next(self, thing: int, slot: int, place: int, base: Array) -> Array:
        """Where it goes when it leaves `place`, whenever that is within a day (P,)."""
        elsewhere = self._prior(base, place, math.inf)
        chance = self._forecast(thing, slot, place, self._day, elsewhere, moving=True)
        chance[place] = 0.0
        return chance if chance.any() else elsewhere

    def _base(self, alike: Iterable[str], slot: int) -> Array:
        """Where anything is (P,): each place counts as much as one of the objects `alike` at this time of day."""
        count = len(self._place_names)
        found, shares = np.full(count, 1.0 / max(count, 1)), 1
        for thing in [self._things[name] for name in alike if name in self._things]:
            found += self._shares(thing, slot)
            shares += 1
        return found / shares

    def _shares(self, thing: int, slot: int) -> Array:
        """Share of the time that it was at each place at about this time of day (P,); anywhere where it never was."""
        count, window = len(self._place_names), self.config.reach
        days = slot - self._day * np.arange(self.config.days + 2)
        slots = (days[:, None] + np.arange(-window, window + 1)).ravel()
        slots = slots[(slots >= self._oldest(self._last)) & (slots <= self._last)]
        there = self._history.place[slots % len(self._history.place), thing]
        counted = np.bincount(there[there >= 0], minlength=count)
        return counted / counted.sum() if counted.any() else np.full(count, 1.0 / count)

    def moves(self, stamp: float, horizon: float) -> dict[str, tuple[str, float]]:
        """Objects expected to move within `horizon` s after `stamp`, where the first move leads to, and how probably.

        Only moves with at least the configured probability. What is out of sight, nobody knows where, is not told of.
        """
        stamp = self._checked(stamp)
        if not math.isfinite(horizon) or horizon < 0.0:
            raise InputError(f"horizon must be finite and not negative, s, not {horizon}")
        ahead = self._within_reach(round(horizon / self.config.slot))
        if self._last < 0 or ahead < 1:
            return {}
        slot = self._last + self._within_reach(self._slot(stamp) - self._last)
        fill(self._history, self._last, slot)  # until something else is seen, all is as it was
        base = self._base((), slot)
        now = self._history.place[slot % len(self._history.place)]
        expected = {}
        for name, thing in self._things.items():
            place = int(now[thing])
            if place < 0:
                continue
            chance = self._forecast(thing, slot, place, ahead, self._prior(base, place, ahead), moving=True)
            chance[place] = 0.0
            to = int(chance.argmax())
            if chance[to] >= self.config.threshold:
                expected[name] = (self._place_names[to], float(chance[to]))
        return expected

    def explain(self, object: str, stamp: float) -> str:
        """One sentence: what the object usually does where it was last seen, and on how many days it did.

        Only stays count that lasted into the hour around the time of day of `stamp`, or all where there is none.
        """
        stamp = self._checked(stamp)
        thing = self._things.get(object)
        if thing is None:
            return f"{object} has not been seen."
        _, place = self._last_seen(thing)
        if place < 0:
            return f"Nobody knows where {object} is."
        ended = stays(self._history, thing, place, self._oldest(self._last), self._last)
        return usual_move(object, place, ended, self._slot(stamp), self.config.slot, self._place_names)

    def to_dict(self) -> dict[str, Any]:
        """All that was learned, as JSON-able data.

        For each object its stays (since slot, place, place before), and the slots in which it was seen, packed.
        """
        slots = np.arange(self._oldest(self._last), self._last + 1) if self._last >= 0 else np.zeros(0, int)
        return {
            "format": FORMAT,
            "version": VERSION,
            "config": asdict(self.config),
            "stamp": self._stamp if self._last >= 0 else None,
            "first": self._first,
            "last": self._last,
            "moves": self._moves,
            "exposure": self._exposure,
            "places": {name: _finite(self._looked[index]) for index, name in enumerate(self._place_names)},
            "looks": {name: self._known.looks(index, slots) for index, name in enumerate(self._place_names)},
            "objects": [
                {"name": name, "seen": _finite(self._seen[thing]), **self._known.of(thing, slots)}
                for name, thing in self._things.items()
            ],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Routines:
        """What `to_dict` gave: the same answers, the same learning.

        Raises
        ------
        InputError : the data is not of this format and version.
        """
        if data.get("format") != FORMAT or data.get("version") != VERSION:
            raise InputError(f"not {FORMAT} of version {VERSION}")
        try:
            # Older files name weights that had no effect.
            config = {each.name: data["config"][each.name] for each in fields(RoutinesConfig)}
            return cls(RoutinesConfig(**config))._restored(data)
        except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
            raise InputError(f"{FORMAT}: {error!r}") from error

    def _restored(self, data: Mapping[str, Any]) -> Routines:
        for name, looked in data["places"].items():
            place = self._place(name)
            self._looked[place] = -np.inf if looked is None else looked
        self._first, self._last = int(data["first"]), int(data["last"])
        if self._last < 0:
            return self
        self._stamp = float(data["stamp"])
        self._moves, self._exposure = float(data["moves"]), float(data["exposure"])
        slots = np.arange(self._oldest(self._last), self._last + 1)
        for name, packed in data.get("looks", {}).items():
            self._known.looked[slots % len(self._known.looked), self._places[name]] = unpacked(
                packed, len(slots)
            )
        for kept in data["objects"]:
            thing = self._known.column(kept["name"])
            self._seen[thing] = -np.inf if kept["seen"] is None else kept["seen"]
            self._known.put(thing, slots, kept)
        return self

    def _checked(self, stamp: float) -> float:
        if not math.isfinite(stamp):
            raise InputError(f"stamp must be finite, s, not {stamp}")
        if stamp < self._stamp:
            raise InputError(f"stamp {stamp} is before the newest look, {self._stamp}")
        return float(stamp)

    def _slot(self, stamp: float) -> int:
        return math.floor(stamp / self.config.slot)

    def _within_reach(self, slots: int) -> int:
        """The same time of day within the next 24 h: further ahead a day is like another."""
        return slots if slots <= self._day else (slots - 1) % self._day + 1

    def _oldest(self, last: int) -> int:
        """The oldest slot that counts when `last` is the newest."""
        return max(self._first, last - self.config.days * self._day + 1)

    def _advance(self, stamp: float) -> None:
        """Time goes on to `stamp`; what is not looked at stays where it is believed to be."""
        slot = self._slot(stamp)
        self._stamp = stamp
        if self._last < 0:
            self._first = self._last = slot
        elif slot > self._last:
            passed = slot - self._last
            self._known.advance(self._last, slot)
            kept = 0.5 ** (passed / (self._day * self.config.half_life))
            self._moves *= kept
            self._exposure = kept * self._exposure + passed * len(self._things)
            if slot // self._day > self._last // self._day:
                self._forget(slot)
            self._last = slot

    def _forget(self, slot: int) -> None:
        """Things that were not seen for as long as anything is remembered are dropped."""
        oldest = (slot - self.config.days * self._day) * self.config.slot
        for name in [name for name, thing in self._things.items() if self._seen[thing] < oldest]:
            self._known.drop(name)

    def _place(self, name: str) -> int:
        if name not in self._places:
            self._places[name] = len(self._place_names)
            self._place_names.append(name)
            self._looked = np.append(self._looked, -np.inf)
            self._known.add_place()
        return self._places[name]

    def _recall(self, name: str) -> None:
        """What nobody saw of a thing since it was last seen, now that it is."""
        seen = float(self._seen[self._things[name]])
        first = self._oldest(self._last)
        low = max(self._last - GAP * self._day, first)
        low = max(self._slot(seen), low) if math.isfinite(seen) else self._last
        if low < self._last - 1:
            self._known.recall(name, low, self._last, first, -math.expm1(-self._rate()), self.config)

    def _rate(self) -> float:
        """Of moves of anything, per slot."""
        return (self._moves + 1.0) / (self._exposure + self._day)

    def _last_seen(self, thing: int) -> tuple[int, int]:
        """Slot and place of where a forecast starts: where the thing was last known to be (-1: not remembered)."""
        rows = len(self._history.place)
        place = int(self._history.place[self._last % rows, thing])
        if place >= 0:
            # Not longer ago than a day: its row is still there, and no day differs from the next.
            return max(self._slot(self._seen[thing]), self._last - self._day), place
        slot = max(int(self._history.since[self._last % rows, thing]) - 1, self._last - self._day)
        if slot < self._first:
            return slot, -1
        return slot, int(self._history.place[slot % rows, thing])

    def _moments(self, slot: int) -> tuple[Array, Array]:
        """Past moments like `slot` with their log weights, both (E,)."""
        key = (slot, self._version)
        if self._alike is None or self._alike[0] != key:
            newest = max(slot, self._last)
            found = moments(self._history, slot, self._oldest(newest), self._last, self._day, self.config)
            self._alike = key, found
        return self._alike[1]

    def _forecast(self, thing: int, slot: int, place: int, ahead: int, prior: Array, moving: bool) -> Array:
        """Probabilities (P,) of where the thing is, or first moves to, `ahead` slots after it was at a place."""
        if place < 0:
            return prior
        found, weights = self._moments(slot)
        votes, days = outcomes(
            self._history, thing, slot, found, weights, self._last, ahead, self._day, moving, self.config,
            len(self._place_names),
        )  # fmt: skip
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
        stays_here = math.exp(-self._rate() * ahead)
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


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


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
        return f"about {_duration(middle)} after it came"
    return f"at about {int(clock // HOUR):02d}:{int(clock % HOUR // 60):02d} UTC"


def _duration(seconds: float) -> str:
    """Minutes up to two hours, hours up to two days, then days."""
    for unit, length, most in (("min", 60, 2.0 * HOUR), ("h", HOUR, 2.0 * DAY)):
        if seconds < most:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds / DAY:.0f} days"

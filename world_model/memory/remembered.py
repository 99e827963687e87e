"""Which thing was where in each slot of time: what routines are learned from, and how it is kept."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from estimation.checks import as_number, require_count, require_positive
from estimation.errors import InputError
from world_model.memory.routine_kernels import GAP, History, ThingMoves, fill, recall
from world_model.state import DAY

Array = np.ndarray


@dataclass(frozen=True)
class RoutinesConfig:
    """What past moments count.

    slot : s, resolution of time. days : that are remembered; what is older is gone. half_life : days until a moment
    counts half. window, clock : largest difference and deviation of the time of day, s. differs : log weight of a
    thing that was elsewhere than now. stay : deviation of the log of how long the thing itself has been there.
    prior : days that the general rate of moves counts for. threshold : of the probability from which on `moves` tells
    of a move.
    """

    slot: float = 600.0
    days: int = 120
    half_life: float = 60.0
    window: float = 1800.0
    clock: float = 900.0
    differs: float = 0.8
    stay: float = 0.7
    prior: float = 0.3
    threshold: float = 0.35

    def __post_init__(self) -> None:
        for name in ("slot", "half_life", "clock", "stay", "prior"):
            require_positive(name, getattr(self, name))
        for name in ("window", "differs", "threshold"):
            as_number(name, getattr(self, name))
        require_count("days", self.days)
        if DAY % self.slot:
            raise InputError(f"slot must divide a day of {DAY:g} s, not {self.slot}")

    @property
    def reach(self) -> int:
        """Largest difference of the time of day, slots."""
        return round(self.window / self.slot)

    @property
    def spread(self) -> float:
        """Deviation of the time of day, slots."""
        return self.clock / self.slot


class Remembered:
    """Where things were, in a ring of slots.

    things, places : index of each by name. history : all that is known. seen (N,), looked_at (P,) : s, newest look that
    found a thing, and at a place. looked (R, P) : whether somebody looked at a place. been (P, N) : whether a thing
    ever was there. stamp : s, of the newest look. first, last : oldest and newest slot, -1 before any. day : in slots.
    """

    def __init__(self, config: RoutinesConfig) -> None:
        self.config = config
        self.day = round(DAY / config.slot)
        # A day more than is remembered: a forecast fills in what is not yet known.
        rows = (config.days + 2) * self.day
        self.history = _empty(rows, 0)
        self.things: dict[str, int] = {}
        self.places: dict[str, int] = {}
        self.seen, self.looked_at = np.full(0, -np.inf), np.full(0, -np.inf)
        self.looked, self.been = np.zeros((rows, 0), bool), np.zeros((0, 0), bool)
        self.stamp = -math.inf
        self.first = self.last = -1
        # Moves of anything, and slots times things, both forgotten by half-life.
        self._moves = self._exposure = 0.0
        self._free: list[int] = []

    # Names.

    def place(self, name: str) -> int:
        """Index of a place, a new one where it has none yet."""
        if name not in self.places:
            self.places[name] = len(self.places)
            self.looked_at = np.append(self.looked_at, -np.inf)
            self.looked = np.pad(self.looked, ((0, 0), (0, 1)))
            self.been = np.pad(self.been, ((0, 1), (0, 0)))
        return self.places[name]

    def column(self, name: str) -> int:
        """Of a thing, a new one where it has none yet."""
        if name not in self.things:
            if not self._free:
                self._grow()
            self.things[name] = self._free.pop()
        return self.things[name]

    def _grow(self, least: int = 16) -> None:
        """Room for twice as many things, and for so many more."""
        before = len(self.seen)
        more = max(before, least)
        added = _empty(len(self.looked), more)
        self.history = History(*map(np.hstack, zip(self.history, added, strict=True))) if before else added
        self.been = np.pad(self.been, ((0, 0), (0, more)))
        self.seen = np.append(self.seen, np.full(more, -np.inf))
        self._free = list(range(before + more - 1, before - 1, -1))

    def drop(self, name: str) -> None:
        """Forget a thing."""
        thing = self.things.pop(name)
        for into, nothing in zip(self.history, _empty(1, 1), strict=True):
            into[:, thing] = nothing[0, 0]
        self.been[:, thing] = False
        self.seen[thing] = -np.inf
        self._free.append(thing)

    # Time.

    def slot(self, stamp: float) -> int:
        """That a stamp, s, is in."""
        return math.floor(stamp / self.config.slot)

    def oldest(self, last: int) -> int:
        """The oldest slot that counts when `last` is the newest."""
        return max(self.first, last - self.config.days * self.day + 1)

    @property
    def slots(self) -> Array:
        """All that count."""
        return np.arange(self.oldest(self.last), self.last + 1) if self.last >= 0 else np.zeros(0, int)

    @property
    def rate(self) -> float:
        """Of moves of anything, per slot."""
        return (self._moves + 1.0) / (self._exposure + self.day)

    def advance(self, stamp: float) -> None:
        """Time goes on to a stamp, s; what is not looked at stays where it is believed to be."""
        slot, passed = self.slot(stamp), self.slot(stamp) - self.last
        self.stamp = stamp
        if self.last < 0:
            self.first = self.last = slot
        elif passed > 0:
            fill(self.history, self.last, slot)
            rows = np.arange(max(self.last + 1, slot - len(self.looked) + 1), slot + 1) % len(self.looked)
            self.history.sure[rows] = self.looked[rows] = False
            kept = 0.5 ** (passed / (self.day * self.config.half_life))
            self._moves *= kept
            self._exposure = kept * self._exposure + passed * len(self.things)
            if slot // self.day > self.last // self.day:
                self._forget(slot)
            self.last = slot

    def _forget(self, slot: int) -> None:
        """Things that were not seen for as long as anything is remembered are dropped."""
        oldest = (slot - self.config.days * self.day) * self.config.slot
        for name in [name for name, thing in self.things.items() if self.seen[thing] < oldest]:
            self.drop(name)

    # Looks.

    def look(self, place: str, names: Iterable[str]) -> None:
        """These things, and no other, are at a place at `stamp`."""
        index, row = self.place(place), self.last % len(self.looked)
        columns = {name: self.column(name) for name in names}
        present = np.array([*columns.values()], np.int64)
        now = self.history.place[row]
        absent = now == index
        absent[present] = False
        for thing in np.flatnonzero(absent).tolist():
            self.set(thing, -1)
        for thing in present[now[present] != index].tolist():
            self.set(thing, index)
        self.history.sure[row, absent], self.history.sure[row, present] = False, True
        self.looked[row, index] = True
        for name in columns:
            self.recall(name)
        self.seen[present] = self.looked_at[index] = self.stamp

    def set(self, thing: int, place: int) -> None:
        """The thing is at another place than it was, or nobody knows where (-1)."""
        history, rows = self.history, len(self.looked)
        row = self.last % rows
        if place >= 0:
            self.been[place, thing] = True
            at = self.last if history.place[row, thing] >= 0 else int(history.since[row, thing]) - 1
            known = at >= max(self.first, self.last - rows + 1)
            self._moves += known and history.place[at % rows, thing] not in (-1, place)
        history.place[row, thing], history.since[row, thing] = place, self.last

    def last_seen(self, thing: int) -> tuple[int, int]:
        """Slot and place where a thing was last known to be (-1: not remembered)."""
        rows = len(self.looked)
        place = int(self.history.place[self.last % rows, thing])
        if place >= 0:
            # Not longer ago than a day: its row is still there, and no day differs from the next.
            return max(self.slot(self.seen[thing]), self.last - self.day), place
        slot = max(int(self.history.since[self.last % rows, thing]) - 1, self.last - self.day)
        return slot, int(self.history.place[slot % rows, thing]) if slot >= self.first else -1

    def days_moved(self, thing: int) -> int:
        """Days, UTC, on which a thing was seen at another place than before."""
        slots = self.slots
        seen = slots[self.history.sure[slots % len(self.looked), thing]]
        moved = np.diff(self.history.place[seen % len(self.looked), thing]) != 0
        return len(np.unique(seen[1:][moved] // self.day))

    def recall(self, name: str) -> None:
        """What nobody saw of a thing since it was last seen, now that it is."""
        thing, first = self.things[name], self.oldest(self.last)
        seen = float(self.seen[thing])
        low = max(self.slot(seen), self.last - GAP * self.day, first) if math.isfinite(seen) else self.last
        if low >= self.last - 1:
            return
        seed = zlib.crc32(f"{name} {self.last}".encode())
        recall(self.history, self.looked, self.chain(thing), low, self.last, first, seed)

    def chain(self, thing: int) -> ThingMoves:
        """How a thing moves between the places where it ever was."""
        places = np.append(np.flatnonzero(self.been[:, thing]), -1)
        state = np.zeros(len(self.been) + 1, np.int64)
        state[places + 1] = np.arange(len(places))
        reach, spread = self.config.reach, self.config.spread
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / spread) ** 2)
        fading, rate = 0.5 ** (1.0 / self.config.half_life), -math.expm1(-self.rate)
        return ThingMoves(thing, state, places, kernel, fading, rate, self.config.prior, self.day)

    # Kept.

    def to_dict(self) -> dict[str, Any]:
        """All of it as JSON-able data; of each thing the stays, and the slots in which it was seen, packed."""
        slots = self.slots
        rows = slots % len(self.looked)
        return {
            "config": asdict(self.config), "stamp": _finite(self.stamp), "first": self.first, "last": self.last,
            "moves": self._moves, "exposure": self._exposure,
            "places": {name: _finite(self.looked_at[index]) for name, index in self.places.items()},
            "looks": {name: packed(self.looked[rows, index]) for name, index in self.places.items()},
            "objects": [
                {"name": name, "seen": _finite(self.seen[thing]), "stays": self._stays(thing, slots),
                 "sure": packed(self.history.sure[rows, thing])}
                for name, thing in self.things.items()
            ],
        }  # fmt: skip

    def _stays(self, thing: int, slots: Array) -> list[list[int]]:
        """First slot remembered, since, place."""
        rows = slots % len(self.looked)
        table = np.column_stack([slots, self.history.since[rows, thing], self.history.place[rows, thing]])
        changed = np.ones(len(table), bool)
        changed[1:] = np.any(table[1:, 1:] != table[:-1, 1:], axis=1)
        return table[changed].tolist()

    def restore(self, data: Mapping[str, Any]) -> None:
        """What `to_dict` told, into an empty memory. Where nobody says when a thing was seen, it was where it is said
        to have been. Raises KeyError, TypeError, IndexError, AttributeError or ValueError."""
        for name, looked in data["places"].items():
            index = self.place(name)
            self.looked_at[index] = -np.inf if looked is None else looked
        self.first, self.last = int(data["first"]), int(data["last"])
        if self.last < 0:
            return
        self.stamp = float(data["stamp"])
        self._moves, self._exposure = float(data["moves"]), float(data["exposure"])
        slots = self.slots
        rows = slots % len(self.looked)
        for name, text in data.get("looks", {}).items():
            self.looked[rows, self.places[name]] = unpacked(text, len(slots))
        self._grow(len(data["objects"]))
        for kept in data["objects"]:
            thing = self.column(kept["name"])
            self.seen[thing] = -np.inf if kept["seen"] is None else kept["seen"]
            # Older files have a fourth number, the place before, which is not used.
            runs = np.array([stay[:3] for stay in kept["stays"]], np.int64).reshape(-1, 3)
            run = np.searchsorted(runs[:, 0], slots, side="right") - 1
            self.history.since[rows, thing], self.history.place[rows, thing] = runs[run, 1:].T
            self.been[np.unique(runs[runs[:, 2] >= 0, 2]), thing] = True
            there = self.history.place[rows, thing] >= 0
            self.history.sure[rows, thing] = unpacked(kept["sure"], len(slots)) if "sure" in kept else there


def packed(flags: Array) -> str:
    """Flags as text."""
    return base64.b64encode(zlib.compress(np.packbits(flags).tobytes())).decode()


def unpacked(text: str, count: int) -> Array:
    """So many flags that were `packed`. Raises ValueError."""
    try:
        flags = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    except zlib.error as error:
        raise ValueError(f"packed flags: {error}") from error
    return np.unpackbits(flags, count=count).astype(bool)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _empty(rows: int, things: int) -> History:
    """A history in which nothing is known."""
    shape = rows, things
    return History(np.full(shape, -1, np.int16), np.zeros(shape, np.int32), np.zeros(shape, bool))

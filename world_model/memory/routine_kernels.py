"""Past moments like the present one, and what came after them: the sums and loops of `world_model.memory.routines`.

A forecast is made of arrays alone: somebody who asks once does not wait until compiled functions have been read.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from estimation.checks import require_count, require_positive
from estimation.errors import InputError
from world_model.state import DAY

# mypy: disable-error-code="no-untyped-def"


class History(NamedTuple):
    """Where N things were, over a ring of R rows: slot t of time is row t mod R.

    place : (R, N) index of the place, -1 where nobody knows. before : (R, N) the place it was at before that, or -1.
    since : (R, N) the slot in which it came, or went missing.
    """

    place: np.ndarray
    before: np.ndarray
    since: np.ndarray


@dataclass(frozen=True)
class RoutinesConfig:
    """What past moments count.

    slot : s, resolution of time. days : that are remembered; what is older is gone. half_life : days until a moment
    counts half. window, clock : largest difference and deviation of the time of day, s. differs : log weight of a
    thing that was elsewhere than now. stay : deviation of the log of how long the thing itself has been there.
    origin : log weight of its having come from elsewhere. prior : days that the general rate of moves counts for.
    threshold : of the probability from which on `moves` tells of a move.
    """

    slot: float = 600.0
    days: int = 120
    half_life: float = 60.0
    window: float = 1800.0
    clock: float = 900.0
    differs: float = 0.8
    stay: float = 0.7
    origin: float = 1.2
    prior: float = 0.3
    threshold: float = 0.35

    def __post_init__(self) -> None:
        for name in ("slot", "half_life", "clock", "stay", "prior"):
            require_positive(name, getattr(self, name))
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


FAINT = (
    0.1  # of a move in the middle of what nobody saw, beside one at a time of day at which it was seen before
)
FAR = 12.0  # largest squared deviation of the stay: a moment is never ruled out by it alone


class Remembered:
    """Which thing was where. history : all of it. things : column of each, by name. seen (N,) : s, when it was seen
    last."""

    def __init__(self, rows: int) -> None:
        self.history = _empty(rows, 0)
        self.things: dict[str, int] = {}
        self.seen = np.full(0, -np.inf)
        self._free: list[int] = []

    def column(self, name: str) -> int:
        """Of a thing, a new one where it has none yet."""
        if name not in self.things:
            if not self._free:
                self._grow()
            self.things[name] = self._free.pop()
        return self.things[name]

    def drop(self, name: str) -> None:
        """Forget a thing."""
        thing = self.things.pop(name)
        self.history.place[:, thing] = self.history.before[:, thing] = -1
        self.history.since[:, thing] = 0
        self.seen[thing] = -np.inf
        self._free.append(thing)

    def _grow(self) -> None:
        """Room for twice as many things."""
        before = len(self.seen)
        more = max(before, 16)
        added = _empty(len(self.history.place), more)
        self.history = History(*map(np.hstack, zip(self.history, added, strict=True)))
        self.seen = np.append(self.seen, np.full(more, -np.inf))
        self._free = list(range(before + more - 1, before - 1, -1))

    def set(self, slot: int, thing: int, place: int) -> bool:
        """The thing is at another place than it was, or nobody knows where (-1); whether it has moved."""
        row = slot % len(self.history.place)
        was = int(self.history.place[row, thing])
        if was >= 0:
            self.history.before[row, thing] = was
        self.history.place[row, thing] = place
        self.history.since[row, thing] = slot
        return place >= 0 and self.history.before[row, thing] not in (-1, place)

    def amend(
        self,
        thing: int,
        place: int,
        last: int,
        seen: int,
        absent: int,
        choose: Callable[[int, int, int], int],
    ) -> None:
        """What nobody saw between slot `seen` and now, `last`: when the thing left, and came to `place`.

        absent : newest slot in which it was not at `place` yet. choose : slot of a move from a place between two.
        """
        rows = len(self.history.place)
        was = int(self.history.place[seen % rows, thing])
        if seen >= last - 1 or was < 0:
            return
        unknown = (slot for slot in range(seen + 1, last) if self.history.place[slot % rows, thing] < 0)
        empty = next(unknown, last)  # newest slot by which it had gone from where it was
        if was == place:
            # It was away in between, nobody knows where.
            if empty == last:
                return
            gone, came = (seen + 1 + empty) // 2, (absent + 1 + last) // 2
        elif absent < empty:
            gone = came = choose(was, absent, empty)
        else:
            gone, came = choose(was, seen, empty), choose(was, absent, last)
        fill(self.history, seen, gone - 1, thing)  # until then all was as it was
        amend(self.history, thing, gone, came, last, was, place)

    def runs(self, thing: int, slots: np.ndarray) -> list[list[int]]:
        """Rows (first slot remembered, since, place, before) of the stays of one thing."""
        place, before, since = (each[slots % len(each), thing] for each in self.history)
        table = np.column_stack([slots, since, place, before]).astype(np.int64)
        changed = np.ones(len(table), bool)
        changed[1:] = np.any(table[1:, 1:] != table[:-1, 1:], axis=1)
        kept: list[list[int]] = table[changed].tolist()
        return kept

    def put(self, thing: int, slots: np.ndarray, stays_known: list[list[int]]) -> None:
        """What `runs` told."""
        runs = np.array(stays_known, np.int64).reshape(-1, 4)
        run = np.searchsorted(runs[:, 0], slots, side="right") - 1
        for into, column in zip(self.history, (2, 3, 1), strict=True):
            into[slots % len(into), thing] = runs[run, column]


def _empty(rows: int, things: int) -> History:
    """A history in which nothing is known."""
    shape = rows, things
    return History(np.full(shape, -1, np.int16), np.full(shape, -1, np.int16), np.zeros(shape, np.int32))


def fill(history, last, now, things=slice(None)):
    """Copy the row of slot `last` to the slots behind it, up to `now`; of some things where they are said."""
    rows = len(history.place)
    behind = np.arange(max(last + 1, now - rows + 1), now + 1) % rows
    for each in history:
        each[behind, things] = each[last % rows, things]


def moments(history, slot, first, last, day, config):
    """Past moments at about the time of day of `slot`, and how alike they are by all that was where.

    first, last : slots that are known. day : slots of a day.
    Returns slots (E,), newest day first, and log weights (E,), of which only differences mean anything.
    """
    rows = len(history.place)
    ages = np.arange(1, max((last - first) // day + 2, 1) + 1)[:, None]
    shifts = np.arange(-config.reach, config.reach + 1)
    others = slot - ages * day + shifts
    known = (others >= first) & (others < last)
    found = others[known]
    cost = (0.5 * (shifts / config.spread) ** 2 + ages * math.log(2.0) / config.half_life)[known]
    now, then = slot % rows, found % rows
    here, there = history.place[now], history.place[then]
    both = (here >= 0) & (there >= 0)
    cost += config.differs * (both & (here != there)).sum(1)
    return found, -cost


def _own(history, thing, slot, found, weights, last, config):
    """Log weights (E,) for one thing: -inf where it was elsewhere, or what came after is not known by `last`."""
    rows = len(history.place)
    now, then = slot % rows, found % rows
    place, before, since = (each[:, thing] for each in history)
    ratio = np.log((slot - since[now] + 1.0) / (found - since[then] + 1.0))
    scores = weights - 0.5 * np.minimum((ratio / config.stay) ** 2, FAR)
    scores = scores - config.origin * (before[then] != before[now])
    return np.where((place[then] == place[now]) & (found <= last), scores, -np.inf)


def _outcome(history, thing, slots, ahead, moving, last):
    """Where the thing was `ahead` slots after each of `slots` (E,), -1 unknown; with `moving`, where it first moved to.

    What went missing has moved: to where it was next seen by slot `last`. Seen where it had been, it was elsewhere.
    """
    place, rows = history.place[:, thing], len(history.place)
    if not moving:
        return place[(slots + ahead) % rows]
    start = place[slots % rows]
    after = slots[:, None] + np.arange(1, ahead + 1)
    there = place[after % rows]
    went = (there < 0) | (there != start[:, None])
    first = went.argmax(1)
    each = np.arange(len(slots))
    to, gone = there[each, first], after[each, first]
    # Those that went missing: on to where they were seen next, all of them slot by slot.
    missing = np.flatnonzero((to < 0) & went.any(1))
    while len(missing):
        gone[missing] += 1
        missing = missing[gone[missing] <= last]
        to[missing] = place[gone[missing] % rows]
        missing = missing[to[missing] < 0]
    back = (there[each, first] < 0) & (to == start)
    return np.where(went.any(1), np.where(back, -1, to), start)


def outcomes(history, thing, slot, found, weights, last, ahead, day, moving, config, count):
    """What came after moments like `slot` for one thing, as sums of weights by place (`count`,).

    last : the newest slot that is known. ahead : slots. moving : its first move within `ahead`, not where it was then.
    Returns the sums, and how many days speak, each by its most similar moment: what smoothing has to yield to.
    """
    scores = _own(history, thing, slot, found, weights, last - ahead, config)
    fits = np.flatnonzero(scores > -np.inf)
    if not len(fits):
        return np.zeros(count), 0.0
    weight = np.exp(scores[fits] - scores[fits].max())
    where = _outcome(history, thing, found[fits], ahead, moving, last)
    days = (slot - found[fits] + day // 2) // day
    seen = where >= 0
    where, weight, days = where[seen], weight[seen], days[seen]
    strongest = np.zeros(int(days.max(initial=0)) + 1)
    np.maximum.at(strongest, days, weight)
    return np.bincount(where, weight, count), float(strongest.sum())


def stays(history, thing, place, first, last):
    """Stays of one thing at a place that ended: rows (slot it came, slot it was gone, place it went to, or -1)."""
    slots = np.arange(first, last + 1)
    where = history.place[slots % len(history.place), thing].astype(np.int64)
    here = np.concatenate(([False], where == place))
    came, gone = np.flatnonzero(here[1:] & ~here[:-1]), np.flatnonzero(here[:-1] & ~here[1:])
    # Where it was seen next, which is behind the end where it never was.
    known = np.append(np.flatnonzero(where >= 0), len(where))
    to = np.append(where, -1)[known[np.searchsorted(known, gone)]]
    return np.column_stack([slots[came[: len(gone)]], slots[gone], to])


@njit(cache=True)
def likely_slot(ended, to, low, high, day, spread):
    """In which slot of low < slot ≤ high a thing went to `to`: when it usually does, or in the middle.

    ended : (M, 3) its stays where it was, as of `stays`. spread : deviation of its times of day, slots.
    """
    middle = 0.5 * (low + 1 + high)
    best, chosen = -1.0, high
    for slot in range(low + 1, high + 1):
        score = FAINT / (1.0 + abs(slot - middle))
        for k in range(len(ended)):
            if ended[k, 2] == to:
                apart = (slot - ended[k, 1] + day // 2) % day - day // 2
                score += math.exp(-0.5 * (apart / spread) ** 2)
        if score > best:
            best, chosen = score, slot
    return chosen


def amend(history, thing, gone, came, now, place, to):
    """What nobody saw happen: the thing left `place` in slot `gone` and was at `to` from slot `came` to `now`."""
    slots = np.arange(gone, now + 1)
    rows, there = slots % len(history.place), slots >= came
    history.place[rows, thing] = np.where(there, to, -1)
    history.before[rows, thing] = place
    history.since[rows, thing] = np.where(there, came, gone)

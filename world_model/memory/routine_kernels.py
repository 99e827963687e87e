"""Past moments like the present one, and what came after them: the sums and loops of `world_model.memory.routines`.

A forecast is made of arrays alone: somebody who asks once does not wait until compiled functions have been read.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

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


AGAIN = 8  # older gaps filled anew with each new one; HOMER does a little better by 8 than by 4
GAP = 7  # days of a gap that are filled
FAR = 12.0  # largest squared deviation of the stay: a moment is never ruled out by it alone


class Remembered:
    """Which thing was where.

    history : all of it. things : column of each, by name. seen (N,) : s, when it was seen last. sure (R, N) : whether
    it was seen in a slot. looked (R, P) : whether somebody looked at a place. been (P, N) : whether it ever was there.
    """

    def __init__(self, rows: int) -> None:
        self.history = _empty(rows, 0)
        self.things: dict[str, int] = {}
        self.seen = np.full(0, -np.inf)
        self.sure, self.looked, self.been = (
            np.zeros(shape, bool) for shape in ((rows, 0), (rows, 0), (0, 0))
        )
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
        self.sure[:, thing] = self.been[:, thing] = False
        self.seen[thing] = -np.inf
        self._free.append(thing)

    def _grow(self) -> None:
        """Room for twice as many things."""
        before = len(self.seen)
        more = max(before, 16)
        added = _empty(len(self.history.place), more)
        self.history = History(*map(np.hstack, zip(self.history, added, strict=True)))
        self.sure, self.been = (np.pad(each, ((0, 0), (0, more))) for each in (self.sure, self.been))
        self.seen = np.append(self.seen, np.full(more, -np.inf))
        self._free = list(range(before + more - 1, before - 1, -1))

    def add_place(self) -> None:
        """There is one more."""
        self.looked, self.been = np.pad(self.looked, ((0, 0), (0, 1))), np.pad(self.been, ((0, 1), (0, 0)))

    def advance(self, last: int, slot: int) -> None:
        """Time goes on from slot `last`: what nobody looks at stays where it is."""
        fill(self.history, last, slot)
        passed = np.arange(max(last + 1, slot - len(self.sure) + 1), slot + 1) % len(self.sure)
        self.sure[passed] = self.looked[passed] = False

    def set(self, slot: int, thing: int, place: int) -> bool:
        """The thing is at another place than it was, or nobody knows where (-1); whether it has moved."""
        row = slot % len(self.history.place)
        was = int(self.history.place[row, thing])
        if was >= 0:
            self.history.before[row, thing] = was
        self.history.place[row, thing] = place
        self.history.since[row, thing] = slot
        if place >= 0:
            self.been[place, thing] = True
        return place >= 0 and self.history.before[row, thing] not in (-1, place)

    def recall(self, name: str, low: int, last: int, first: int, rate: float, config: RoutinesConfig) -> None:
        """Fill in what nobody saw of a thing between slot `low` and now, `last`, where it was seen.

        first : the oldest slot that counts. rate : with which anything moves, per slot.
        """
        thing = self.things[name]
        places = np.append(np.flatnonzero(self.been[:, thing]), -1)
        state = np.zeros(len(self.been) + 1, np.int64)
        state[places + 1] = np.arange(len(places))
        kernel = np.exp(-0.5 * (np.arange(-config.reach, config.reach + 1) / config.spread) ** 2)
        recall(
            self.history, self.sure, self.looked, thing, low, last, first, rate, kernel,
            0.5 ** (1.0 / config.half_life), config.prior, round(DAY / config.slot), state, places,
            zlib.crc32(f"{name} {last}".encode()),
        )  # fmt: skip

    def looks(self, place: int, slots: np.ndarray) -> str:
        """In which slots somebody looked at a place."""
        return packed(self.looked[slots % len(self.looked), place])

    def of(self, thing: int, slots: np.ndarray) -> dict[str, Any]:
        """What is known of one thing: stays (first slot remembered, since, place, before), and when it was seen."""
        rows = slots % len(self.sure)
        place, before, since = (each[rows, thing] for each in self.history)
        table = np.column_stack([slots, since, place, before]).astype(np.int64)
        changed = np.ones(len(table), bool)
        changed[1:] = np.any(table[1:, 1:] != table[:-1, 1:], axis=1)
        return {"stays": table[changed].tolist(), "sure": packed(self.sure[rows, thing])}

    def put(self, thing: int, slots: np.ndarray, known: Mapping[str, Any]) -> None:
        """What `of` told; where nobody says when it was seen, it was wherever it is said to have been."""
        runs = np.array(known["stays"], np.int64).reshape(-1, 4)
        run, rows = np.searchsorted(runs[:, 0], slots, side="right") - 1, slots % len(self.sure)
        for into, column in zip(self.history, (2, 3, 1), strict=True):
            into[rows, thing] = runs[run, column]
        self.been[np.unique(runs[runs[:, 2] >= 0, 2]), thing] = True
        there = self.history.place[rows, thing] >= 0
        self.sure[rows, thing] = unpacked(known["sure"], len(slots)) if "sure" in known else there


def packed(flags: np.ndarray) -> str:
    """Flags as text."""
    return base64.b64encode(zlib.compress(np.packbits(flags).tobytes())).decode()


def unpacked(text: str, count: int) -> np.ndarray:
    """So many flags that were `packed`. Raises ValueError."""
    try:
        flags = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    except zlib.error as error:
        raise ValueError(f"packed flags: {error}") from error
    return np.unpackbits(flags, count=count).astype(bool)


def _empty(rows: int, things: int) -> History:
    """A history in which nothing is known."""
    shape = rows, things
    return History(np.full(shape, -1, np.int16), np.full(shape, -1, np.int16), np.zeros(shape, np.int32))


def fill(history, last, now):
    """Copy the row of slot `last` to the slots behind it, up to `now`."""
    rows = len(history.place)
    behind = np.arange(max(last + 1, now - rows + 1), now + 1) % rows
    for each in history:
        each[behind] = each[last % rows]


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
def _transitions(place, thing, low, high, first, known, state, count, reach, fading, day):
    """Moves on other days at the times of day around low < slot ≤ high, as weights (high - low + 2 reach, S, S).

    first, known : slots that count. state (P + 1,) : number of each place, of nowhere first. count : S, of states.
    """
    rows, length = len(place), high - low + 2 * reach
    moves = np.zeros((length, count, count))
    for days in range((first - high) // day, (known - low) // day + 1):
        start = low + 1 - reach + days * day
        begin, end = max(start, first + 1), min(start + length, known + 1)
        if days == 0 or begin >= end:
            continue
        weight, row = fading ** abs(days), (begin - 1) % rows
        was = state[place[row, thing] + 1]
        for slot in range(begin, end):
            row = row + 1 if row + 1 < rows else 0
            to = state[place[row, thing] + 1]
            if not low < slot <= high:
                moves[slot - start, was, to] += weight
            was = to
    return moves


@njit(cache=True)
def _draw(weights):
    """An index, as probable as its weight."""
    left = np.random.random() * weights.sum()  # noqa: NPY002 -- seeded by `recall`
    chosen = -1
    for k in range(len(weights)):
        if weights[k] > 0.0:
            chosen, left = k, left - weights[k]
            if left < 0.0:
                break
    return chosen


@njit(cache=True)
def _course(place, looked, thing, low, high, moves, kernel, rate, prior, state, places):
    """Write where the thing was between slots `low` and `high`: a draw from all courses that fit the looks.

    Forward filtering, backward sampling of a Markov chain whose moves depend on the time of day. moves : as of
    `_transitions`; a thing moves with the probability `rate` per slot, which counts for `prior` days. places (S,) : of
    each state, the last is nowhere.
    """
    rows, count, length = len(place), len(places), high - low
    joint = np.zeros((length, count, count))  # of the states before and after a step, by the looks until then
    belief = np.zeros(count)
    belief[state[place[low % rows, thing] + 1]] = 1.0
    for step in range(length):
        after = np.zeros(count)
        for was in range(count):
            if belief[was] == 0.0:
                continue
            row = joint[step, was]
            for to in range(count):
                row[to] = prior * (1.0 - rate if was == to else rate / (count - 1))
                for w in range(len(kernel)):
                    row[to] += kernel[w] * moves[step + w, was, to]
            scale = belief[was] / row.sum()
            for to in range(count):
                row[to] *= scale
                after[to] += row[to]
        for to in range(count - 1):
            if looked[(low + 1 + step) % rows, places[to]] and step < length - 1:
                after[to] = 0.0  # somebody looked, and it was not there
        total = after.sum()
        for to in range(count):
            belief[to] = after[to] / total
    to = state[place[high % rows, thing] + 1]
    for step in range(length - 1, 0, -1):
        to = _draw(joint[step, :, to])
        place[(low + step) % rows, thing] = places[to]


@njit(cache=True)
def _follow(history, thing, low, high, last):
    """Write `before` and `since` anew behind slot `low`, up to where nothing changes behind `high`."""
    place, before, since = history.place, history.before, history.since
    rows = len(place)
    for slot in range(low + 1, last + 1):
        row, was = slot % rows, (slot - 1) % rows
        came, origin = since[was, thing], before[was, thing]
        if place[row, thing] != place[was, thing]:
            came = slot
            if place[was, thing] >= 0:
                origin = place[was, thing]
        if slot > high and since[row, thing] == came and before[row, thing] == origin:
            break
        since[row, thing], before[row, thing] = came, origin


@njit(cache=True)
def recall(
    history, sure, looked, thing, low, last, first, rate, kernel, fading, prior, day, state, places, seed
):
    """Fill in what nobody saw of a thing between slots `low` and `last`, and `AGAIN` of its older gaps anew.

    sure (R, N) : whether it was seen, as it was in slot `last`. looked (R, P) : whether somebody looked at a place.
    first : the oldest slot that counts. The others are as of `_course`. Drawn again and again, by what is known
    meanwhile, gaps and moves settle to what fits all looks (Gibbs sampling).
    """
    np.random.seed(seed)  # noqa: NPY002 -- the stream of compiled functions, nobody else's
    rows, reach = len(sure), len(kernel) // 2
    begin, end, known = low, last, low
    for turn in range(AGAIN + 1):
        if turn > 0:
            if last - first < day:
                break
            days = np.random.randint(1, (last - first) // day + 1)  # noqa: NPY002
            end = last - day * days
            while not sure[end % rows, thing]:
                end += 1
            begin, known = end - 1, last
            while begin > max(first, end - GAP * day) and not sure[begin % rows, thing]:
                begin -= 1
        if first <= begin < end - 1:
            moves = _transitions(
                history.place, thing, begin, end, first, known, state, len(places), reach, fading, day
            )
            _course(history.place, looked, thing, begin, end, moves, kernel, rate, prior, state, places)
            _follow(history, thing, begin, end, last)

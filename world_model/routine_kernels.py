"""Past moments like the present one, and what came after them: the loops of `world_model.routines`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

# mypy: disable-error-code="no-untyped-def"


class History(NamedTuple):
    """Where N things were, over a ring of R rows: slot t of time is row t mod R.

    place : (R, N) index of the place, -1 where nobody knows. before : (R, N) the place it was at before that, or -1.
    since : (R, N) the slot in which it came, or went missing.
    """

    place: np.ndarray
    before: np.ndarray
    since: np.ndarray


class Likeness(NamedTuple):
    """How alike two moments are; the log weights of all parts add up.

    window : largest difference of the time of day, slots. clock : deviation of its Gaussian, slots.
    half_life : days until a moment counts half. differs : for each thing that is at another place.
    recent : for each thing that moved within the last `moved` slots at one of the moments only.
    stay : deviation of the log of how long the thing itself has been there. origin : where it came from elsewhere.
    """

    window: int
    clock: float
    half_life: float
    differs: float
    recent: float
    moved: int
    stay: float
    origin: float


FAINT = (
    0.1  # of a move in the middle of what nobody saw, beside one at a time of day at which it was seen before
)
FAR = 12.0  # largest squared deviation of the stay: a moment is never ruled out by it alone


@njit(cache=True)
def fill(history, last, now):
    """Copy the row of slot `last` to the slots behind it, up to `now`."""
    rows = len(history.place)
    source = last % rows
    for slot in range(max(last + 1, now - rows + 1), now + 1):
        row = slot % rows
        if row != source:
            history.place[row] = history.place[source]
            history.before[row] = history.before[source]
            history.since[row] = history.since[source]


@njit(cache=True)
def moments(history, slot, first, last, day, like):
    """Past moments at about the time of day of `slot`, and how alike they are by all that was where.

    first, last : slots that are known. day : slots of a day. like : `Likeness`.
    Returns slots (E,), newest day first, and log weights (E,), of which only differences mean anything.
    """
    rows, things = history.place.shape
    days = max((last - first) // day + 2, 1)
    found = np.empty(days * (2 * like.window + 1), np.int64)
    weights = np.empty(len(found))
    number = 0
    now = slot % rows
    for age in range(1, days + 1):
        for shift in range(-like.window, like.window + 1):
            other = slot - age * day + shift
            if other < first or other >= last:
                continue
            then = other % rows
            cost = 0.5 * (shift / like.clock) ** 2 + age * math.log(2.0) / like.half_life
            for k in range(things):
                here, there = history.place[now, k], history.place[then, k]
                if here < 0 or there < 0:
                    continue
                if here != there:
                    cost += like.differs
                fresh = slot - history.since[now, k] < like.moved
                if fresh != (other - history.since[then, k] < like.moved):
                    cost += like.recent
            found[number], weights[number] = other, -cost
            number += 1
    return found[:number], weights[:number]


@njit(cache=True)
def _own(history, thing, slot, found, weights, last, like):
    """Log weights (E,) for one thing: -inf where it was elsewhere, or what came after is not known by `last`."""
    rows = len(history.place)
    now = slot % rows
    age = slot - history.since[now, thing]
    scores = np.full(len(found), -np.inf)
    for i in range(len(found)):
        row = found[i] % rows
        if history.place[row, thing] != history.place[now, thing] or found[i] > last:
            continue
        ratio = math.log((age + 1.0) / (found[i] - history.since[row, thing] + 1.0))
        scores[i] = weights[i] - 0.5 * min((ratio / like.stay) ** 2, FAR)
        if history.before[row, thing] != history.before[now, thing]:
            scores[i] -= like.origin
    return scores


@njit(cache=True)
def _outcome(history, thing, slot, ahead, moving, last):
    """Where the thing was `ahead` slots after `slot` (-1: unknown); with `moving`, where its first move led to.

    What went missing has moved: to where it was next seen by slot `last`. Seen where it had been, it was elsewhere.
    """
    rows = len(history.place)
    if not moving:
        return history.place[(slot + ahead) % rows, thing]
    start = history.place[slot % rows, thing]
    for gone in range(slot + 1, slot + ahead + 1):
        there = history.place[gone % rows, thing]
        while there < 0 and gone < last:
            gone += 1
            there = history.place[gone % rows, thing]
            if there == start:
                return -1
        if there != start:
            return there
    return start


@njit(cache=True)
def outcomes(history, thing, slot, found, weights, last, ahead, day, moving, like, out):
    """What came after moments like `slot` for one thing, as sums of weights by place, written to `out` (P,).

    last : the newest slot that is known. ahead : slots. moving : its first move within `ahead`, not where it was then.
    Returns how many days speak, each by its most similar moment: what smoothing has to yield to.
    """
    out[:] = 0.0
    scores = _own(history, thing, slot, found, weights, last - ahead, like)
    best = -np.inf
    for i in range(len(found)):
        if scores[i] > best:
            best = scores[i]
    evidence = strongest = 0.0
    current = -1
    for i in range(len(found)):
        if scores[i] == -np.inf:
            continue
        where = _outcome(history, thing, found[i], ahead, moving, last)
        if where < 0:
            continue
        weight = math.exp(scores[i] - best)
        out[where] += weight
        of_day = (slot - found[i] + day // 2) // day
        if of_day != current:
            evidence += strongest
            strongest, current = 0.0, of_day
        strongest = max(strongest, weight)
    return evidence + strongest


@njit(cache=True)
def stays(history, thing, place, first, last):
    """Stays of one thing at a place that ended: rows (slot it came, slot it was gone, place it went to, or -1)."""
    rows = len(history.place)
    found = np.empty((last - first + 1, 3), np.int64)
    number = 0
    came = -1
    for slot in range(first, last + 1):
        where = history.place[slot % rows, thing]
        if where == place:
            if came < 0:
                came = slot
        elif came >= 0:
            gone = slot
            to = where
            ahead = slot
            while to < 0 and ahead < last:
                ahead += 1
                to = history.place[ahead % rows, thing]
            found[number, 0], found[number, 1], found[number, 2] = came, gone, to
            number += 1
            came = -1
    return found[:number]


@njit(cache=True)
def likely_slot(history, thing, place, to, low, high, first, day, spread):
    """In which slot of low < slot ≤ high the thing went from `place` to `to`: when it usually does, or in the middle.

    spread : deviation of its times of day, slots.
    """
    if high - low <= 1:
        return high
    ended = stays(history, thing, place, first, low)
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


@njit(cache=True)
def amend(history, thing, gone, came, now, place, to):
    """What nobody saw happen: the thing left `place` in slot `gone` and was at `to` from slot `came` to `now`."""
    rows = len(history.place)
    for slot in range(gone, now + 1):
        row = slot % rows
        there = slot >= came
        history.place[row, thing] = to if there else -1
        history.before[row, thing] = place
        history.since[row, thing] = came if there else gone


@njit(cache=True)
def still(history, thing, start, stop):
    """The thing was from slot `start` to `stop`, the latter excluded, what it was in the slot before `start`."""
    rows = len(history.place)
    source = (start - 1) % rows
    for slot in range(start, stop):
        row = slot % rows
        history.place[row, thing] = history.place[source, thing]
        history.before[row, thing] = history.before[source, thing]
        history.since[row, thing] = history.since[source, thing]

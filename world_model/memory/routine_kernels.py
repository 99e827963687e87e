"""Past moments like the present one, and what came after them: the sums and loops of `world_model.memory.routines`.

A forecast is made of arrays alone: somebody who asks once does not wait until compiled functions have been read.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

# mypy: disable-error-code="no-untyped-def"
AGAIN = 8  # older gaps filled anew with each new one; HOMER does a little better by 8 than by 4
GAP = 7  # days of a gap that are filled
FAR = 12.0  # largest squared deviation of the stay: a moment is never ruled out by it alone


class History(NamedTuple):
    """Where N things were, over a ring of R rows: slot t of time is row t mod R.

    place : (R, N) index of the place, -1 where nobody knows. since : (R, N) the slot in which it came, or went missing.
    sure : (R, N) whether it was seen in a slot.
    """

    place: np.ndarray
    since: np.ndarray
    sure: np.ndarray


class ThingMoves(NamedTuple):
    """How one thing moves, for what nobody saw of it: a Markov chain over S states, where it ever was and nowhere.

    thing : its column. state (P + 1,) : number of each place, of nowhere first. places (S,) : of each state, the last
    is nowhere. kernel : weights of times of day around one, fading : factor per day on what other days say. rate :
    probability per slot of a move of anything, which counts for `prior` days. day : slots of a day.
    """

    thing: int
    state: np.ndarray
    places: np.ndarray
    kernel: np.ndarray
    fading: float
    rate: float
    prior: float
    day: int


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
    place, since = history.place[:, thing], history.since[:, thing]
    ratio = np.log((slot - since[now] + 1.0) / (found - since[then] + 1.0))
    scores = weights - 0.5 * np.minimum((ratio / config.stay) ** 2, FAR)
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


def outcomes(history, thing, slot, alike, times, moving, config, count):
    """What came after moments like `slot` for one thing, as sums of weights by place (`count`,).

    alike : as of `moments`. times : the newest slot that is known, slots ahead, slots of a day. moving : its first move
    within the slots ahead, not where it was then.
    Returns the sums, and how many days speak, each by its most similar moment: what smoothing has to yield to.
    """
    (found, weights), (last, ahead, day) = alike, times
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
def _transitions(place, chain, low, high, first, known):
    """Moves on other days at the times of day around low < slot ≤ high, as weights (high - low + 2 reach, S, S).

    first, known : slots that count.
    """
    rows, reach, day, count = len(place), len(chain.kernel) // 2, chain.day, len(chain.places)
    length = high - low + 2 * reach
    moves = np.zeros((length, count, count))
    for days in range((first - high) // day, (known - low) // day + 1):
        start = low + 1 - reach + days * day
        begin, end = max(start, first + 1), min(start + length, known + 1)
        if days == 0 or begin >= end:
            continue
        weight, row = chain.fading ** abs(days), (begin - 1) % rows
        was = chain.state[place[row, chain.thing] + 1]
        for slot in range(begin, end):
            row = row + 1 if row + 1 < rows else 0
            to = chain.state[place[row, chain.thing] + 1]
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
def _course(place, looked, chain, low, high, moves):
    """Write where the thing was between slots `low` and `high`: a draw from all courses that fit the looks.

    Forward filtering, backward sampling of a Markov chain whose moves, as of `_transitions`, depend on the time of day.
    """
    rows, count, length = len(place), len(chain.places), high - low
    joint = np.zeros((length, count, count))  # of the states before and after a step, by the looks until then
    belief = np.zeros(count)
    belief[chain.state[place[low % rows, chain.thing] + 1]] = 1.0
    for step in range(length):
        after = np.zeros(count)
        for was in range(count):
            if belief[was] == 0.0:
                continue
            row = joint[step, was]
            for to in range(count):
                row[to] = chain.prior * (1.0 - chain.rate if was == to else chain.rate / (count - 1))
                for w in range(len(chain.kernel)):
                    row[to] += chain.kernel[w] * moves[step + w, was, to]
            scale = belief[was] / row.sum()
            for to in range(count):
                row[to] *= scale
                after[to] += row[to]
        for to in range(count - 1):
            if looked[(low + 1 + step) % rows, chain.places[to]] and step < length - 1:
                after[to] = 0.0  # somebody looked, and it was not there
        total = after.sum()
        for to in range(count):
            belief[to] = after[to] / total
    to = chain.state[place[high % rows, chain.thing] + 1]
    for step in range(length - 1, 0, -1):
        to = _draw(joint[step, :, to])
        place[(low + step) % rows, chain.thing] = chain.places[to]


@njit(cache=True)
def _follow(history, thing, low, high, last):
    """Write `since` anew behind slot `low`, up to where nothing changes behind `high`."""
    place, since = history.place, history.since
    rows = len(place)
    for slot in range(low + 1, last + 1):
        row, was = slot % rows, (slot - 1) % rows
        came = since[was, thing] if place[row, thing] == place[was, thing] else slot
        if slot > high and since[row, thing] == came:
            break
        since[row, thing] = came


@njit(cache=True)
def recall(history, looked, chain, low, last, first, seed):
    """Fill in what nobody saw of a thing between slots `low` and `last`, and `AGAIN` of its older gaps anew.

    It was seen in slot `last`. looked (R, P) : whether somebody looked at a place. first : the oldest slot that counts.
    Drawn again and again, by what is known meanwhile, gaps and moves settle to what fits all looks (Gibbs sampling).
    """
    np.random.seed(seed)  # noqa: NPY002 -- the stream of compiled functions, nobody else's
    sure, day = history.sure[:, chain.thing], chain.day
    rows = len(sure)
    begin, end, known = low, last, low
    for turn in range(AGAIN + 1):
        if turn > 0:
            if last - first < day:
                break
            days = np.random.randint(1, (last - first) // day + 1)  # noqa: NPY002
            end = last - day * days
            while not sure[end % rows]:
                end += 1
            begin, known = end - 1, last
            while begin > max(first, end - GAP * day) and not sure[begin % rows]:
                begin -= 1
        if first <= begin < end - 1:
            moves = _transitions(history.place, chain, begin, end, first, known)
            _course(history.place, looked, chain, begin, end, moves)
            _follow(history, chain.thing, begin, end, last)

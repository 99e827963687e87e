"""Where things were: the stays of an object at places, read from a store's history; and the routines these teach."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.places import Place
from world_model.memory.routines import FORMAT, VERSION, Routines, RoutinesConfig
from world_model.memory.store_records import Sight
from world_model.state import BELIEVED, DAY, WorldObject

MOST = 25_000  # Rows of history that are looked through for all objects at once: some weeks of a busy home
STEP = 0.005  # m: what moves less from row to row rests
APART = 0.5  # m: so far from where it was something has been moved, where no other place says so
AWAY = 900.0  # s: what was missing for longer and is back began another stay
PRIOR = 2.0 * DAY  # s in which anything is taken to have moved once
BACK_AGAIN = 0.25  # Share of moves between two looks that lead back before the second
FOUND_AFTER = 1200.0  # s: what was missing is found about so long after it came back


class PlaceWords:
    """Names of the places around positions: the smallest piece of furniture, or room, "" where there is none."""

    def __init__(self, places: Iterable[Place]) -> None:
        # What is found last is said: the smallest furniture.
        self._ordered = sorted(places, key=lambda place: (place.kind != "room", -place.area))
        self._names = ["", *(place.name for place in self._ordered)]
        boxes = [
            (*place.polygon.min(0), place.height[0], *place.polygon.max(0), place.height[1])
            for place in self._ordered
        ]
        self._lows, self._highs = np.hsplit(np.array(boxes).reshape(-1, 6), 2)
        # Within the bounds of a rectangle is within it: most need no further look.
        bounds = np.prod((self._highs - self._lows)[:, :2], axis=1)
        self._is_box = [
            place.area > (1.0 - 1e-9) * m2 for place, m2 in zip(self._ordered, bounds, strict=True)
        ]

    def __call__(self, positions: FloatArray) -> list[str]:
        """Of each position (N, 3), m; rows that rest share theirs."""
        if not len(positions):
            return []
        steps = np.concatenate([[True], np.abs(np.diff(positions, axis=0)).max(1) > STEP])
        firsts = positions[steps]
        last = np.zeros(len(firsts), np.int64)
        near = ((firsts[:, None] >= self._lows) & (firsts[:, None] <= self._highs)).all(2)
        for number in np.flatnonzero(near.any(0)).tolist():
            rows = np.flatnonzero(near[:, number])
            if not self._is_box[number]:
                rows = rows[self._ordered[number].contains(firsts[rows])]
            last[rows] = number + 1
        return [self._names[index] for index in last[np.cumsum(steps) - 1].tolist()]


class ObjectStay(NamedTuple):
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

    def is_where(self, other: ObjectStay) -> bool:
        """Whether another stay is at the same place, where none is named so near that nothing was moved."""
        return self.place == other.place and (bool(self.place) or self.is_near(other.position))

    def is_near(self, position: FloatArray) -> bool:
        """Whether nothing has to be moved from here to a position (3,), m."""
        return bool(np.linalg.norm(position[:2] - self.position[:2]) < APART)


@dataclass(frozen=True)
class Timeline:
    """The stays of one object, oldest first. lost : nobody knows where it is at the end. cut : whether there is more of
    it, before these stays, that was not read."""

    id: str
    stays: tuple[ObjectStay, ...]
    lost: bool
    cut: bool = False

    @property
    def begun(self) -> bool:
        """Whether it is known when the first stay began."""
        return bool(self.stays) and (not self.cut or math.isfinite(self.stays[0].came_after))

    @property
    def rate(self) -> float:
        """1/s, at which it moves, with what is known of anything; there is a stay."""
        known = self.stays[-1].until - self.stays[0].since
        return len(self.stays) / (known + PRIOR)

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

    def last(self, stamp: float) -> ObjectStay | None:
        """The newest stay that had begun by a moment."""
        index = bisect_right(self.stays, stamp, key=lambda stay: stay.since) - 1
        return self.stays[index] if index >= 0 else None

    def found_by(self, stamp: float) -> ObjectStay | None:
        """Where it was found last before a moment, None where it was not there yet, or found to have gone since."""
        stay = self.last(stamp)
        return None if stay is None or (stay.left_by or math.inf) <= stamp else stay

    def within(self, start: float, end: float) -> list[ObjectStay]:
        """The stays that overlap a span."""
        return [stay for stay in self.stays if stay.until >= start and stay.since <= end]

    def shares(self, start: float, end: float) -> dict[str, float]:
        """`shares_of` the time between two moments."""
        return self.shares_of([(start, end)])

    def shares_of(self, spans: Iterable[tuple[float, float]], absent: bool = False) -> dict[str, float]:
        """Share of the time of some spans, each from and to, that it was at each place.

        absent : of all the time since it was first seen, else of that in which it was anywhere.
        """
        spent: Counter[str] = Counter()
        there = 0.0
        for start, end in spans:
            spent.update(self.spent(start, end))
            there += max(end - max(start, self.stays[0].since), 0.0) if self.stays else 0.0
        total = max(sum(spent.values()), there if absent else 0.0)
        return {place: seconds / total for place, seconds in spent.items()} if total > 0.0 else {}

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

    def course(self) -> list[tuple[float, str | None]]:
        """From which stamp on it was where, None for nowhere."""
        return [
            (stamp, place)
            for stay in self.stays
            for stamp, place in ((stay.since, stay.place), (stay.left_by, None))
            if stamp is not None
        ]

    def after(self, earlier: Timeline) -> Timeline:
        """With the stays that it had before, under another id."""
        if not earlier.stays or not self.stays:
            return replace(self, stays=earlier.stays + self.stays, cut=earlier.cut)
        last, first = earlier.stays[-1], self.stays[0]
        if last.place == first.place and last.place and first.since - last.until < AWAY:
            first = first._replace(came_after=last.came_after, since=last.since, seen=last.seen + first.seen)
            between: tuple[ObjectStay, ...] = (first,)
        else:
            last = last._replace(left_by=min(last.left_by or first.since, first.since))
            between = last, first._replace(came_after=last.until)
        return replace(self, stays=(*earlier.stays[:-1], *between, *self.stays[1:]), cut=earlier.cut)


def timeline_of(
    object_id: str,
    rows: list[Sight],
    words: PlaceWords,
    item: WorldObject | None,
    now: float,
    start: float = -math.inf,
    coarse: bool = False,
) -> Timeline:
    """The stays of one id by its rows of history from the last before `start`, s, on.

    item : it as it is known `now`, None where that is of no interest, or it is no longer known. coarse : the rows do
    not say whether it was seen again; it has then stayed until it was missed, or found elsewhere, however soon.
    """
    stamps = [row[0] for row in rows]
    here = [row[1] != "gone" and not row[4] and row[3] >= BELIEVED for row in rows]
    seen = [row[5] for row in rows]
    new = bool(rows) and rows[0][1] == "appeared"
    cut = bool(rows) and not new and stamps[0] <= start
    if new and here[0]:  # believed in only after some looks
        seen[0] = stamps[0] = rows[0][6]
    positions = np.frombuffer(b"".join(row[2] for row in rows), "<f8").reshape(-1, 3)
    if item is not None and not rows:  # all that is known is the present
        stamps, here, seen, positions = [item.first_seen], [True], [item.first_seen], item.position[None]
    if item is not None:
        stamps.append(max(now, stamps[-1]))
        here.append(not item.lost and item.existence >= BELIEVED)
        seen.append(item.last_seen)
        positions = np.vstack([positions, item.position[None]])
    stays = _stays(stamps, here, seen, positions, words(positions), 0.0 if coarse else AWAY)
    if coarse:
        found = [*(stay.since for stay in stays[1:]), None]
        ends = [stay.left_by or since or stay.until for stay, since in zip(stays, found, strict=False)]
        stays = [stay._replace(until=end) for stay, end in zip(stays, ends, strict=True)]
    return Timeline(object_id, tuple(stays), not here[-1] if here else True, cut)


def _stays(
    stamps: list[float],
    here: list[bool],
    seen: list[float],
    positions: FloatArray,
    words: list[str],
    away: float,
) -> list[ObjectStay]:
    """Rows of history joined where an object is still at the same place."""
    stays: list[ObjectStay] = []
    absent = -math.inf
    for begin, end in _runs(here, positions, words):
        stamp, position, word = stamps[begin], positions[begin], words[begin]
        current = stays[-1] if stays else None
        if not here[begin]:
            absent = stamp
            if current is not None and not current.gone:
                # A measurement up to here still found it there.
                until = min(max(current.until, seen[begin]), stamp)
                stays[-1] = current._replace(until=until, left_by=stamp)
            continue
        until = min(seen[end - 1], stamps[end - 1])
        if current is not None and _goes_on(current, word, position, stamp, away):
            until, seen_now = max(current.until, until), current.seen + end - begin
            stays[-1] = current._replace(until=until, left_by=None, seen=seen_now)
            continue
        after = current.until if current is not None else absent
        since = min(seen[begin], stamp) if seen[begin] > after else stamp
        stays.append(ObjectStay(word, after, since, max(since, until), None, position, end - begin))
    return stays


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


def _goes_on(current: ObjectStay, word: str, position: FloatArray, stamp: float, away: float) -> bool:
    """Whether what is seen still belongs to a stay."""
    if current.place != word:
        return False
    if (not word or current.gone) and not current.is_near(position):
        return False
    return current.left_by is None or stamp - current.left_by < away


def routines_of(lines: Iterable[Timeline], start: float, now: float, days: int) -> Routines:
    """What so many days of stays since `start`, s, teach."""
    config = RoutinesConfig(days=days)
    courses = {line.id: line.course() for line in lines if line.stays}
    seen = {line.id: line.stays[-1].until for line in lines if line.stays}
    begun = min((course[0][0] for course in courses.values()), default=now)
    first = math.floor(max(start, begun) / config.slot)
    last = math.floor(now / config.slot)
    places = (place for course in courses.values() for _, place in course if place is not None)
    number = {name: index for index, name in enumerate(dict.fromkeys(places))}
    moves, things = 0, []
    for name, course in courses.items():
        runs, at = [[first, first, -1]], -1
        for stamp, place in course:
            # What has gone is still there in the slot in which it went.
            slot = math.floor(stamp / config.slot) + (place is None)
            row = [max(slot, first), slot, -1 if place is None else number[place]]
            moves += place is not None and row[0] > first and at not in (-1, row[2])
            at = at if place is None else row[2]
            if runs[-1][0] == row[0]:
                runs.pop()
            runs.append(row)
        things.append({"name": name, "seen": seen[name], "stays": runs})
    data = {
        "format": FORMAT, "version": VERSION, "config": config.__dict__, "stamp": now, "first": first, "last": last,
        "moves": float(moves), "exposure": float(len(courses) * (last - first)), "places": dict.fromkeys(number),
        "objects": things,
    }  # fmt: skip
    return Routines.from_dict(data)

"""Where things usually are at a time of day: a behaviour learned from the store's history (section 2.4.2).

For each object, and for each class, how long it was at each named place in each hour of the day.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import groupby
from typing import Protocol

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.places import Places
from world_model.memory.store_records import Note
from world_model.state import DAY, Box, WorldObject

BINS = 24
NEIGHBOR = 0.5  # Weight of the hour before and the hour after
OF_CLASS = 0.2  # Weight of what others of its class do, beside what it does itself
DOUBT = 1800.0  # s: what was watched for this long at a time of day is believed by half to be a habit
LEAST = 900.0  # s: and less than this says nothing
WATCHED = 60.0  # s: for how long after its last measurement something counts as watched


class NoteSource(Protocol):
    """The part of a store that habits are learned from."""

    def notes(self) -> Iterable[Note]: ...


class Habits:
    """Seconds per place and hour of the day, by object and by class. The stamps' own clock says what time it is."""

    def __init__(self, places: Places) -> None:
        self.places = places
        self._names = [place.name for place in places]
        self._seconds: dict[str, FloatArray] = {}
        self._total: dict[str, FloatArray] = {}
        self._spreads: dict[tuple[float, ...], FloatArray] = {}
        self._at = -np.inf

    def add(self, item: WorldObject, begin: float, end: float) -> None:
        """An object was where it is from `begin` to `end`, s; of more than a day the last counts."""
        if self._names and not item.lost:
            self._count(item.id, item.most_probable("class"), item.position, item.covariance, begin, end)

    def _count(
        self, name: str, kind: str, position: FloatArray, covariance: FloatArray, begin: float, end: float
    ) -> None:
        if not end > begin:
            return
        spread = self._spread(position, covariance)
        begin = max(begin, end - DAY)
        while begin < end:
            hour = np.floor(begin / DAY * BINS + 1e-9)
            until = min(end, (hour + 1.0) * DAY / BINS)
            for key in (f"id {name}", f"class {kind}"):
                if key not in self._seconds:
                    self._seconds[key] = np.zeros((BINS, len(self._names)))
                    self._total[key] = np.zeros(BINS)
                self._seconds[key][int(hour) % BINS] += (until - begin) * spread
                self._total[key][int(hour) % BINS] += until - begin
            begin = until

    def learn(self, store: NoteSource) -> None:
        """Everything that a store's history says: objects stay where they were noted until they are noted elsewhere."""
        if not self._names:
            return
        for _, of_one in groupby(store.notes(), key=lambda note: (note.epoch, note.object_id)):
            notes = list(of_one)
            for note, after in zip(notes, [*notes[1:], None], strict=True):
                if note.lost or note.event in ("lost", "gone"):
                    continue
                end = note.last_seen + WATCHED
                if after is not None:
                    stayed = math.dist(after.position, note.position) < 0.5
                    end = after.stamp if stayed else min(end, after.stamp)
                where = note.position, note.covariance
                self._count(note.object_id, note.kind, *where, note.stamp, max(end, note.stamp))

    def watch(self, objects: Iterable[WorldObject], stamp: float) -> None:
        """Take in where things are now; call it with every world, once a minute something is done."""
        if stamp < self._at:
            self._at = -np.inf
        if stamp - self._at < WATCHED or not self._names:
            return
        for item in objects:
            if stamp - item.last_seen < WATCHED:
                self.add(item, max(self._at, item.first_seen, stamp - WATCHED), stamp)
        self._at = stamp

    def shares(self, object_id: str, class_name: str, stamp: float) -> tuple[dict[str, float], float]:
        """Where an object usually is at this time of day, by place, and how far that can be believed, in [0, 1]."""
        hour = int(np.floor(stamp % DAY / DAY * BINS))
        seconds, total = np.zeros(len(self._names)), 0.0
        for key, weight in ((f"id {object_id}", 1.0), (f"class {class_name}", OF_CLASS)):
            if key not in self._seconds:
                continue
            for offset, near in ((-1, NEIGHBOR), (0, 1.0), (1, NEIGHBOR)):
                at = (hour + offset) % BINS
                seconds += weight * near * self._seconds[key][at]
                total += weight * near * float(self._total[key][at])
        if total < LEAST:
            return {}, 0.0
        return dict(zip(self._names, (seconds / total).tolist(), strict=True)), total / (total + DOUBT)

    def where(self, item: WorldObject, stamp: float, trust: float, region: Box) -> dict[str, float]:
        """Probability by place of a lost object: where it usually is, with probability `trust`, else anywhere."""
        usual, believed = self.shares(item.id, item.most_probable("class"), stamp)
        if not usual:
            return {}
        weight = trust * believed
        return {
            name: (1.0 - weight) * share + weight * usual.get(name, 0.0)
            for name, share in self.places.shares(region).items()
        }

    def odds(
        self, object_id: str, class_name: str, spot: FloatArray, stamp: float, trust: float, area: float
    ) -> float:
        """How much likelier an object is put down at `spot` (3,) by habit than anywhere in `area` m²."""
        usual, believed = self.shares(object_id, class_name, stamp)
        around = [place for place in self.places if place.contains(spot[:2])]
        if not usual or not around:
            return 1.0 if not usual else 1.0 - trust * believed
        # Furniture says more than the room around it.
        place = min(around, key=lambda place: place.area)
        return 1.0 - trust * believed + trust * believed * usual[place.name] * area / place.area

    def _spread(self, position: FloatArray, covariance: FloatArray) -> FloatArray:
        """Probabilities (P,) of the places; positions to the decimetre share theirs."""
        variance = max(*covariance.diagonal().tolist(), 1e-6)
        key = (*(round(10 * x) for x in position.tolist()), round(0.5 * math.log2(variance)))
        if key not in self._spreads:
            found = self.places.probabilities(position, covariance)
            self._spreads[key] = np.array([found[name] for name in self._names])
            if len(self._spreads) > 10_000:
                self._spreads.clear()
                return self._spread(position, covariance)
        return self._spreads[key]

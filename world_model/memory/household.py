"""The routines of a home, learned from what a world model believes: where things are by now though nobody looks.

They say where a thing has gone that is not where it was, and so which of several lost things was found; and where one
is by now that nobody has seen for a while, if it has moved on some days.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from estimation.checks import FloatArray
from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model.config import WorldModelConfig, motion_of
from world_model.kept_file import KeptFile, read_kept, write_kept
from world_model.memory.routines import Routines, RoutinesConfig
from world_model.memory.stays import MOST, PlaceWords, routines_of, timeline_of
from world_model.memory.store import Store
from world_model.state import DAY, PERSON, WorldObject
from world_model.symbols import parse_symbol

FORMAT, VERSION = "whereabouts.household", 1
PERIOD = 120.0  # s between two looks at the believed world, and for which a forecast holds
SURE = 0.7
"""Probability of a place from which on a thing is said to be there: one at an edge does not move to and fro."""
UNSEEN = 600.0  # s after which a thing that nobody has seen may be elsewhere by now
MANY = 200
"""Things that are followed from the start; of more only those that are seen to move. Memory goes by things and days."""
DAYS = 60
SUFFIX = ".routines"
STAYS = 0.9  # Probability of still being there from which on nothing else is said


class Household:
    """places : where things can be. path : of the file that keeps what was learned, or None.

    aliases : symbols that things had before somebody renamed them. kept : the file.
    """

    def __init__(self, places: Places, path: Path | None = None) -> None:
        self.places = places
        self._rooms = {
            place.name: room.name
            for place in places.furniture
            if (room := places.room_of(place.polygon.mean(0))) is not None
        }
        self.smallest = min((place.area for place in places), default=math.inf)  # m²
        self.routines = Routines(RoutinesConfig(days=DAYS))
        self.aliases: dict[str, str] = {}
        self._at: dict[str, str] = {}
        self._watched = -math.inf
        self.kept = KeptFile(path, "routines", self.read, self.write)
        self._furniture = [place.name for place in places.furniture]
        self.routines.know(self._furniture)

    # Learning.

    def learn(self, store: Store) -> None:
        """What a store's history teaches, where nothing was kept beside it."""
        run, now, _ = store.newest()
        if self.routines.objects or now is None or not self.places:
            return
        present = {item.id: item for item in store.present()}
        (rows, start), words = store.happened(now - DAYS * DAY, MOST), PlaceWords(self.places)
        lines = [
            timeline_of(
                name,
                store.sights(name, run, start, start) + rows.get(name, []),
                words,
                present.get(name),
                now,
                start,
                True,
            )
            for name in dict.fromkeys([*present, *rows])
            if (present[name].most_probable("class") if name in present else _kind(name)) != PERSON
        ]
        self.routines = routines_of(lines, start, now, DAYS)
        self.routines.know(self._furniture)
        self._at |= {line.id: line.stays[-1].place for line in lines if not line.lost}

    def due(self, stamp: float) -> bool:
        """Whether it is time to `watch` again."""
        if stamp < self._watched - PERIOD:
            self._watched = stamp  # another time: nothing is learned until it has caught up
        return bool(self.places) and stamp - self._watched >= PERIOD and stamp >= self._newest

    @property
    def _newest(self) -> float:
        stamp = self.routines.to_stamp
        return -math.inf if stamp is None else stamp

    def watch(self, objects: Iterable[WorldObject], stamp: float) -> None:
        """Take in where described things (`Words.described`) are believed to be; what moves by itself is left out."""
        before, self._watched = self._watched, stamp
        now: dict[str, str] = {}
        fresh: set[str] = set()
        for item in objects:
            if item.lost or item.behaviors.get("constant_velocity", 0.0) > 0.5:
                continue
            sure = bool(item.place) and item.place_probability >= SURE
            place = item.place if sure else self._at.get(item.id, "")
            if place:
                now[item.id] = place
                if item.last_seen > before:
                    fresh.add(item.id)
        changed = {name for name in now.keys() | self._at.keys() if now.get(name) != self._at.get(name)}
        self._follow(now, changed & now.keys(), stamp)
        places = {now[name] for name in fresh | changed if name in now}
        places |= {self._at[name] for name in changed if name in self._at}
        self._at |= now
        for name in changed - now.keys():
            del self._at[name]
        for place in sorted(places):
            self.routines.look(place, self._followed(name for name in now if now[name] == place), stamp)

    def _follow(self, now: Mapping[str, str], changed: Iterable[str], stamp: float) -> None:
        """A thing that was not followed, and is now seen to move, is followed from where it was."""
        known = set(self.routines.objects)
        for name in changed:
            old = self._at.get(name)
            if old and old != now[name] and name not in known:
                there = [other for other, at in self._at.items() if at == old and other in known]
                self.routines.look(old, [*there, name], stamp)

    def _followed(self, names: Iterable[str]) -> list[str]:
        known = set(self.routines.objects)
        return [name for name in names if name in known or len(known) < MANY]

    def rename(self, name: str, new: str) -> None:
        """A thing has another symbol."""
        self.routines.rename(name, new)
        if name in self._at:
            self._at[new] = self._at.pop(name)
        self.aliases = {old: new if kept == name else kept for old, kept in self.aliases.items()} | {
            name: new
        }
        self.aliases.pop(new, None)

    # Forecasts.

    def by_now(self, name: str, stamp: float) -> dict[str, float]:
        """Probability of each place, a room's with that of its furniture; {} for what has no routines yet."""
        if not self.routines.are_known_of(name) or stamp < self._newest:
            return {}
        return self._by_place(self.routines.where(name, stamp))

    def gone_to(self, name: str, kind: str, stamp: float) -> dict[str, float]:
        """The same of a thing that is not where it was: where it goes from there, or things of its class are.

        {} where neither it nor any of its class has routines yet.
        """
        alike = self._alike(name, kind)
        if not (alike or self.routines.are_known_of(name)):
            return {}
        return self._by_place(self.routines.where(name, max(stamp, self._newest), left=True, alike=alike))

    def _alike(self, name: str, kind: str) -> list[str]:
        """Other things of a class that have routines."""
        others = (other for other in self.routines.objects if other != name and _kind(other) == kind)
        return [other for other in others if self.routines.are_known_of(other)]

    def odds(
        self, object_id: str, class_name: str, spot: FloatArray, stamp: float, trust: float, area: float
    ) -> float:
        """How much likelier a thing that was carried is put down at `spot` (3,) than anywhere in `area` m².

        trust : that it goes where it usually does.
        """
        around = [place for place in self.places if place.contains(spot[:2])]
        alike = self._alike(object_id, class_name)
        usual = {}
        # What is still believed to be where it was is weighed by evidence alone.
        if object_id not in self._at and (alike or self.routines.are_known_of(object_id)):
            # It was seen there: that others had looked there in vain says nothing any more.
            usual = self._by_place(self.routines.goes(object_id, max(stamp, self._newest), alike))
        if not usual or not around:
            return 1.0 if not usual else 1.0 - trust
        # Furniture says more than the room around it.
        place = min(around, key=lambda place: place.area)
        return 1.0 - trust + trust * usual[place.name] * area / place.area

    def _by_place(self, found: Mapping[str, float]) -> dict[str, float]:
        total = sum(found.values())
        if not total > 0.0:
            return {}
        found = {place: p / total for place, p in found.items() if place in self.places}
        for place, room in self._rooms.items():
            if found.get(place, 0.0) > 0.0:
                found[room] = found.get(room, 0.0) + found[place]
        return {place.name: found.get(place.name, 0.0) for place in self.places}

    def moves(self, stamp: float, horizon: float) -> dict[str, tuple[str, float]]:
        """Things that will probably move within `horizon` s, where to, and how probably."""
        return {} if stamp < self._newest else self.routines.moves(stamp, horizon)

    def explain(self, name: str, stamp: float) -> str:
        """What a thing usually does, in a sentence; "" where nothing was learned of it."""
        if name not in self.routines.objects:
            return ""
        return self.routines.explain(name, max(stamp, self._newest))

    # The file.

    def keep(self, stamp: float, now: bool = False) -> None:
        """Write what was learned, now and then or `now`. Does not raise."""
        if self.routines.objects or self.aliases:
            self.kept.keep(stamp, now)

    def write(self, path: Path) -> None:
        """Write what was learned to a file. Raises OSError."""
        data = {"format": FORMAT, "version": VERSION, "aliases": self.aliases, "at": self._at}
        write_kept(path, {**data, "routines": self.routines.to_dict()})

    def read(self, path: Path) -> None:
        """Go on from what `write` wrote. Raises OSError, and InputError where the file is no such one; nothing is
        changed then."""
        data = read_kept(path, FORMAT, VERSION)
        try:
            routines = Routines.from_dict(data["routines"])
            aliases = {str(name): str(new) for name, new in data["aliases"].items()}
            at = {str(name): str(place) for name, place in data["at"].items()}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"damaged: {error}") from error
        self.routines, self.aliases, self._at = routines, aliases, at


def _kind(name: str) -> str:
    """Class that a symbol was made for, "" where somebody has renamed the thing."""
    parsed = parse_symbol(name)
    return parsed[0] if parsed else ""


class ByNow:
    """Where things are by now though nobody looks. where : probability by place of an object as it was seen."""

    def __init__(
        self,
        config: WorldModelConfig,
        where: Callable[[WorldObject], Mapping[str, float]],
        household: Household,
    ) -> None:
        self.config, self.where, self.household = config, where, household
        self._furniture = {place.name for place in household.places.furniture}
        self._told: dict[str, tuple[tuple[float, float, bool], WorldObject, WorldObject]] = {}

    def told(self, objects: Iterable[WorldObject], stamp: float) -> tuple[WorldObject, ...]:
        """What is lost, or was not seen for a while, is probably where it usually is by then."""
        if not self.household.places:
            return tuple(objects)
        return tuple(
            self._forecast(item, stamp) if item.lost or stamp - item.last_seen > UNSEEN else item
            for item in objects
        )

    def _forecast(self, item: WorldObject, stamp: float) -> WorldObject:
        """A thing with where it usually is, which is asked anew every `PERIOD` s, not of all things at once."""
        turn = (stamp + zlib.crc32(item.id.encode()) % PERIOD) // PERIOD
        key, known = (turn, item.last_seen, item.lost), self._told.get(item.id)
        if known is not None and known[0] == key and known[1] is item:
            return known[2]
        usual = known[2].usual if known is not None and known[0] == key else self._usual(item, stamp)
        made = replace(item, usual=usual) if usual else item
        if len(self._told) > 10_000:
            self._told.clear()
        self._told[item.id] = key, item, made
        return made

    def _usual(self, item: WorldObject, stamp: float) -> Mapping[str, float]:
        if not item.lost:
            usual = self.household.by_now(item.id, stamp)
            return self._moved_by(item, usual) if usual else {}
        kind = item.most_probable("class")
        usual = self.household.gone_to(item.id, kind, stamp)
        trust = motion_of(kind, self.config.motion).usual_place
        anywhere = self.household.places.shares(item.region or self.config.region)
        return {name: (1.0 - trust) * anywhere[name] + trust * p for name, p in usual.items()}

    def _moved_by(self, item: WorldObject, forecast: Mapping[str, float]) -> dict[str, float]:
        """Of a thing that is believed to be where it was seen: there, or gone its way meanwhile."""
        here = self.where(replace(item, usual={}))
        place = max(here, key=lambda name: (here[name] > SURE, name in self._furniture, here[name]))
        stays = float(forecast.get(place, 0.0))
        if stays >= STAYS:
            return {}
        # Where it is in the place where it stays, the position knows better.
        return {name: stays * p if name == place else forecast.get(name, 0.0) for name, p in here.items()}

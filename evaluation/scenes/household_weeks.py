"""Weeks in the apartment: things that people carry about by habit, and a robot's camera that sees a part at a time.

Each thing has one or two trips a day, to a place of its own and back, at about the same time. Some are left out, some
end elsewhere. While a thing is carried it is nowhere.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from estimation.geometry.places import Places
from whereabouts.simulation.home.apartment_camera import Camera, person_block
from whereabouts.simulation.home.apartment_day import THINGS
from whereabouts.simulation.home.floor_plan import Apartment, apartment
from whereabouts.simulation.home.live_apartment import SHELVES, tour
from whereabouts.simulation.shapes import Array
from world_model import WorldEvidence

DAY, HOUR, MINUTE = 86400.0, 3600.0, 60.0
CARRIED = ("red cup", "white cup", "blue book", "green bowl", "black remote", "white clock", "green bottle")
SKIPPED, STRAYS = 0.15, 0.05
"""Probabilities that a trip is left out, and that it ends somewhere else."""
JITTER, IN_HAND = 12.0 * MINUTE, 90.0
"""s: standard deviation of a trip's beginning; how long it takes."""
SOMEBODY = 0.1
"""Probability that a person stands in the way of a look."""
IMAGES, PERIOD = 3, 0.5
"""Images of a look, and s between them."""


@dataclass(frozen=True)
class Trip:
    """A habit: there at a time of day and back, s; to a place (its name and spot)."""

    out: float
    back: float
    place: str
    spot: tuple[float, float, float]


@dataclass
class Weeks:
    """places : furniture, by whose names spots are called. begin : stamp of the first midnight, s."""

    places: Places
    days: int
    seed: int = 0
    begin: float = 1.8e9 // DAY * DAY
    camera: Camera = field(default_factory=Camera)
    home: Apartment = field(default_factory=apartment)

    def __post_init__(self) -> None:
        rng = np.random.default_rng([self.seed, 61])
        self._eyes = np.random.default_rng([self.seed, 62])
        self._furniture: dict[tuple[float, float, float], str] = {}
        self._stands: dict[str, tuple[Array, list[float]]] = {}
        self._spots = {name: self._spots_of(index) for index, name in enumerate(CARRIED)}
        self._plan = {name: self._planned(name, rng) for name in CARRIED}
        self._when = {name: [stamp for stamp, _ in plan] for name, plan in self._plan.items()}
        found = {self.place_at(spot) for spots in self._spots.values() for spot in spots.values()}
        self.looked_at = sorted(name for name in found if name)

    def place_at(self, spot: tuple[float, float, float]) -> str:
        """The furniture that a spot is on, "" for none."""
        if spot not in self._furniture:
            inside = [place for place in self.places.furniture if place.contains(np.array([spot[:2]]))[0]]
            self._furniture[spot] = inside[0].name if inside else ""
        return self._furniture[spot]

    def things(self, stamp: float) -> dict[str, tuple[float, float, float] | None]:
        """Where each thing is; None while it is carried."""
        where: dict[str, tuple[float, float, float] | None] = {
            name: spot for name, (_, spot) in THINGS.items()
        }
        for name, plan in self._plan.items():
            before = bisect_right(self._when[name], stamp) - 1
            if before >= 0:
                where[name] = plan[before][1]
        return where

    def where(self, name: str, stamp: float) -> str:
        """The furniture that a thing is on, "" while it is carried."""
        spot = self.things(stamp)[name]
        return "" if spot is None else self.place_at(spot)

    def look(self, place: str, stamp: float) -> Iterator[tuple[float, Array, WorldEvidence]]:
        """Images of a place from where the robot stands for it: stamp, pose (3,), evidence in the camera's frame."""
        if place not in self._stands:
            self._stands[place] = self._stand(place)
        stop, yaws = self._stands[place]
        for k in range(IMAGES * len(yaws)):
            now = stamp + PERIOD * k
            pose = np.array([*stop, yaws[k % len(yaws)] + self._eyes.normal(0.0, 0.1)])
            lying = {
                name: (THINGS[name][0], np.array(spot)) for name, spot in self.things(now).items() if spot
            }
            yield now, pose, self.camera.look(self._eyes, pose, self._hiding(pose), lying)

    def _hiding(self, pose: Array) -> Array:
        if self._eyes.random() > SOMEBODY:
            return self.home.blocks
        ahead = pose[2] + self._eyes.uniform(-0.5, 0.5)
        spot = pose[:2] + self._eyes.uniform(0.8, 1.6) * np.array([math.cos(ahead), math.sin(ahead)])
        return np.vstack([self.home.blocks, np.array([person_block(spot)])])

    def _stand(self, place: str) -> tuple[Array, list[float]]:
        """Where to stand, and to look, to see most spots of a place."""
        spots = {
            spot for own in self._spots.values() for spot in own.values() if self.place_at(spot) == place
        }
        best: tuple[int, float, Array, list[float]] = (-1, 0.0, np.zeros(2), [])
        for stop in tour():
            yaws = [math.atan2(spot[1] - stop[1], spot[0] - stop[0]) for spot in sorted(spots)]
            seen = [
                yaw
                for yaw, spot in zip(yaws, sorted(spots), strict=True)
                if self.camera.sees(np.array([*stop[:2], yaw]), self.home.blocks, np.array(spot))
            ]
            nearness = -min(math.dist(stop[:2], spot[:2]) for spot in spots)
            if (len(seen), nearness) > best[:2]:
                best = (len(seen), nearness, stop[:2], seen)
        low, high = min(best[3], default=0.0), max(best[3], default=0.0)
        return best[2], [low, high] if high - low > 0.5 * self.camera.opening else [0.5 * (low + high)]

    def _spots_of(self, index: int) -> dict[str, tuple[float, float, float]]:
        """Where one thing lies on each shelf: things that are there together lie beside each other."""
        angle = 2.0 * math.pi * index / len(CARRIED)
        off = (0.12 * math.cos(angle), 0.12 * math.sin(angle))
        spots = {}
        for shelf, choices in SHELVES.items():
            x, y, z = choices[index % len(choices)]
            spot = (x + off[0], y + off[1], z)
            spots[shelf] = spot if self.place_at(spot) else (x, y, z)
        return {shelf: spot for shelf, spot in spots.items() if self.place_at(spot)}

    def _habits(self, name: str, rng: np.random.Generator) -> list[Trip]:
        home = self.place_at(THINGS[name][1])
        there = [shelf for shelf, spot in self._spots[name].items() if self.place_at(spot) != home]
        trips = []
        for out in (rng.uniform(7.5, 11.0), rng.uniform(14.0, 18.0))[: int(rng.integers(1, 3))]:
            shelf = str(rng.choice(there))
            back = out + rng.uniform(1.0, 3.0)
            trips.append(Trip(out * HOUR, back * HOUR, shelf, self._spots[name][shelf]))
        return trips

    def _planned(
        self, name: str, rng: np.random.Generator
    ) -> list[tuple[float, tuple[float, float, float] | None]]:
        """All changes of one thing: (stamp, where it is from then on), in order."""
        home, spots = THINGS[name][1], self._spots[name]
        habits = self._habits(name, rng)
        plan: list[tuple[float, tuple[float, float, float] | None]] = []
        for day in range(self.days):
            for trip in habits:
                skipped, strays = rng.random() < SKIPPED, rng.random() < STRAYS
                late, shelf = rng.normal(0.0, JITTER, 2), str(rng.choice(sorted(spots)))
                if skipped:
                    continue
                midnight = self.begin + day * DAY
                out, back = midnight + trip.out + late[0], midnight + trip.back + late[1]
                plan += [(out, None), (out + IN_HAND, spots[shelf] if strays else trip.spot)]
                plan += [(back, None), (back + IN_HAND, home)]
        return sorted(plan, key=lambda change: change[0])

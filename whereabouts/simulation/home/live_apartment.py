"""The apartment with a robot that drives where it is told, people who go around it, and things that they carry about.

What people do is drawn from the seed: after the robot's first tour each of three carries things from one piece of
furniture to another, the red bag and the red cup among them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from whereabouts.simulation.home.apartment_camera import Camera
from whereabouts.simulation.home.apartment_day import (
    MOVED,
    PUT,
    ROUND,
    SPEEDS,
    TICKS,
    Moment,
    Senses,
    things_at,
)
from whereabouts.simulation.home.apartment_people import Resident, Stay, live
from whereabouts.simulation.home.driving import Driver, floor_plan
from whereabouts.simulation.home.floor_plan import Apartment, apartment
from whereabouts.simulation.shapes import Array, Shapes

ASKED = "red cup"
"""What the robot is asked to fetch; there is a white one, too."""
TOURED = 150.0
"""s from which on things are carried about; the first tour is over by then."""
ELBOW = 0.5
"""m that a person keeps from the middle of the robot, by going around it."""
GLANCE, STARE = 4.0, 8.0
"""s at each stop of the tour, and that the robot looks for what should be in front of it: one turn of its head."""
ARM = 0.45
"""m at least from the middle of the robot to what it is about to take."""
REACH = 1.1
"""m from the middle of the robot to a thing that it can take."""
# Where people stand to put things down, and where these lie then.
SHELVES: dict[str, tuple[tuple[float, float, float], ...]] = {
    "kitchen_table": ((0.45, 3.4, 0.76), (-0.3, 3.7, 0.76)),
    "counter": ((-1.3, 2.7, 0.91), (-1.3, 4.1, 0.91)),
    "sofa": ((5.6, 3.6, 0.47),),
    "sofa_right": ((6.4, 3.8, 0.47),),
    "sideboard": ((8.35, 2.0, 0.85), (8.35, 2.8, 0.85)),
    "desk": ((-1.2, -3.0, 0.78), (-1.2, -3.4, 0.78)),
    "bookcase": ((0.8, -4.6, 1.0), (1.6, -4.6, 1.0)),
    "nightstand": ((6.2, -3.12, 0.6),),
}
# Where what is carried lies at first, by where one stands to take it.
HOME_OF = {
    "red cup": "kitchen_table",
    "red bag": "hall_bag",
    "blue book": "sideboard",
    "green bowl": "counter",
    "black remote": "sofa",
    "white clock": "nightstand",
}
LOUNGES = ("sofa", "sofa_right", "armchair", "bed", "wardrobe", "kitchen_north", "office", "living_west")


@dataclass(frozen=True)
class LiveHousehold:
    """What people do. people : their days. puts : where each thing is put down, in this order."""

    people: tuple[Resident, ...]
    puts: dict[str, list[tuple[float, float, float]]]

    def things(self, time: float) -> dict[str, Array | None]:
        """Where each thing is, None while somebody carries it."""
        return things_at(time, self.people, self.puts)

    @property
    def moves(self) -> list[tuple[float, str]]:
        """When each thing was put down somewhere else: (s, name), in order."""
        return sorted(
            (when, name) for person in self.people for when, name, taken in person.handled if not taken
        )


def household(seed: int, duration: float) -> LiveHousehold:
    """Three people, each of whom carries two things about, one every two minutes or so from `TOURED` on."""
    rng = np.random.default_rng([seed, 7])
    shelves = {name: list(spots) for name, spots in SHELVES.items()}
    others = [name for name in HOME_OF if name not in (ASKED, MOVED)]
    rng.shuffle(others)
    carried = [[ASKED, others[0]], [MOVED, others[1]], [others[2], others[3]]]
    people: list[Resident] = []
    puts: dict[str, list[tuple[float, float, float]]] = {}
    for names, speed in zip(carried, SPEEDS, strict=True):
        day = _day(rng, names, shelves, puts, duration)
        people.append(live(rng, day, [person.walker for person in people], duration, speed))
    return LiveHousehold(tuple(people), puts)


def _day(
    rng: np.random.Generator,
    names: list[str],
    shelves: dict[str, list[tuple[float, float, float]]],
    puts: dict[str, list[tuple[float, float, float]]],
    duration: float,
) -> list[Stay]:
    """Stops of one person, who takes each of some things to another place."""
    day = [Stay(str(rng.choice(LOUNGES)), float(rng.uniform(5.0, 25.0)))]
    while len(day) < 4:
        day.append(Stay(_other(rng, day[-1].spot), float(rng.uniform(8.0, 30.0))))
    due = TOURED + float(rng.uniform(0.0, 40.0))
    for name in names:
        if name == MOVED:
            there, spot = "bag_place", PUT[MOVED][0]
        else:
            there = str(rng.choice([k for k, left in shelves.items() if left and k != HOME_OF[name]]))
            spot = shelves[there].pop(int(rng.integers(len(shelves[there]))))
        puts.setdefault(name, []).append(spot)
        day += [Stay(HOME_OF[name], 2.0, due, takes=name), Stay(there, 3.0, leaves=name)]
        day.append(Stay(_other(rng, there), float(rng.uniform(15.0, 40.0))))
        due += float(rng.uniform(70.0, 130.0))
    for _ in range(int(duration / 25.0)):
        day.append(Stay(_other(rng, day[-1].spot), float(rng.uniform(15.0, 60.0))))
    return day


def _other(rng: np.random.Generator, spot: str) -> str:
    return str(rng.choice([name for name in LOUNGES if name != spot]))


@dataclass
class LiveDay:
    """The run, a moment at a time: `robot.go(...)`, then `step()`.

    duration : s for which people have something to do. scans, clouds : whether these are simulated, too.
    """

    seed: int = 0
    duration: float = 900.0
    camera: Camera = field(default_factory=Camera)
    home: Apartment = field(default_factory=apartment)
    scans: bool = True
    clouds: bool = True

    def __post_init__(self) -> None:
        self.household = household(self.seed, self.duration)
        self.grid = floor_plan(self.home)
        self.robot = Driver(self.grid, np.zeros(3))
        self.taken: str | None = None
        self._senses = Senses(self.seed, self.home, self.camera, self.scans, self.clouds)
        self._tick = 0

    @property
    def time(self) -> float:
        """s that have passed."""
        return self._tick / TICKS

    @property
    def things(self) -> dict[str, Array | None]:
        """Where everything is now, None for what somebody or the robot carries."""
        found = self.household.things(self.time)
        if self.taken is not None:
            found[self.taken] = None
        return found

    @property
    def people(self) -> Array:
        """(P, 2) m, where everybody is now."""
        walkers = [person.walker for person in self.household.people]
        spots = np.array([walker.position(self.time) for walker in walkers])
        return spots + [self._aside(spot) for spot in spots]

    def step(self) -> Moment:
        """What is measured now; then an eighth of a second passes."""
        moment = self._senses.moment(self._tick, self.robot.pose.copy(), self._everybody(), self.things)
        self._tick += 1
        if self.robot.status == "driving":
            self.robot.step(1.0 / TICKS, self.people)
        return moment

    def take(self, spot: Array) -> str | None:
        """Take what lies within a hand's breadth of where it is thought to be, (3,): its name, None for nothing.

        The arm has REACH.
        """
        near = {
            name: float(np.linalg.norm(where - spot))
            for name, where in self.things.items()
            if where is not None and self.away(where) <= REACH
        }
        name = min(near, key=near.__getitem__, default="")
        if not name or near[name] > 0.25:
            return None
        self.taken = name
        return name

    def away(self, spot: Array) -> float:
        """m on the floor from the robot to a place."""
        return math.hypot(*(spot[:2] - self.robot.pose[:2]))

    def _everybody(self) -> tuple[Array, Array, list[Shapes]]:
        walkers = [person.walker for person in self.household.people]
        time = self.time
        if not self.scans:
            return self.people, np.zeros((len(walkers), 2)), []
        velocities = np.array([walker.velocity(time) for walker in walkers])
        outlines = [
            walker.shapes(time, owner).moved([*self._aside(walker.position(time)), 0.0])
            for owner, walker in enumerate(walkers, start=1)
        ]
        return self.people, velocities, outlines

    def _aside(self, spot: Array) -> Array:
        """How far (2,) somebody at a spot (2,) steps aside for the robot."""
        offset = spot - self.robot.pose[:2]
        away = float(np.hypot(*offset))
        if away >= ELBOW:
            return np.zeros(2)
        way = offset / away if away > 1e-3 else np.array([0.0, 1.0])
        return np.asarray((ELBOW - away) * way)


def tour() -> list[Array]:
    """Poses (3,) of a round through all rooms, to look from; those where the robot stops on its recorded rounds."""
    stops = [np.array(stop[:2]) for stop in ROUND if stop[2] > 0.0] + [np.array([0.0, -0.1])]
    return [np.array([*stop, math.nan]) for stop in stops]

"""A robot's morning in the apartment: three rounds, three people, a dozen things of which some are carried about.

Everything is drawn from one seed. Each sensor has its own stream of random numbers, so that the first seconds of a run
are the same however long it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import compound
from registration import Scan
from whereabouts.simulation.home.apartment_camera import Camera, Item, person_block
from whereabouts.simulation.home.apartment_people import Moving, Resident, Stay, live
from whereabouts.simulation.home.floor_plan import Apartment, apartment
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.robot import Drive, Wheels
from whereabouts.simulation.shapes import Array, Shapes, box, joined
from whereabouts.simulation.walkers import positions
from world_model import WorldEvidence

SEED = 20
SCAN_RATE, LOOK_RATE, CLOUD_RATE = 8, 2, 1
TICKS = SCAN_RATE
"""Moments per second at which something is measured: all scan, and hear of the wheels."""
LASER_MOUNT = np.array([0.15, 0.0, 0.0])
SCANNER = Lidar(
    beams=451, opening=np.deg2rad(270.0), range_max=12.0, sigma=0.008, resolution=1.0 / 256.0, dropout=0.002
)
WHEELS = Wheels(scale=1.015, bias=0.012, per_metre=0.02, per_radian=0.02)
# One round: where to, and how long to look from there.
ROUND = (
    (0.0, -0.1, 0.0), (1.2, -0.1, 0.0), (1.2, 2.0, 0.0), (0.5, 2.4, 5.0), (1.4, 4.2, 1.0), (3.4, 4.2, 1.0),
    (4.2, 2.6, 0.0), (5.0, 2.7, 4.0), (7.2, 2.6, 4.0), (7.4, -0.1, 0.0), (7.4, -1.9, 1.0), (7.4, -0.2, 0.0),
    (7.1, -0.1, 0.0), (3.9, -0.1, 0.0), (3.9, -2.2, 0.0), (4.5, -2.5, 5.0), (3.9, -2.2, 0.0), (3.9, -0.1, 0.0),
    (0.6, -0.1, 0.0), (0.6, -2.3, 0.0), (0.2, -2.9, 5.0), (0.6, -2.3, 0.0), (0.6, -0.1, 1.0),
)  # fmt: skip
ROUNDS = 3
# In the second round the robot stops in the hall, where the bag was seen.
STOP = (1, 12, 14.0)
THINGS: dict[str, tuple[Item, tuple[float, float, float]]] = {
    "red cup": (Item("cup", "red"), (0.0, 3.5, 0.76)),
    "white cup": (Item("cup", "white"), (6.3, 3.6, 0.48)),
    "green bowl": (Item("bowl", "green"), (-1.3, 2.2, 0.91)),
    "green bottle": (Item("bottle", "green"), (-1.3, 3.5, 0.98)),
    "blue book": (Item("book", "blue"), (8.35, 2.4, 0.84)),
    "red book": (Item("book", "red"), (1.2, -4.6, 0.99)),
    "white laptop": (Item("laptop", "white"), (-1.2, -3.8, 0.78)),
    "black remote": (Item("remote control", "black"), (5.8, 3.8, 0.46)),
    "green plant": (Item("plant", "green"), (8.35, 3.2, 1.0)),
    "black shoes": (Item("shoes", "black"), (-1.1, -0.7, 0.08)),
    "red bag": (Item("bag", "red", (0.17, 0.1, 0.2)), (5.3, -0.6, 0.2)),
    "white clock": (Item("alarm clock", "white"), (6.3, -2.9, 0.61)),
}
# Where things are put down, in this order.
PUT = {
    "red cup": [(-1.2, -3.0, 0.78), (0.2, 3.6, 0.76)],
    "red bag": [(5.7, -1.6, 0.2)],
    "blue book": [(6.25, -3.15, 0.59)],
    "green bowl": [(0.45, 3.4, 0.76), (-1.3, 2.2, 0.91)],
}
MOVED = "red bag"
"""The thing that is carried to another room while the robot looks elsewhere, and that the robot is told to find."""
DAYS = (
    (
        Stay("sofa", 30.0), Stay("kitchen_table", 4.0, takes="red cup"), Stay("desk", 60.0, leaves="red cup"),
        Stay("bed", 20.0), Stay("desk", 15.0, 205.0, takes="red cup"),
        Stay("kitchen_table", 5.0, leaves="red cup"), Stay("sofa", 60.0), Stay("bed", 20.0),
        Stay("sofa", 30.0), Stay("desk", 60.0), Stay("sofa", 60.0),
    ),
    (
        Stay("wardrobe", 15.0), Stay("armchair", 20.0), Stay("wardrobe", 10.0, 112.0),
        Stay("hall_bag", 0.5, takes="red bag"), Stay("bag_place", 3.0, leaves="red bag"),
        Stay("wardrobe", 15.0), Stay("sideboard", 4.0, takes="blue book"),
        Stay("nightstand", 6.0, leaves="blue book"), Stay("armchair", 40.0), Stay("bookcase", 20.0),
        Stay("armchair", 50.0), Stay("wardrobe", 20.0), Stay("armchair", 60.0), Stay("bookcase", 60.0),
    ),
    (
        Stay("counter", 15.0), Stay("sofa_right", 20.0), Stay("counter", 3.0, takes="green bowl"),
        Stay("kitchen_table", 20.0, leaves="green bowl"), Stay("sofa_right", 25.0), Stay("bed", 20.0),
        Stay("kitchen_table", 5.0, 260.0, takes="green bowl"), Stay("counter", 20.0, leaves="green bowl"),
        Stay("sofa_right", 30.0), Stay("counter", 20.0), Stay("bed", 20.0), Stay("sofa_right", 60.0),
    ),
)  # fmt: skip
SPEEDS = (0.95, 1.05, 0.85)


@dataclass(frozen=True)
class Moment:
    """All that is measured at one moment, and the truth. What is not measured then is None.

    pose (3,) of the robot; wheels (3,) by the wheels, drifting; pan rad, of the camera's head; cloud (N, 3) in the
    camera's frame; people (P, 2) m; velocities (P, 2) m/s; returns (P,) beams of the scan on each.
    things : position (3,) of each thing by name, None while it is carried.
    """

    time: float
    pose: Array
    wheels: Array
    pan: float
    scan: Scan | None
    evidence: WorldEvidence | None
    cloud: Array | None
    people: Array
    velocities: Array
    returns: NDArray[np.int64]
    things: dict[str, Array | None]


@dataclass
class ApartmentDay:
    """One run. `people` and `drive` tell what happens, `moments` measures it.

    rounds : through all rooms; people have done in the first three what they do, and stay where they are then.
    """

    seed: int = SEED
    rounds: int = ROUNDS
    camera: Camera = field(default_factory=Camera)
    home: Apartment = field(default_factory=apartment)

    def __post_init__(self) -> None:
        self.drive = _drive(self.rounds)
        self.people: list[Resident] = []
        rng = np.random.default_rng([self.seed, 0])
        for day, speed in zip(DAYS, SPEEDS, strict=True):
            others: list[Moving] = [self.drive]
            others += [person.walker for person in self.people]
            self.people.append(live(rng, day, others, self.duration, speed))

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.drive.duration

    def things(self, time: float) -> dict[str, Array | None]:
        """Where each thing is, None while somebody carries it."""
        return things_at(time, self.people, PUT)

    def moments(self, duration: float | None = None) -> Iterator[Moment]:
        """The run, `TICKS` moments per second, for all of it or its first `duration` seconds."""
        senses = Senses(self.seed, self.home, self.camera)
        walkers = [person.walker for person in self.people]
        end = self.duration if duration is None else min(duration, self.duration)
        for tick in range(int(end * TICKS) + 1):
            time = tick / TICKS
            outlines = [walker.shapes(time, owner) for owner, walker in enumerate(walkers, start=1)]
            velocities = np.array([walker.velocity(time) for walker in walkers])
            people = (positions(walkers, time), velocities, outlines)
            yield senses.moment(tick, self.drive(time), people, self.things(time))


def things_at(
    time: float, people: Iterable[Resident], puts: Mapping[str, Sequence[tuple[float, float, float]]]
) -> dict[str, Array | None]:
    """Where each thing is, None while one of `people` carries it; puts : where each is put down, in this order."""
    where: dict[str, Array | None] = {name: np.array(spot) for name, (_, spot) in THINGS.items()}
    spots = {name: iter(every) for name, every in puts.items()}
    for when, name, taken in sorted(event for person in people for event in person.handled):
        if when <= time:
            where[name] = None if taken else np.array(next(spots[name]))
    return where


@dataclass
class Senses:
    """What the robot measures, moment by moment; each sensor has a stream of random numbers of its own.

    clouds, scans : whether there are any.
    """

    seed: int
    home: Apartment
    camera: Camera
    scans: bool = True
    clouds: bool = True

    def __post_init__(self) -> None:
        self._streams = [np.random.default_rng([self.seed, k]) for k in (1, 2, 3, 4)]
        self._wheels, self._before = np.zeros(3), np.zeros(3)

    def moment(
        self,
        tick: int,
        pose: Array,
        everybody: tuple[Array, Array, list[Shapes]],
        things: dict[str, Array | None],
    ) -> Moment:
        """The next moment: the robot's true pose (3,), positions and velocities (P, 2) of people and
        their outlines, things.
        """
        time = tick / TICKS
        people, velocities, outlines = everybody
        if tick:
            motion = WHEELS.motion(self._before, pose, self._streams[0])
            self._wheels = compound(self._wheels, motion)
        self._before = pose
        lying = {name: (THINGS[name][0], spot) for name, spot in things.items() if spot is not None}
        scan, evidence, cloud = None, None, None
        returns = np.zeros(len(people), dtype=np.int64)
        if self.scans:
            world = joined([self.home.outlines, *_low(lying), joined(outlines)])
            simulated = SCANNER.scan(world, compound(pose, LASER_MOUNT), self._streams[1], time)
            scan = simulated.scan
            returns = np.array([np.sum(simulated.owners == k + 1) for k in range(len(people))])
        pan = self.camera.pan(time)
        eye = pose + np.array([0.0, 0.0, pan])
        hiding = [self.home.blocks, np.array([person_block(spot) for spot in people]).reshape(-1, 6)]
        if tick % (TICKS // LOOK_RATE) == 0:
            evidence = self.camera.look(self._streams[2], eye, np.vstack(hiding), lying)
        if self.clouds and tick % (TICKS // CLOUD_RATE) == 0:
            solid = [np.concatenate([spot - item.half, spot + item.half]) for item, spot in lying.values()]
            hiding.append(np.array(solid).reshape(-1, 6))
            cloud = self.camera.depth(self._streams[3], eye, np.vstack(hiding), (24, 14))
        return Moment(
            time, pose, self._wheels, pan, scan, evidence, cloud, people, velocities, returns, things
        )


def _low(lying: Mapping[str, tuple[Item, Array]]) -> list[Shapes]:
    """Outlines of what stands so low that the scanner meets it."""
    return [
        box(2.0 * item.half[0], 2.0 * item.half[1], (*spot[:2], 0.0))
        for item, spot in lying.values()
        if abs(spot[2] - 0.25) < item.half[2]
    ]


def _drive(rounds: int = ROUNDS) -> Drive:
    stops = [list(stop) for _ in range(rounds) for stop in ROUND]
    number, place, seconds = STOP
    stops[number * len(ROUND) + place][2] = seconds
    stops.append([0.0, -0.1, 3.0])
    # The robot starts in the hall, and there is the origin of its map.
    way = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], *stops[1:]])
    return Drive(way[:, :2], speed=0.5, turn_rate=0.7, rests=way[:, 2])


def stop() -> float:
    """Seconds at which the robot has come to its stop in the hall, before the place where the bag was."""
    number, place, _ = STOP
    target = np.array(ROUND[place][:2])
    drive = _drive()
    times = np.arange(0.0, drive.duration, 0.5)
    spots = np.array([drive(time)[:2] for time in times])
    here = np.flatnonzero(np.linalg.norm(spots - target, axis=1) < 0.02)
    # It is there once in every round, and stays in one of them.
    visits = np.split(here, np.flatnonzero(np.diff(here) > 1) + 1)
    return float(times[visits[number][0]])

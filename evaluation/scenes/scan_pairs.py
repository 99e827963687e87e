"""Pairs of scans with the true motion between them: the ground of the registration experiments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from whereabouts.simulation.lidar import Lidar, SimulatedScan
from whereabouts.simulation.movers import Mover, crowd, outlines
from whereabouts.simulation.robot import relative
from whereabouts.simulation.rooms import random_room
from whereabouts.simulation.shapes import Array, Shapes, joined

CLEARANCE = 0.6  # metres a robot keeps from walls and furniture


@dataclass(frozen=True)
class Pair:
    """Two scans of one world; `motion` (3,) is the pose of the source sensor in the target sensor's frame."""

    target: SimulatedScan
    source: SimulatedScan
    motion: Array


@dataclass(frozen=True)
class Difficulty:
    """translation : metres, the most; rotation : radians, the most; movers : how many are about."""

    translation: float
    rotation: float
    movers: int = 0


EASY = Difficulty(0.2, np.deg2rad(10.0))
HARD = Difficulty(0.6, np.deg2rad(35.0))
CROWDED = Difficulty(0.2, np.deg2rad(10.0), movers=8)


def free_pose(shapes: Shapes, rng: np.random.Generator, reach: float, clearance: float = CLEARANCE) -> Array:
    """A random pose (3,) within `reach` metres of the origin, `clearance` metres off every outline."""
    spot = np.zeros(2)
    for attempt in range(1000):
        spot = rng.uniform(-reach, reach, 2)
        if shapes.distance(spot) > clearance * (1.0 - attempt / 1000.0):
            break
    return np.array([*spot, rng.uniform(-np.pi, np.pi)])


def _crowd_around(rng: np.random.Generator, poses: tuple[Array, Array], count: int) -> list[Mover]:
    """Movers 0.9 to 3 m around the sensor that do not walk over it: clear of both poses at their times."""
    movers: list[Mover] = []
    while len(movers) < count:
        (mover,) = crowd(rng, poses[0][:2], 1, (0.9, 3.0))
        gaps = [
            mover.shapes(time, 1).distance(pose[:2]) for time, pose in zip((0.0, 0.5), poses, strict=True)
        ]
        if min(gaps) > 0.5:
            movers.append(mover)
    return movers


def random_pair(rng: np.random.Generator, lidar: Lidar, difficulty: Difficulty) -> Pair:
    """Two scans in a random room, 0.5 s apart, moved by up to the difficulty's translation and rotation."""
    room = random_room(rng)
    while True:
        first = free_pose(room, rng, 2.0)
        heading, away = rng.uniform(-np.pi, np.pi), difficulty.translation * np.sqrt(rng.random())
        turn = rng.uniform(-1.0, 1.0) * difficulty.rotation
        second = first + np.array([away * np.cos(heading), away * np.sin(heading), turn])
        if room.distance(second[:2]) > 0.3:
            break
    movers = _crowd_around(rng, (first, second), difficulty.movers)
    scans = [
        lidar.scan(joined([room, outlines(movers, time)]), pose, rng, time)
        for time, pose in ((0.0, first), (0.5, second))
    ]
    return Pair(scans[0], scans[1], relative(first, second))

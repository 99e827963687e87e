"""Paths by social forces, section 4.5 of the anchoring text: (4.13) to (4.18), several people together.

A person is drawn along its way at its own pace, pushed away by other people and by the nearest obstacle. Masses are
divided out: every strength is an acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.checks import FloatArray, as_points
from tracking.prediction.social_forces_kernels import Repulsion, Walkers, Walls, walk

IntArray = NDArray[np.int64]
CELL = 1.0
THINNING = 0.1


@dataclass(frozen=True)
class Forces:
    """Parameters of the social forces.

    relaxation : τ, s. people_strength : q / M of other people, m/s²; people_range : f, m; radius : r of a person, m.
    wall_strength, wall_range : the same for obstacles, whose own radius is zero. hardness, wall_hardness : c / M, 1/s².
    """

    relaxation: float = 4.0
    people_strength: float = 0.3
    people_range: float = 0.2
    radius: float = 0.2
    wall_strength: float = 3.0
    wall_range: float = 0.3
    hardness: float = 2.0
    wall_hardness: float = 20.0


class Obstacles:
    """Obstacle points (K, 2) m, thinned and sorted into cells, so that the nearest one is found at once.

    Raises InputError: not (K, 2), or not finite.
    """

    def __init__(self, points: ArrayLike | None = None) -> None:
        given = np.zeros((0, 2)) if points is None else as_points("obstacles", points, 2)
        if len(given):
            _, first = np.unique(np.floor(given / THINNING).astype(np.int64), axis=0, return_index=True)
            given = given[np.sort(first)]
        self.origin: FloatArray = given.min(axis=0) if len(given) else np.zeros(2)
        column = np.floor((given - self.origin) / CELL).astype(np.int64)
        self.shape: IntArray = column.max(axis=0) + 1 if len(given) else np.zeros(2, dtype=np.int64)
        number = column[:, 0] * self.shape[1] + column[:, 1]
        order = np.argsort(number, kind="stable")
        self.points: FloatArray = np.ascontiguousarray(given[order])
        counts = np.bincount(number, minlength=int(self.shape.prod()))
        self.cells: IntArray = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def walls(self) -> Walls:
        """The same for compiled functions."""
        return Walls(self.points, self.cells, self.origin, CELL, self.shape)


@dataclass(frozen=True)
class Walker:
    """One person to be moved: `state` (4,) x, y, vx, vy; `way` (M, 2) points to pass, the goal last, None to go on as
    now; `speed` m/s it wants; `relaxation` s, None for that of the forces; `arriving` in (0, 1], how surely."""

    state: FloatArray
    way: FloatArray | None = None
    speed: float = 1.0
    relaxation: float | None = None
    arriving: float = 1.0


def simulate(
    walkers: list[Walker], horizon: float, forces: Forces, obstacles: Obstacles | None = None, dt: float = 0.1
) -> FloatArray:
    """States (T + 1, P, 4) of all people from now to `horizon` s ahead, every `dt` s at most."""
    steps = max(1, int(np.ceil(horizon / dt - 1e-9)))
    around = obstacles or Obstacles()
    longest = max((len(w.way) for w in walkers if w.way is not None), default=1)
    ways = np.zeros((len(walkers), max(longest, 1), 2))
    lengths = np.ones(len(walkers), dtype=np.int64)
    moving = np.zeros(len(walkers), dtype=np.bool_)
    for k, walker in enumerate(walkers):
        if walker.way is not None and len(walker.way):
            ways[k, : len(walker.way)] = walker.way
            lengths[k] = len(walker.way)
            moving[k] = True
    f = forces
    people = Repulsion(f.people_strength, f.people_range, f.hardness, 2.0 * f.radius)
    wall = Repulsion(f.wall_strength, f.wall_range, f.wall_hardness, f.radius)
    states = np.array([w.state for w in walkers], dtype=np.float64).reshape(-1, 4)
    speeds = np.array([w.speed for w in walkers], dtype=np.float64)
    relaxation = np.array([f.relaxation if w.relaxation is None else w.relaxation for w in walkers])
    arriving = np.array([w.arriving for w in walkers])
    everybody = Walkers(states, speeds, ways, lengths, moving, relaxation, arriving)
    return np.asarray(walk(everybody, steps, horizon / steps, people, wall, around.walls))

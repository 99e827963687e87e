"""The laser experiment of Section 5.3 in simulation: one person stands, another walks by behind and is hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evaluation.scenes.targets import Array, TargetScene
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.shapes import circle, joined

PERIOD = 0.2  # s between sweeps, T of Table 1
RADIUS = 0.2  # m, of a person at the waist
RANGE = 13.0  # m, of the surveillance area
POSE = np.array([0.0, 0.0, 0.5 * np.pi])  # of the scanner: it looks along y
# When the first and the second person enter.
ENTRY = (21, 37)


@dataclass(frozen=True)
class HiddenPerson:
    """Returns (N, 2) of every sweep in the world, the two people, and beams (K, 2) on each."""

    returns: list[Array]
    scene: TargetScene
    beams: Array


def hidden_person(
    rng: np.random.Generator,
    speed: float = 0.8,
    away: tuple[float, float] = (5.0, 7.0),
    clutter: float = 1.0,
    sweeps: int = 100,
) -> HiddenPerson:
    """One person goes to (0, away[0]) and stands; from the right another walks by at y = away[1], at `speed` m/s."""
    lidar = Lidar(361, np.pi, 0.05, RANGE, 0.02)
    returns, positions, identities = [], [], []
    beams = np.zeros((sweeps, 2))
    # The second is half way, hidden, two thirds through its walk.
    start = speed * PERIOD * (sweeps - ENTRY[1]) * 0.6
    for k in range(sweeps):
        people = []
        if k >= ENTRY[0]:
            people.append((0, np.array([min(-6.0 + 1.5 * PERIOD * (k - ENTRY[0]), 0.0), away[0]])))
        if k >= ENTRY[1]:
            people.append((1, np.array([start - speed * PERIOD * (k - ENTRY[1]), away[1]])))
        shapes = joined([circle(at[0], at[1], RADIUS).owned_by(i + 1) for i, at in people])
        sweep = lidar.scan(shapes, POSE, rng)
        for i in range(2):
            beams[k, i] = (sweep.owners == i + 1).sum()
        points = sweep.scan.points()
        c, s = np.cos(POSE[2]), np.sin(POSE[2])
        count = rng.poisson(clutter)
        far, bearing = RANGE * np.sqrt(rng.random(count)), np.pi * rng.random(count)
        noise = np.column_stack([far * np.cos(bearing), far * np.sin(bearing)])
        returns.append(np.vstack([points @ np.array([[c, s], [-s, c]]), noise]))
        positions.append(np.array([at for _, at in people]).reshape(-1, 2))
        identities.append(np.array([i for i, _ in people], dtype=np.int64))
    return HiddenPerson(returns, TargetScene(positions, identities), beams)

"""Things that move: boxes, cylinders, and people seen as two legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from whereabouts.simulation.shapes import Array, Shapes, box, circle, joined, unit
from whereabouts.simulation.walkers import SimulatedWalker

KINDS = ("person", "cylinder", "box")


@dataclass(frozen=True)
class Mover:
    """Something that moves at constant velocity, with a turn rate for boxes.

    kind : "person" (two legs at knee height), "cylinder", "box". start : (3,) x, y, yaw at time 0, metres.
    velocity : (2,) m/s. turn_rate : rad/s. size : metres, diameter of a cylinder, length of a box,
    stride of a person. phase : radians, of a person's gait. width : metres, of a box.
    """

    kind: str
    start: Array
    velocity: Array
    turn_rate: float = 0.0
    size: float = 0.5
    phase: float = 0.0
    width: float = 0.6

    def pose(self, time: float) -> Array:
        """(3,) x, y, yaw at `time` seconds."""
        x, y = self.start[:2] + time * self.velocity
        return np.array([x, y, self.start[2] + time * self.turn_rate])

    def shapes(self, time: float, owner: int) -> Shapes:
        """Outline at `time` seconds, belonging to `owner`."""
        x, y, yaw = self.pose(time)
        if self.kind == "cylinder":
            outline = circle(x, y, 0.5 * self.size)
        elif self.kind == "box":
            outline = box(self.size, self.width, (x, y, yaw))
        elif self.kind == "person":
            outline = self._legs(time)
        else:
            raise ValueError(f"kind: one of {', '.join(KINDS)}, got {self.kind!r}")
        return outline.owned_by(owner)

    def _legs(self, time: float) -> Shapes:
        """Two legs that swing along the walking direction in opposite phase, 0.2 m apart across it."""
        x, y, yaw = self.pose(time)
        speed = float(np.linalg.norm(self.velocity))
        heading = np.arctan2(self.velocity[1], self.velocity[0]) if speed > 0.0 else yaw
        ahead = unit(heading)
        aside = np.array([-ahead[1], ahead[0]])
        # A gait cycle covers two strides of ground.
        swing = 0.5 * self.size * np.sin(self.phase + np.pi * speed * time / self.size)
        legs = [np.array([x, y]) + side * (0.1 * aside + swing * ahead) for side in (1.0, -1.0)]
        return joined([circle(leg[0], leg[1], 0.07) for leg in legs])


def random_mover(rng: np.random.Generator, position: Array, speed: tuple[float, float] = (0.3, 1.5)) -> Mover:
    """A mover of any kind at `position` (2,) that goes anywhere, at `speed` m/s (from, to)."""
    kind = str(rng.choice(KINDS))
    heading = rng.uniform(-np.pi, np.pi)
    velocity = rng.uniform(*speed) * unit(heading)
    size = {"person": rng.uniform(0.5, 0.8), "cylinder": rng.uniform(0.3, 0.6), "box": rng.uniform(0.6, 1.2)}[
        kind
    ]
    turn_rate = rng.uniform(-0.5, 0.5) if kind == "box" else 0.0
    return Mover(
        kind, np.array([*position, heading]), velocity, turn_rate, size, rng.uniform(0.0, 2.0 * np.pi)
    )


def crowd(rng: np.random.Generator, around: Array, count: int, distance: tuple[float, float]) -> list[Mover]:
    """`count` movers scattered `distance` (from, to) metres around a point (2,)."""
    movers = []
    for _ in range(count):
        bearing, away = rng.uniform(-np.pi, np.pi), rng.uniform(*distance)
        movers.append(random_mover(rng, around + away * unit(bearing)))
    return movers


def outlines(movers: Sequence[Mover | SimulatedWalker], time: float) -> Shapes:
    """All movers or people at `time` seconds, owners counting from 1 in the order of the list."""
    return joined([mover.shapes(time, owner) for owner, mover in enumerate(movers, start=1)])

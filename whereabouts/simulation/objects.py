"""Scenes of objects seen by a detector: static, carried, removed and added ones, with missed and false detections."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray as Array
from world_model import ObjectEvidence, WorldEvidence

CLASSES = ("cup", "bowl", "bottle", "book", "box")
COLORS = ("red", "green", "blue", "white")


@dataclass(frozen=True)
class Thing:
    """One object of a scene.

    position : (3,) m. path : (time s, position (3,) or None) in order; from then on it is there, None: gone.
    """

    kind: str
    color: str
    position: Array
    path: tuple[tuple[float, Array | None], ...] = ()

    def at(self, time: float) -> Array | None:
        """Where it is at `time` seconds, None where it is nowhere."""
        where: Array | None = self.position
        for begin, place in self.path:
            if time >= begin:
                where = place
        return where


@dataclass(frozen=True)
class SeenObject:
    """One look: evidence, where everything truly is, and the object behind each detection (-1: clutter)."""

    stamp: float
    evidence: WorldEvidence
    truth: dict[int, Array]
    sources: tuple[int, ...]


@dataclass
class ObjectScene:
    """Things and the detector that looks at them `rate` times a second.

    region : ((x0, x1), (y0, y1), (z0, z1)) m, where clutter falls (in view). detection : p_D. clutter : false
    detections per look. sigma : m. accuracy : how often the named class and colour are the true ones.
    missed_run : mean looks of a run of misses. sensor : pose, range and angle, turning at `turn` rad/s; None: all
    is in view. say_sensor : whether evidence tells the field of view. blocked : (from, to) s, no detections.
    hidden : ((from, to), (x0, x1)) s and m: what is between x0 and x1 cannot be seen then.
    """

    things: Sequence[Thing]
    region: tuple[tuple[float, float], ...] = ((-2.5, 2.5), (-2.5, 2.5), (0.0, 1.5))
    rate: float = 20.0
    detection: float = 0.95
    clutter: float = 0.2
    sigma: float = 0.03
    accuracy: float = 0.9
    missed_run: float = 1.0
    sensor: dict[str, Any] | None = None
    turn: float = 0.0
    say_sensor: bool = True
    seed: int = 0
    blocked: Sequence[tuple[float, float]] = ()
    classes: Sequence[str] = CLASSES
    colors: Sequence[str] = COLORS
    drop: Sequence[tuple[tuple[float, float], Sequence[int]]] = field(default=())
    """((from, to) s, things): things that are occluded then, inside a part of the view that is said to be hidden."""

    def looks(self, count: int) -> Iterator[SeenObject]:
        """`count` looks, the first at time 0."""
        rng = np.random.default_rng(self.seed)
        hidden = np.zeros(len(self.things), bool)
        run = max(self.missed_run, 1.0 / self.detection)
        begin = (1.0 - self.detection) / (self.detection * run)
        hidden[:] = rng.random(len(hidden)) > self.detection
        for k in range(count):
            stamp = k / self.rate
            change = rng.random(len(hidden))
            hidden = np.where(hidden, change < 1.0 - 1.0 / run, change < begin)
            yield self._look(stamp, rng, hidden)

    def _look(self, stamp: float, rng: np.random.Generator, hidden: NDArray[np.bool_]) -> SeenObject:
        sensor = self._sensor(stamp)
        truth: dict[int, Array] = {}
        found: list[tuple[int, ObjectEvidence]] = []
        shut = any(begin <= stamp < end for begin, end in self.blocked)
        occluded = {i for (begin, end), which in self.drop if begin <= stamp < end for i in which}
        for index, thing in enumerate(self.things):
            position = thing.at(stamp)
            if position is None:
                continue
            truth[index] = position
            if shut or hidden[index] or index in occluded or not in_view(position, sensor):
                continue
            noisy = position + rng.normal(0.0, self.sigma, 3)
            found.append((index, self._evidence(noisy, thing.kind, thing.color, rng)))
        for _ in range(0 if shut else rng.poisson(self.clutter)):
            found.append((-1, self._false(sensor, rng)))
        order = rng.permutation(len(found))
        evidence = WorldEvidence(
            [found[i][1] for i in order], sensor if self.say_sensor and not shut else None
        )
        return SeenObject(stamp, evidence, truth, tuple(found[i][0] for i in order))

    def _sensor(self, stamp: float) -> dict[str, Any] | None:
        if self.sensor is None:
            return None
        x, y, z, yaw = self.sensor["pose"]
        return {**self.sensor, "pose": (x, y, z, yaw + self.turn * stamp)}

    def _false(self, sensor: dict[str, Any] | None, rng: np.random.Generator) -> ObjectEvidence:
        low, high = np.array(self.region).T
        for _ in range(1000):
            position = rng.uniform(low, high)
            if in_view(position, sensor):
                break
        return self._evidence(position, str(rng.choice(self.classes)), str(rng.choice(self.colors)), rng)

    def _evidence(self, position: Array, kind: str, color: str, rng: np.random.Generator) -> ObjectEvidence:
        attributes = {
            "class": classified(rng, kind, self.classes, self.accuracy),
            "color": classified(rng, color, self.colors, self.accuracy),
        }
        return ObjectEvidence(position, self.sigma**2 * np.eye(3), attributes)


def classified(
    rng: np.random.Generator, true: str, names: Sequence[str], accuracy: float
) -> dict[str, float]:
    """What a classifier says that is right with probability `accuracy`, and knows it."""
    others = [name for name in names if name != true]
    said = true if not others or rng.random() < accuracy else str(rng.choice(others))
    rest = (1.0 - accuracy) / max(len(others), 1)
    return {name: (accuracy if name == said else rest) if others else 1.0 for name in names}


def in_view(position: Array, sensor: dict[str, Any] | None) -> bool:
    """Whether a sensor (None: sees everything) covers a position."""
    if sensor is None:
        return True
    x, y, _, yaw = sensor["pose"]
    dx, dy = position[0] - x, position[1] - y
    bearing = np.arctan2(dy, dx) - yaw
    bearing -= 2.0 * np.pi * np.round(bearing / (2.0 * np.pi))
    return bool(np.hypot(dx, dy) <= sensor["range"] and abs(bearing) <= 0.5 * sensor["angle"])


def scattered(
    count: int, rng: np.random.Generator, region: Sequence[Sequence[float]], apart: float = 0.25
) -> list[Thing]:
    """`count` things of random class and colour, at least `apart` metres from each other."""
    low, high = np.array(region, dtype=float).T
    things: list[Thing] = []
    while len(things) < count:
        position = rng.uniform(low, high)
        if all(np.linalg.norm(position - other.position) >= apart for other in things):
            things.append(Thing(str(rng.choice(CLASSES)), str(rng.choice(COLORS)), position))
    return things

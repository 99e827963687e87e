"""Seeded places with traffic: streets, halls and offices, and the boxes, cylinders and people that move in them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from whereabouts.simulation.movers import Mover, crowd, random_mover
from whereabouts.simulation.rooms import random_room
from whereabouts.simulation.shapes import Array, Shapes, box, circle, joined, polygon, unit

CAR = (4.3, 1.8)  # metres, length and width
LANE = 1.8  # metres from the middle of the street to the middle of a lane


def random_street(rng: np.random.Generator) -> Shapes:
    """A street along x around the origin: facades with setbacks, parked cars, trees and bins on both sides."""
    parts: list[Shapes] = []
    for side in (1.0, -1.0):
        pavement = rng.uniform(6.0, 10.0)
        parts.append(_facade(rng, side, pavement))
        x = -45.0
        while x < 45.0:
            kind = rng.random()
            if kind < 0.35:
                pose = (x, side * rng.uniform(4.5, 4.8), rng.uniform(-0.04, 0.04))
                parts.append(box(CAR[0] * rng.uniform(0.85, 1.1), CAR[1], pose))
            elif kind < 0.7:
                parts.append(circle(x, side * rng.uniform(5.6, pavement - 0.3), rng.uniform(0.08, 0.3)))
            elif kind < 0.8:
                parts.append(box(0.8, 0.6, (x, side * (pavement - 0.5), rng.uniform(-0.3, 0.3))))
            x += rng.uniform(3.5, 9.0)
    return joined(parts)


def _facade(rng: np.random.Generator, side: float, pavement: float) -> Shapes:
    """Houses along x: walls that step back and forth, with gaps a few metres deep between some."""
    corners: list[tuple[float, float]] = []
    x = -60.0
    while x < 60.0:
        length, y = rng.uniform(5.0, 15.0), side * (pavement + rng.uniform(0.0, 2.5))
        corners += [(x, y), (x + length, y)]
        x += length
        if rng.random() < 0.3:
            deep = y + side * rng.uniform(3.0, 8.0)
            gap = rng.uniform(1.0, 3.5)
            corners += [(x, deep), (x + gap, deep)]
            x += gap
    return polygon(corners, closed=False)


def random_hall(rng: np.random.Generator) -> Shapes:
    """A hall around the origin, 14 to 26 m by 10 to 16 m, with pillars, counters and benches."""
    length, width = rng.uniform(14.0, 26.0), rng.uniform(10.0, 16.0)
    parts = [box(length, width), *_niches(rng, length, width)]
    for x in np.arange(-0.35, 0.36, 0.7 / max(int(length // 6), 1)) * length:
        for side in (-1.0, 1.0):
            spot = (x, side * 0.3 * width)
            round_one = rng.random() < 0.5
            parts.append(
                circle(*spot, rng.uniform(0.2, 0.4))
                if round_one
                else box(0.5, 0.5, (*spot, rng.uniform(0, 1)))
            )
    for _ in range(int(rng.integers(2, 6))):
        at = rng.uniform(-0.45, 0.45, 2) * [length, width]
        parts.append(box(rng.uniform(0.8, 2.5), rng.uniform(0.4, 0.8), (*at, rng.uniform(0.0, np.pi))))
    return joined(parts)


def _niches(rng: np.random.Generator, length: float, width: float) -> list[Shapes]:
    """Buttresses along the long walls, so that nothing slides along them unseen."""
    parts = []
    for side in (-1.0, 1.0):
        for _ in range(int(rng.integers(2, 5))):
            x = rng.uniform(-0.45, 0.45) * length
            parts.append(box(rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.8), (x, side * 0.5 * width, 0.0)))
    return parts


SCENES: dict[str, Callable[[np.random.Generator], Shapes]] = {
    "street": random_street,
    "hall": random_hall,
    "office": random_room,
    "crowd": random_room,
}


def traffic(rng: np.random.Generator, scene: str, count: int) -> list[Mover]:
    """`count` movers such as the scene has: cars and walkers in streets, boxes, cylinders and people indoors."""
    if scene == "street":
        return [_on_street(rng) for _ in range(count)]
    return crowd(
        rng, np.zeros(2), count, {"hall": (1.5, 7.0), "office": (1.0, 3.0), "crowd": (0.9, 3.0)}[scene]
    )


def _on_street(rng: np.random.Generator) -> Mover:
    if rng.random() < 0.6:
        side = rng.choice([-1.0, 1.0])
        speed = rng.uniform(2.0, 9.0)
        heading = (0.0 if side < 0.0 else np.pi) + rng.uniform(-0.06, 0.06)
        start = np.array([rng.uniform(-16.0, 20.0), side * LANE, heading])
        velocity: Array = speed * unit(heading)
        return Mover("box", start, velocity, rng.uniform(-0.1, 0.1), CAR[0], width=CAR[1])
    side = rng.choice([-1.0, 1.0])
    return random_mover(rng, np.array([rng.uniform(-8.0, 12.0), side * rng.uniform(2.5, 6.0)]), (0.6, 1.8))

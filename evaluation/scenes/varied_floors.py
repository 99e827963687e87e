"""Floors as different as real ones, by scanners as different: what the classes of targets are learned from.

Chairs, tables, desks, office chairs, plants, bins, poles, pillars, trolleys and the ends of partitions stand about on
the floors of `people_scenes`, or what is round stands about a scanner at rest; scanners have 181 to 1081 beams, 5 to
25 Hz, noise, mixed pixels and lost beams. None of these scenes judges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from evaluation.scenes.people_scenes import PeopleScene, with_people
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.robot import Drive
from whereabouts.simulation.rooms import random_floor
from whereabouts.simulation.shapes import Array, Shapes, box, circle, joined, polygon
from whereabouts.simulation.walkers import Build, SimulatedWalker, random_build, wander

TURN = 2.0 * np.pi


def varied_floor(
    rng: np.random.Generator, most: int = 0, standing: float = 0.4, duration: float = 40.0
) -> PeopleScene:
    """A robot drives through furnished rooms along a corridor, with up to `most` people; see the module."""
    floor, way = random_floor(rng, int(rng.integers(2, 5)))
    middles = [b for a, b, c in zip(way, way[1:], way[2:], strict=False) if np.allclose(a, c)]
    path = np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(way)])
    things: list[Shapes] = []
    count = int(rng.integers(3, 16))
    for room in middles:
        for spot in room + rng.uniform(-3.5, 3.5, (count, 2)):
            clear = np.linalg.norm(path - spot, axis=1).min() > 1.1
            if clear and joined([floor, *things]).distance(spot) > rng.uniform(0.1, 0.8):
                kind = THINGS[int(rng.integers(len(THINGS)))]
                things.append(kind(rng).moved((*spot, rng.uniform(-np.pi, np.pi))))
    lidar, rate = _scanner(rng)
    drive = Drive(way, rng.uniform(0.3, 0.9))
    scene = PeopleScene(floor, [], duration, lidar, drive, rate, joined(things) if things else Shapes())
    return with_people(rng, scene, middles, most, standing) if most else scene


def things_stand_about(rng: np.random.Generator, duration: float = 15.0) -> PeopleScene:
    """Pillars, bins, poles and plants that hide each other and a few people in part, most of them in a room.

    The scanner rests, or goes to and fro. Of the people some walk, and some stand where a thing hides half of them.
    """
    pose: Array | Callable[[float], Array] = np.zeros(3)
    way = rng.uniform(-2.2, 2.2, (2, 2))
    if rng.random() < 0.4:
        pose = Drive(np.array([*way, *way, *way]), rng.uniform(0.3, 0.6))
    else:
        way = np.zeros((2, 2))
    room = box(rng.uniform(11.0, 16.0), rng.uniform(9.0, 13.0)) if rng.random() < 0.8 else Shapes()
    things: list[Shapes] = []
    spots: list[Array] = []
    path = np.linspace(way[0], way[1], 20)
    for _ in range(200):
        hidden = len(spots) > 0 and rng.random() < 0.5
        spot = _half_hidden(rng, spots) if hidden else rng.uniform(-5.0, 5.0, 2)
        clear = np.linalg.norm(path - spot, axis=1).min() > 1.0
        if clear and (not things or joined(things).distance(spot) > 0.7):
            kind = ROUND[int(rng.integers(len(ROUND)))]
            things.append(kind(rng).moved((*spot, rng.uniform(-np.pi, np.pi))))
            spots.append(spot)
        if len(spots) == 9:
            break
    lidar, rate = _scanner(rng)
    scene = PeopleScene(room, [], duration, lidar, pose, rate, joined(things))
    return replace(scene, people=_passers(rng, joined([room, *things]), spots, path, duration))


def _half_hidden(rng: np.random.Generator, spots: list[Array]) -> Array:
    """A place (2,) that one of the things at `spots` hides in part from the middle."""
    near = spots[int(rng.integers(len(spots)))]
    away = float(np.hypot(*near))
    along = near / away
    far = away + rng.uniform(0.7, 2.0)
    aside = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.5) * far / away
    return np.asarray(far * along + aside * np.array([-along[1], along[0]]))


def _passers(
    rng: np.random.Generator, solid: Shapes, spots: list[Array], path: Array, duration: float
) -> list[SimulatedWalker]:
    """Up to three people who walk or stand, half of these half hidden by what stands at `spots`."""
    people: list[SimulatedWalker] = []
    times, taken = np.arange(0.0, duration, 0.2), [path]
    count = int(rng.integers(0, 4))
    for _ in range(60):
        if len(people) == count:
            break
        body = str(rng.choice(["legs", "legs", "trunk", "skirt", "round"]))
        build = (
            Build("skirt", shoulders=rng.uniform(0.4, 0.6)) if body == "round" else random_build(rng, body)
        )
        if rng.random() < 0.5:
            walker = wander(rng, solid, (4.8, 4.2), duration, build)
        else:
            spot = _half_hidden(rng, spots) if rng.random() < 0.5 else rng.uniform(-4.5, 4.5, 2)
            walker = SimulatedWalker(spot[None], 1.0, build, phase=rng.uniform(0.0, 6.0))
        line = walker.path(times)
        apart = min(np.linalg.norm(line[:, None] - other, axis=2).min() for other in taken)
        if apart > 0.6 and min(solid.distance(place) for place in line[::3]) > 0.35:
            people.append(walker)
            taken.append(line)
    return people


def disturbed(rng: np.random.Generator, rate: float, count: int) -> Array:
    """Errors (count, 3) m and rad of a scanner's poses at `rate` Hz: jitter of each, and drift of what adds up."""
    jitter, drift = rng.uniform(0.0, 0.012), rng.uniform(0.0, 0.02)
    size = np.array([1.0, 1.0, 0.35])
    walk = np.cumsum(rng.standard_normal((count, 3)), axis=0) * drift / np.sqrt(rate)
    # Now and then a scan is placed a few centimetres off for a while.
    slips = rng.random(count) < 0.05 / rate
    slip = np.cumsum(np.where(slips[:, None], 0.04 * rng.standard_normal((count, 3)), 0.0), axis=0)
    return np.asarray(size * (jitter * rng.standard_normal((count, 3)) + walk + slip))


def _scanner(rng: np.random.Generator) -> tuple[Lidar, float]:
    """A scanner and its rate, Hz."""
    beams, opening = [
        (181, np.pi),
        (361, np.pi),
        (451, 1.5 * np.pi),
        (541, 1.5 * np.pi),
        (1081, 1.5 * np.pi),
        (360, TURN * 359 / 360),
        (720, TURN * 719 / 720),
    ][int(rng.integers(7))]
    lidar = Lidar(
        beams,
        float(opening),
        range_max=float(rng.choice([6.0, 12.0, 30.0, 80.0])),
        sigma=rng.uniform(0.003, 0.03),
        resolution=float(rng.choice([0.0, 0.004, 0.01])),
        dropout=float(rng.choice([0.0, 0.005, 0.03])),
        mixed=rng.uniform(0.0, 0.6),
    )
    return lidar, float(rng.choice([5.0, 8.0, 10.0, 10.0, 15.0, 25.0]))


def _legs(rng: np.random.Generator, length: float, width: float) -> Shapes:
    """Four legs, round or square, of which one pair may be turned in."""
    x, y = 0.5 * length, 0.5 * width
    inward = rng.uniform(0.6, 1.0)
    spots = [(-x, -y * inward), (x, -y), (x, y), (-x, y * inward)]
    size = rng.uniform(0.01, 0.04)
    if rng.random() < 0.5:
        return joined([circle(a, b, size) for a, b in spots])
    return joined([box(2.0 * size, 2.0 * size, (a, b, 0.0)) for a, b in spots])


def _chair(rng: np.random.Generator) -> Shapes:
    return _legs(rng, rng.uniform(0.35, 0.5), rng.uniform(0.35, 0.5))


def _table(rng: np.random.Generator) -> Shapes:
    return _legs(rng, rng.uniform(0.7, 1.8), rng.uniform(0.5, 0.9))


def _table_with_chairs(rng: np.random.Generator) -> Shapes:
    length, width = rng.uniform(0.8, 1.6), rng.uniform(0.7, 0.9)
    parts = [_legs(rng, length, width)]
    for side in (-1.0, 1.0):
        for along in np.arange(-0.5 * length + 0.3, 0.5 * length, 0.6):
            if rng.random() < 0.7:
                pose = (along, side * (0.5 * width + rng.uniform(0.0, 0.3)), rng.uniform(-0.3, 0.3))
                parts.append(_chair(rng).moved(pose))
    return joined(parts)


def _desk(rng: np.random.Generator) -> Shapes:
    """Two panels, and a drawer unit under it perhaps."""
    length, width = rng.uniform(1.0, 1.8), rng.uniform(0.6, 0.8)
    ends = [box(rng.uniform(0.02, 0.06), width, (side * 0.5 * length, 0.0, 0.0)) for side in (-1.0, 1.0)]
    if rng.random() < 0.6:
        ends.append(box(0.4, rng.uniform(0.4, width), (0.5 * length - 0.25, 0.0, 0.0)))
    return joined(ends)


def _office_chair(rng: np.random.Generator) -> Shapes:
    """Five castors about a column, or the seat where the scanner is as high."""
    if rng.random() < 0.3:
        return circle(0.0, 0.0, rng.uniform(0.18, 0.26))
    turns = TURN * np.arange(5) / 5.0
    away, size = rng.uniform(0.24, 0.34), rng.uniform(0.02, 0.035)
    castors = [circle(away * np.cos(turn), away * np.sin(turn), size) for turn in turns]
    return joined([circle(0.0, 0.0, rng.uniform(0.02, 0.05)), *castors])


def _plant(rng: np.random.Generator) -> Shapes:
    """A pot, or leaves and stems."""
    if rng.random() < 0.4:
        return circle(0.0, 0.0, rng.uniform(0.1, 0.25))
    spread = rng.uniform(0.08, 0.25)
    spots = spread * rng.standard_normal((int(rng.integers(3, 12)), 2))
    return joined([circle(x, y, rng.uniform(0.008, 0.05)) for x, y in spots])


def _bin(rng: np.random.Generator) -> Shapes:
    return circle(0.0, 0.0, rng.uniform(0.1, 0.2))


def _pole(rng: np.random.Generator) -> Shapes:
    return circle(0.0, 0.0, rng.uniform(0.02, 0.09))


def _pair(rng: np.random.Generator) -> Shapes:
    """Two poles, or the wheels of a trolley."""
    gap = rng.uniform(0.12, 0.7)
    size = rng.uniform(0.015, 0.06)
    return joined([circle(-0.5 * gap, 0.0, size), circle(0.5 * gap, 0.0, size)])


def _pillar(rng: np.random.Generator) -> Shapes:
    if rng.random() < 0.5:
        return circle(0.0, 0.0, rng.uniform(0.15, 0.4))
    return box(rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6))


def _crate(rng: np.random.Generator) -> Shapes:
    return box(rng.uniform(0.08, 0.5), rng.uniform(0.08, 0.4))


def _partition(rng: np.random.Generator) -> Shapes:
    """A thin wall with feet, of which the ends show."""
    length = rng.uniform(0.3, 2.0)
    wall = polygon([[-0.5 * length, 0.0], [0.5 * length, 0.0]], closed=False)
    feet = [
        box(rng.uniform(0.03, 0.06), rng.uniform(0.1, 0.5), (side * 0.5 * length, 0.0, 0.0))
        for side in (-1.0, 1.0)
    ]
    return joined([wall, *feet])


def _pieces(rng: np.random.Generator) -> Shapes:
    """Things of any outline close to each other: bags, boxes, cables."""
    parts = []
    for _ in range(int(rng.integers(2, 6))):
        corners = int(rng.integers(3, 7))
        turns = np.sort(rng.uniform(0.0, TURN, corners))
        away = rng.uniform(0.03, 0.2, corners)
        outline = np.column_stack((away * np.cos(turns), away * np.sin(turns)))
        parts.append(polygon(outline + rng.uniform(-0.4, 0.4, 2)))
    return joined(parts)


THINGS: tuple[Callable[[np.random.Generator], Shapes], ...] = (
    _chair,
    _table,
    _table_with_chairs,
    _desk,
    _office_chair,
    _plant,
    _bin,
    _pole,
    _pair,
    _pillar,
    _crate,
    _partition,
    _pieces,
)
ROUND = (_pillar, _pillar, _bin, _bin, _pole, _plant)

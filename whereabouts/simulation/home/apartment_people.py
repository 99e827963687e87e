"""Who lives in the apartment: people who walk between rooms, sit, and carry things, out of each other's way."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimation.errors import InputError
from whereabouts.simulation.shapes import Array
from whereabouts.simulation.walkers import SimulatedWalker, random_build

# Spots people walk over or stay at, m.
SPOTS: dict[str, tuple[float, float]] = {
    "hall_west": (0.6, 0.6), "hall_kitchen": (1.2, 0.6), "hall_middle": (3.9, 0.6), "hall_bag": (5.3, 0.0),
    "hall_east": (7.4, 0.6), "kitchen_door": (1.2, 1.1), "kitchen": (1.2, 2.2), "counter": (-0.7, 2.5),
    "kitchen_table": (0.1, 4.5), "kitchen_north": (1.5, 4.2), "kitchen_living_door": (2.6, 4.2),
    "living_west": (3.6, 4.4), "sofa": (5.4, 4.45), "sofa_right": (6.4, 4.45), "living_south": (3.9, 2.1),
    "opening": (3.9, 1.1), "living_east": (7.2, 2.5), "sideboard": (7.8, 2.6), "armchair": (7.3, 4.6),
    "living_door": (7.4, 1.1), "office_door": (0.6, -1.1), "office": (0.6, -2.2), "desk": (-0.5, -3.2),
    "bedroom_door": (3.9, -1.1), "bedroom": (3.9, -2.2), "bag_place": (5.5, -2.1),
    "nightstand": (5.7, -2.8), "bed": (4.4, -4.2), "wardrobe": (3.4, -3.7), "bookcase": (1.4, -3.9),
}  # fmt: skip
WAYS = (
    ("hall_west", "hall_kitchen"), ("hall_kitchen", "hall_middle"), ("hall_middle", "hall_bag"),
    ("hall_middle", "hall_east"), ("hall_bag", "hall_east"), ("hall_kitchen", "kitchen_door"),
    ("kitchen_door", "kitchen"), ("kitchen", "counter"), ("kitchen_north", "kitchen_table"),
    ("kitchen", "kitchen_north"), ("kitchen_north", "kitchen_living_door"),
    ("kitchen_living_door", "living_west"), ("living_west", "sofa"), ("sofa", "sofa_right"),
    ("armchair", "sofa_right"), ("living_west", "living_south"),
    ("living_south", "opening"), ("opening", "hall_middle"), ("living_south", "living_east"),
    ("living_east", "sideboard"), ("living_east", "armchair"), ("living_east", "living_door"),
    ("living_door", "hall_east"), ("hall_west", "office_door"), ("office_door", "office"), ("office", "desk"),
    ("hall_middle", "bedroom_door"), ("bedroom_door", "bedroom"), ("bedroom", "bag_place"),
    ("bag_place", "nightstand"), ("bedroom", "bed"), ("bedroom", "wardrobe"), ("office", "bookcase"),
)  # fmt: skip
CLEAR = 0.6
"""m, between people, and between people and the robot."""
STEP, LONGEST = 0.25, 120.0


Moving = SimulatedWalker | Callable[[float], Array]
"""Somebody, or the robot: pose (3,) by time, s."""


@dataclass(frozen=True)
class Stay:
    """One stop of a person's day.

    spot : where. rest : s, at least. after : s, not left before. takes, leaves : the thing picked up when leaving, the
    thing put down on arrival.
    """

    spot: str
    rest: float
    after: float = 0.0
    takes: str = ""
    leaves: str = ""


@dataclass(frozen=True)
class Resident:
    """A day as it came to be. handled : (time s, thing, True where it is taken and False where it is put down)."""

    walker: SimulatedWalker
    handled: tuple[tuple[float, str, bool], ...]


def route(start: str, end: str) -> list[str]:
    """Spots on the shortest way. Raises InputError where there is none."""
    waiting, done = [(0.0, start, [start])], set()
    while waiting:
        length, here, path = heapq.heappop(waiting)
        if here == end:
            return path
        if here in done:
            continue
        done.add(here)
        for pair in WAYS:
            if here in pair:
                there = pair[1] if pair[0] == here else pair[0]
                step = float(np.hypot(*np.subtract(SPOTS[there], SPOTS[here])))
                heapq.heappush(waiting, (length + step, there, [*path, there]))
    raise InputError(f"no way from {start!r} to {end!r}")


def live(
    rng: np.random.Generator,
    day: Sequence[Stay],
    others: Sequence[Moving],
    duration: float,
    speed: float = 1.0,
) -> Resident:
    """A person who makes every stop of `day`, and waits there until the way to the next one is free.

    others : everybody who is in the way.
    """
    build, phase = random_build(rng), float(rng.uniform(0.0, 6.0))
    points, rests = [np.array(SPOTS[day[0].spot])], [0.0]
    handled: list[tuple[float, str, bool]] = []
    now = 0.0
    for stay, following in pairwise(day):
        way = np.array([SPOTS[name] for name in route(stay.spot, following.spot)])
        leaving = max(now + stay.rest, stay.after)
        remain = min(following.rest, LONGEST)
        while leaving < duration and not _free(way, leaving, remain, speed, others):
            leaving += float(rng.uniform(0.5, 3.0))
        rests[-1] += leaving - now
        if stay.takes:
            handled.append((leaving, stay.takes, True))
        points += list(way[1:])
        rests += [0.0] * (len(way) - 1)
        now = leaving + float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) / speed
        if following.leaves:
            handled.append((now, following.leaves, False))
    return Resident(
        SimulatedWalker(np.array(points), speed, build, 0.0, np.array(rests), phase), tuple(handled)
    )


def _free(way: Array, leaving: float, remain: float, speed: float, others: Sequence[Moving]) -> bool:
    """Whether nobody comes near while one walks a way from `leaving` and remains at its end."""
    walker = SimulatedWalker(way, speed, start=leaving)
    times = np.arange(leaving, walker.duration + remain + 2.0, STEP)
    mine = walker.path(times)
    for other in others:
        if isinstance(other, SimulatedWalker):
            theirs = other.path(times)
        else:
            theirs = np.array([other(float(time))[:2] for time in times])
        if np.linalg.norm(mine - theirs, axis=1).min() < CLEAR:
            return False
    return True

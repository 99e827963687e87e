"""Rooms made after a recipe, and a robot that looks for something in them (section 5.4.1).

Ten main objects stand about where the recipe says, twenty smaller ones lie next to one of those they may lie next to.
A robot that looks all around sees an object from up to its size times the view scale (5.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Step = Callable[[Mapping[str, Array], Array], Array | None]

# name: size in metres, places as shares of the room for the first and for the redesigned recipe.
MAINS: dict[str, tuple[float, tuple[float, float], tuple[float, float]]] = {
    "dining table": (1.6, (0.22, 0.75), (0.75, 0.20)),
    "three-seater": (1.8, (0.72, 0.36), (0.26, 0.62)),
    "two-seater": (1.5, (0.84, 0.26), (0.14, 0.70)),
    "coffee table": (1.0, (0.83, 0.38), (0.16, 0.60)),
    "side table": (0.7, (0.93, 0.24), (0.07, 0.76)),
    "tv": (1.1, (0.94, 0.44), (0.06, 0.54)),
    "bookcase": (1.7, (0.10, 0.35), (0.88, 0.65)),
    "desk": (1.4, (0.15, 0.12), (0.85, 0.88)),
    "cupboard": (1.5, (0.45, 0.92), (0.55, 0.08)),
    "kitchen counter": (1.8, (0.80, 0.90), (0.20, 0.12)),
}
# name: size in metres, main objects it may be next to with their weights, distance from it in metres.
SMALLS: dict[str, tuple[float, dict[str, float], float]] = {
    "remote control": (
        0.35,
        {"coffee table": 0.4, "side table": 0.25, "two-seater": 0.2, "tv": 0.15},
        0.45,
    ),
    "keys": (
        0.3,
        {"dining table": 0.25, "coffee table": 0.25, "side table": 0.3, "desk": 0.2},
        0.4,
    ),
    "book": (0.4, {"bookcase": 0.4, "side table": 0.2, "coffee table": 0.2, "desk": 0.2}, 0.5),
    "newspaper": (0.45, {"coffee table": 0.6, "dining table": 0.4}, 0.4),
    "cup": (0.35, {"dining table": 0.4, "coffee table": 0.3, "kitchen counter": 0.3}, 0.45),
    "plate": (0.4, {"dining table": 0.6, "kitchen counter": 0.4}, 0.45),
    "chair": (0.9, {"dining table": 0.7, "desk": 0.3}, 0.9),
    "lamp": (0.6, {"side table": 0.5, "desk": 0.5}, 0.3),
    "cushion": (0.5, {"three-seater": 0.6, "two-seater": 0.4}, 0.5),
    "plant": (0.7, {"cupboard": 0.5, "bookcase": 0.5}, 0.8),
    "laptop": (0.45, {"desk": 0.6, "dining table": 0.4}, 0.4),
    "phone": (0.3, {"desk": 0.5, "side table": 0.5}, 0.3),
    "vase": (0.45, {"dining table": 0.5, "cupboard": 0.5}, 0.3),
    "game console": (0.4, {"tv": 1.0}, 0.6),
    "dvd": (0.3, {"tv": 0.6, "bookcase": 0.4}, 0.6),
    "footstool": (0.7, {"three-seater": 0.5, "two-seater": 0.5}, 0.9),
    "pan": (0.5, {"kitchen counter": 1.0}, 0.5),
    "kettle": (0.4, {"kitchen counter": 1.0}, 0.5),
    "toy": (0.4, {"three-seater": 0.4, "coffee table": 0.3, "tv": 0.3}, 0.9),
    "bin": (0.6, {"desk": 0.5, "kitchen counter": 0.5}, 0.8),
}
STRIDE = 0.25  # metres between looks
RECIPE_SIZE = (
    18.0  # metres; from the middle the remote control's neighbours are out of sight at small view scales
)


@dataclass(frozen=True)
class RecipeRoom:
    """positions : {name: (2,) m}. sizes : {name: m}. width : m, of the square room."""

    positions: dict[str, Array]
    sizes: dict[str, float]
    width: float

    def seen(self, place: Array, view_scale: float) -> dict[str, Array]:
        """What is seen from a place (2,): {name: position}."""
        return {
            name: spot
            for name, spot in self.positions.items()
            if math.hypot(*(spot - place)) <= view_scale * self.sizes[name]
        }

    def corners(self) -> Array:
        """(4, 2) places just inside the corners, where a robot comes in."""
        low, high = 0.5, self.width - 0.5
        return np.array([[low, low], [high, low], [high, high], [low, high]])


def recipe_room(
    rng: np.random.Generator, redesigned: bool = False, width: float = RECIPE_SIZE, spread: float = 0.5
) -> RecipeRoom:
    """A room after the recipe, disturbed by Gaussian noise of `spread` metres for main objects."""
    positions, sizes = {}, {}
    for name, (size, first, second) in MAINS.items():
        spot = width * np.array(second if redesigned else first) + spread * rng.standard_normal(2)
        positions[name], sizes[name] = np.clip(spot, 0.3, width - 0.3), size
    for name, (size, hosts, away) in SMALLS.items():
        host = str(rng.choice(list(hosts), p=list(hosts.values())))
        spot = positions[host] + away * rng.standard_normal(2)
        positions[name], sizes[name] = np.clip(spot, 0.1, width - 0.1), size
    return RecipeRoom(positions, sizes, width)


def learning_frames(
    rng: np.random.Generator, view_scale: float = 4.0, rooms: int = 30, width: float = RECIPE_SIZE
) -> list[list[str]]:
    """What a robot sees that looks around on a grid of places in rooms after the recipe."""
    places = np.arange(1.0, width, 2.0)
    made = (recipe_room(rng, width=width) for _ in range(rooms))
    return [sorted(room.seen(np.array([x, y]), view_scale)) for room in made for x in places for y in places]


@dataclass(frozen=True)
class SearchRun:
    """failed : whether directed search ended in vain. length : m until the target was seen, a sweep included."""

    failed: bool
    length: float


def sweep_path(room: RecipeRoom, start: Array, reach: float) -> Array:
    """Places (K, 2) of a zigzag over the room from the corner nearest to `start`, lanes twice `reach` apart."""
    corner = room.corners()[np.argmin(np.hypot(*(room.corners() - start).T))]
    lanes = max(math.ceil((room.width - 1.0) / (2.0 * reach)), 1) + 1
    across = np.linspace(0.5, room.width - 0.5, lanes)
    if corner[1] > 0.5 * room.width:
        across = across[::-1]
    ends = (0.5, room.width - 0.5) if corner[0] < 0.5 * room.width else (room.width - 0.5, 0.5)
    places = [start]
    for lane, y in enumerate(across):
        places += [np.array([ends[lane % 2], y]), np.array([ends[1 - lane % 2], y])]
    return np.array(places)


def swept(room: RecipeRoom, start: Array, target: str, view_scale: float) -> float:
    """Metres of the sweep until the target is seen."""
    reach = view_scale * room.sizes[target]
    length, place = 0.0, start
    for goal in sweep_path(room, start, reach)[1:]:
        while math.hypot(*(goal - place)) > 1e-9:
            if math.hypot(*(room.positions[target] - place)) <= reach:
                return length
            place, stride = _towards(place, goal)
            length += stride
    return length


def driven(
    room: RecipeRoom,
    start: Array,
    target: str,
    view_scale: float,
    next_goal: Step,
    reached: Callable[[Array], None],
) -> SearchRun:
    """Drive where `next_goal(observed, place)` says until the target is seen; a sweep follows where it says None."""
    known: dict[str, Array] = {}
    place, length = start.copy(), 0.0
    goal: Array | None = None
    for _ in range(20000):
        seen = room.seen(place, view_scale)
        if target in seen:
            return SearchRun(False, length)
        fresh = any(name not in known for name in seen)
        known |= seen
        if goal is not None and math.hypot(*(goal - place)) < 1e-9:
            reached(goal)
            goal = None
        if goal is None or fresh:
            goal = next_goal(known, place)
            if goal is None:
                return SearchRun(True, length + swept(room, place, target, view_scale))
        place, stride = _towards(place, goal)
        length += stride
    return SearchRun(True, length + swept(room, place, target, view_scale))


def _towards(place: Array, goal: Array) -> tuple[Array, float]:
    offset = goal - place
    away = math.hypot(*offset)
    stride = min(away, STRIDE)
    return place + offset * (stride / max(away, 1e-12)), stride

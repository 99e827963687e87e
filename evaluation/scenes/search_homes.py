"""Homes of several rooms with furniture, and a robot that drives through them until it sees what it looks for.

A rectangle is divided into rooms, most neighbours of which have a door; each room has furniture by its type. What is
looked for lies near furniture that it goes with, or, now and then, anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.grid_paths import GridPaths
from estimation.geometry.places import Places
from world_model.tasks.maintenance_kernels import resampled
from world_model.tasks.relations import Relations

Array = np.ndarray
Box = tuple[float, float, float, float]

FURNITURE: dict[str, tuple[str, ...]] = {
    "kitchen": ("fridge", "oven", "sink", "table", "chair"),
    "living room": ("sofa", "tv", "coffee table", "armchair", "shelf"),
    "bedroom": ("bed", "wardrobe", "nightstand", "lamp"),
    "bathroom": ("toilet", "bathtub", "washbasin"),
    "office": ("desk", "office chair", "shelf", "printer"),
    "hall": ("coat rack", "shoe rack"),
}
MORE = ("bedroom", "bedroom", "living room", "office")
"""Types of the rooms of a home beyond one of each."""
GOES_WITH: dict[str, dict[str, float]] = {
    "mug": {"sink": 3.0, "table": 3.0, "desk": 2.0, "coffee table": 2.0},
    "remote control": {"coffee table": 4.0, "sofa": 3.0, "tv": 1.0, "bed": 1.0},
    "book": {"shelf": 3.0, "nightstand": 3.0, "desk": 2.0, "sofa": 1.0},
    "glasses": {"nightstand": 2.0, "desk": 2.0, "washbasin": 1.0, "coffee table": 1.0},
    "towel": {"washbasin": 2.0, "bathtub": 3.0, "oven": 1.0},
    "keys": {"shoe rack": 3.0, "table": 1.0, "coat rack": 2.0},
}
STRAY = 0.25  # share of things that lie anywhere
RESOLUTION, CLEARANCE = 0.1, 0.25  # m
DOOR = 4  # cells to each side of a door's middle
SEEN, FOUND = 5.0, 2.0  # m from which furniture and what is looked for are recognised
STRIDE = 0.2  # m between two looks
NEAR = 2.5  # m between what counts as seen together


class Home:
    """One home. grid, places : as a robot has them. things : name, place (2,) and type of room of each piece of
    furniture. target, spot : what is looked for, and where it is. start (2,) : of the robot."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 77])
        width, height = rng.uniform(8.0, 16.0), rng.uniform(8.0, 13.0)
        self.boxes = _divided(rng, (0.0, 0.0, width, height), 3 if width * height > 110.0 else 2)
        types = [*rng.permutation(list(FURNITURE)).tolist(), *MORE][: len(self.boxes)]
        self.grid = _walls(rng, self.boxes)
        rooms = {
            f"room {k}": {"polygon": [[x0, y0], [x1, y0], [x1, y1], [x0, y1]], "type": kind}
            for k, ((x0, y0, x1, y1), kind) in enumerate(zip(self.boxes, types, strict=True))
        }
        self.places = Places.from_mapping({"places": rooms})
        self.things: list[tuple[str, Array, str]] = []
        for box, kind in zip(self.boxes, types, strict=True):
            for name in rng.permutation(FURNITURE[kind])[: rng.integers(2, 5)].tolist():
                self.things.append((name, _inside(rng, box, 0.5), kind))
        self.target = str(rng.choice(list(GOES_WITH)))
        self.spot = self.lies(rng, self.target)
        free = self.grid.centres(np.argwhere(self.grid.free))
        self.start = free[rng.integers(len(free))]

    @property
    def solvable(self) -> bool:
        """Whether the robot can drive to where the target is, and to almost all rooms."""
        paths = GridPaths(self.grid, self.start, CLEARANCE)
        middles = np.array([[0.5 * (x0 + x1), 0.5 * (y0 + y1)] for x0, y0, x1, y1 in self.boxes])
        there = np.isfinite(paths.lengths(np.vstack([self.spot, middles])))
        return bool(there[0] and np.count_nonzero(~there) <= 1)

    def lies(self, rng: np.random.Generator, name: str) -> Array:
        """Where a thing of this name may lie, (2,)."""
        near = [thing for thing in self.things if thing[0] in GOES_WITH[name]]
        if not near or rng.random() < STRAY:
            return _inside(rng, self.boxes[rng.integers(len(self.boxes))], 0.4)
        weights = np.array([GOES_WITH[name][thing[0]] for thing in near])
        at = near[rng.choice(len(near), p=weights / weights.sum())][1]
        x0, y0, x1, y1 = self.boxes[self._room_of(at)]
        return np.clip(at + rng.normal(0.0, 0.4, 2), [x0 + 0.3, y0 + 0.3], [x1 - 0.3, y1 - 0.3])

    def _room_of(self, place: Array) -> int:
        x, y = place
        return next(k for k, (x0, y0, x1, y1) in enumerate(self.boxes) if x0 <= x <= x1 and y0 <= y <= y1)

    def sees(self, place: Array, spot: Array, reach: float) -> bool:
        """Whether what is at `spot` is seen from `place`, both (2,) m."""
        x, y = spot - place
        away = math.hypot(x, y)
        return away <= reach and bool(
            self.grid.ray_cast(place, [math.atan2(y, x)], max(away, 1e-3))[0] >= away - 0.3
        )

    def together(self, rng: np.random.Generator, name: str) -> tuple[list[str], str]:
        """A thing of this name with the furniture around it, and the type of its room."""
        spot = self.lies(rng, name)
        near = [thing for thing, at, _ in self.things if self.sees(spot, at, NEAR)]
        return [name, *near], self.places[f"room {self._room_of(spot)}"].type


def home(seed: int) -> Home:
    """A home in which the target can be found; of one that is not, another is drawn."""
    made = Home(seed)
    while not made.solvable:
        seed += 1_000_003
        made = Home(seed)
    return made


def learned_homes(seed: int, count: int, looks: int = 2) -> Relations:
    """What is found together and in which rooms, from other homes."""
    relations = Relations()
    rng = np.random.default_rng([seed, 5])
    for one in rng.integers(2**31, size=count).tolist():
        seen = Home(one)
        for name in GOES_WITH:
            for _ in range(looks):
                relations.observe(*seen.together(rng, name))
    return relations


class Chooser(Protocol):
    """Says where to go."""

    def next_goal(self, known: Mapping[str, Array], place: Array) -> Array | None: ...
    def reached(self, place: Array) -> None: ...


def driven_through(made: Home, chooser: Chooser, limit: float = 200.0) -> float:
    """Metres until the target is seen, at most `limit`."""
    place, length, seen = made.start, 0.0, set[int]()

    def known() -> dict[str, Array]:
        seen.update(k for k, (_, at, _) in enumerate(made.things) if made.sees(place, at, SEEN))
        nearest = sorted(seen, key=lambda k: -math.dist(made.things[k][1], place))
        return {made.things[k][0]: made.things[k][1] for k in nearest}

    while length < limit:
        if made.sees(place, made.spot, FOUND):
            return length
        goal = chooser.next_goal(known(), place)
        if goal is None:
            break
        paths = GridPaths(made.grid, place, CLEARANCE)
        path = paths.path(_reachable(made.grid, paths, goal))
        assert path is not None
        at_end = True
        for point in resampled(path, STRIDE)[1:]:
            place, length = point, length + math.dist(point, place)
            if made.sees(place, made.spot, FOUND):
                return length
            other = chooser.next_goal(known(), place)
            if other is None or math.dist(other, goal) > 0.5:
                at_end = False
                break
        if at_end:
            chooser.reached(goal if math.dist(place, goal) > 1.0 else place)
    return limit


def _reachable(grid: OccupancyGrid, paths: GridPaths, goal: Array) -> Array:
    """The place that can be driven to nearest to a goal (2,)."""
    centres = grid.centres(np.argwhere(paths.reachable()))
    return np.asarray(centres[np.argmin(np.hypot(*(centres - goal).T))])


def _inside(rng: np.random.Generator, box: Box, margin: float) -> Array:
    x0, y0, x1, y1 = box
    return rng.uniform([x0 + margin, y0 + margin], [x1 - margin, y1 - margin])


def _divided(rng: np.random.Generator, box: Box, depth: int) -> list[Box]:
    """A box in two, these in two, and so on, across the longer side."""
    x0, y0, x1, y1 = box
    if depth == 0 or max(x1 - x0, y1 - y0) < 6.0:
        return [box]
    share = rng.uniform(0.4, 0.6)
    if x1 - x0 > y1 - y0:
        x = x0 + share * (x1 - x0)
        halves: tuple[Box, Box] = ((x0, y0, x, y1), (x, y0, x1, y1))
    else:
        y = y0 + share * (y1 - y0)
        halves = ((x0, y0, x1, y), (x0, y, x1, y1))
    return [part for half in halves for part in _divided(rng, half, depth - 1)]


def _walls(rng: np.random.Generator, boxes: list[Box]) -> OccupancyGrid:
    """Walls around all rooms, with doors between most of those that have a wall in common."""
    cells = [[round(side / RESOLUTION) for side in box] for box in boxes]
    values = np.zeros((1 + max(box[3] for box in cells), 1 + max(box[2] for box in cells)), dtype=np.int8)
    for x0, y0, x1, y1 in cells:
        values[y0 : y1 + 1, [x0, x1]] = 100
        values[[y0, y1], x0 : x1 + 1] = 100
    for k, one in enumerate(cells):
        for other in cells[:k]:
            for axis in range(2):
                low = max(one[1 - axis], other[1 - axis]) + DOOR + 2
                high = min(one[3 - axis], other[3 - axis]) - DOOR - 2
                if one[axis] != other[axis + 2] or high <= low or rng.random() > 0.75:
                    continue
                wall, middle = one[axis], int(rng.integers(low, high))
                along = slice(middle - DOOR, middle + DOOR + 1)
                values[(along, wall) if axis == 0 else (wall, along)] = 0
    return OccupancyGrid.from_values(values, RESOLUTION)

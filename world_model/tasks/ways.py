"""Ways of a robot to where it can look: straight, or around what a grid has occupied."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.grid_paths import GridPaths
from estimation.geometry.places import Place, Places
from estimation.geometry.rotations import wrap_angle
from world_model.tasks.maintenance_kernels import looks_along, straight_stop

CLEARANCE = 0.25  # m a robot's middle keeps from what is occupied
ASIDE = math.radians(60.0)  # between directions that are different sides
AGAIN = 2.0  # m a robot drives before the ways to rooms are worked out anew
INNER = 21  # points along a side of a room, the middle among them, of which one is where it is entered
SIDES = 16  # directions from which an object may be looked at


@dataclass(frozen=True)
class Way:
    """points : (K, 2) m, from the robot to the goal. heading : rad to look in at the end. length : m."""

    points: FloatArray
    heading: float
    length: float

    @property
    def goal(self) -> FloatArray:
        """(3,) x, y, yaw."""
        return np.array([*self.points[-1], self.heading])

    def sampled(self, step: float) -> FloatArray:
        """(S, 3) x, y and heading after each `step` metres, the goal last; the robot itself only where it stays."""
        return np.asarray(looks_along(self.points, self.heading, step))


class Ways:
    """Ways from one pose.

    pose : (3,) x, y, yaw. grid : None is an empty floor.
    """

    def __init__(self, pose: FloatArray, grid: OccupancyGrid | None = None) -> None:
        self.pose = pose
        self._grid = grid
        self._paths: GridPaths | None = None

    def stay(self) -> Way:
        """Look from here, with the heading there is."""
        here = self.pose[:2]
        return Way(np.array([here, here]), float(self.pose[2]), 0.0)

    def to_see(
        self, target: FloatArray, low: float, high: float, standoff: float, aside: bool = False
    ) -> Way | None:
        """Shortest way to where a target (2,) is within range; None where none can be reached.

        low, high : m, range of the sensor. standoff : share of `high` to stop at. aside : look from another side than
        the one that the robot is on, if there is one.
        """
        x, y, heading, length = straight_stop(self.pose, target[0], target[1], low, high, standoff, aside)
        stop = np.array([x, y])
        if self._grid is None:
            return Way(np.array([self.pose[:2], stop]), heading, length)
        nearest = min(low + 0.05, 0.5 * (low + high))
        return self._around(target, stop, nearest, max(standoff * high, nearest), aside)

    def _around(
        self, target: FloatArray, stop: FloatArray, nearest: float, reach: float, aside: bool
    ) -> Way | None:
        """The nearest of several places around the target that can be reached and has a free view of it.

        aside : those that are on another side than the robot come first.
        """
        assert self._grid is not None
        if self._paths is None:
            self._paths = GridPaths(self._grid, self.pose[:2], CLEARANCE)
        angles = np.arange(SIDES) * (2.0 * math.pi / SIDES)
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        spots = np.vstack([stop[None], *(target + radius * ring for radius in (reach, 0.6 * reach, nearest))])
        lengths = self._paths.lengths(spots)
        order = np.argsort(lengths, kind="stable")
        if aside:
            front = math.atan2(*(self.pose[:2] - target)[::-1])
            bearings = np.arctan2(*(spots - target).T[::-1])
            same = np.abs(wrap_angle(bearings - front)) < ASIDE
            far = ~np.isfinite(lengths)
            order = order[np.argsort((same | far)[order] + 1.0 * far[order], kind="stable")]
        for index in order:
            if not math.isfinite(lengths[index]):
                return None
            spot = spots[index]
            offset = target - spot
            heading = math.atan2(offset[1], offset[0])
            away = math.hypot(*offset)
            free = self._grid.ray_cast(spot, [heading], max(away, 1e-3))[0]
            # What stands on a table is within occupied cells itself.
            if free < away - 0.5:
                continue
            points = self._paths.path(spot)
            if points is not None:
                return Way(points, heading, float(np.hypot(*np.diff(points, axis=0).T).sum()))
        return None


class Entrances:
    """Where to drive in each room, and how far that is."""

    def __init__(self, places: Places) -> None:
        self._places = places
        self._worked_out: tuple[OccupancyGrid, FloatArray, dict[str, tuple[FloatArray, float]]] | None = None

    def seen_from(self, place: FloatArray, grid: OccupancyGrid | None) -> dict[str, tuple[FloatArray, float]]:
        """By room, the place (2,) m next to its middle that is free, and metres there from `place` (2,); inf: no way.

        grid : None is an empty floor.
        """
        known = self._worked_out
        if known is not None and known[0] is grid and math.dist(known[1], place) < AGAIN:
            return known[2]
        # What nobody has mapped yet may be floor.
        paths = None if grid is None else GridPaths(grid, place, CLEARANCE, through_unknown=True)
        if grid is None or paths is None or not paths.reachable().any():
            # Of a robot that stands in a wall, or off the map, the map tells no way at all.
            return {name: (spot, math.dist(spot, place)) for name, spot in self._middles.items()}
        reachable, rooms = paths.reachable(), self._places.rooms
        found = [_nearest_to_middle(room, _cells_around(room, grid, reachable)) for room in rooms]
        lengths = paths.lengths(np.array(found).reshape(-1, 2)).tolist()
        entrances = {
            room.name: way for room, way in zip(rooms, zip(found, lengths, strict=True), strict=True)
        }
        self._worked_out = grid, place, entrances
        return entrances

    @cached_property
    def _middles(self) -> dict[str, FloatArray]:
        """Of each room on an empty floor."""
        return {room.name: _nearest_to_middle(room, _lattice(room)) for room in self._places.rooms}


def _cells_around(room: Place, grid: OccupancyGrid, among: npt.NDArray[np.bool_]) -> FloatArray:
    """Middles (N, 2) m of the grid's cells `among` some (H, W) in the box around a room."""
    rows, columns = grid.window(room.polygon.min(axis=0), room.polygon.max(axis=0))
    return grid.centres(np.argwhere(among[rows, columns]) + np.array([rows.start, columns.start]))


def _lattice(room: Place) -> FloatArray:
    """Points (N, 2) m over the box around a room."""
    low, high = room.polygon.min(axis=0), room.polygon.max(axis=0)
    sides = [np.linspace(low[a], high[a], INNER + 2)[1:-1] for a in range(2)]
    return np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)


def _nearest_to_middle(room: Place, points: FloatArray) -> FloatArray:
    """The one of `points` (N, 2) in a room that is nearest to its middle, (2,); the middle where none is in it."""
    middle = np.asarray(room.center, dtype=np.float64)
    inside = points[room.contains(points)] if len(points) else points
    if not len(inside):
        return middle
    return np.asarray(inside[int(np.argmin(np.hypot(*(inside - middle).T)))])

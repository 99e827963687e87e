"""Ways of a robot to where it can look: straight, or around what a grid has occupied."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.grid_paths import GridPaths
from world_model.tasks.maintenance_kernels import straight_stop

CLEARANCE = 0.25  # m a robot's middle keeps from what is occupied
ASIDE = math.radians(60.0)  # between directions that are different sides
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
        legs = np.hypot(*np.diff(self.points, axis=0).T)
        along = np.concatenate(([0.0], np.cumsum(legs)))
        count = max(math.ceil(self.length / step - 1e-9), 1)
        marks = np.linspace(0.0, self.length, count + 1)[1:]
        result = np.empty((count + 1, 3))
        for axis in range(2):
            result[1:, axis] = np.interp(marks, along, self.points[:, axis])
        result[0, :2] = self.points[0]
        ahead = np.diff(result[:, :2], axis=0)
        result[1:, 2] = np.where(
            np.hypot(*ahead.T) > 1e-9, np.arctan2(ahead[:, 1], ahead[:, 0]), self.heading
        )
        result[0, 2] = result[1, 2]
        result[-1, 2] = self.heading
        return result


class Ways:
    """Ways from one pose.

    pose : (3,) x, y, yaw. grid : None is an empty floor.
    """

    def __init__(self, pose: FloatArray, grid: OccupancyGrid | None = None) -> None:
        self.pose = pose
        self._grid = grid
        self._paths: GridPaths | None = None

    @property
    def straight(self) -> bool:
        """Whether nothing is in the way of anything."""
        return self._grid is None

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
            same = np.abs(np.angle(np.exp(1j * (bearings - front)))) < ASIDE
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

"""Random search that is not blind: what of the floor has been looked at, and where to look next."""

from __future__ import annotations

import math

import numpy as np

from estimation.checks import FloatArray
from estimation.grid import OccupancyGrid
from estimation.grid_paths import GridPaths

CELL = 0.5  # metres
CLEARANCE = 0.25  # metres


class Coverage:
    """Which cells of a floor were within `view` metres of the robot, and in sight.

    Parameters
    ----------
    low, high : (2,) metres, corners of the floor where there is no grid. grid : its reachable cells are the floor.
    """

    def __init__(
        self, view: float, low: FloatArray, high: FloatArray, grid: OccupancyGrid | None = None
    ) -> None:
        self.view = view
        self._grid = grid
        x = np.arange(low[0] + 0.5 * CELL, max(high[0], low[0] + CELL), CELL)
        y = np.arange(low[1] + 0.5 * CELL, max(high[1], low[1] + CELL), CELL)
        self._cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if grid is not None:
            self._cells = self._cells[grid.lookup(self._cells) < 0.0]
        self._seen = np.zeros(len(self._cells), dtype=np.bool_)

    def look(self, place: FloatArray) -> None:
        """The robot was at a place (2,)."""
        near = np.flatnonzero(~self._seen & (np.hypot(*(self._cells - place).T) <= self.view))
        if self._grid is not None and len(near):
            offsets = self._cells[near] - place
            away = np.hypot(*offsets.T)
            free = self._grid.ray_cast(place, np.arctan2(offsets[:, 1], offsets[:, 0]), self.view)
            near = near[free >= away]
        self._seen[near] = True

    @property
    def share(self) -> float:
        """Share of the floor that has been looked at."""
        return float(self._seen.mean()) if len(self._seen) else 1.0

    def next_place(self, place: FloatArray) -> FloatArray | None:
        """Where to look next from a place (2,): much that is new for little driving; None when all has been seen."""
        left = self._cells[~self._seen]
        if not len(left):
            return None
        lengths = np.hypot(*(left - place).T)
        if self._grid is not None:
            lengths = GridPaths(self._grid, place, CLEARANCE).lengths(left)
        able = np.flatnonzero(np.isfinite(lengths))
        if not len(able):
            self._seen[:] = True
            return None
        # A few candidates are enough: those that are nearest by bearing and distance alike.
        order = able[np.argsort(lengths[able], kind="stable")]
        chosen = order[:: max(len(order) // 30, 1)]
        fresh = (np.hypot(*(left[chosen, None] - left[None]).transpose(2, 0, 1)) <= self.view).sum(axis=1)
        worth = fresh / (lengths[chosen] + self.view)
        return np.asarray(left[chosen[int(np.argmax(worth))]])


def middle_of(grid: OccupancyGrid) -> FloatArray | None:
    """The free place nearest to the middle of what is free; None where nothing is."""
    cells = np.argwhere(grid.free)
    if not len(cells):
        return None
    centres = grid.centres(cells)
    middle = centres.mean(axis=0)
    return np.asarray(centres[int(np.argmin(np.hypot(*(centres - middle).T)))])


def bounds_of(grid: OccupancyGrid) -> tuple[FloatArray, FloatArray]:
    """Corners (2,), (2,) of the box around what is free, metres."""
    centres = grid.centres(np.argwhere(grid.free)) if grid.free.any() else np.zeros((1, 2))
    half = 0.5 * grid.resolution
    return centres.min(axis=0) - half, centres.max(axis=0) + half


def length_between(a: FloatArray, b: FloatArray) -> float:
    """Metres between two places (2,)."""
    return math.hypot(a[0] - b[0], a[1] - b[1])

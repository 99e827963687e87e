"""Shortest ways over the free cells of an occupancy grid."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_points, as_vectors
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.grid_kernels import NEIGHBOURS, close_around, way_lengths

NEAR = 0.5  # m from a place to the nearest cell that stands for it


class GridPaths:
    """Ways from one place, 8-connected, at least `clearance` metres from what is occupied.

    A robot that stands closer than that to something may still leave. Unknown cells are taken as free where
    `through_unknown`, cells outside the grid never.

    start : (2,) metres.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        start: npt.ArrayLike,
        clearance: float = 0.25,
        through_unknown: bool = False,
    ) -> None:
        self._grid = grid
        self._start = as_vectors("start", start, 2)
        occupied = grid.occupied
        free = ~occupied if through_unknown else grid.free
        self._open = free.copy()
        close_around(self._open, occupied, clearance / grid.resolution)
        rows, columns = grid.window(self._start - 2.0 * clearance, self._start + 2.0 * clearance)
        self._open[rows, columns] |= free[rows, columns] & (self._away(rows, columns) < 2.0 * clearance)
        source = self._nearest_open()
        self._lengths, self._steps = way_lengths(self._open, *source, grid.resolution)

    def _away(self, rows: slice, columns: slice) -> FloatArray:
        """(H, W) m from the start to the cells in these rows and columns."""
        height, width = self._grid.shape
        index = np.meshgrid(np.arange(height)[rows], np.arange(width)[columns], indexing="ij")
        centres = self._grid.centres(np.stack(index, axis=-1))
        return np.asarray(np.hypot(*(centres - self._start).transpose(2, 0, 1)))

    def _nearest_open(self) -> tuple[int, int]:
        """Row and column of the open cell at the start, or of the nearest within NEAR; (-1, -1): there is none."""
        row, column = self._grid.cells(self._start).tolist()
        if self._grid.inside([row, column]) and self._open[row, column]:
            return row, column
        rows, columns = self._grid.window(self._start - NEAR, self._start + NEAR)
        away = np.where(self._open[rows, columns], self._away(rows, columns), np.inf)
        if not away.size or away.min() >= NEAR:
            return -1, -1
        row, column = np.unravel_index(np.argmin(away), away.shape)
        return int(row) + rows.start, int(column) + columns.start

    def lengths(self, places: npt.ArrayLike) -> FloatArray:
        """Metres (N,) to places (N, 2); inf where one cannot be reached."""
        cells = self._grid.cells(as_points("places", places, 2))
        lengths, inside = np.full(len(cells), np.inf), self._grid.inside(cells)
        lengths[inside] = self._lengths[tuple(cells[inside].T)]
        return lengths

    def reachable(self) -> npt.NDArray[np.bool_]:
        """Cells (H, W) that can be reached."""
        return np.isfinite(self._lengths)

    def path(self, place: npt.ArrayLike) -> FloatArray | None:
        """Points (K, 2) from the start to a place (2,), corners only; None where it cannot be reached."""
        end = as_vectors("place", place, 2)
        if not math.isfinite(self.lengths(end[None])[0]):
            return None
        cells = [self._grid.cells(end).tolist()]
        while (step := self._steps[tuple(cells[-1])]) >= 0:
            cells.append([here - by for here, by in zip(cells[-1], NEIGHBOURS[step], strict=True)])
        points = self._grid.centres(cells[::-1])
        turns = np.any(np.diff(cells[::-1], 2, axis=0) != 0, axis=1) if len(points) > 2 else np.zeros(0, bool)
        kept = points[np.concatenate(([False], turns, [False]))] if len(points) > 2 else points[:0]
        return np.vstack([self._start[None], kept, end[None]])

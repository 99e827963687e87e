"""Shortest ways over the free cells of an occupancy grid."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from estimation.checks import FloatArray, as_points, as_vectors
from estimation.geometry.grid import OccupancyGrid

NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


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
        place = as_vectors("start", start, 2)
        self._start = place
        open_cells = ~grid.occupied if through_unknown else grid.free
        if open_cells.size:
            away = distance_transform_edt(~grid.occupied) * grid.resolution
            rows, columns = np.indices(grid.shape)
            centres = grid.centres(np.stack([rows, columns], axis=-1))
            around = np.hypot(*(centres - place).transpose(2, 0, 1))
            open_cells = open_cells & ((away >= clearance) | ((around < 2.0 * clearance) & (away > 0.0)))
        self._open = open_cells
        self._numbers = np.where(open_cells, np.cumsum(open_cells).reshape(grid.shape) - 1, -1)
        self._cells = np.argwhere(open_cells)
        self._source = self._nearest_open(place)
        if self._source < 0:
            self._lengths = np.full(len(self._cells), np.inf)
            self._before = np.full(len(self._cells), -9999)
        else:
            self._lengths, self._before = dijkstra(
                self._graph(), directed=False, indices=self._source, return_predecessors=True
            )

    def _graph(self) -> coo_array:
        height, width = self._grid.shape
        starts, ends, costs = [], [], []
        for down, right in NEIGHBOURS:
            first = self._numbers[: height - down, max(0, -right) : width - max(0, right)]
            second = self._numbers[down:, max(0, right) : width - max(0, -right)]
            both = (first >= 0) & (second >= 0)
            starts.append(first[both])
            ends.append(second[both])
            costs.append(np.full(int(both.sum()), math.hypot(down, right) * self._grid.resolution))
        shape = (len(self._cells), len(self._cells))
        return coo_array(
            (np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends))), shape=shape
        ).tocsr()

    def _nearest_open(self, place: FloatArray) -> int:
        """Number of the open cell at a place, or of the nearest within half a metre; -1 where there is none."""
        cell = self._grid.cells(place)
        if self._grid.inside(cell) and self._numbers[tuple(cell)] >= 0:
            return int(self._numbers[tuple(cell)])
        if not len(self._cells):
            return -1
        away = np.hypot(*(self._grid.centres(self._cells) - place).T)
        best = int(np.argmin(away))
        return best if away[best] < 0.5 else -1

    def lengths(self, places: npt.ArrayLike) -> FloatArray:
        """Metres (N,) to places (N, 2); inf where one cannot be reached."""
        points = as_points("places", places, 2)
        cells = self._grid.cells(points)
        inside = self._grid.inside(cells)
        safe = np.where(inside[:, None], cells, 0)
        numbers = np.where(inside, self._numbers[safe[:, 0], safe[:, 1]], -1) if self._open.size else None
        if numbers is None or not len(self._lengths):
            return np.full(len(points), np.inf)
        return np.where(numbers >= 0, self._lengths[numbers], np.inf)

    def reachable(self) -> npt.NDArray[np.bool_]:
        """Cells (H, W) that can be reached."""
        result = np.zeros(self._grid.shape, dtype=np.bool_)
        result[tuple(self._cells[np.isfinite(self._lengths)].T)] = True
        return result

    def path(self, place: npt.ArrayLike) -> FloatArray | None:
        """Points (K, 2) from the start to a place (2,), corners only; None where it cannot be reached."""
        end = as_vectors("place", place, 2)
        cell = self._grid.cells(end)
        if not self._grid.inside(cell):
            return None
        number = int(self._numbers[tuple(cell)])
        if number < 0 or not math.isfinite(self._lengths[number]):
            return None
        steps = [number]
        while steps[-1] != self._source:
            steps.append(int(self._before[steps[-1]]))
        points = self._grid.centres(self._cells[steps[::-1]])
        turns = np.any(np.diff(points, 2, axis=0) != 0.0, axis=1) if len(points) > 2 else np.zeros(0, bool)
        kept = points[np.concatenate(([False], turns, [False]))] if len(points) > 2 else points[:0]
        return np.vstack([self._start[None], kept, end[None]])

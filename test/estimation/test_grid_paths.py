"""Shortest ways over a grid against breadth-first search and plain geometry."""

from __future__ import annotations

import heapq
import itertools
import math

import numpy as np
import pytest

from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.grid_paths import GridPaths


def searched(free: np.ndarray, start: tuple[int, int]) -> np.ndarray:
    """Lengths in cells, by Dijkstra's algorithm written out."""
    lengths = np.full(free.shape, np.inf)
    lengths[start] = 0.0
    queue = [(0.0, start)]
    while queue:
        length, (row, column) = heapq.heappop(queue)
        if length > lengths[row, column]:
            continue
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                cell = (row + down, column + right)
                inside = 0 <= cell[0] < free.shape[0] and 0 <= cell[1] < free.shape[1]
                if not inside or not free[cell]:
                    continue
                longer = length + math.hypot(down, right)
                if longer < lengths[cell] - 1e-12:
                    lengths[cell] = longer
                    heapq.heappush(queue, (longer, cell))
    return lengths


def test_lengths_are_those_of_a_search_written_out() -> None:
    rng = np.random.default_rng(3)
    values = np.where(rng.random((25, 30)) < 0.25, 100, 0)
    values[12, 15] = 0
    grid = OccupancyGrid.from_values(values, 0.1, (1.0, -2.0))
    start = grid.centres([12, 15])
    paths = GridPaths(grid, start, clearance=0.0)
    rows, columns = np.indices(values.shape)
    places = grid.centres(np.stack([rows.ravel(), columns.ravel()], axis=-1))
    expected = searched(values == 0, (12, 15)).ravel() * 0.1
    expected[values.ravel() > 0] = np.inf
    np.testing.assert_allclose(paths.lengths(places), expected, rtol=1e-9)


def test_path_goes_round_a_wall_and_keeps_clear_of_it() -> None:
    values = np.zeros((60, 60), dtype=int)
    values[:40, 30] = 100
    grid = OccupancyGrid.from_values(values, 0.1)
    paths = GridPaths(grid, [1.0, 1.0], clearance=0.3)
    points = paths.path([5.0, 1.0])
    assert points is not None
    np.testing.assert_allclose(points[[0, -1]], [[1.0, 1.0], [5.0, 1.0]])
    dense = np.vstack([np.linspace(a, b, 50) for a, b in itertools.pairwise(points)])
    wall = grid.centres(np.argwhere(values > 0))
    assert np.hypot(*(dense[:, None] - wall[None]).transpose(2, 0, 1)).min() > 0.2
    length = np.hypot(*np.diff(points, axis=0).T).sum()
    assert length == pytest.approx(paths.lengths([[5.0, 1.0]])[0], abs=0.2)


def test_what_is_walled_in_unknown_or_outside_is_out_of_reach() -> None:
    values = np.zeros((40, 40), dtype=int)
    values[:, 20] = 100
    values[30:, :10] = -1
    grid = OccupancyGrid.from_values(values, 0.1)
    paths = GridPaths(grid, [1.0, 1.0], clearance=0.1)
    away = [[3.0, 1.0], [0.5, 3.5], [9.0, 9.0]]
    assert np.isinf(paths.lengths(away)).all()
    assert paths.path([3.0, 1.0]) is None
    assert paths.path([9.0, 9.0]) is None
    known = GridPaths(grid, [1.0, 1.0], clearance=0.1, through_unknown=True)
    assert np.isfinite(known.lengths([[0.5, 3.5]])[0])


def test_where_nothing_is_occupied_every_cell_can_be_reached_by_a_shortest_way() -> None:
    grid = OccupancyGrid.from_values(np.zeros((12, 20), dtype=int), 0.1)
    paths = GridPaths(grid, [1.55, 0.85])
    assert paths.reachable().all()
    np.testing.assert_allclose(paths.lengths([[0.05, 0.05]]), 0.8 * math.sqrt(2.0) + 0.7)


def test_clearance_is_kept_from_all_that_is_occupied() -> None:
    rng = np.random.default_rng(4)
    values = np.where(rng.random((40, 50)) < 0.01, 100, 0)
    values[20:30, 20:32] = 100
    grid = OccupancyGrid.from_values(values, 0.1)
    centres = grid.centres(np.argwhere(values == 0))
    walls = grid.centres(np.argwhere(values > 0))
    away = np.hypot(*(centres[:, None] - walls[None]).transpose(2, 0, 1)).min(axis=1)
    start = centres[np.argmax(away)]
    open_cells = (away >= 0.25) | (np.hypot(*(centres - start).T) < 0.5)
    free = np.zeros(values.shape, dtype=bool)
    free[tuple(grid.cells(centres[open_cells]).T)] = True
    expected = np.isfinite(searched(free, tuple(grid.cells(start).tolist())))
    np.testing.assert_array_equal(GridPaths(grid, start, clearance=0.25).reachable(), expected)


def test_a_robot_that_stands_too_close_may_leave() -> None:
    values = np.zeros((40, 40), dtype=int)
    values[10, :] = 100
    grid = OccupancyGrid.from_values(values, 0.1)
    paths = GridPaths(grid, [2.0, 1.25], clearance=0.4)
    assert np.isfinite(paths.lengths([[2.0, 3.0]])[0])

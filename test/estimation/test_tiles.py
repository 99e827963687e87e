"""Tiles against walking every ray cell by cell, and against places far apart."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.grid import HIT, MISS, MOST, OccupancyGrid
from estimation.geometry.grid_kernels import TILE
from estimation.geometry.tiles import TiledGrid

RESOLUTION = 0.05


def scan(rng: np.random.Generator, count: int = 60, reach: float = 7.0) -> np.ndarray:
    """Points of a scan in a cave without form."""
    angles = rng.uniform(-np.pi, np.pi, count)
    return rng.uniform(0.1, reach, count)[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))


def walked(start: np.ndarray, end: np.ndarray) -> set[tuple[int, int]]:
    """Cells (column, row) that the way from `start` to `end`, in cells, leads through."""
    cuts = [0.0, 1.0]
    for a, b in zip(start, end, strict=True):
        borders = np.arange(np.ceil(min(a, b)), np.floor(max(a, b)) + 1.0)
        cuts += ((borders - a) / (b - a)).tolist()
    times = np.unique(np.clip(cuts, 0.0, 1.0))
    middles = start + 0.5 * (times[:-1] + times[1:])[:, None] * (end - start)
    return {(int(x), int(y)) for x, y in np.floor(middles)}


def brute_force(looks: list[tuple[np.ndarray, np.ndarray]]) -> dict[tuple[int, int], np.float32]:
    """Log-odds by cell (column, row) after all looks, each a pose and points."""
    cells: dict[tuple[int, int], np.float32] = {}
    for pose, points in looks:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        ends = (pose[:2] + points @ np.array([[c, s], [-s, c]])) / RESOLUTION
        hits = {(int(x), int(y)) for x, y in np.floor(ends)}
        passed: set[tuple[int, int]] = set()
        for end in ends:
            passed |= walked(pose[:2] / RESOLUTION, end)
        for cell in passed | hits:
            change = HIT if cell in hits else MISS
            value = float(cells.get(cell, np.float32(0.0))) + change
            cells[cell] = np.float32(min(max(value, -MOST), MOST))
    return cells


@pytest.mark.parametrize("where", [(0.0, 0.0), (-3.17, 120.4), (99_999.3, -100_000.7)])
def test_every_cell_is_what_walking_the_rays_gives(where: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    tiles = TiledGrid(RESOLUTION)
    looks = [
        (np.array([*rng.uniform(-2.0, 2.0, 2) + where, rng.uniform(-3.0, 3.0)]), scan(rng)) for _ in range(40)
    ]
    for pose, points in looks:
        tiles.integrate(pose, points)
    expected = brute_force(looks)
    grid = tiles.dense()
    rows, columns = np.nonzero(grid.log_odds)
    low = np.round(grid.origin / RESOLUTION).astype(int)
    found = {
        (int(i + low[0]), int(j + low[1])): grid.log_odds[j, i]
        for j, i in zip(rows.tolist(), columns.tolist(), strict=True)
    }
    nothing = np.float32(0.0)
    # A ray through a corner may pass on either side of it; hits and passes may add up to nothing.
    differing = {
        cell
        for cell in found.keys() | expected.keys()
        if found.get(cell, nothing) != expected.get(cell, nothing)
    }
    assert len(found) > 20_000
    assert len(differing) <= 2


def test_tiles_and_a_dense_grid_are_the_same_cells() -> None:
    rng = np.random.default_rng(2)
    tiles, grid = TiledGrid(RESOLUTION), OccupancyGrid(RESOLUTION)
    for _ in range(60):
        pose, points = np.array([*rng.uniform(-9.0, 9.0, 2), rng.uniform(-3.0, 3.0)]), scan(rng)
        tiles.integrate(pose, points)
        grid.integrate(pose, points)
    places = rng.uniform(-20.0, 20.0, (20_000, 2))
    np.testing.assert_array_equal(tiles.lookup(places), grid.lookup(places))
    np.testing.assert_array_equal(tiles.dense().lookup(places), grid.lookup(places))
    view = tiles.view()
    np.testing.assert_array_equal(tiles.values(view), tiles.dense(view).values())
    points = tiles.occupied_points()
    assert len(points) == grid.occupied.sum()
    assert (grid.lookup(points) > 0.0).all()


@pytest.mark.parametrize("away", [300.0, 1e5, 1e6])
def test_a_jump_costs_kilobytes_and_the_part_around_the_robot_is_shown(away: float) -> None:
    rng = np.random.default_rng(3)
    tiles, points = TiledGrid(RESOLUTION), scan(rng)
    for x in (0.0, 1.0, 2.0):
        tiles.integrate([x, 0.0, 0.0], points)
    before, home = tiles.nbytes, tiles.view()
    there = np.array([away, -away, 0.0])
    tiles.integrate(there, points)
    assert tiles.nbytes - before < 1_000_000
    near, far = tiles.view((0.0, 0.0)), tiles.view(there[:2])
    assert (near.low, near.shape) == (home.low, home.shape)
    assert tiles.view() == near, "the larger part, where nothing is said"
    for view, pose in ((near, np.zeros(3)), (far, there)):
        assert tiles.dense(view).lookup((pose[:2] + points)[:10]).min() > 0.0
        inside = tiles.dense(view).inside(
            tiles.dense(view).cells((tiles.tiles[:, ::-1] + 0.5) * TILE * RESOLUTION)
        )
        assert view.left_out == (~inside).sum() > 0
        assert view.farthest == pytest.approx(away * np.sqrt(2.0), abs=20.0)


def test_parts_near_each_other_are_shown_together() -> None:
    points = scan(np.random.default_rng(4))
    tiles = TiledGrid(RESOLUTION)
    tiles.integrate(np.zeros(3), points)
    tiles.integrate([20.0, 0.0, 0.0], points)
    tiles.integrate([300.0, 0.0, 0.0], points)
    view = tiles.view((0.0, 0.0))
    grid = tiles.dense(view)
    assert grid.inside(grid.cells([[0.0, 0.0], [20.0, 0.0], [300.0, 0.0]])).tolist() == [True, True, False]


def test_what_is_too_large_is_shown_around_the_robot() -> None:
    tiles = TiledGrid(0.1)
    points = scan(np.random.default_rng(5), reach=9.0)
    for x in np.arange(0.0, 200.0, 4.0):
        tiles.integrate([x, 0.0, 0.0], points)
        tiles.integrate([0.0, x, 0.0], points)
    everything = tiles.view()
    assert everything.left_out == 0
    most = 300_000
    for place in ((150.0, 3.0), (2.0, 2.0), (-500.0, 0.0)):
        view = tiles.view(place, most)
        grid = tiles.dense(view)
        assert grid.log_odds.size <= most
        assert view.left_out > 0
        nearest = np.clip(place, -5.0, 195.0)
        assert grid.inside(grid.cells(nearest))
    # It moves now and then, not with every step.
    assert 2 <= len({tiles.view((x, 3.0), most).low for x in np.arange(100.0, 130.0, 0.5)}) <= 5


def test_erased_tiles_are_unknown_and_their_memory_is_used_again() -> None:
    rng = np.random.default_rng(6)
    tiles, points = TiledGrid(RESOLUTION), scan(rng)
    touched = tiles.integrate(np.zeros(3), points)
    assert len(touched) == len(tiles)
    tiles.erase(touched)
    assert len(tiles) == 0
    assert (tiles.lookup(points) == 0.0).all()
    assert tiles.view().shape == (0, 0)
    for k in range(50):
        tiles.erase(tiles.integrate([40.0 * k, 0.0, 0.0], points))
    again = TiledGrid(RESOLUTION)
    again.integrate(np.zeros(3), points)
    tiles.integrate(np.zeros(3), points)
    np.testing.assert_array_equal(tiles.dense().log_odds, again.dense().log_odds)


def test_only_the_tiles_asked_for_change() -> None:
    tiles, points = TiledGrid(RESOLUTION), scan(np.random.default_rng(7))
    touched = tiles.integrate(np.zeros(3), points)
    before = tiles.dense()
    one = frozenset([min(touched)])
    assert tiles.integrate(np.zeros(3), points, only=one) == touched
    changed = np.argwhere(tiles.dense().log_odds != before.log_odds)
    cells = np.floor(before.centres(changed) / RESOLUTION).astype(int)[:, ::-1] // TILE
    assert {tuple(tile) for tile in cells.tolist()} == one


@pytest.mark.parametrize("x", [1e10, -1e19, np.inf, np.nan])
def test_a_place_no_map_reaches_is_refused(x: float) -> None:
    for grid in (TiledGrid(RESOLUTION), OccupancyGrid(RESOLUTION)):
        with pytest.raises(InputError):
            grid.integrate([x, 0.0, 0.0], np.ones((3, 2)))
    with pytest.raises(InputError, match="too wide"):
        TiledGrid(RESOLUTION).integrate(np.zeros(3), np.array([[1e6, 1e6]]))


def test_a_dense_grid_does_not_grow_without_bounds() -> None:
    grid = OccupancyGrid(RESOLUTION)
    grid.integrate(np.zeros(3), np.ones((1, 2)))
    with pytest.raises(InputError, match="at most"):
        grid.integrate([1e5, 1e5, 0.0], np.ones((1, 2)))
    assert grid.lookup([1.0, 1.0]) > 0.0


def test_rounding_at_a_border_stays_in_the_box() -> None:
    """What lies 1e-20 below a border of tiles is not in the tile that comes after the last."""
    tiles = TiledGrid(1.0)
    touched = tiles.integrate([-1e-20, -1e-20, 0.0], np.array([[0.0, 0.0], [-3.5, -3.5]]))
    assert touched == {(-1, -1)}
    assert tiles.lookup([-0.5, -0.5]) > 0.0
    assert tiles.lookup([-3.5, -3.5]) > 0.0

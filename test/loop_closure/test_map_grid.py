"""The grid of a map, drawn piece by piece, against the same drawn at once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from loop_closure.keyframes import Keyframes
from loop_closure.maps.map_grid import MapGrid
from registration.laser.scan import Scan

MOVE = np.array([0.2, -0.1, 0.05])


class Map:
    """Keyframes and poses that a test moves as it likes."""

    def __init__(self) -> None:
        self.keyframes = Keyframes()
        self.graph = SimpleNamespace(poses=np.zeros((0, 3)))
        self._rng = np.random.default_rng(0)

    def add(self, *pose: float) -> None:
        bearings = np.linspace(-2.0, 2.0, 181)
        ranges = 3.0 + np.sin(3.0 * bearings + self._rng.uniform(0.0, 6.0))
        scan = Scan(ranges, -2.0, 4.0 / 180.0, 0.05, 30.0, float(len(self.keyframes)))
        self.keyframes.add_scan(scan, np.array(pose), 25.0)
        self.graph.poses = np.vstack((self.graph.poses, pose))

    def take_out(self, gone: list[int]) -> None:
        stay = np.setdiff1d(np.arange(len(self.keyframes)), gone)
        number = np.full(len(self.keyframes), -1)
        number[stay] = np.arange(len(stay))
        self.keyframes.take_out(number)
        self.graph.poses = self.graph.poses[stay]


def at_once(slam: Any) -> MapGrid:
    made = MapGrid()
    made.update(slam)
    return made


def same(a: MapGrid, b: MapGrid) -> bool:
    tiles = {tuple(tile) for tile in np.vstack((a.tiles.tiles, b.tiles.tiles)).tolist()}
    lattice = np.array(sorted(tiles))[:, ::-1] * 64 * 0.05
    offsets = (np.stack(np.mgrid[0:64, 0:64], axis=-1) + 0.5) * 0.05
    places = (lattice[:, None, None] + offsets).reshape(-1, 2)
    return np.array_equal(a.tiles.lookup(places), b.tiles.lookup(places))


@pytest.fixture
def corridor() -> Any:
    slam = Map()
    for k in range(60):
        slam.add(0.7 * k, 0.3 * np.sin(k), 0.1 * np.cos(k))
    return slam


def test_what_is_new_is_added(corridor: Any) -> None:
    grid = at_once(corridor)
    corridor.add(42.0, 1.0, 0.0)
    grid.changed()
    grid.update(corridor)
    assert 0 < len(grid.changed()) < 0.3 * len(grid.tiles)
    assert same(grid, at_once(corridor))


def test_what_has_moved_is_drawn_anew_and_nothing_else(
    corridor: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = at_once(corridor)
    before = grid.tiles.dense()
    grid.changed()
    corridor.graph.poses[40:44] += MOVE
    drawn: list[float] = []
    integrate = grid.tiles.integrate
    monkeypatch.setattr(
        grid.tiles,
        "integrate",
        lambda pose, *rest, **more: drawn.append(pose[0]) or integrate(pose, *rest, **more),
    )
    grid.update(corridor)
    assert same(grid, at_once(corridor))
    # The other end of the corridor was left alone.
    assert min(drawn) > 14.0
    changed = np.array(sorted(grid.changed()))
    assert changed[:, 1].min() * 64 * 0.05 > 14.0
    away = np.stack(np.meshgrid(np.arange(0.02, 14.0, 0.05), np.arange(-2.98, 3.0, 0.05)), axis=-1)
    np.testing.assert_array_equal(grid.tiles.lookup(away), before.lookup(away))


def test_small_steps_add_up(corridor: Any) -> None:
    grid = at_once(corridor)
    for _ in range(20):
        corridor.graph.poses = corridor.graph.poses + np.array([0.004, 0.0, 0.0])
        grid.update(corridor)
    # Never more than half a cell behind.
    shown = (
        at_once(SimpleNamespace(keyframes=corridor.keyframes, graph=SimpleNamespace(poses=poses)))
        for poses in (corridor.graph.poses - np.array([0.004 * k, 0.0, 0.0]) for k in range(7))
    )
    assert any(same(grid, other) for other in shown)


def test_what_was_taken_out_is_gone_when_its_place_is_drawn_anew(corridor: Any) -> None:
    grid = at_once(corridor)
    corridor.take_out([10, 11, 12, 30])
    grid.update(corridor)
    corridor.graph.poses[:20] += MOVE
    grid.update(corridor)
    assert same(grid, at_once(corridor))


@pytest.mark.parametrize("away", [300.0, 1e5, 1e6])
def test_a_jump_costs_kilobytes_is_said_and_is_taken_back(corridor: Any, away: float) -> None:
    grid = at_once(corridor)
    cost = grid.tiles.nbytes
    corridor.add(away, away, 0.0)
    grid.update(corridor)
    assert 0 < grid.tiles.nbytes - cost < 500_000
    assert grid.grid.log_odds.nbytes < 10 * cost
    view = grid.tiles.view((0.0, 0.0))
    assert view.farthest == pytest.approx(away * np.sqrt(2.0), abs=50.0)
    assert f"left out, up to {view.farthest:.0f} m away" in grid.left_out(view)
    corridor.graph.poses[-1] = [42.0, 1.0, 0.0]
    grid.update(corridor)
    assert same(grid, at_once(corridor))
    assert not grid.left_out(grid.tiles.view((0.0, 0.0)))
    assert grid.tiles.nbytes < cost + 500_000


def test_a_place_no_map_reaches_is_said_and_the_rest_is_drawn(corridor: Any) -> None:
    expected = at_once(corridor)
    corridor.add(1e19, 0.0, 0.0)
    grid = at_once(corridor)
    assert same(grid, expected)
    assert "1 keyframe" in grid.left_out(grid.tiles.view())
    corridor.graph.poses[-1] = [42.0, 1.0, 0.0]
    grid.update(corridor)
    assert same(grid, at_once(corridor))
    assert not grid.left_out(grid.tiles.view())


def test_a_few_at_a_time_leads_to_the_same_grid_and_shows_a_whole_one_meanwhile(corridor: Any) -> None:
    grid = at_once(corridor)
    before = at_once(corridor)
    grid.changed()
    corridor.graph.poses = corridor.graph.poses + MOVE
    corridor.add(42.0, 1.0, 0.0)
    calls = 0
    grid.update(corridor, 10)
    while grid.behind:
        calls += 1
        assert len(grid.tiles) >= len(before.tiles)
        grid.update(corridor, 10)
    grid.update(corridor, 10)
    assert calls >= 4
    assert grid.changed()
    assert same(grid, at_once(corridor))

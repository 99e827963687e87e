"""Occupancy grid against brute force and against the files other tools write."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid


def room(rng: np.random.Generator, looks: int = 5) -> OccupancyGrid:
    """A room of 6 by 4 m seen from random places."""
    grid = OccupancyGrid(0.1)
    for _ in range(looks):
        pose = np.array([*rng.uniform([-2.0, -1.0], [2.0, 1.0]), rng.uniform(-3.0, 3.0)])
        angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
        heading = angles + pose[2]
        with np.errstate(divide="ignore"):
            x = np.where(np.cos(heading) > 0, 3.0 - pose[0], -3.0 - pose[0]) / np.cos(heading)
            y = np.where(np.sin(heading) > 0, 2.0 - pose[1], -2.0 - pose[1]) / np.sin(heading)
        far = np.minimum(x, y)
        grid.integrate(pose, far[:, None] * np.column_stack((np.cos(angles), np.sin(angles))))
    return grid


def test_inside_is_free_walls_are_occupied_outside_is_unknown() -> None:
    grid = room(np.random.default_rng(0))
    inside = np.random.default_rng(1).uniform([-2.7, -1.7], [2.7, 1.7], (200, 2))
    assert (grid.lookup(inside) < 0.0).all()
    assert (grid.lookup([[3.5, 0.0], [0.0, 2.5], [100.0, 100.0]]) == 0.0).all()
    along = np.linspace(-2.8, 2.8, 40)
    walls = np.column_stack((along, np.full(40, 2.0)))
    assert np.mean([grid.lookup(walls + np.array([0.0, d])) > 0.0 for d in (-0.05, 0.05)], axis=1).max() > 0.9


def test_a_free_line_is_what_stepping_along_it_gives() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        grid = OccupancyGrid(0.25)
        end = rng.uniform(-8.0, 8.0, 2)
        grid.integrate(np.zeros(3), end[None])
        steps = np.linspace(0.0, 1.0, 20001)[:, None] * end
        expected = {tuple(cell) for cell in grid.cells(steps).tolist()}
        touched = {tuple(cell) for cell in np.argwhere(grid.log_odds != 0.0).tolist()}
        # Corners that a line only grazes may fall to either side.
        assert len(expected ^ touched) <= 2
        assert grid.lookup(end) > 0.0


def test_rays_end_where_marching_finds_the_wall() -> None:
    rng = np.random.default_rng(3)
    grid = room(rng)
    headings = rng.uniform(-np.pi, np.pi, 100)
    found = grid.ray_cast((0.3, -0.2), headings, 10.0)
    for heading, distance in zip(headings, found, strict=True):
        steps = np.arange(0.0, 10.0, 0.002)[:, None] * [np.cos(heading), np.sin(heading)] + [0.3, -0.2]
        hit = np.flatnonzero(grid.lookup(steps) > 0.6)
        assert distance == pytest.approx(0.002 * hit[0], abs=0.01)
    assert np.isinf(grid.ray_cast((0.3, -0.2), [0.0], 1.0)).all()
    assert grid.ray_cast((10.0, 0.0), [0.0], 5.0, through_unknown=False)[0] == 0.0


def test_what_is_visible_is_bounded_by_walls_and_opening() -> None:
    grid = room(np.random.default_rng(4))
    seen = grid.visible((0.0, 0.0, 0.0), 8.0)
    assert seen[tuple(grid.cells((2.0, 1.0)))]
    assert not seen[tuple(grid.cells((3.6, 0.0)))]
    ahead = grid.visible((0.0, 0.0, 0.0), 8.0, opening=np.pi / 2)
    assert ahead[tuple(grid.cells((2.0, 1.0)))]
    assert not ahead[tuple(grid.cells((-2.0, 0.0)))]
    assert not grid.visible((0.0, 0.0, 0.0), 1.0)[tuple(grid.cells((2.0, 1.0)))]


def test_files_come_back_and_look_as_map_saver_writes_them(tmp_path) -> None:
    grid = room(np.random.default_rng(5))
    described = grid.save(tmp_path / "map")
    again = OccupancyGrid.load(described)
    np.testing.assert_array_equal(again.values(), grid.values())
    np.testing.assert_allclose(again.origin, grid.origin, atol=1e-6)
    data = (tmp_path / "map.pgm").read_bytes()
    height, width = grid.shape
    pixels = np.frombuffer(data[-height * width :], dtype=np.uint8).reshape(height, width)
    row, column = np.argwhere(grid.occupied)[0]
    assert data.startswith(b"P5\n")
    assert pixels[height - 1 - row, column] == 0
    assert set(np.unique(pixels)) == {0, 205, 254}


@pytest.mark.parametrize(
    ("mode", "negate", "expected"),
    [
        ("", 0, [[100, -1, 0]]),
        ("mode: trinary", 1, [[0, -1, 100]]),
        ("mode: scale", 0, [[100, 50, 0]]),
        ("mode: raw", 0, [[-1, -1, 1]]),
        ("mode: raw", 1, [[0, -1, -1]]),
    ],
)
def test_maps_of_other_mappers_are_read_as_map_server_reads_them(
    tmp_path, mode: str, negate: int, expected: list[list[int]]
) -> None:
    (tmp_path / "m.pgm").write_bytes(
        b"P5\n# CREATOR: somebody 0.100 m/pix\n3 1\n255\n" + bytes([0, 147, 254])
    )
    path = tmp_path / "m.yaml"
    thresholds = f"negate: {negate}\noccupied_thresh: 0.65\nfree_thresh: 0.196\n{mode}\n"
    path.write_text(f"image: m.pgm\nresolution: 0.1\norigin: [1.0, 2.0, 0.0]\n{thresholds}")
    share = np.clip(np.array(expected), 1, 99) / 100.0
    known = np.where(np.array(expected) < 0, 0.0, np.log(share / (1.0 - share)))
    np.testing.assert_allclose(OccupancyGrid.load(path).log_odds, known, atol=1e-5)


@pytest.mark.parametrize("content", [b"P5\n1 1\n65535\n\0\0", b"P2\n1 1\n255\n0\n", b"P5\n2 2\n255\n\0"])
def test_an_image_that_is_read_otherwise_is_refused(tmp_path, content: bytes) -> None:
    (tmp_path / "m.pgm").write_bytes(content)
    about = "image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "m.yaml").write_text(about)
    with pytest.raises(InputError, match=r"m\.yaml"):
        OccupancyGrid.load(tmp_path / "m.yaml")
    (tmp_path / "m.yaml").write_text(f"{about}mode: other\n")
    with pytest.raises(InputError, match=r"m\.yaml"):
        OccupancyGrid.load(tmp_path / "m.yaml")


def test_growing_keeps_what_is_known() -> None:
    grid = room(np.random.default_rng(6))
    before = grid.lookup([[0.0, 0.0], [2.95, 0.0]])
    grid.include((-50.0, -40.0), (30.0, 20.0))
    np.testing.assert_array_equal(grid.lookup([[0.0, 0.0], [2.95, 0.0]]), before)


@pytest.mark.parametrize("content", ["", "image: none.pgm", "image: map.pgm\nresolution: x"])
def test_a_bad_file_is_named(tmp_path, content: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(content)
    with pytest.raises(InputError, match=r"bad\.yaml"):
        OccupancyGrid.load(path)


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="resolution"):
        OccupancyGrid(0.0)
    with pytest.raises(InputError, match="points"):
        OccupancyGrid(0.1).integrate(np.zeros(3), np.full((3, 2), np.nan))
    with pytest.raises(InputError, match="values"):
        OccupancyGrid.from_values(np.full((2, 2), 200), 0.1)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda g: g.integrate(np.zeros(3), [[1.0, 0.0]], np.nan), "weight"),
        (lambda g: g.integrate(np.zeros(3), [[1.0, 0.0]], -1.0), "weight"),
        (lambda g: g.integrate(np.zeros((2, 3)), [[1.0, 0.0]]), "pose"),
        (lambda g: g.ray_cast((0.0, 0.0), [0.0, np.nan], 5.0), "headings"),
        (lambda g: g.ray_cast((0.0, 0.0), [[0.0]], 5.0), "headings"),
        (lambda g: g.lookup([np.nan, 0.0]), "points"),
        (lambda g: g.cells([0.0, 0.0, 0.0]), "points"),
        (lambda g: g.visible(np.zeros(3), 5.0, opening=np.nan), "opening"),
        (lambda g: g.visible(np.zeros(3), 5.0, margin=np.nan), "margin"),
        (lambda g: OccupancyGrid.from_values([[np.nan]], 0.1), "values"),
        (lambda g: OccupancyGrid.from_values([[50.5]], 0.1), "values"),
        (lambda g: OccupancyGrid.from_values(np.ones((2, 2), bool), 0.1), "values"),
        (lambda g: OccupancyGrid(0.1, log_odds="walls"), "log_odds"),
    ],
)
def test_bad_arguments_are_named_and_change_nothing(call, named) -> None:
    grid = OccupancyGrid(0.1)
    grid.integrate(np.zeros(3), [[2.0, 0.0]])
    before = grid.log_odds.copy()
    with pytest.raises(InputError, match=named):
        call(grid)
    np.testing.assert_array_equal(grid.log_odds, before)


def test_a_grid_keeps_its_own_origin() -> None:
    origin = np.zeros(2)
    grid = OccupancyGrid(0.1, origin, np.zeros((3, 3)))
    origin[:] = 9.0
    np.testing.assert_array_equal(grid.origin, np.zeros(2))

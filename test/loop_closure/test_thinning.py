"""A robot that stays in a place it knows: the map stops growing, stays right, and shows what has changed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.poses import between, compound
from estimation.metrics.statistics import absolute_trajectory_error
from loop_closure.graph.esdf import EsdfGraph
from loop_closure.keyframes import Keyframes
from loop_closure.maps.map_file import read_map, write_map
from loop_closure.maps.map_grid import MapGrid
from loop_closure.slam.closing import Gate
from loop_closure.slam.thinning import BATCH, Thinning
from loop_closure.slam.trajectory import Slam
from registration import Scan
from whereabouts.simulation import Lidar, Shapes, box, joined

ROUND = 20  # scans of a round of 12 m
LAPS = 16
NEW = (-2.6, 1.9)  # where a cupboard is put after half of the laps


def room(changed: bool) -> Shapes:
    """Nine by seven metres, furnished."""
    furniture = [
        box(1.6, 0.8, (3.4, 2.4, 0.2)),
        box(0.7, 0.9, (-3.6, -2.4, 0.4)),
        box(0.9, 0.6, (1.4, -3.0, 1.1)),
    ]
    if changed:
        furniture.append(box(0.8, 0.6, (*NEW, 0.0)))
    return joined([box(9.0, 7.0), *furniture])


def at(k: int) -> np.ndarray:
    """Pose of the `k`-th scan: round and round, every lap a little elsewhere."""
    angle = 2.0 * np.pi * (k + 0.37 * (k // ROUND)) / ROUND
    radius = 1.85 + 0.06 * np.sin(0.9 * (k // ROUND))
    return np.array([radius * np.cos(angle), 0.75 * radius * np.sin(angle), angle + 0.5 * np.pi])


def driven() -> tuple[list[Scan], np.ndarray, np.ndarray]:
    """Scans, drifting odometry and the truth."""
    rng, lidar = np.random.default_rng(0), Lidar(181)
    worlds = room(False), room(True)
    truth = np.array([at(k) for k in range(ROUND * LAPS)])
    scans = [
        lidar.scan(worlds[k >= len(truth) // 2], pose, rng, float(k)).scan for k, pose in enumerate(truth)
    ]
    odometry = [np.zeros(3)]
    for before, after in pairwise(truth):
        step = between(before, after)
        odometry.append(
            compound(odometry[-1], step * [1.01, 1.01, 1.0] + rng.normal(0.0, [0.003, 0.003, 0.002]))
        )
    return scans, np.array(odometry), truth


@pytest.fixture(scope="module")
def run() -> tuple[Slam, MapGrid, list[int], np.ndarray]:
    """The thinned map, its grid, how many keyframes it had after each lap, and the truth."""
    scans, odometry, truth = driven()
    slam, grid, sizes = Slam(thin=True), MapGrid(), []
    for k, (scan, pose) in enumerate(zip(scans, odometry, strict=True)):
        update = slam.process(scan, pose)
        assert update.keyframe in (None, len(slam.keyframes) - 1)
        for closure in update.closures:
            frames = slam.keyframes[closure.earlier], slam.keyframes[closure.later]
            assert (closure.earlier_stamp, closure.later_stamp) == (frames[0].stamp, frames[1].stamp)
        if k % 10 == 9:
            grid.update(slam)
        if k % ROUND == ROUND - 1:
            sizes.append(len(slam.keyframes))
    return slam, grid, sizes, truth


def test_the_map_stops_growing(run: tuple[Slam, MapGrid, list[int], np.ndarray]) -> None:
    slam, _, sizes, _ = run
    behind = 7 * ROUND  # what is not looked at yet
    assert max(sizes) <= behind + 4 * ROUND + BATCH
    assert sizes[-1] <= sizes[-4] + BATCH
    assert slam.keyframes[len(slam.keyframes) - 1].number > 1.3 * len(slam.keyframes)
    assert len(slam.trajectory()) <= len(slam.keyframes) + 1
    nodes = {node for edge in slam.graph.edges for node in (edge.a, edge.b)}
    assert nodes == set(range(len(slam.keyframes)))


def test_the_map_and_the_robot_in_it_stay_right(run: tuple[Slam, MapGrid, list[int], np.ndarray]) -> None:
    slam, _, _, truth = run
    rows = slam.trajectory()
    expected = truth[rows[:, 0].astype(int)]
    assert absolute_trajectory_error(rows[:, 1:3], expected[:, :2]).rmse < 0.05
    miss = between(between(expected[0], expected[-1]), between(rows[0, 1:], rows[-1, 1:]))
    assert np.hypot(*miss[:2]) < 0.08


def test_what_has_changed_is_in_the_map(run: tuple[Slam, MapGrid, list[int], np.ndarray]) -> None:
    slam, grid, _, truth = run
    # The near side of the new cupboard, as seen from the first pose.
    side = between(truth[0], np.array([NEW[0] + 0.4, NEW[1], 0.0]))[:2]
    anew = MapGrid(0.05)
    anew.update(slam)
    for drawn in (grid.grid, anew.grid):
        cells = drawn.cells(side) + np.stack(np.mgrid[-2:3, -2:3], axis=-1)
        assert drawn.occupied[cells[..., 0], cells[..., 1]].any()


def test_a_thinned_map_is_saved_and_gone_on_with(
    run: tuple[Slam, MapGrid, list[int], np.ndarray], tmp_path
) -> None:
    slam = run[0]
    slam.finish()
    file = tmp_path / "room.npz"
    with file.open("wb") as out:
        write_map(slam, out)
    again = read_map(file, thin=True)
    np.testing.assert_allclose(again.graph.poses, slam.graph.poses, atol=1e-9)
    scans, odometry, truth = driven()
    # A new run begins half a lap on.
    again.resume(between(truth[0], truth[ROUND // 2]))
    count = len(again.keyframes)
    for k in range(ROUND // 2, 3 * ROUND):
        again.process(scans[k], between(odometry[ROUND // 2], odometry[k]))
    miss = between(between(truth[0], truth[3 * ROUND - 1]), again.pose)
    assert np.hypot(*miss[:2]) < 0.1
    assert max(closure.later for closure in again.closures) >= count


def test_every_scan_keeps_its_place_when_asked_for() -> None:
    scans, odometry, truth = driven()
    slam = Slam(thin=True, every_scan=True)
    for scan, pose in zip(scans, odometry, strict=True):
        slam.process(scan, pose)
    rows = slam.trajectory()
    assert len(slam.keyframes) < len(rows) == len(truth)
    assert absolute_trajectory_error(rows[:, 1:3], truth[:, :2]).rmse < 0.05


def test_the_filter_cannot_forget_nodes() -> None:
    with pytest.raises(InputError, match="thin"):
        Slam(graph=EsdfGraph(), thin=True)


def test_a_stand_in_that_goes_too_is_followed() -> None:
    thinning = Thinning(0.5, 0.5)
    thinning.gone = {5: 3, 3: 1}
    assert thinning.stands_for(5) == 1
    assert thinning.stands_for(2) == 2


def test_a_guessed_step_to_what_goes_is_part_of_the_way_to_what_follows() -> None:
    keyframes = Keyframes()
    for k in range(6):
        keyframes.add_scan(Scan(np.full(90, 3.0), -1.5, 3.0 / 90.0), np.array([0.5 * k, 0.0, 0.0]), 25.0)
        if k in (2, 3):
            keyframes.break_off(0.3 + 0.1 * (k - 2))
    keyframes.take_out(np.array([0, 1, -1, 2, -1, 3]))
    assert [keyframes[k].number for k in range(4)] == [0, 1, 3, 5]
    assert keyframes.breaks == {2: pytest.approx(0.5)}
    np.testing.assert_allclose(keyframes.paths, [0.0, 0.5, 1.5, 2.5])


def test_what_could_not_be_told_is_looked_at_again() -> None:
    keyframes, thinning = Keyframes(), Thinning(0.5, 0.5)
    lidar, rng, world = Lidar(181), np.random.default_rng(1), room(False)
    for k, pose in enumerate((at(0), at(5), at(0))):
        keyframes.add_scan(lidar.scan(world, pose, rng, float(k)).scan, pose, 25.0, 80.0 * k)
    poses = np.array([at(0), at(5), at(0)])
    paths = np.array([0.0, 80.0, 160.0, 300.0])
    vague, known = Gate(np.full(3, 3.0), np.full(3, 0.1)), Gate(np.full(3, 0.02), np.full(3, 0.01))
    looked = [thinning.next(paths) for _ in range(3)]
    assert looked == [[0], [1], [2]]
    thinning.examine(2, keyframes, poses, vague, set())
    assert thinning.next(paths) == [2]
    thinning.examine(2, keyframes, poses, known, {2})
    assert (thinning.next(paths), thinning.gone) == ([2], {})
    thinning.examine(2, keyframes, poses, known, set())
    assert (thinning.next(paths), thinning.gone) == ([], {2: 0})

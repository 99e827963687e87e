"""A robot in a saved map, against simulated truth: found without a pose, from a said one, refused where it is not."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimation.errors import InputError
from estimation.geometry.poses import between, compound
from evaluation.scenes.outdoor import (
    Neighbourhood,
    SpinningLidar,
    random_neighbourhood,
    round_trip,
)
from loop_closure.graph.uncertainty import window
from loop_closure.keyframes import MOST, Keyframes
from loop_closure.maps.localization import Localizer, Located
from loop_closure.maps.map_file import read_map, write_map
from loop_closure.maps.map_search import PlanarMap, SpatialMap
from loop_closure.slam.cloud_closing import common, common_standing, lay
from loop_closure.slam.trajectory import Slam
from registration import Scan
from registration.placement.align_submaps import Placement, align_submaps
from whereabouts.simulation import Drive, Lidar, Shapes, box, joined, random_floor

ROUND = round_trip(200)  # about a metre apart
MAPPED = 60
AROUND = random_neighbourhood(np.random.default_rng(21))
ELSEWHERE = random_neighbourhood(np.random.default_rng(22))
LIDAR = SpinningLidar()


def moved(x: float, y: float, z: float, turns: tuple[float, float, float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("zyx", turns).as_matrix()
    pose[:3, 3] = x, y, z
    return pose


# Odometry of another run begins anywhere, and not level.
FAR = moved(150.0, -80.0, 2.0, (0.7, 0.02, -0.01))


def drifting(poses: np.ndarray, rng: np.random.Generator, start: np.ndarray = FAR) -> np.ndarray:
    """What odometry makes of a way: the right steps, each off by a centimetre and a milliradian."""
    made = [start]
    for a, b in pairwise(poses):
        off = np.eye(4)
        off[:3, :3] = Rotation.from_rotvec(0.001 * rng.standard_normal(3)).as_matrix()
        off[:3, 3] = 0.01 * rng.standard_normal(3)
        made.append(made[-1] @ np.linalg.inv(a) @ b @ off)
    return np.array(made)


def aside(poses: np.ndarray, metres: float, back: bool) -> np.ndarray:
    """The same way beside itself, or back along it."""
    way = poses.copy()
    way[:, :3, 3] += metres * poses[:, :3, 1]
    if back:
        way = way[::-1].copy()
        way[:, :3, :2] *= -1.0
    return way


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Slam:
    """A map of the first part of the round, written and read again; its frame is that of the first pose."""
    rng, slam = np.random.default_rng(1), Slam()
    way = ROUND[:MAPPED]
    for k, (pose, odometry) in enumerate(zip(way, drifting(way, rng, np.eye(4)), strict=True)):
        slam.process(LIDAR.cloud(AROUND, pose, rng), odometry, None, 0.5 * k)
    file = tmp_path_factory.mktemp("map") / "street.npz"
    with file.open("wb") as out:
        write_map(slam, out)
    return read_map(file)


def located(
    localizer: Localizer, world: Neighbourhood, way: np.ndarray, seed: int
) -> tuple[list[Located], np.ndarray]:
    """What is said along a way, and metres from the truth (N,), NaN where no pose is."""
    rng = np.random.default_rng(seed)
    truth = np.linalg.inv(ROUND[0]) @ way
    said = [
        localizer.process(LIDAR.cloud(world, pose, rng), odometry)
        for pose, odometry in zip(way, drifting(way, rng), strict=True)
    ]
    misses = [
        np.nan if item.pose is None else np.linalg.norm(item.pose[:3, 3] - true[:3, 3])
        for item, true in zip(said, truth, strict=True)
    ]
    return said, np.array(misses)


@pytest.mark.usefixtures("kiss_matcher")
@pytest.mark.parametrize(("metres", "back"), [(1.5, False), (-1.0, True)])
def test_clouds_are_found_in_a_saved_map_from_anywhere(saved: Slam, metres: float, back: bool) -> None:
    way = aside(ROUND[20:45], metres, back)[:16]
    said, misses = located(Localizer(saved.keyframes, saved.graph.poses), AROUND, way, 2)
    found = np.flatnonzero(np.isfinite(misses))
    assert len(found), "never found"
    assert found[0] <= 10, "metres until it was found"
    assert list(found) == list(range(found[0], len(way))), "lost again"
    assert misses[found].max() < 0.15
    assert sum(item.sure for item in said) >= len(found) - 2
    rotation = said[-1].pose[:3, :3].T @ ROUND[0][:3, :3].T @ way[-1][:3, :3]  # type: ignore[index]
    assert np.linalg.norm(Rotation.from_matrix(rotation).as_rotvec()) < 0.02


@pytest.mark.parametrize("initial", [False, True])
def test_in_another_place_no_pose_is_believed(saved: Slam, initial: bool) -> None:
    localizer = Localizer(saved.keyframes, saved.graph.poses)
    way = ROUND[20 : 34 if initial else 28]
    if initial:
        localizer.place(np.linalg.inv(ROUND[0]) @ way[0])
    said, misses = located(localizer, ELSEWHERE, way, 3)
    assert not any(item.sure for item in said)
    # A pose that was said holds for ten metres at most.
    assert np.isnan(misses[12 if initial else 0 :]).all()


def test_where_a_room_without_map_looks_like_one_with_it_a_wrong_pose_is_soon_given_up() -> None:
    rng = np.random.default_rng([77, 0])
    shapes, waypoints = random_floor(rng)
    drive, lidar = Drive(waypoints, speed=0.6), Lidar(181, np.pi)

    def seen(time: float) -> tuple[Scan, np.ndarray]:
        return lidar.scan(shapes, drive(time), rng, time).scan, drive(time)

    slam = Slam()
    for time in np.arange(0.0, 0.45 * drive.duration, 0.25):
        slam.process(*seen(time), np.diag([1e-4] * 3))
    slam.finish()
    home = compound(slam.graph.poses[0], between(drive(0.0), np.zeros(3)))
    wrong = 0
    for start in (0.6, 0.8):
        localizer = Localizer(slam.keyframes, slam.graph.poses)
        for time in np.arange(start * drive.duration, start * drive.duration + 30.0, 0.25):
            scan, pose = seen(time)
            said = localizer.process(scan, pose).pose
            wrong += said is not None and bool(np.hypot(*between(compound(home, pose), said)[:2]) > 1.0)
    assert 0.25 * wrong < 5.0


def test_a_room_without_map_is_not_taken_for_one_that_looks_like_it() -> None:
    rng = np.random.default_rng([301, 0])
    shapes, waypoints = random_floor(rng)
    drive, lidar = Drive(waypoints, speed=0.6), Lidar(271, 1.5 * np.pi)

    def seen(time: float) -> tuple[Scan, np.ndarray]:
        return lidar.scan(shapes, drive(time), rng, time).scan, drive(time)

    slam = Slam(thin=True, every_scan=True)
    for time in np.arange(0.0, 0.5 * drive.duration, 0.25):
        slam.process(*seen(time), np.diag([1e-4] * 3))
    slam.finish()
    home = compound(slam.graph.poses[0], between(drive(0.0), np.zeros(3)))
    said = {}
    for share in (0.55, 0.75):
        localizer, said[share] = Localizer(slam.keyframes, slam.graph.poses), 0
        for time in np.arange(share * drive.duration, share * drive.duration + 15.0, 0.25):
            scan, pose = seen(time)
            found = localizer.process(scan, pose).pose
            said[share] += found is not None
            assert found is None or np.hypot(*between(compound(home, pose), found)[:2]) < 1.0
    assert said[0.55] > 0, "not found where the map is"


def test_a_pose_as_rviz_says_it_is_made_exact_at_once(saved: Slam) -> None:
    way = aside(ROUND[30:36], 0.7, False)
    start = np.linalg.inv(ROUND[0]) @ way[0]
    localizer = Localizer(saved.keyframes, saved.graph.poses)
    heading = np.arctan2(start[1, 0], start[0, 0])
    localizer.place([start[0, 3] + 0.5, start[1, 3] - 0.5, heading + 0.2])
    said, misses = located(localizer, AROUND, way, 4)
    assert said[0].pose is not None
    first = next(k for k, item in enumerate(said) if item.sure)
    assert first <= 3
    assert misses[first:].max() < 0.15


@pytest.mark.usefixtures("kiss_matcher")
def test_a_wrong_pose_is_given_up_and_the_right_one_found(saved: Slam) -> None:
    localizer = Localizer(saved.keyframes, saved.graph.poses)
    localizer.place([5.0, 25.0, 2.0])
    _, misses = located(localizer, AROUND, ROUND[20:40], 5)
    assert misses[0] > 10.0
    assert misses[-1] < 0.15


def test_a_planar_pose_stands_on_the_map_s_slope() -> None:
    # Uphill along x, one in ten, keyframes looking up; a robot that looks down or across stands on the same ground.
    pitch, places = -np.arctan(0.1), Keyframes()
    poses = np.array([moved(x, 0.0, 0.1 * x, (0.0, pitch, 0.0)) for x in np.arange(0.0, 20.0)])
    for pose in poses:
        places.add_cloud(np.zeros((1, 3)), 0.0, pose)
    ground = SpatialMap(places, poses)
    for yaw in (0.0, np.pi, 0.5 * np.pi, -0.7):
        stood = ground.on_the_ground(np.array([12.3, 0.4, yaw]))
        np.testing.assert_allclose(stood[:3, 2], poses[0][:3, 2], atol=1e-9)
        np.testing.assert_allclose(stood[:3, :3].T @ stood[:3, :3], np.eye(3), atol=1e-9)
        assert np.arctan2(stood[1, 0], stood[0, 0]) == pytest.approx(yaw)
        assert stood[:2, 3] == pytest.approx([12.3, 0.4])
        assert stood[2, 3] == pytest.approx(1.2, abs=0.31)
    assert ground.on_the_ground(np.array([12.0, 0.0, np.pi]))[2, 0] == pytest.approx(np.sin(pitch))


@pytest.mark.usefixtures("kiss_matcher")
def test_a_restart_in_mid_run_goes_on_in_the_saved_map(saved: Slam, tmp_path) -> None:
    """The map is extended past its end by the second run, in one frame."""
    file = tmp_path / "again.npz"
    with file.open("wb") as out:
        write_map(saved, out)
    slam, rng = read_map(file), np.random.default_rng(6)
    before = len(slam.keyframes)
    localizer: Localizer | None = Localizer(slam.keyframes, slam.graph.poses)
    way = ROUND[MAPPED - 10 : MAPPED + 7]
    truth = np.linalg.inv(ROUND[0]) @ way
    misses = []
    for k, (pose, odometry) in enumerate(zip(way, drifting(way, rng), strict=True)):
        cloud = LIDAR.cloud(AROUND, pose, rng)
        if localizer is not None:
            said = localizer.process(cloud, odometry)
            if said.sure:
                assert localizer.correction is not None
                slam.resume(localizer.correction)
                localizer = None
        else:
            slam.process(cloud, odometry, None, 100.0 + 0.5 * k)
            misses.append(np.linalg.norm(slam.pose[:3, 3] - truth[k][:3, 3]))
    assert len(misses) >= 10, "metres in which the map was extended"
    assert max(misses) < 0.2
    joins = [c for c in slam.closures if c.earlier < before <= c.later]
    assert joins, "no closure between the runs"


def test_scans_are_found_however_far_away_odometry_began() -> None:
    spots = [(-2.0, 4.1), (1.5, 4.2), (5.1, 1.0), (4.9, -1.8), (0.6, -4.1), (-2.8, -4.2), (-5.0, 0.4)]
    rng = np.random.default_rng(7)
    furniture = [
        box(rng.uniform(0.3, 0.9), rng.uniform(0.2, 0.4), (x, y, rng.uniform(0, 3))) for x, y in spots
    ]
    world, lidar = joined([box(11.0, 9.0), box(6.4, 4.4), *furniture]), Lidar(181)
    drive = Drive([(-4.3, -3.3), (4.3, -3.3), (4.3, 3.3), (-4.3, 3.3)], speed=0.7, turn_rate=0.8)
    places, poses = Keyframes(), []
    for time in np.arange(0.0, drive.duration, 0.7):
        poses.append(drive(time))
        places.add_scan(lidar.scan(world, poses[-1], rng, time).scan, poses[-1], 25.0)
    localizer = Localizer(places, np.array(poses))
    misses = []
    for time in np.arange(6.0, 20.0, 0.4):
        pose = drive(time)
        said = localizer.process(
            lidar.scan(world, pose, rng, time).scan, compound(np.array([400.0, -300.0, 2.0]), pose)
        )
        misses.append(np.nan if said.pose is None else np.hypot(*(said.pose[:2] - pose[:2])))
    assert np.isfinite(misses[-1]), "never found"
    assert np.nanmax(misses) < 0.2


def test_turning_on_the_spot_proves_no_place() -> None:
    """The same look again and again is one look; two metres on it is another."""
    rng, lidar = np.random.default_rng(9), Lidar(361, 2.0 * np.pi)
    furniture = [
        box(rng.uniform(0.4, 1.2), rng.uniform(0.3, 0.6), (x, 2.0, 0.3 * x)) for x in (-4.0, -1.0, 3.5)
    ]
    world = joined([box(12.0, 6.0), *furniture])
    places, poses = Keyframes(), np.array([[x, -1.0, 0.0] for x in np.arange(-4.0, 4.1, 0.5)])
    for pose in poses:
        places.add_scan(lidar.scan(world, pose, rng, 0.0).scan, pose, 25.0)
    localizer = Localizer(places, poses)
    turning = [np.array([-2.0, -0.8, yaw]) for yaw in np.arange(0.0, 6.3, 0.35)]
    driving = [np.array([x, -0.8, 6.3]) for x in np.arange(-2.0, 2.1, 0.4)]
    said = [localizer.process(lidar.scan(world, pose, rng, 0.0).scan, pose) for pose in (*turning, *driving)]
    first = next(k for k, item in enumerate(said) if item.pose is not None)
    assert len(turning) + 3 <= first <= len(turning) + 8
    pose = said[-1].pose
    assert pose is not None
    assert np.hypot(*(pose[:2] - driving[-1][:2])) < 0.1


def test_flat_ground_alone_closes_nothing() -> None:
    """Two places on a plain with different poles: all points agree well, what stands does not."""
    rng, frames = np.random.default_rng(8), Keyframes()
    for k in range(2):
        ground = np.column_stack((rng.uniform(-15.0, 15.0, (6000, 2)), np.zeros(6000)))
        poles = rng.uniform(-12.0, 12.0, (12, 2)).repeat(60, axis=0)
        upright = np.column_stack((poles + 0.05 * rng.standard_normal(poles.shape), rng.uniform(0, 3, 720)))
        frames.add_cloud(np.concatenate((ground, upright)), float(k), np.eye(4), 100.0 * k)
    a, b = (frames[k].points for k in range(2))
    assert a is not None
    assert b is not None
    assert common(b, a, np.eye(4)) > 0.75
    assert common_standing(b, a, np.eye(4)) < 0.3
    assert lay(frames, 0, 1, np.eye(4), 0.3, 2.0) is None
    assert common_standing(a, a, np.eye(4)) == 1.0


def test_what_does_not_fit_the_map_is_refused(saved: Slam) -> None:
    scan = Scan(np.ones(10), -1.0, 0.2)
    localizer = Localizer(saved.keyframes, saved.graph.poses)
    for wrong, odometry in ((scan, np.zeros(3)), (np.zeros((5, 3)), np.zeros(3)), (scan, np.eye(4))):
        with pytest.raises(InputError, match="cloud"):
            localizer.process(wrong, odometry)
    with pytest.raises(InputError, match=r"\(N, 3\)"):
        localizer.process(np.zeros((5, 2)), np.eye(4))
    flat = Keyframes()
    flat.add_scan(scan, np.zeros(3), 25.0)
    with pytest.raises(InputError, match="pose"):
        Localizer(flat, np.zeros((1, 3))).place(np.eye(4))
    for given, named in (((flat, np.zeros((2, 3))), "poses"), ((None, np.zeros((1, 3))), "places")):
        with pytest.raises(InputError, match=named):
            Localizer(*given)  # type: ignore[arg-type]
    for doubt in ({"sigma": np.nan}, {"turn": 0.0}):
        with pytest.raises(InputError, match=r"sigma|turn"):
            Localizer(flat, np.zeros((1, 3))).place(np.zeros(3), **doubt)


def mapped(world: Shapes, lidar: Lidar, drive: Drive) -> tuple[Keyframes, np.ndarray]:
    """A map by true poses, one every 0.3 m or so."""
    rng, places, poses = np.random.default_rng(31), Keyframes(), []
    for time in np.arange(0.0, drive.duration, 0.6):
        poses.append(drive(time))
        places.add_scan(lidar.scan(world, poses[-1], rng, time).scan, poses[-1], 25.0)
    return places, np.array(poses)


@pytest.mark.parametrize("seed", [11, 12])
def test_a_robot_that_was_carried_away_is_found_again(seed: int) -> None:
    rng, lidar = np.random.default_rng(seed), Lidar(181, np.pi, range_max=8.0)
    world, waypoints = random_floor(rng, 4)
    drive = Drive(waypoints, speed=0.5)
    localizer = Localizer(*mapped(world, lidar, drive))
    localizer.place(drive(0.0))
    here, before, misses = np.zeros(3), drive(0.0), []
    # Half way on, of which the wheels notice nothing.
    times = np.concatenate((np.arange(0.0, 20.0, 0.5), 0.5 * drive.duration + np.arange(0.0, 70.0, 0.5)))
    for k, time in enumerate(times):
        pose = drive(time)
        here = compound(here, between(before, pose)) if k != 40 else here
        said, before = localizer.process(lidar.scan(world, pose, rng, time).scan, here).pose, pose
        misses.append(np.inf if said is None else np.hypot(*(said[:2] - pose[:2])))
    assert max(misses[:40]) < 0.2
    assert misses[41] > 0.5, "not carried away"
    assert max(misses[-10:]) < 0.2, "not found within 30 m"


def test_a_robot_is_not_believed_at_the_edge_of_where_it_may_be() -> None:
    """Where the map has changed, something else may fit there."""
    rng, lidar = np.random.default_rng(16), Lidar(181, np.pi, range_max=8.0)
    world, waypoints = random_floor(rng, 2)
    drive, recent = Drive(waypoints, speed=0.5), Keyframes()
    places = PlanarMap(*mapped(world, lidar, drive))
    for time in np.arange(0.0, 8.0, 0.6):
        pose = drive(time)
        places.remember(recent, lidar.scan(world, pose, rng, time).scan, pose)
    sigma, turn = 0.3, 0.1
    reach, _ = window(sigma, turn)
    found = []
    for share in (0.5, 0.95):
        # Diagonally: so far along an axis of whichever place it is laid on.
        found.append(places.track(recent, pose + share * np.array([reach, reach, 0.0]), sigma, turn))
    assert found[0] is not None
    assert np.hypot(*(found[0] - pose)[:2]) < 0.1
    assert found[1] is None


def test_a_lost_robot_searches_no_more_in_a_scan_than_its_time_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng, lidar = np.random.default_rng(15), Lidar(181, np.pi, range_max=8.0)
    world, waypoints = random_floor(rng, 4)
    drive, tried = Drive(waypoints, speed=0.5), []

    def counted(*given: Any) -> list[Placement]:
        tried.append(len(scans))
        return align_submaps(*given)

    monkeypatch.setattr("loop_closure.maps.map_search.align_submaps", counted)
    localizer, scans, found = Localizer(*mapped(world, lidar, drive)), [], np.inf
    for time in np.arange(0.0, 30.0, 0.1):
        scans.append(time)
        said = localizer.process(lidar.scan(world, drive(time), rng, time).scan, drive(time))
        if said.pose is not None:
            found = np.hypot(*(said.pose[:2] - drive(time)[:2]))
            break
    assert found < 0.2
    assert len(tried) > 20
    # Three is to follow it, with the scan that finds it.
    assert np.bincount(tried).max() <= 3


def test_a_slow_sweep_is_undone() -> None:
    rng, lidar = np.random.default_rng(13), Lidar(181, np.pi, range_max=8.0)
    world, waypoints = random_floor(rng, 2)
    drive = Drive(waypoints, speed=0.5)
    localizer = Localizer(*mapped(world, lidar, drive))
    localizer.place(drive(0.0))
    slow, misses = replace(lidar, sweep_time=0.19), []
    for time in np.arange(0.0, 20.0, 0.2):
        pose = drive(time)
        said = localizer.process(slow.scan(world, drive, rng, time).scan, pose)
        if said.sure and said.pose is not None:
            misses.append(np.hypot(*(said.pose[:2] - pose[:2])))
    assert len(misses) > 20
    assert np.median(misses) < 0.015


def test_what_is_remembered_of_the_way_stays_bounded() -> None:
    rng, lidar, world = np.random.default_rng(14), Lidar(30), box(9.0, 7.0)
    places = Keyframes()
    places.add_scan(lidar.scan(world, np.zeros(3), rng).scan, np.zeros(3), 25.0)
    localizer = Localizer(places, np.zeros((1, 3)))
    for k in range(6 * MOST):
        pose = np.array([0.5 * (k % 2), 0.0, 0.0])
        localizer.process(lidar.scan(world, pose, rng, float(k)).scan, pose)
    assert len(localizer._recent) <= 4 * MOST

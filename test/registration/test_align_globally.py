"""Registration without a guess, and of clouds, against known motions."""

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.poses import wrap_angle
from evaluation.datasets import recording
from evaluation.registration.registration_data import read_3dtk, read_ply
from evaluation.scenes.scan_pairs import EASY, free_pose, random_pair
from registration import align, align_globally
from whereabouts.simulation import Lidar, box, corridor, random_room
from whereabouts.simulation.robot import relative

ROUND = Lidar(361, 2.0 * np.pi * 360 / 361)
THREE_QUARTERS = Lidar(1081, np.deg2rad(270.0))


def test_finds_places_of_a_room_from_any_direction() -> None:
    rng = np.random.default_rng(1)
    right = sure_and_wrong = 0
    for _ in range(30):
        room = random_room(rng)
        a, b = (free_pose(room, rng, 2.0) for _ in range(2))
        found = align_globally(ROUND.scan(room, b, rng).scan, ROUND.scan(room, a, rng).scan)
        error = found.transform - relative(a, b)
        good = np.hypot(*error[:2]) < 0.05 and abs(wrap_angle(error[2])) < np.deg2rad(1.0)
        right += good
        sure_and_wrong += found.converged and not good
    assert right >= 27
    assert sure_and_wrong == 0


def test_a_square_room_has_four_answers_and_so_none() -> None:
    rng = np.random.default_rng(2)
    scans = [ROUND.scan(box(5.0, 5.0), (0.3, 0.1, yaw), rng).scan for yaw in (0.2, 0.4)]
    found = align_globally(scans[1], scans[0])
    assert not found.converged
    assert "another pose" in found.reason


@pytest.mark.parametrize("seed", [4008, 4043])
def test_a_room_that_fits_turned_as_far_as_it_was_seen_is_no_answer(seed: int) -> None:
    """Walls agree after a turn by 90 or 180 degrees, and what would speak against it was out of view."""
    rng = np.random.default_rng(seed)
    room = random_room(rng)
    a, b = (free_pose(room, rng, 2.5) for _ in range(2))
    found = align_globally(THREE_QUARTERS.scan(room, b, rng).scan, THREE_QUARTERS.scan(room, a, rng).scan)
    turned = abs(wrap_angle(found.transform[2] - relative(a, b)[2]))
    assert not found.converged
    assert found.reason
    assert turned > 1.5
    assert np.diag(found.covariance).min() > 0.2


def test_a_corridor_without_a_guess_is_refused() -> None:
    rng = np.random.default_rng(3)
    scans = [ROUND.scan(corridor(), (x, 0.2, 0.0), rng).scan for x in (0.0, 1.0)]
    found = align_globally(scans[1], scans[0])
    assert not found.converged
    assert found.reason


def test_different_rooms_are_not_believed() -> None:
    rng = np.random.default_rng(4)
    scans = [random_pair(rng, ROUND, EASY).target.scan for _ in range(60)]
    believed = sum(align_globally(a, b).converged for a, b in zip(scans[::2], scans[1::2], strict=True))
    assert believed == 0


def cloud(rng: np.random.Generator) -> np.ndarray:
    """Points on the floor, walls and boxes of a hall."""
    floor = np.column_stack((rng.uniform(-8.0, 8.0, (3000, 2)), np.zeros(3000)))
    walls = [
        np.column_stack((np.full(1500, x), rng.uniform(-6.0, 6.0, 1500), rng.uniform(0.0, 3.0, 1500)))
        for x in (-8.0, 8.0)
    ]
    ends = [
        np.column_stack((rng.uniform(-8.0, 8.0, 1500), np.full(1500, y), rng.uniform(0.0, 3.0, 1500)))
        for y in (-6.0, 6.0)
    ]
    blocks = [
        rng.uniform(-0.5, 0.5, (600, 3)) * [1.0, 2.0, 1.5] + [x, y, 0.75]
        for x, y in ((2.0, 1.0), (-4.0, -3.0), (5.0, -4.0))
    ]
    return np.concatenate([floor, *walls, *ends, *blocks])


def moved(yaw: float, x: float, y: float) -> np.ndarray:
    transform = np.eye(4)
    transform[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    transform[:3, 3] = [x, y, 0.05]
    return transform


def test_clouds_from_a_guess() -> None:
    points = cloud(np.random.default_rng(5))
    truth = moved(0.08, 0.2, -0.1)
    back = np.linalg.inv(truth)
    found = align(points @ back[:3, :3].T + back[:3, 3], points)
    assert found.converged
    np.testing.assert_allclose(found.transform, truth, atol=0.02)
    assert found.covariance.shape == (6, 6)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0


@pytest.mark.parametrize(
    "clouds", [(np.zeros((5, 3)), 0), (np.zeros((500, 3)), 0), (np.full((500, 3), np.nan), 0)]
)
@pytest.mark.parametrize("register", [align, align_globally])
def test_poor_clouds_are_refused_and_said(clouds: tuple, register) -> None:
    found = register(clouds[0], cloud(np.random.default_rng(6)))
    assert not found.converged
    assert "points" in found.reason


def test_planar_and_spatial_do_not_mix() -> None:
    with pytest.raises(InputError, match="target"):
        align_globally(np.zeros((50, 2)), np.zeros((50, 3)))


@pytest.mark.usefixtures("kiss_matcher")
def test_recorded_clouds() -> None:
    path = recording("scans_3d/source.ply")
    if path is None:
        pytest.skip("scans_3d is not among the recordings here")
    source, target = read_ply(path), read_ply(path.with_name("target.ply"))
    truth = np.loadtxt(path.with_name("T_target_source.txt"))
    turn = moved(2.0, 0.0, 0.0)
    turn[2, 3] = 0.0
    for found, wanted in (
        (align(source, target), truth),
        (align_globally(source @ turn[:3, :3].T, target), truth @ turn.T),
    ):
        off = np.linalg.inv(wanted) @ found.transform
        assert found.converged
        assert np.linalg.norm(off[:3, 3]) < 0.02
        assert np.linalg.norm(off[:3, :3] - np.eye(3)) / np.sqrt(2.0) < np.deg2rad(0.2)


def test_3dtk_scans_are_read_in_metres() -> None:
    path = recording("scans_3d/3dtk/scan000.3d.gz")
    if path is None:
        pytest.skip("scans_3d is not among the recordings here")
    points = read_3dtk(path)
    assert points.shape[1] == 3
    assert 1.0 < np.abs(points).max() < 32.0

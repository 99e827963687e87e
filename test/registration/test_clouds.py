"""Clouds of spinning scanners: rings that lie on each other are no places that do; one point of each voxel."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from registration import align
from registration.clouds.cloud_registration import thin

HALF = np.array([6.0, 4.0, 1.5])  # metres, half of the room's extent


def ringed(pose: np.ndarray, rings: int, rng: np.random.Generator, columns: int = 1200) -> np.ndarray:
    """(N, 3) what a scanner of some rings sees of a room with two columns, from `pose` (4, 4)."""
    turn = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    rise = np.deg2rad(np.linspace(-25.0, 25.0, rings))
    a, e = (grid.ravel() for grid in np.meshgrid(turn, rise))
    rays = np.column_stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)))
    ways, start = rays @ pose[:3, :3].T, pose[:3, 3]
    ranges = ((np.sign(ways) * HALF - start) / ways).min(axis=1)
    for middle in ([2.5, 1.5, 0.0], [-2.0, -2.2, 0.0]):
        low, high = (
            np.divide(np.array(middle) + side * np.array([0.3, 0.4, 1.5]) - start, ways) for side in (-1, 1)
        )
        near, far = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
        ranges = np.where((near < far) & (near > 0.0), np.minimum(ranges, near), ranges)
    return rays * (ranges + rng.normal(0.0, 0.01, len(ranges)))[:, None]


def motion(x: float, y: float, yaw: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", [0.01, 0.02, yaw]).as_matrix()
    matrix[:2, 3] = x, y
    return matrix


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("rings", [16, 32])
def test_the_rings_of_a_scanner_do_not_hold_it(rings: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, step = motion(*rng.uniform(-0.5, 0.5, 3)), motion(*rng.uniform(-0.4, 0.4, 3))
    found = align(
        ringed(start @ step, rings, rng), ringed(start, rings, rng), step @ motion(0.05, -0.05, 0.02)
    )
    off = np.linalg.inv(step) @ found.transform
    assert np.linalg.norm(off[:3, 3]) < 0.02
    assert Rotation.from_matrix(off[:3, :3]).magnitude() < 0.01


@pytest.mark.parametrize("far", [0.0, 1e15])
def test_one_point_of_each_voxel_is_kept(far: float) -> None:
    rng = np.random.default_rng(4)
    cloud = np.vstack((rng.normal(0.0, 2.0, (3000, 3)), [[far, 0.0, -far]]))
    kept = thin(cloud, 0.5)
    voxels = {tuple(voxel) for voxel in np.floor(cloud / 0.5)}
    assert len(kept) == len(voxels) == len({tuple(voxel) for voxel in np.floor(kept / 0.5)})
    assert len(thin(np.zeros((0, 3)), 0.5)) == 0

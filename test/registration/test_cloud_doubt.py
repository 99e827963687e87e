"""What clouds that are laid on each other are told to be off, beside how far they are."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evaluation.scenes.outdoor import Neighbourhood, SpinningLidar
from registration import align
from registration.clouds.cloud_doubt import OPEN_VARIANCE, jackknife, kept

LIDAR = SpinningLidar(32, 600, math.radians(-25.0), math.radians(25.0))
WALL = 0.1  # metres


def walls(length: float, width: float, height: float) -> list[list[float]]:
    """Corners of what encloses a hall about the origin: two sides, two ends, a ceiling."""
    x, y = length / 2.0, width / 2.0
    return [
        [-x, -y - WALL, 0.0, x, -y, height],
        [-x, y, 0.0, x, y + WALL, height],
        [-x - WALL, -y, 0.0, -x, y, height],
        [x, -y, 0.0, x + WALL, y, height],
        [-x, -y, height, x, y, height + WALL],
    ]


def pair(blocks: list[list[float]], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Two clouds from about the middle, the true motion between them (4, 4) and a guess of it."""
    rng = np.random.default_rng(seed)
    world = Neighbourhood(np.array(blocks), np.empty((0, 4)))
    first, step, off = np.eye(4), np.eye(4), np.eye(4)
    first[2, 3] = 1.2
    step[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, [0.02, 0.02, 0.2])).as_matrix()
    step[:3, 3] = rng.normal(0.0, [0.3, 0.3, 0.02])
    off[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.01, 3)).as_matrix()
    off[:3, 3] = rng.normal(0.0, 0.05, 3)
    return LIDAR.cloud(world, first @ step, rng), LIDAR.cloud(world, first, rng), step, step @ off


def error(transform: np.ndarray, truth: np.ndarray) -> np.ndarray:
    turn = Rotation.from_matrix(transform[:3, :3] @ truth[:3, :3].T).as_rotvec()
    return np.concatenate((transform[:3, 3] - truth[:3, 3], turn))


def test_what_clouds_are_said_to_be_off_is_what_they_are_off() -> None:
    squares = []
    for seed in range(40, 46):
        rng = np.random.default_rng(seed)
        places = rng.uniform([-5.0, -3.5], [-1.5, -1.0], (4, 2)) * [[1, 1], [1, -1], [-1, 1], [-1, -1]]
        boxes = [
            [*place, 0.0, *(place + rng.uniform(0.3, 1.0, 2)), rng.uniform(0.4, 2.0)] for place in places
        ]
        source, target, truth, guess = pair(walls(12.0, 8.0, 3.0) + boxes, seed)
        found = align(source, target, guess)
        assert found.converged
        assert not found.reason
        off = error(found.transform, truth)
        squares.append(off @ np.linalg.solve(found.covariance, off) / 6.0)
        # Millimetres, and no more than that is said.
        assert np.sqrt(np.diag(found.covariance))[:2].max() < 0.01
    assert 0.1 < np.mean(squares) < 8.0


def test_a_tunnel_leaves_open_how_far_one_went_and_the_guess_stays() -> None:
    squares = []
    for seed in range(50, 55):
        source, target, truth, guess = pair(walls(400.0, 4.0, 3.0), seed)
        found = align(source, target, guess)
        assert found.converged
        assert "open" in found.reason
        off, wrong = error(found.transform, truth), error(guess, truth)
        assert off[0] == pytest.approx(wrong[0], abs=0.03)
        assert np.abs(off[1:3]).max() < 0.02
        assert found.covariance[0, 0] == pytest.approx(OPEN_VARIANCE, rel=0.1)
        squares.append(off @ np.linalg.solve(found.covariance, off) / 6.0)
    assert np.median(squares) < 8.0


def test_the_end_of_a_tunnel_tells_how_far_one_went() -> None:
    blocks = walls(400.0, 4.0, 3.0)
    blocks.append([6.0, -2.0, 0.0, 6.1, 2.0, 3.0])
    source, target, truth, guess = pair(blocks, 53)
    found = align(source, target, guess)
    assert not found.reason
    assert abs(error(found.transform, truth)[0]) < 0.01
    assert found.covariance[0, 0] < 0.01**2


def test_the_jackknife_is_that_of_fits_without_each_piece() -> None:
    rng = np.random.default_rng(7)
    pieces = rng.integers(0, 9, 300)
    jacobian, weight = rng.normal(size=(300, 6)), rng.uniform(0.5, 1.0, 300)
    off = jacobian @ rng.normal(0.0, 0.02, 6) + rng.normal(0.0, 0.05, 300)

    def fit(rows: np.ndarray) -> np.ndarray:
        root = np.sqrt(weight[rows])
        return np.linalg.lstsq(root[:, None] * jacobian[rows], root * off[rows])[0]

    step = fit(np.full(300, True))
    changes = np.array([fit(pieces != k) - step for k in range(9)])
    sigma = 0.05
    expected = (
        sigma**2 * np.linalg.inv((weight[:, None] * jacobian).T @ jacobian)
        + np.outer(step, step)
        + 8.0 / 9.0 * changes.T @ changes
    )
    np.testing.assert_allclose(
        jackknife(jacobian, weight, off, pieces, sigma), expected, rtol=2e-3, atol=1e-7
    )


def test_only_what_is_open_stays_where_the_guess_is() -> None:
    start, found = np.eye(4), np.eye(4)
    start[:3, 3], found[:3, 3] = [1.0, 2.0, 3.0], [1.4, 2.3, 3.1]
    start[:3, :3] = Rotation.from_euler("z", 0.2).as_matrix()
    found[:3, :3] = Rotation.from_euler("z", 0.3).as_matrix()
    along = kept(start, found, np.array([[0.6, 0.8, 0.0, 0.0, 0.0, 0.0]]))
    # It went by (.4, .3), of which .48 is along (.6, .8).
    np.testing.assert_allclose(along[:3, 3], [1.4 - 0.6 * 0.48, 2.3 - 0.8 * 0.48, 3.1])
    np.testing.assert_allclose(along[:3, :3], found[:3, :3])
    turned = kept(start, found, np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.1]]))
    np.testing.assert_allclose(turned[:3, 3], found[:3, 3])
    np.testing.assert_allclose(turned[:3, :3], start[:3, :3])

"""The normal distributions transform against sums over cells one by one, numerical derivatives and known motions."""

import itertools

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from registration import align
from registration.clouds.ndt import among_outliers, derivatives, grids_of

CELL = 1.3


def moved(points: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Points (N, D) after a motion (3,) or (6,), by scipy."""
    if points.shape[1] == 2:
        flat = np.column_stack((points, np.zeros(len(points))))
        return Rotation.from_rotvec([0.0, 0.0, motion[2]]).apply(flat)[:, :2] + motion[:2]
    return Rotation.from_rotvec(motion[3:]).apply(points) + motion[:3]


def score(target: np.ndarray, placed: np.ndarray, width: float) -> float:
    """Every cell of every grid on its own."""
    total, dimension = 0.0, target.shape[1]
    least, flattest = (3, 1e-3) if dimension == 2 else (5, 1e-2)
    for shift in itertools.product((0.0, 0.5), repeat=dimension):
        homes = [tuple(np.floor(p / CELL + shift)) for p in target]
        for point in placed:
            members = target[[home == tuple(np.floor(point / CELL + shift)) for home in homes]]
            if len(members) < least:
                continue
            values, axes = np.linalg.eigh(np.cov(members.T))
            along = axes.T @ (point - members.mean(axis=0))
            total += np.exp(-0.5 * width * np.sum(along**2 / np.maximum(values, flattest * values[-1])))
    return total


@pytest.mark.parametrize("dimension", [2, 3])
def test_score_and_gradient_are_those_of_the_sum_over_cells(dimension: int) -> None:
    rng = np.random.default_rng(dimension)
    target, source = rng.uniform(-2.0, 2.0, (150, dimension)), rng.uniform(-2.2, 2.2, (40, dimension))
    width, grids = 0.6, grids_of(target, CELL)
    found, gradient, curvature = derivatives(grids, source, width)
    assert found == pytest.approx(score(target, source, width))
    still = np.zeros(len(gradient))
    numerical = approx_fprime(still, lambda m: -score(target, moved(source, m), width), 1e-7)
    np.testing.assert_allclose(gradient, numerical, rtol=1e-3, atol=1e-3)
    assert np.linalg.eigvalsh(curvature)[0] >= 0.0


def test_the_width_matches_the_likelihood_among_outliers_at_three_points() -> None:
    """-log(c₁ exp(-½ q) + c₂) less its value at infinity, over its value at 0, is exp(-½ d q) at q = 1."""
    for cell in (0.5, 1.0, 2.0):
        c1, c2 = 4.5, 0.55 / cell**3
        likelihood = [np.log(c1 * np.exp(-0.5 * q) + c2) - np.log(c2) for q in (0.0, 1.0)]
        assert np.exp(-0.5 * among_outliers(cell)) == pytest.approx(likelihood[1] / likelihood[0])


def hall(rng: np.random.Generator) -> np.ndarray:
    """Points (N, 3) on the floor, two walls that are no parallels, a ramp and a pillar."""
    u, v = rng.uniform(-5.0, 5.0, (2, 4, 3000))
    turn = rng.uniform(-np.pi, np.pi, 1500)
    return np.concatenate(
        [
            np.column_stack((u[0], v[0], np.zeros(3000))),
            np.column_stack((u[1], np.full(3000, 5.0) - 0.2 * u[1], 0.3 * (v[1] + 5.0))),
            np.column_stack((np.full(3000, -5.0), u[2], 0.3 * (v[2] + 5.0))),
            np.column_stack((0.2 * u[3] + 3.0, 0.4 * v[3], 0.15 * (u[3] + 5.0))),
            np.column_stack((np.cos(turn) - 2.0, np.sin(turn) + 1.0, rng.uniform(0.0, 3.0, 1500))),
        ]
    )


@pytest.mark.parametrize("seed", range(6))
def test_clouds_are_laid_on_each_other(seed: int) -> None:
    """Drawn anew from the same surfaces, with noise, from half a metre and ten degrees away."""
    rng = np.random.default_rng(seed)
    away = rng.normal(size=(2, 3))
    truth = np.eye(4)
    truth[:3, :3] = Rotation.from_rotvec(np.deg2rad(10.0) * away[0] / np.linalg.norm(away[0])).as_matrix()
    truth[:3, 3] = 0.5 * away[1] / np.linalg.norm(away[1])
    target, source = (hall(rng) + rng.normal(0.0, 0.01, (13500, 3)) for _ in range(2))
    found = align((source - truth[:3, 3]) @ truth[:3, :3], target, method="ndt")
    off = np.linalg.inv(truth) @ found.transform
    assert found.converged
    assert np.linalg.norm(off[:3, 3]) < 0.02
    assert np.linalg.norm(Rotation.from_matrix(off[:3, :3]).as_rotvec()) < np.deg2rad(0.2)
    assert np.linalg.eigvalsh(found.covariance)[0] > 0.0


def test_clouds_apart_are_refused() -> None:
    target = hall(np.random.default_rng(7))
    found = align(target + np.array([40.0, 0.0, 0.0]), target, method="ndt")
    assert not found.converged
    assert found.reason

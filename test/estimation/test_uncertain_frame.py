"""Positions through an uncertain pose, against drawn samples and the conversion of range and bearing."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.conversion.map_frame import convert_to_map
from estimation.conversion.uncertain_frame import state_through_uncertain_pose, through_uncertain_pose
from estimation.errors import InputError


@pytest.mark.parametrize("heading", [0.02, 0.15, 0.5])
def test_moments_agree_with_samples(heading: float) -> None:
    rng = np.random.default_rng(4)
    pose = np.array([1.0, -2.0, 0.7])
    root = rng.normal(size=(3, 3)) * np.array([[0.1], [0.1], [heading]])
    P = root @ root.T
    P *= np.outer([1, 1, heading / np.sqrt(P[2, 2])], [1, 1, heading / np.sqrt(P[2, 2])])
    seen, R = np.array([3.0, 1.0, 0.4]), np.diag([0.02, 0.05, 0.01])
    R[0, 2] = R[2, 0] = 0.004
    poses = rng.multivariate_normal(pose, P, 400_000)
    local = rng.multivariate_normal(seen, R, 400_000)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    world = np.column_stack(
        [
            poses[:, 0] + c * local[:, 0] - s * local[:, 1],
            poses[:, 1] + s * local[:, 0] + c * local[:, 1],
            local[:, 2],
        ]
    )
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]]
    through_mean = turn @ seen + [1.0, -2.0, 0.0]
    mean, cov = through_uncertain_pose(through_mean, turn @ R @ turn.T, pose[:2], P)
    assert mean == pytest.approx(world.mean(0), abs=0.012)
    assert cov == pytest.approx(np.cov(world.T), abs=0.01 * np.cov(world.T).max())


def test_agrees_with_the_conversion_of_range_and_bearing() -> None:
    P = np.diag([0.01, 0.02, 0.05**2])
    r, sigma_r, bearing, sigma_b = 4.0, 0.05, 0.3, 0.02
    mean, cov = convert_to_map([0.0, 0.0, 0.0], P, r, bearing, sigma_r, sigma_b, method="ucm")
    along, across = (
        np.array([np.cos(bearing), np.sin(bearing)]),
        np.array([-np.sin(bearing), np.cos(bearing)]),
    )
    R = np.zeros((3, 3))
    R[:2, :2] = sigma_r**2 * np.outer(along, along) + (r * sigma_b) ** 2 * np.outer(across, across)
    ours, covariance = through_uncertain_pose([*(r * along), 0.0], R, [0.0, 0.0], P)
    # The text's conversion takes the mean of the measurement out, not that of the position.
    assert ours[:2] == pytest.approx(mean, rel=0.005)
    assert covariance[:2, :2] == pytest.approx(cov, abs=0.002)


def test_an_exact_pose_changes_nothing_and_bad_ones_are_named() -> None:
    R = np.diag([0.1, 0.2, 0.3])
    mean, cov = through_uncertain_pose([1.0, 2.0, 3.0], R, [0.5, 0.5], np.zeros((3, 3)))
    assert mean.tolist() == [1.0, 2.0, 3.0]
    assert cov == pytest.approx(R)
    with pytest.raises(InputError, match="pose_covariance"):
        through_uncertain_pose([1.0, 2.0, 3.0], R, [0.0, 0.0], np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(InputError, match="position"):
        through_uncertain_pose([1.0, np.nan, 3.0], R, [0.0, 0.0], np.eye(3))


@pytest.mark.parametrize("heading", [0.03, 0.4])
def test_moments_of_states_agree_with_samples(heading: float) -> None:
    rng = np.random.default_rng(5)
    origin = np.array([1.0, -2.0])
    root = rng.normal(size=(3, 3)) * np.array([[0.1], [0.1], [heading]])
    P = root @ root.T
    state = np.array([3.5, -0.5, 0.9, -0.4])
    half = 0.2 * rng.normal(size=(4, 4))
    R = half @ half.T
    off = rng.multivariate_normal(np.zeros(3), P, 400_000)
    states = rng.multivariate_normal(state, R, 400_000)
    c, s = np.cos(off[:, 2]), np.sin(off[:, 2])
    arm = states[:, :2] - origin
    turned = [
        np.column_stack((c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1])) for v in (arm, states[:, 2:])
    ]
    world = np.column_stack((origin + off[:, :2] + turned[0], turned[1]))
    mean, cov = state_through_uncertain_pose(state, R, origin, P)
    assert mean == pytest.approx(world.mean(0), abs=0.012)
    assert cov == pytest.approx(np.cov(world.T), abs=0.01 * np.cov(world.T).max())
    # Its position is what the conversion of positions says.
    planar = np.zeros((3, 3))
    planar[:2, :2] = R[:2, :2]
    place, spread = through_uncertain_pose([*state[:2], 0.0], planar, origin, P)
    assert place[:2] == pytest.approx(mean[:2])
    assert spread[:2, :2] == pytest.approx(cov[:2, :2])

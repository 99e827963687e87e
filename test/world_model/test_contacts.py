"""Movers that are detected as one: who is who when they part, from how each went before."""

from __future__ import annotations

import numpy as np
import pytest

from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig
from world_model.anchoring.loops.contacts import Movers, contacts, group_weight, touching_groups
from world_model.anchoring.loops.leaves import empty
from world_model.anchoring.loops.look import Detections
from world_model.anchoring.loops.walking import flow, walk

RATE, SIGMA, REACH = 30.0, 0.001, 0.008


def config(**more: object) -> WorldModelConfig:
    return WorldModelConfig(
        region=((-0.1, 0.1), (-0.1, 0.1), (-0.01, 0.01)),
        rate_hz=RATE,
        detection_probability=0.97,
        clutter_per_frame=0.02,
        measurement_sigma=SIGMA,
        missed_run_frames=2.0,
        motion={"*": {"model": "constant_velocity", "accel_sigma": 0.01, "turn_sigma": 0.3}},
        merged_detections=True,
        **more,  # type: ignore[arg-type]
    )


def names_of(paths: np.ndarray, seed: int) -> tuple[list[str], list[str]]:
    """Identities of movers on paths (N, K, 2) before and after all those nearer than REACH were detected as one."""
    rng = np.random.default_rng(seed)
    model = WorldModel(config())
    names: list[list[str]] = []
    for k in range(paths.shape[1]):
        groups: list[list[int]] = []
        for mover in range(len(paths)):
            near = [g for g in groups if any(np.hypot(*(paths[mover, k] - paths[i, k])) < REACH for i in g)]
            groups = [g for g in groups if g not in near] + [[mover, *(i for g in near for i in g)]]
        seen = [paths[group, k].mean(0) + rng.normal(0.0, SIGMA, 2) for group in groups]
        state = model.update(
            WorldEvidence([ObjectEvidence([*z, 0.0], SIGMA**2 * np.eye(3)) for z in seen]), k / RATE
        )
        places = np.array([item.position[:2] for item in state.objects]).reshape(-1, 2)
        if len(places) == len(paths):
            order = [int(np.hypot(*(places - path[k]).T).argmin()) for path in paths]
            names.append([state.objects[i].id for i in order])
    return names[0], names[-1]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_two_that_cross_keep_their_identities(seed: int) -> None:
    """Straight on, 3 cm/s each, one detection of both for a quarter of a second."""
    clock = np.arange(90) / RATE - 1.5
    first = np.column_stack([0.03 * clock, 0.004 * np.ones(90)])
    second = np.column_stack([0.004 * np.ones(90), 0.03 * clock])
    before, after = names_of(np.array([first, second]), seed)
    assert before == after
    assert len(set(after)) == 2


@pytest.mark.parametrize("seed", [0, 1])
def test_three_at_once_keep_their_identities(seed: int) -> None:
    """From three sides through one place, one detection of all three."""
    clock = np.arange(90) / RATE - 1.5
    angles = np.array([0.0, 2.0, 4.1])
    paths = np.stack([np.outer(0.03 * clock, [np.cos(a), np.sin(a)]) for a in angles])
    before, after = names_of(paths, seed)
    assert before == after
    assert len(set(after)) == 3


def test_movers_told_apart_side_by_side_stay_as_many() -> None:
    """Two that walk abreast and are detected both, in every look: no third, no one for two."""
    rng = np.random.default_rng(3)
    model = WorldModel(config())
    for k in range(90):
        seen = [np.array([0.02 * k / RATE - 0.03, y, 0.0]) for y in (0.0, 0.006)]
        state = model.update(
            WorldEvidence(
                [
                    ObjectEvidence(z + np.array([*rng.normal(0.0, SIGMA, 2), 0.0]), SIGMA**2 * np.eye(3))
                    for z in seen
                ]
            ),
            k / RATE,
        )
    assert len(state.objects) == 2
    assert state.expected_count == pytest.approx(2.0, abs=0.1)


def test_turning_has_the_moments_of_many_walks() -> None:
    """Mean and covariance against simulated walks with a diffusing heading."""
    rng = np.random.default_rng(0)
    turning, accel, dt, steps, count = 1.5, 0.01, 1.0 / 30.0, 12, 40_000
    x = np.array([0.0, 0.0, 0.0, 0.02, 0.01, 0.0])
    P = np.diag([1e-6, 1e-6, 1e-12, 2.5e-5, 2.5e-5, 1e-12])
    walks = rng.multivariate_normal(x, P, count)
    place, velocity = walks[:, :2], walks[:, 3:5]
    fine = 8
    for _ in range(steps * fine):
        angle = turning * np.sqrt(dt / fine) * rng.normal(size=count)
        turned = np.column_stack(
            [
                np.cos(angle) * velocity[:, 0] - np.sin(angle) * velocity[:, 1],
                np.sin(angle) * velocity[:, 0] + np.cos(angle) * velocity[:, 1],
            ]
        )
        place = place + dt / fine * 0.5 * (velocity + turned)
        velocity = turned + accel * np.sqrt(dt / fine) * rng.normal(size=(count, 2))
    leaves = empty(1, 0)
    leaves.moving[0], leaves.moving_cov[0] = x, P
    for _ in range(steps):
        walk(leaves, 0, dt, accel**2, turning)
    joint = np.concatenate([place, velocity], axis=1)
    at = [0, 1, 3, 4]
    spread = np.sqrt(np.cov(joint.T).diagonal())
    assert np.abs(leaves.moving[0, at] - joint.mean(0)).max() < 0.02 * spread.max()
    off = (leaves.moving_cov[0][np.ix_(at, at)] - np.cov(joint.T)) / np.outer(spread, spread)
    assert np.abs(off).max() < 0.05


def test_without_turning_a_walk_is_constant_velocity() -> None:
    leaves = empty(1, 0)
    leaves.moving[0], leaves.moving_cov[0] = np.arange(6.0), np.eye(6)
    x, P = np.arange(6.0), np.eye(6)
    walk(leaves, 0, 0.2, 0.09, 0.0)
    flow(x, P, 0.2, 0.09)
    np.testing.assert_allclose(leaves.moving[0], x)
    np.testing.assert_allclose(leaves.moving_cov[0], P)


def test_weight_of_a_pair_is_its_contact_times_a_gaussian_about_the_middle() -> None:
    rng = np.random.default_rng(1)
    centres, spreads = rng.normal(0.0, 0.004, (3, 3)), np.array([s * np.eye(3) for s in (1e-6, 2e-6, 3e-6)])
    local, present = np.array([0, 1, 2]), np.ones(3)
    movers = Movers(present, centres, spreads, np.zeros(3, np.int64), 0.01)
    touching = contacts(local, movers)
    np.testing.assert_array_equal(touching, touching.T)
    z, R = np.array([[0.001, 0.0, 0.0]]), 1e-6 * np.eye(3)[None]
    one = np.ones(1)
    seen = Detections(0.0, 0.0, np.zeros(1, np.int64), z, R, np.ones((1, 1)), one, one)
    found = group_weight(np.array([0, 2, -1, -1]), 2, 0, local, touching, seen, movers)
    apart = centres[0] - centres[2]
    S = R[0] + 0.25 * (spreads[0] + spreads[2]) + 0.15 * 0.25 * np.outer(apart, apart)
    off = z[0] - 0.5 * (centres[0] + centres[2])
    density = -0.5 * (off @ np.linalg.solve(S, off) + np.log(np.linalg.det(2.0 * np.pi * S)))
    assert found == pytest.approx(np.log(touching[0, 2]) + density)


def test_groups_hang_together() -> None:
    """A chain of four and one apart: all connected subsets of two to four, once each."""
    touching = np.zeros((5, 5))
    for a in range(3):
        touching[a, a + 1] = touching[a + 1, a] = 0.5
    groups, count = touching_groups(touching)
    found = [tuple(int(i) for i in group if i >= 0) for group in groups[:count]]
    assert sorted(found) == [(0, 1), (0, 1, 2), (0, 1, 2, 3), (1, 2), (1, 2, 3), (2, 3)]


def test_who_turns_at_a_wall_stays_the_same() -> None:
    """Straight at a wall at 4.5 cm/s and back, where nothing but small accelerations is expected."""
    rng = np.random.default_rng(4)
    motion = {"*": {"model": "constant_velocity", "accel_sigma": 0.01}}
    model = WorldModel(
        WorldModelConfig(
            region=((-0.1, 0.1), (-0.1, 0.1), (-0.01, 0.01)),
            rate_hz=RATE,
            detection_probability=0.97,
            clutter_per_frame=0.02,
            measurement_sigma=SIGMA,
            motion=motion,
        )
    )
    names = set()
    for k in range(120):
        x = 0.09 - abs(0.09 - 0.045 * k / RATE)
        z = [x + rng.normal(0.0, SIGMA), 0.02 + rng.normal(0.0, SIGMA), 0.0]
        state = model.update(WorldEvidence([ObjectEvidence(z, SIGMA**2 * np.eye(3))]), k / RATE)
        names |= {item.id for item in state.objects}
    assert len(names) == 1
    assert state.objects[0].velocity[0] == pytest.approx(-0.045, abs=0.01)

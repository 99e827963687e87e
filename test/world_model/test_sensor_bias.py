"""Systematic errors of a moving sensor: found from what it says about resting objects, without knowing them."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig
from world_model.sensor_bias import SensorBias, basis

LANDMARKS = np.array([[0.0, 3.0, 0.0], [2.5, 0.5, 0.0], [-2.5, -0.5, 0.0], [0.5, -3.0, 0.0], [3.0, 3.0, 0.0]])
REGION = ((-6.0, 6.0), (-6.0, 6.0), (-0.5, 0.5))


def measured(pose: np.ndarray, errors: np.ndarray, rng: np.random.Generator) -> tuple[list[int], np.ndarray]:
    """Landmarks ahead as a sensor reports them: range and bearing with these errors, written out by hand."""
    seen, out = [], []
    for k, landmark in enumerate(LANDMARKS):
        off = landmark[:2] - pose[:2]
        distance, angle = np.hypot(*off), np.arctan2(off[1], off[0])
        bearing = (angle - pose[3] + np.pi) % (2.0 * np.pi) - np.pi
        if abs(bearing) > 0.6 or distance > 6.0:
            continue
        offset, scale, depth, turn = errors
        reported = distance * (1.0 + scale + 0.5 * depth * bearing**2) + offset + rng.normal(0.0, 0.01)
        angle += turn + rng.normal(0.0, 0.003)
        seen.append(k)
        out.append([pose[0] + reported * np.cos(angle), pose[1] + reported * np.sin(angle), 0.0])
    return seen, np.array(out).reshape(-1, 3)


def round_trip(step: int) -> np.ndarray:
    """A pose on a circle about the landmarks' middle, looking to and fro across it."""
    at = 0.05 * step
    return np.array([1.5 * np.cos(at), 1.5 * np.sin(at), 0.0, at + np.pi + 0.5 * np.sin(0.37 * step)])


def test_basis_is_the_derivative_of_what_a_sensor_reports() -> None:
    """Numerical derivative of (range, bearing) to position by each error."""
    pose, place = np.array([0.3, -0.2, 0.0, 0.7]), np.array([[2.0, 1.1, 0.0]])
    off = place[0, :2] - pose[:2]
    distance, angle = np.hypot(*off), np.arctan2(off[1], off[0])

    def reported(offset: float, scale: float, depth: float, turn: float) -> np.ndarray:
        r = distance * (1.0 + scale + 0.5 * depth * (angle - pose[3]) ** 2) + offset
        return pose[:2] + r * np.array([np.cos(angle + turn), np.sin(angle + turn)])

    step = 1e-6
    columns = [(reported(*e) - reported(*-e)) / (2.0 * step) for e in step * np.eye(4)]
    assert basis(place, pose)[0] == pytest.approx(np.column_stack(columns), abs=1e-8)


def test_errors_are_found_from_different_places() -> None:
    errors, rng = np.array([0.12, 0.03, -0.8, 0.01]), np.random.default_rng(3)
    model = WorldModel(
        WorldModelConfig(
            region=REGION,
            rate_hz=5.0,
            clutter_per_frame=0.01,
            motion={"*": {"moved_per_second": 0.0}},
            learn_sensor_bias=True,
        )
    )
    for step in range(400):
        pose = round_trip(step)
        _, positions = measured(pose, errors, rng)
        spread = 0.03**2 * np.eye(3)
        given = WorldEvidence(
            [ObjectEvidence(p, spread) for p in positions],
            {"pose": tuple(pose.tolist()), "range": 6.0, "angle": 1.2},
        )
        state = model.update(given, 0.2 * step)
    assert model.sensor_bias == pytest.approx(errors, abs=0.02)
    found = np.array([item.position for item in state.objects])
    assert len(found) == len(LANDMARKS)
    nearest = np.linalg.norm(LANDMARKS[:, None] - found[None], axis=2).min(1)
    assert nearest.max() < 0.03


def test_elimination_is_the_joint_least_squares() -> None:
    """Against one dense system of all places and errors, also after an object is gone."""
    rng = np.random.default_rng(5)
    bias = SensorBias()
    bias.significant = True
    rows, right = [], []
    for step in range(40):
        pose = round_trip(step)
        bias.follow(pose)
        seen, positions = measured(pose, np.array([0.05, 0.0, 0.0, 0.0]), rng)
        if not seen:
            continue
        covariance = np.tile(0.1**2 * np.eye(3), (len(seen), 1, 1))
        bias.add(seen, LANDMARKS[seen], positions, covariance, pose)
        for k, z, J in zip(seen, positions, basis(LANDMARKS[seen], pose), strict=True):
            row = np.zeros((2, 2 * len(LANDMARKS) + 4))
            row[:, 2 * k : 2 * k + 2], row[:, -4:] = np.eye(2), J
            rows.append(row / 0.1)
            right.append(z[:2] / 0.1)
    prior = np.zeros((4, 2 * len(LANDMARKS) + 4))
    prior[:, -4:] = np.diag([1 / 0.1, 1 / 0.05, 1 / 1.0, 1 / 0.02])
    dense = np.linalg.lstsq(
        np.concatenate([*rows, prior]), np.concatenate([*right, np.zeros(4)]), rcond=None
    )[0]
    bias.keep_only({0, 1, 2, 3})
    while bias.solve() is None:
        pass
    assert bias.values == pytest.approx(dense[-4:], abs=1e-6)


def test_sensor_without_errors_is_left_alone() -> None:
    """Noise alone moves nothing, although the sensor goes about."""
    rng, bias = np.random.default_rng(11), SensorBias()
    covariance = 0.01**2 * np.eye(3)
    for step in range(200):
        pose = round_trip(step)
        bias.follow(pose)
        seen, _ = measured(pose, np.zeros(4), rng)
        positions = LANDMARKS[seen] + rng.normal(0.0, 0.01, (len(seen), 3))
        bias.add(seen, LANDMARKS[seen], positions, np.tile(covariance, (len(seen), 1, 1)), pose)
        bias.solve()
    assert not bias.values.any()


def test_resting_sensor_is_left_alone() -> None:
    bias = SensorBias()
    assert not bias.follow(np.array([1.0, 2.0, 0.0, 0.0]))
    assert not bias.follow(np.array([1.2, 2.0, 0.0, 3.0]))
    assert bias.follow(np.array([1.6, 2.0, 0.0, 0.0]))


def test_setting_is_checked() -> None:
    with pytest.raises(InputError, match="sensor_bias"):
        WorldModelConfig(sensor_bias=(0.1, 0.2))


def test_carried_object_says_nothing_about_the_sensor() -> None:
    """Seen without error from two places, then somewhere else from both: there is nothing to correct."""
    bias = SensorBias()
    poses = [np.array([0.0, -2.0, 0.0, 1.5]), np.array([2.0, 0.0, 0.0, 3.0])]
    covariance = np.tile(0.03**2 * np.eye(3), (1, 1, 1))
    for place in (np.array([[0.0, 0.0, 0.8]]), np.array([[0.5, 0.3, 0.8]])):
        for pose in poses * 10:
            bias.follow(pose)
            bias.add([0], place, place, covariance, pose)
            bias.solve()
    assert bias.values == pytest.approx(np.zeros(4), abs=1e-6)

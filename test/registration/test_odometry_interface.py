"""The contract every caller of Odometry relies on, whatever registers underneath."""

import numpy as np
import pytest

from estimation.errors import InputError
from registration import Odometry, OdometryConfig, Scan


def room_scan(x: float, beams: int = 361) -> Scan:
    """Scan of an 8 m x 5 m room taken at (x, 0), by plane intersection."""
    bearings = np.linspace(-2.0, 2.0, beams)
    with np.errstate(divide="ignore"):
        walls = [(5.0 - x) / np.cos(bearings), (-3.0 - x) / np.cos(bearings)]
        walls += [2.0 / np.sin(bearings), -3.0 / np.sin(bearings)]
    ranges = np.min([np.where(wall > 0.0, wall, np.inf) for wall in walls], axis=0)
    return Scan(ranges, -2.0, 4.0 / (beams - 1), 0.0, 60.0)


def test_first_scan_is_the_origin() -> None:
    odometry = Odometry()
    np.testing.assert_allclose(odometry.register(room_scan(0.0), 0.0), np.zeros(3), atol=1e-12)
    np.testing.assert_allclose(odometry.covariance, np.zeros((3, 3)), atol=1e-12)
    assert odometry.converged


def test_scan_without_returns_keeps_the_prediction_and_says_so() -> None:
    odometry = Odometry()
    odometry.register(room_scan(0.0), 0.0)
    empty = Scan(np.full(361, np.nan), -2.0, 4.0 / 360, 0.0, 60.0)
    pose = odometry.register(empty, 0.1, guess=[0.1, 0.0, 0.02])
    np.testing.assert_allclose(pose, [0.1, 0.0, 0.02], atol=1e-9)
    assert odometry.unsure
    assert "points" in odometry.reason
    assert np.linalg.eigvalsh(odometry.covariance).min() > 0.0


def test_reset_starts_over_and_allows_the_other_kind() -> None:
    odometry = Odometry()
    odometry.register(room_scan(0.0), 0.0)
    with pytest.raises(InputError, match="reset"):
        odometry.register(np.zeros((50, 3)), 0.1)
    odometry.reset()
    cloud = np.random.default_rng(0).uniform(-10.0, 10.0, (500, 3))
    np.testing.assert_allclose(odometry.register(cloud, 0.0), np.eye(4), atol=1e-9)
    assert odometry.covariance.shape == (6, 6)


@pytest.mark.parametrize(
    ("measurement", "stamp", "guess", "named"),
    [
        (np.zeros((4, 2)), 0.0, None, "scan_or_cloud"),
        (room_scan(0.0), np.nan, None, "stamp"),
        (room_scan(0.0), 0.0, [0.0, 0.0], "guess"),
        (room_scan(0.0), 0.0, [0.0, np.nan, 0.0], "guess"),
        (room_scan(0.0), "now", None, "stamp"),
        (room_scan(0.0), 1.7e12, None, "stamp"),
        (None, 0.0, None, "scan_or_cloud"),
        (np.zeros((60, 3)), 0.0, 2.0 * np.eye(4), "guess"),
    ],
)
def test_wrong_input_names_the_argument(measurement, stamp, guess, named) -> None:
    with pytest.raises(InputError, match=named):
        Odometry().register(measurement, stamp, guess)


def test_a_pose_that_was_told_is_no_handle_on_the_next() -> None:
    odometry = Odometry()
    odometry.register(room_scan(0.0), 0.0)[:] = 5.0
    assert np.abs(odometry.register(room_scan(0.0), 0.1)).max() < 0.1
    with pytest.raises(ValueError, match="read-only"):
        odometry.pose[:] = 5.0


def test_a_masked_reading_is_none() -> None:
    scan = Scan(np.ma.masked_equal([1.0, 9.0, 2.0], 9.0), 0.0, 0.1)
    assert scan.valid.tolist() == [True, False, True]


def test_config_names_the_field_and_its_range() -> None:
    with pytest.raises(InputError, match="max_range"):
        OdometryConfig(max_range=-1.0)


def test_clouds_are_followed_the_same_each_time() -> None:
    rng = np.random.default_rng(4)
    walls = rng.uniform(-10.0, 10.0, (30_000, 3))
    walls[np.arange(len(walls)), rng.integers(0, 2, len(walls))] = rng.choice([-10.0, 10.0], len(walls))
    clouds = [walls - [0.2 * k, 0.05 * k, 0.0] + rng.normal(0.0, 0.02, walls.shape) for k in range(6)]

    def followed() -> np.ndarray:
        odometry = Odometry()
        return np.array([odometry.register(cloud, 0.1 * k) for k, cloud in enumerate(clouds)])

    first = followed()
    for _ in range(3):
        np.testing.assert_array_equal(followed(), first)


def test_clouds_without_points_leave_no_doubt_behind() -> None:
    rng, odometry = np.random.default_rng(8), Odometry()
    room = rng.uniform(-1.0, 1.0, (3000, 3)) * [6.0, 4.0, 1.5]
    for axis, half in enumerate((6.0, 4.0, 1.5)):
        room[axis::3, axis] = np.copysign(half, room[axis::3, axis])
    for k in range(12):
        odometry.register(np.zeros((0, 3)) if 5 <= k < 8 else room - [0.02 * k, 0.0, 0.0], 0.1 * k)
        deviation = np.sqrt(odometry.covariance[0, 0])
        assert deviation >= 1.0 if 5 <= k < 8 else deviation < 0.1, k
        assert (
            odometry.increment_covariance[0, 0] >= 1.0
            if 5 <= k < 9
            else odometry.increment_covariance[0, 0] < 0.01
        )

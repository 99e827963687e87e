"""What is no number, no covariance and no rotation is refused by name, wherever arrays come in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from estimation.checks import as_floats, as_number, as_own, require_count, require_kind, require_positive
from estimation.conversion import condition_ratio, convert
from estimation.conversion.map_frame import convert_to_map
from estimation.conversion.spherical import convert_spherical
from estimation.conversion.switching import ConstantVelocity, SwitchingFilter
from estimation.errors import InputError
from estimation.filters import kalman
from estimation.metrics import associate, nees
from estimation.poses import compound, compound_covariance, euler_from_rotation, pose_from_matrix
from estimation.settings import check_settings, setting

DATES = np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[s]")


@pytest.mark.parametrize(
    "value",
    ["1", ["1", "2"], np.array(["1", 2.0], dtype=object), [1 + 1j], DATES, 10**400, [[1.0], [1.0, 2.0]]],
)
def test_what_is_no_array_of_numbers_is_named(value: Any) -> None:
    with pytest.raises(InputError, match="speed must be an array of numbers"):
        as_floats("speed", value)


def test_numbers_of_any_kind_become_floats_and_masked_ones_nan() -> None:
    for value in ([1, 2], np.array([1, 2], np.int8), np.array([1, 2], np.float32), np.array([1, 2], object)):
        np.testing.assert_array_equal(as_floats("speed", value), [1.0, 2.0])
    assert type(as_floats("speed", np.arange(2).view(np.recarray))) is np.ndarray
    masked = np.ma.masked_equal([1.0, -1.0, 3.0], -1.0)
    np.testing.assert_array_equal(as_floats("speed", masked), [1.0, np.nan, 3.0])


@pytest.mark.parametrize("value", [True, "1", None, np.nan, np.inf, 1j, [1.0], np.ones(1), 10**400])
def test_what_is_not_one_finite_number_is_named(value: Any) -> None:
    for check in (as_number, require_positive, require_count):
        with pytest.raises(InputError, match="speed must be a"):
            check("speed", value)


def test_numbers_of_numpy_are_numbers() -> None:
    for value in (2, 2.0, np.float32(2.0), np.int64(2), np.array(2.0)):
        assert as_number("speed", value) == 2.0
        assert require_count("speed", value) == 2


def test_a_copy_is_the_caller_s_no_more() -> None:
    given = np.zeros(3)
    own = as_own("pose", given, (3,))
    given[:] = 1.0
    np.testing.assert_array_equal(own, np.zeros(3))
    with pytest.raises(InputError, match=r"pose must have shape \(3,\) or \(4, 4\)"):
        as_own("pose", np.zeros(4), (3,), (4, 4))
    with pytest.raises(InputError, match="scan must be a int or float, not str"):
        require_kind("scan", "x", int, float)


@dataclass
class Settings:
    quick: bool = setting(True, "", "whether")
    way: str = setting("one", "", "which", choices=("one", "two"))


@pytest.mark.parametrize(
    ("name", "value"), [("quick", "false"), ("quick", 0), ("way", ["one"]), ("way", np.ones(2))]
)
def test_settings_are_of_their_kind(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=name):
        check_settings(Settings(**{name: value}))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: compound(np.zeros((2, 3)), np.zeros((5, 3))), "a, b"),
        (lambda: convert([1.0, 2.0], 0.0, 0.1, [0.1, 0.1, 0.1]), "sigma_bearing"),
        (lambda: convert(5.0, 0.1, 0.1, 5.0), "sigma_bearing must be within"),
        (lambda: convert_spherical(5.0, 0.1, 0.1, 0.1, 0.1, 5.0), "sigma_elevation must be within"),
        (
            lambda: convert_to_map(np.zeros(3), np.diag([0.1, 0.1, 1e6]), 5.0, 0.0, 0.1, 0.1),
            "deviation of robot_pose yaw",
        ),
        (
            lambda: SwitchingFilter(ConstantVelocity(0.1), np.ones(4), np.eye(4)).update(
                np.zeros(3), np.zeros((3, 3)), [5.0, 0.1], np.diag([0.01, 25.0])
            ),
            "bearing's up to",
        ),
        (lambda: condition_ratio([1.0, 2.0], [0.0, 0.0, 0.0], 0.1, 0.1), "bearing"),
        (lambda: nees(np.zeros((5, 2)), np.tile(np.eye(2), (3, 1, 1))), "error, cov"),
        (
            lambda: kalman.predict(np.zeros((4, 2)), np.tile(np.eye(2), (3, 1, 1)), np.eye(2), np.eye(2)),
            "mean",
        ),
        (lambda: nees([1.0, 2.0], [[1.0, 0.0], [0.9, 1.0]]), "cov must be symmetric"),
        (lambda: compound_covariance(np.zeros(3), -np.eye(3), np.zeros(3), np.eye(3)), "a_covariance"),
        (lambda: condition_ratio(1.0, 0.0, 0.1, 0.1, -np.eye(2)), "covariance"),
        (lambda: associate([0.0, 1.0], [0.5], np.nan), "tolerance"),
        (lambda: euler_from_rotation(2.0 * np.eye(3)), "rotation"),
        (lambda: euler_from_rotation(np.diag([1.0, 1.0, -1.0])), "rotation"),
        (lambda: pose_from_matrix(np.ones((3, 3))), "matrix"),
        (lambda: pose_from_matrix(np.vstack((np.eye(4)[:3], [0.0, 0.0, 0.5, 1.0]))), "last row"),
    ],
)
def test_what_does_not_fit_is_named(call: Any, named: str) -> None:
    with pytest.raises(InputError, match=named):
        call()

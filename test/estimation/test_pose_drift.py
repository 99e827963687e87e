"""How uncertain a pose is over a window, against drawn paths."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.pose_drift import PoseUncertainty
from estimation.geometry.poses import compound, compound_jacobians


def test_over_a_window_it_is_the_uncertainty_of_the_motion_since() -> None:
    step, noise = np.array([0.2, 0.0, 0.03]), np.diag([0.01, 0.005, 0.01]) ** 2
    pose, P = np.zeros(3), np.zeros((3, 3))
    known, begun = PoseUncertainty(window=4.0), PoseUncertainty()
    for k in range(100):
        known.add(0.1 * k, pose, P)
        begun.add(0.1 * k, pose, P)
        if k == 59:
            early = pose
        J1, J2 = compound_jacobians(pose, step)
        pose, P = compound(pose, step), J1 @ P @ J1.T + J2 @ noise @ J2.T
    # Independently: the last 40 of the steps alone, from an exactly known pose.
    expected, at = np.zeros((3, 3)), early
    for _ in range(40):
        J1, J2 = compound_jacobians(at, step)
        at, expected = compound(at, step), J1 @ expected @ J1.T + J2 @ noise @ J2.T
    found, whole = known.at(9.9), begun.at(9.9)
    assert found is not None
    assert whole is not None
    assert found == pytest.approx(expected, abs=1e-9)
    assert np.trace(whole) > 2.0 * np.trace(found)


def test_of_a_sensor_at_the_end_of_an_arm() -> None:
    P = np.array([[0.01, 0.002, 0.001], [0.002, 0.02, -0.001], [0.001, -0.001, 0.0025]])
    base, mount = np.array([2.0, 1.0, 0.8]), np.array([0.5, 0.2, 0.4])
    known = PoseUncertainty()
    known.add(5.0, base, P)
    J, _ = compound_jacobians(base, mount)
    assert known.at(5.5, compound(base, mount)) == pytest.approx(J @ P @ J.T)


def test_what_is_old_or_bad_is_not_used() -> None:
    known = PoseUncertainty(age=1.0)
    assert known.at(0.0) is None
    known.add(0.0, np.zeros(3), np.eye(3))
    assert known.at(0.5) is not None
    assert known.at(1.5) is None
    # A bag that starts again.
    known.add(-50.0, np.zeros(3), 2.0 * np.eye(3))
    assert known.at(-50.0) == pytest.approx(2.0 * np.eye(3))
    with pytest.raises(InputError, match="covariance"):
        known.add(1.0, np.zeros(3), np.diag([1.0, -1.0, 1.0]))
    with pytest.raises(InputError, match="pose"):
        known.add(1.0, [0.0, np.nan, 0.0], np.eye(3))
    with pytest.raises(InputError, match="window"):
        PoseUncertainty(window=0.0)

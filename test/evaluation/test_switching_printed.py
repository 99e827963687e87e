"""Algorithm 1 as printed, against its formulas written out, a Kalman filter and exact integration."""

import numpy as np
import pytest

from estimation.conversion.switching import SwitchingFilter
from estimation.errors import InputError
from estimation.filters.constant_velocity import ConstantVelocity
from evaluation.conversion.switching_printed import PrintedSwitchingFilter, sample_weights

MOTION = ConstantVelocity(0.6)
NOISE = np.diag([0.02**2, np.radians(2) ** 2])
ROBOT = np.diag([0.07**2, 0.07**2, np.radians(2) ** 2])
START, SPREAD = np.array([4.0, 1.0, -0.5, 0.8]), np.diag([0.05, 0.04, 0.1, 0.1])


def test_weights_by_hand():
    rng = np.random.default_rng(0)
    particles, samples = rng.normal(size=(7, 2)), rng.normal(size=(5, 2))
    summed = [sum(np.hypot(*(p - q)) for q in samples) for p in particles]
    wanted = [np.exp(0.3 * (min(summed) - d)) for d in summed]
    np.testing.assert_allclose(sample_weights(particles, samples, 0.3), wanted)


def test_kalman_mode_is_the_plain_kalman_filter():
    rng = np.random.default_rng(1)
    ours = SwitchingFilter(MOTION, START, SPREAD, k_crit=np.inf, decorrelated=False)
    printed = PrintedSwitchingFilter(MOTION, START, SPREAD, k_crit=np.inf)
    for _ in range(20):
        z = np.array([np.hypot(4, 1) + rng.normal(0, 0.05), np.arctan2(1, 4) + rng.normal(0, 0.03)])
        for each in (ours, printed):
            each.predict(0.05)
            each.update(np.zeros(3), ROBOT, z, NOISE)
        np.testing.assert_allclose(printed.mean, ours.mean, atol=1e-9)
        np.testing.assert_allclose(printed.covariance, ours.covariance, atol=1e-9)
    assert printed.mode == "kf"


def posterior(weight, mean, P, count=60_000):
    """Mean and standard deviations of a position prior under a weight, by plain Monte Carlo."""
    x = np.random.default_rng(5).multivariate_normal(mean, P, count)
    w = weight(x)
    m = np.average(x, axis=0, weights=w)
    return m, np.sqrt(np.average((x - m) ** 2, axis=0, weights=w))


def test_a_sampled_update_has_the_mean_of_its_weights():
    """Far away with a poor bearing K is above 1.075: particles weighed by (6.18) against brute force."""
    z = np.array([6.0, 0.1])
    noise = np.diag([0.02**2, np.radians(6) ** 2])
    start, P = np.array([6.0, 0.4, 0.0, 0.0]), np.diag([0.3, 0.3, 0.1, 0.1])
    found = PrintedSwitchingFilter(MOTION, start, P, particles=20_000, samples=250, seed=3)
    found.update(np.zeros(3), np.zeros((3, 3)), z, noise)
    assert found.mode == "pf"
    assert found.ratio >= 1.075
    rng = np.random.default_rng(9)
    r, t = 6.0 + 0.02 * rng.standard_normal(250), 0.1 + np.radians(6) * rng.standard_normal(250)
    drawn = np.stack([r * np.cos(t), r * np.sin(t)], -1)

    def weight(x):
        summed = np.zeros(len(x))
        for q in drawn:
            summed += np.hypot(*(x - q).T)
        return np.exp(0.1 * (summed.min() - summed))

    mean, deviation = posterior(weight, start[:2], P[:2, :2])
    np.testing.assert_allclose(found.mean[:2], mean, atol=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)[:2]), deviation, rtol=0.15)


def test_modes_follow_the_ratio_and_the_test():
    found = PrintedSwitchingFilter(MOTION, START, SPREAD, mardia_interval=3, particles=500, seed=1)
    wide, fine = np.diag([0.01**2, np.radians(20) ** 2]), np.diag([0.3**2, np.radians(0.5) ** 2])
    z = np.array([np.hypot(4, 1), np.arctan2(1, 4)])
    found.update(np.zeros(3), np.zeros((3, 3)), z, fine)
    assert (found.mode, found.tests) == ("kf", 0)
    found.update(np.zeros(3), np.zeros((3, 3)), z, wide)
    assert (found.mode, found.switches, found.tests) == ("pf", 1, 0)
    for _ in range(30):
        found.predict(0.1)
        found.update(np.zeros(3), np.zeros((3, 3)), z, fine)
        if found.mode == "kf":
            break
    assert found.mode == "kf"
    assert found.tests >= 1
    assert found.switches == 2


def test_bad_arguments_are_named():
    with pytest.raises(InputError, match="alpha"):
        PrintedSwitchingFilter(MOTION, START, SPREAD, alpha=0.0)
    with pytest.raises(InputError, match="k_crit"):
        PrintedSwitchingFilter(MOTION, START, SPREAD, k_crit=-1.0)
    with pytest.raises(InputError, match="measurement"):
        PrintedSwitchingFilter(MOTION, START, SPREAD).update(np.zeros(3), ROBOT, [1.0], NOISE)

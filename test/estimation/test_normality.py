"""Mardia's statistics against their definition over all pairs, and the test's size and power."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.conversion.polar import convert_samples, mardia_statistics, mardia_test
from estimation.errors import InputError


@pytest.mark.parametrize("dimension", [1, 2, 4])
def test_statistics_are_the_sums_over_all_pairs(dimension):
    x = np.random.default_rng(0).gamma(3.0, size=(80, dimension))
    offsets = x - x.mean(0)
    S = offsets.T @ offsets / len(x)
    products = offsets @ np.linalg.inv(S) @ offsets.T
    found = mardia_statistics(x)
    assert found.skewness == pytest.approx((products**3).mean())
    assert found.kurtosis == pytest.approx((np.diag(products) ** 2).mean())


@pytest.mark.parametrize(("count", "dimension"), [(250, 2), (1000, 4)])
def test_gaussian_samples_fail_at_the_rate_of_alpha(count, dimension):
    rng = np.random.default_rng(1)
    A = rng.normal(size=(dimension, dimension))
    passed = [mardia_test(rng.normal(size=(count, dimension)) @ A, 0.1) for _ in range(600)]
    assert np.mean(passed) == pytest.approx(0.9, abs=0.04)


def test_skewed_and_heavy_tailed_samples_fail():
    rng = np.random.default_rng(2)
    assert not mardia_test(rng.gamma(2.0, size=(300, 2)))
    assert not mardia_test(rng.standard_t(3, size=(300, 2)))
    assert not mardia_test(rng.uniform(size=(400, 2)))
    assert not mardia_test(convert_samples(4.0, 0.7, 0.02, np.radians(5), 500, rng))
    assert mardia_test(convert_samples(4.0, 0.7, 0.02, np.radians(0.5), 500, 3))


@given(st.integers(0, 10_000))
def test_affine_maps_change_nothing(seed):
    rng = np.random.default_rng(seed)
    x = rng.gamma(4.0, size=(60, 2))
    A = rng.normal(size=(2, 2)) + 3 * np.eye(2)
    plain, moved = mardia_statistics(x), mardia_statistics(x @ A + rng.normal(size=2))
    assert moved.skewness == pytest.approx(plain.skewness, rel=1e-6)
    assert moved.kurtosis == pytest.approx(plain.kurtosis, rel=1e-6)


@pytest.mark.parametrize(
    ("samples", "alpha", "name"),
    [
        (np.ones((50, 2)), 0.05, "samples"),
        (np.eye(2), 0.05, "samples"),
        (np.full((50, 2), np.nan), 0.05, "samples"),
        (np.zeros(50), 0.05, "samples"),
        (np.random.default_rng(0).normal(size=(50, 2)), 1.5, "alpha"),
    ],
)
def test_bad_input_is_named(samples, alpha, name):
    with pytest.raises(InputError, match=rf"^{name} must"):
        mardia_test(samples, alpha)

"""Gaussians, mixtures, their entropy and the repair of covariances, against scipy and Monte Carlo."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal

from estimation.errors import InputError
from estimation.filters.gaussians import (
    Gaussian,
    GaussianMixture,
    gaussian_entropy,
    log_density,
    repair_covariance,
    repairs,
)

P2 = np.array([[2.0, 0.6], [0.6, 1.0]])


def mixture():
    return GaussianMixture([2.0, 1.0, 1.0], [[0.0, 0.0], [4.0, 1.0], [4.2, 1.1]], [P2, 0.5 * P2, 0.4 * P2])


def test_density_and_entropy_are_scipys():
    x = np.random.default_rng(0).normal(size=(7, 2))
    reference = multivariate_normal([1.0, -1.0], P2)
    gaussian = Gaussian([1.0, -1.0], P2)
    np.testing.assert_allclose(gaussian.log_density(x), reference.logpdf(x))
    assert gaussian.entropy() == pytest.approx(reference.entropy())
    np.testing.assert_allclose(
        gaussian_entropy(np.stack([P2, 4 * P2])), [reference.entropy(), reference.entropy() + np.log(4)]
    )
    assert log_density(x[:, None], np.zeros((3, 2)), np.stack([P2] * 3)).shape == (7, 3)


def test_samples_have_the_moments():
    for source in (Gaussian([1.0, -1.0], P2), mixture()):
        samples = source.sample(200_000, np.random.default_rng(1))
        expected = source if isinstance(source, Gaussian) else source.moments()
        np.testing.assert_allclose(samples.mean(0), expected.mean, atol=0.02)
        np.testing.assert_allclose(np.cov(samples.T), expected.covariance, atol=0.05)


def test_mixture_density_is_the_weighted_sum():
    m = mixture()
    x = np.random.default_rng(2).normal(size=(5, 2))
    expected = sum(
        w * multivariate_normal(mean, P).pdf(x)
        for w, mean, P in zip([0.5, 0.25, 0.25], m.means, m.covariances, strict=True)
    )
    np.testing.assert_allclose(m.log_density(x), np.log(expected))


def test_entropy_of_a_mixture_by_integration():
    m = GaussianMixture([0.3, 0.7], [[-1.0], [2.0]], [[[0.5]], [[1.5]]])
    exact = quad(lambda x: -np.exp(m.log_density([x])) * m.log_density([x]), -15, 15)[0]
    assert m.entropy(np.random.default_rng(3), 40_000) == pytest.approx(exact, abs=0.02)
    assert exact <= m.entropy_bound() <= exact + np.log(2)


def test_reduction_merges_the_closest_and_keeps_the_moments():
    m = mixture()
    reduced = m.reduced(2)
    np.testing.assert_allclose(sorted(reduced.weights), [0.5, 0.5])
    np.testing.assert_allclose(reduced.means[0], [0, 0])
    np.testing.assert_allclose(reduced.means[1], [4.1, 1.05])
    np.testing.assert_allclose(reduced.moments().mean, m.moments().mean)
    np.testing.assert_allclose(reduced.moments().covariance, m.moments().covariance)
    np.testing.assert_allclose(m.reduced(1).covariances[0], m.moments().covariance)


def test_rounding_is_repaired_and_counted():
    before = repairs.count
    flat = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    flat[0, 0] -= 1e-12
    fixed = repair_covariance(np.stack([flat, np.eye(3)]))
    assert repairs.count == before + 1
    np.linalg.cholesky(fixed)
    np.testing.assert_allclose(fixed[0], flat, atol=1e-9)
    np.testing.assert_array_equal(fixed[1], np.eye(3))
    assert repair_covariance(P2) is not None
    assert repairs.count == before + 1
    np.testing.assert_array_equal(repair_covariance(np.zeros((2, 2)), definite=False), np.zeros((2, 2)))
    asymmetric = P2 + np.array([[0.0, 1e-13], [0.0, 0.0]])
    repaired = repair_covariance(asymmetric)
    np.testing.assert_array_equal(repaired, repaired.T)


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros((2, 2)),
        np.diag([1.0, -0.01]),
        np.array([[1.0, 0.5], [0.0, 1.0]]),
        np.full((2, 2), np.nan),
        np.ones((2, 3)),
    ],
)
def test_wrong_covariances_are_named(bad):
    with pytest.raises(InputError, match=r"^P must"):
        repair_covariance(bad, "P")


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: Gaussian([0.0, 0.0], np.eye(3)), "covariance"),
        (lambda: Gaussian([[0.0]], np.eye(1)), "mean"),
        (lambda: GaussianMixture([-1.0, 2.0], np.zeros((2, 1)), np.ones((2, 1, 1))), "weights"),
        (lambda: GaussianMixture([0.0], np.zeros((1, 1)), np.ones((1, 1, 1))), "weights"),
        (lambda: GaussianMixture([1.0], np.zeros((2, 1)), np.ones((2, 1, 1))), "means and covariances"),
        (lambda: mixture().reduced(0), "size"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(InputError, match=rf"^{name} "):
        call()

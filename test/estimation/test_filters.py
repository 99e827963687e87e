"""Kalman and particle filters against joint Gaussians and closed forms."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from estimation.conversion.particles import Particles, effective_size, systematic_resample
from estimation.errors import InputError
from estimation.filters import kalman

F = np.array([[1.0, 0.5], [0.0, 0.9]])
Q = np.array([[0.1, 0.02], [0.02, 0.2]])
H = np.array([[1.0, 0.3]])
R = np.array([[0.4]])
MEAN, COV = np.array([1.0, -2.0]), np.array([[1.0, 0.3], [0.3, 0.5]])


def test_kalman_is_conditioning_of_the_joint_gaussian():
    mean, cov = kalman.predict(MEAN, COV, F, Q)
    np.testing.assert_allclose(mean, F @ MEAN)
    np.testing.assert_allclose(cov, F @ COV @ F.T + Q)
    z = np.array([0.7])
    S = H @ cov @ H.T + R
    posterior, P, log_likelihood = kalman.update(mean, cov, z, H, R)
    gain = cov @ H.T @ np.linalg.inv(S)
    np.testing.assert_allclose(posterior, mean + gain @ (z - H @ mean))
    np.testing.assert_allclose(P, np.linalg.inv(np.linalg.inv(cov) + H.T @ np.linalg.inv(R) @ H))
    assert log_likelihood == pytest.approx(multivariate_normal(H @ mean, S).logpdf(z))


def test_many_filters_at_once():
    rng = np.random.default_rng(0)
    means, zs = rng.normal(size=(3, 4, 2)), rng.normal(size=(4, 1))
    posterior, P, log_likelihood = kalman.update(means, COV, zs, H, R)
    for i, j in np.ndindex(3, 4):
        single = kalman.update(means[i, j], COV, zs[j], H, R)
        np.testing.assert_allclose(posterior[i, j], single[0])
        np.testing.assert_allclose(np.broadcast_to(P, (3, 4, 2, 2))[i, j], single[1])
        np.testing.assert_allclose(log_likelihood[i, j], single[2])


def test_systematic_resampling_takes_floor_or_ceiling():
    rng = np.random.default_rng(1)
    w = rng.dirichlet(np.ones(40) * 0.3)
    totals = np.zeros(40)
    for _ in range(400):
        chosen = systematic_resample(np.log(w) + 123.0, rng)
        counts = np.bincount(chosen, minlength=40)
        assert (counts >= np.floor(40 * w - 1e-9)).all()
        assert (counts <= np.ceil(40 * w + 1e-9)).all()
        totals += counts
    np.testing.assert_allclose(totals / 400, 40 * w, atol=0.12)


def test_effective_size():
    assert effective_size(np.full(50, -3.0)) == pytest.approx(50)
    assert effective_size(np.array([0.0, -np.inf, -np.inf])) == pytest.approx(1)


@pytest.mark.parametrize("noise", [1.0, 0.02])
def test_particles_reach_the_kalman_posterior(noise):
    """Also where the prior is far wider than the likelihood, which needs tempered stages."""
    rng = np.random.default_rng(2)
    z = np.array([1.3])
    expected = kalman.update(MEAN, COV, z, H, [[noise**2]])
    means, stages = [], []
    for _ in range(30):
        particles = Particles.equal(rng.multivariate_normal(MEAN, COV, 1000))
        stages.append(particles.assimilate(lambda x: norm.logpdf(z, x @ H[0], noise), rng))
        particles.resample(rng, below=0.5)
        means.append(particles.mean)
        assert np.isfinite(particles.covariance).all()
    assert (max(stages) > 1) == (noise < 0.1)
    np.testing.assert_allclose(np.mean(means, 0), expected[0], atol=0.04)


def test_reweight_returns_the_evidence():
    rng = np.random.default_rng(3)
    particles = Particles.equal(rng.multivariate_normal(MEAN, COV, 200_000))
    evidence = particles.reweight(norm.logpdf(0.4, particles.states @ H[0], np.sqrt(R[0, 0])))
    assert evidence == pytest.approx(float(kalman.update(MEAN, COV, [0.4], H, R)[2]), abs=0.01)


def test_smooth_resampling_keeps_the_moments_and_parts_copies():
    rng = np.random.default_rng(4)
    states = rng.normal(size=(20_000, 2))
    particles = Particles(states, -0.5 * (states[:, 0] - 1) ** 2)
    particles.reweight(np.zeros(20_000))
    mean, cov = particles.mean, particles.covariance
    assert particles.resample(rng, smooth=1.0)
    np.testing.assert_allclose(particles.mean, mean, atol=0.02)
    np.testing.assert_allclose(particles.covariance, cov, atol=0.03)
    assert len(np.unique(particles.states[:, 0])) == 20_000
    assert not particles.resample(rng, below=0.9)


def test_covariance_of_one_surviving_particle_is_zero():
    particles = Particles(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.0, -np.inf]))
    np.testing.assert_array_equal(particles.covariance, np.zeros((2, 2)))
    np.testing.assert_array_equal(particles.mean, [1.0, 2.0])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: kalman.update(MEAN, COV, [1.0], np.eye(2), R), "H"),
        (lambda: kalman.update(MEAN, COV, [1.0], H, [[-1.0]]), "R"),
        (lambda: kalman.predict(MEAN, np.eye(3), F, Q), "covariance"),
        (lambda: Particles.equal(np.empty((0, 2))), "states"),
        (lambda: effective_size([-np.inf, -np.inf]), "log_weights"),
        (lambda: effective_size([np.nan, 0.0]), "log_weights"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(InputError, match=rf"^{name} "):
        call()

"""The cat and the clean-up of section 3.8, against what the text says of them."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from estimation.errors import InputError
from estimation.filters import kalman
from evaluation.maintenance import maintenance_scenes as scenes

F = np.array([[1.0, 0.5], [0.0, 0.9]])
Q = np.array([[0.1, 0.02], [0.02, 0.2]])
H = np.array([[1.0, 0.3]])
R = np.array([[0.4]])
MEAN, COV = np.array([1.0, -2.0]), np.array([[1.0, 0.3], [0.3, 0.5]])


def test_the_cat_is_looked_at_less_often_where_it_is_measured_worse():
    scene = scenes.film(0)
    blurred = scenes.Film(scene.positions, 9.0 * scene.variances)
    sharp, dull = (scenes.watch(each, 0).rates()[0] for each in (scene, blurred))
    assert 0 < dull < sharp < 30


def test_a_camera_that_cannot_be_moved_looks_as_the_printed_rule_does():
    scene = scenes.film(1)
    np.testing.assert_array_equal(scenes.watch(scene, 1).looks, scenes.watch(scene, 1, ours=True).looks)


def test_clearing_a_room_goes_as_in_the_text():
    for seed in range(3):
        done = scenes.clean_up(seed)
        assert [who for who, _, _ in done] == [stage.theirs for stage in scenes.STAGES]


def test_a_look_before_grabbing_helps():
    looked = [each for seed in range(20) for each in scenes.clean_up(seed) if each[0] != "nobody"]
    before, after = np.mean([each[1:] for each in looked], axis=0)
    assert after < 0.5 * before


def test_particle_entropy_reaches_the_kalman_filters():
    """(3.4) on a linear Gaussian step tends to (3.3) of the Kalman posterior."""
    rng = np.random.default_rng(5)
    before = rng.multivariate_normal(MEAN, COV, 1500)
    moved = before @ F.T + rng.multivariate_normal([0, 0], Q, 1500)
    log_likelihood = norm.logpdf(0.5, moved @ H[0], np.sqrt(R[0, 0]))
    transition = multivariate_normal([0, 0], Q).logpdf(moved[:, None] - (before @ F.T)[None])
    ours = scenes.particle_entropy(log_likelihood, transition, np.zeros(1500))
    _, cov = kalman.predict(MEAN, COV, F, Q)
    _, P, _ = kalman.update(F @ MEAN, cov, [0.5], H, R)
    assert ours == pytest.approx(multivariate_normal(cov=P).entropy(), abs=0.1)
    with pytest.raises(InputError, match=r"^log_likelihood and "):
        scenes.particle_entropy([0.0], [[0.0, 0.0]], [0.0])

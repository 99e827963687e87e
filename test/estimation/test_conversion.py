"""The conversions against their definitions by Gauss-Hermite quadrature, against sampling, and in their frames."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.conversion.map_frame import convert_to_map, convert_with_ratio, sample_in_map
from estimation.conversion.polar import (
    METHODS,
    absolute_bias,
    bias_significance,
    condition_ratio,
    convert,
    convert_samples,
)
from estimation.conversion.spherical import convert_spherical, convert_spherical_to_map, spherical_points
from estimation.errors import InputError

CLOSED = [m for m in METHODS if m != "sampled"]


def nodes(sigmas, count=24):
    """Noise (Q, d) and weights (Q,) that integrate smooth functions of independent Gaussians."""
    x, w = np.polynomial.hermite_e.hermegauss(count)
    w = w / w.sum()
    noise = np.array(list(itertools.product(x, repeat=len(sigmas)))) * sigmas
    return noise, np.prod(list(itertools.product(w, repeat=len(sigmas))), axis=1)


def cartesian(polar):
    return spherical_points(*np.moveaxis(polar, -1, 0)) if polar.shape[-1] == 3 else planar(polar)


def planar(polar):
    return polar[..., :1] * np.stack([np.cos(polar[..., 1]), np.sin(polar[..., 1])], -1)


def definition(method, z, sigmas):
    """Mean and covariance from what the method's authors set out to compute."""
    noise, w = nodes(sigmas, 24 if len(z) == 2 else 12)
    measured = cartesian(z)
    truths = cartesian(z - noise)
    expected = w @ truths
    if method == "mucm":
        return expected, np.einsum("q,qi,qj->ij", w, truths - expected, truths - expected)
    # E[measurement | truth], by quadrature at the truth of every node.
    again = cartesian(z - noise[:, None] + noise[None])
    given_truth = np.einsum("qni,n->qi", again, w)
    if method == "ucm":
        # The factor per axis that makes the conversion unbiased, whatever the truth.
        axis_factor = (w @ given_truth) / expected
        mean = measured / axis_factor
        return mean, np.einsum("q,qi,qj->ij", w, mean - truths, mean - truths)
    bias = w @ (given_truth - truths)
    spread = again - given_truth[:, None]
    return measured - bias, np.einsum("q,n,qni,qnj->ij", w, w, spread, spread)


@pytest.mark.parametrize("method", ["dcm", "ucm", "mucm"])
@pytest.mark.parametrize("sigma", [0.02, 0.2, 0.6])
def test_definitions_in_2d(method, sigma):
    z, sigmas = np.array([3.0, 0.7]), np.array([0.3, sigma])
    mean, cov = definition(method, z, sigmas)
    ours = convert(*z, *sigmas, method)
    np.testing.assert_allclose(ours[0], mean, rtol=1e-9)
    np.testing.assert_allclose(ours[1], cov, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("method", ["dcm", "ucm", "mucm"])
def test_definitions_in_3d(method):
    z, sigmas = np.array([3.0, 0.7, -0.4]), np.array([0.2, 0.3, 0.12])
    if method == "dcm":
        # The nested quadrature of the bias is too large in 3D: sample the truths instead.
        rng = np.random.default_rng(0)
        truth = z - rng.normal(size=(400_000, 3)) * sigmas
        z_again = cartesian(truth + rng.normal(size=(400_000, 3)) * sigmas)
        mean = cartesian(z) - (z_again - cartesian(truth)).mean(0)
        np.testing.assert_allclose(convert_spherical(*z, *sigmas, "dcm")[0], mean, atol=6e-3)
        noise, w = nodes(sigmas, 8)
        again = cartesian(truth[:2000, None] + noise)
        spread = again - np.einsum("qni,n->qi", again, w)[:, None]
        cov = np.einsum("n,qni,qnj->ij", w, spread, spread) / 2000
        np.testing.assert_allclose(convert_spherical(*z, *sigmas, "dcm")[1], cov, atol=0.02)
        return
    noise, w = nodes(sigmas, 16)
    truths = cartesian(z - noise)
    expected = w @ truths
    factors = np.exp(-0.5 * np.array([0.3**2 + 0.12**2, 0.3**2 + 0.12**2, 0.12**2]))
    mean = expected if method == "mucm" else cartesian(z) / factors
    cov = np.einsum("q,qi,qj->ij", w, mean - truths, mean - truths)
    ours = convert_spherical(*z, *sigmas, method)
    np.testing.assert_allclose(ours[0], mean, rtol=1e-9)
    np.testing.assert_allclose(ours[1], cov, rtol=1e-6, atol=1e-9)
    if method == "ucm":
        # Unbiased given the truth: averaged over measurements the mean is the truth.
        again = z + noise
        again[:, 1] = np.angle(np.exp(1j * again[:, 1]))
        measured = convert_spherical(*again.T, *sigmas, "ucm")[0]
        np.testing.assert_allclose(w @ measured, cartesian(z), rtol=1e-9)


def test_only_the_ucm_is_unbiased_given_the_truth():
    truth, sigmas = np.array([4.0, 0.785]), np.array([0.02, 0.25])
    noise, w = nodes(sigmas)
    for method in CLOSED:
        means, _ = convert(*(truth + noise).T, *sigmas, method)
        bias = np.linalg.norm(w @ means - cartesian(truth))
        assert (bias < 1e-9) == (method == "ucm"), method


@pytest.mark.parametrize("dimension", [2, 3])
def test_linear_is_the_numerical_jacobian(dimension):
    z, sigmas = np.array([3.0, 2.2, 0.4])[:dimension], np.array([0.2, 0.3, 0.1])[:dimension]
    steps = 1e-6 * np.eye(dimension)
    J = ((cartesian(z + steps) - cartesian(z - steps)) / 2e-6).T
    mean, cov = (convert if dimension == 2 else convert_spherical)(*z, *sigmas, "linear")
    np.testing.assert_allclose(mean, cartesian(z))
    np.testing.assert_allclose(cov, J @ np.diag(sigmas**2) @ J.T, atol=1e-8)


@pytest.mark.parametrize("dimension", [2, 3])
def test_unscented_is_the_unscented_transform(dimension):
    z, sigmas = np.array([3.0, 2.2, 0.4])[:dimension], np.array([0.2, 0.5, 0.3])[:dimension]
    root = np.sqrt(3.0) * np.diag(sigmas)
    points = cartesian(np.concatenate([[z], z + root, z - root]))
    w = np.array([(3 - dimension) / 3] + [1 / 6] * (2 * dimension))
    mean = w @ points
    cov = np.einsum("q,qi,qj->ij", w, points - mean, points - mean)
    ours = (convert if dimension == 2 else convert_spherical)(*z, *sigmas, "unscented")
    np.testing.assert_allclose(ours[0], mean)
    np.testing.assert_allclose(ours[1], cov, atol=1e-12)


def test_sampled_conversion_is_the_mucm_in_the_limit():
    for ours, exact in (
        (convert(3, 0.7, 0.1, 0.4, "sampled", samples=400_000), convert(3, 0.7, 0.1, 0.4, "mucm")),
        (
            convert_spherical(3, 0.7, 0.3, 0.1, 0.4, 0.2, "sampled", samples=400_000),
            convert_spherical(3, 0.7, 0.3, 0.1, 0.4, 0.2, "mucm"),
        ),
    ):
        np.testing.assert_allclose(ours[0], exact[0], atol=0.01)
        np.testing.assert_allclose(ours[1], exact[1], atol=0.01)


ROBOT = np.array([2.0, -1.0, 2.5])
ROBOT_COVARIANCE = np.array([[0.04, 0.01, 0.008], [0.01, 0.02, -0.004], [0.008, -0.004, 0.02]])


@pytest.mark.parametrize("method", METHODS)
def test_through_an_uncertain_robot_pose(method):
    measurement = (5.0, 1.2, 0.1, 0.1)
    samples = sample_in_map(ROBOT, ROBOT_COVARIANCE, *measurement, samples=400_000, seed=1)
    mean, cov = convert_to_map(ROBOT, ROBOT_COVARIANCE, *measurement, method, samples=20_000)
    # The UCM's covariance is that of its own error, around a mean that is not E[truth | measurement].
    error = samples - (mean if method == "ucm" else samples.mean(0))
    expected = error.T @ error / len(error)
    # All methods agree to second order of a total bearing noise of 0.17 rad.
    tolerance = {"linear": 0.06, "dcm": 0.06, "sampled": 0.03}.get(method, 0.015)
    np.testing.assert_allclose(cov, expected, atol=tolerance * np.abs(expected).max())
    if method == "mucm":
        np.testing.assert_allclose(mean, samples.mean(0), atol=0.006)
    no_correlation = ROBOT_COVARIANCE.copy()
    no_correlation[:2, 2] = no_correlation[2, :2] = 0
    assert np.abs(convert_to_map(ROBOT, no_correlation, *measurement, method)[1] - cov).max() > 0.02


def test_through_an_uncertain_pose_in_3d():
    pose = np.array([1.0, 2.0, 0.5, 0.0, 0.0, 2.0])
    P = np.zeros((6, 6))
    P[np.ix_([0, 1, 5], [0, 1, 5])] = ROBOT_COVARIANCE
    P[2, 2], P[3, 3], P[4, 4] = 1e-3, 4e-4, 4e-4
    measurement = np.array([4.0, -0.6, 0.3])
    sigmas = np.array([0.05, 0.04, 0.03])
    rng = np.random.default_rng(2)
    for roll in (0.0, 0.5):
        pose[3] = roll
        covariance = P if roll == 0 else P * 0.05
        robots = rng.multivariate_normal(pose, covariance, 200_000)
        body = cartesian(measurement + rng.normal(size=(200_000, 3)) * sigmas)
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_euler("ZYX", robots[:, :2:-1])
        samples = turn.apply(body) + robots[:, :3]
        mean, cov = convert_spherical_to_map(pose, covariance, *measurement, *sigmas, "mucm")
        np.testing.assert_allclose(mean, samples.mean(0), atol=0.01)
        expected = np.cov(samples.T)
        np.testing.assert_allclose(cov, expected, atol=0.02 * np.abs(expected).max())


def test_compiled_form_equals_the_arrays():
    rng = np.random.default_rng(3)
    r, theta = rng.uniform(0.3, 9, 50), rng.uniform(-3, 3, 50)
    sr, sb = rng.uniform(0.005, 0.2, 50), rng.uniform(0.005, 0.4, 50)
    mean, cov, K = convert_with_ratio(r, theta, sr, sb)
    np.testing.assert_allclose(mean, convert(r, theta, sr, sb)[0])
    np.testing.assert_allclose(cov, convert(r, theta, sr, sb)[1])
    np.testing.assert_allclose(K, condition_ratio(r, theta, sr, sb))
    mean, cov, K = convert_with_ratio(r, theta, sr, sb, ROBOT, ROBOT_COVARIANCE)
    expected = convert_to_map(ROBOT, ROBOT_COVARIANCE, r, theta, sr, sb)
    np.testing.assert_allclose(mean, expected[0])
    np.testing.assert_allclose(cov, expected[1])
    linear = convert_to_map(ROBOT, ROBOT_COVARIANCE, r, theta, sr, sb, "linear")[1]
    values, lin = np.linalg.eigvalsh(expected[1]), np.linalg.eigvalsh(linear)
    np.testing.assert_allclose(K, values[:, 0] / values[:, 1] / (lin[:, 0] / lin[:, 1]))
    K = convert_with_ratio(r, theta, sr, sb, ROBOT, ROBOT_COVARIANCE, position_in_ratio=False)[2]
    np.testing.assert_allclose(K, condition_ratio(r, theta, sr, np.hypot(sb, np.sqrt(0.02))))


def test_candidate_measures_are_their_definitions():
    z = (4.0, 0.8, 0.02, 0.1)
    linear, ucm = convert(*z, "linear"), convert(*z, "ucm")
    bias = np.linalg.norm(linear[0] - ucm[0])
    assert absolute_bias(*z) == pytest.approx(bias)
    values = np.linalg.eigvalsh(ucm[1])
    assert bias_significance(*z) == pytest.approx(bias / np.sqrt(values[0]))
    lin = np.linalg.eigvalsh(linear[1])
    assert condition_ratio(*z) == pytest.approx(values[0] / values[1] / (lin[0] / lin[1]))
    Sigma = np.array([[0.05, 0.02], [0.02, 0.03]])
    values, lin = np.linalg.eigvalsh(ucm[1] + Sigma), np.linalg.eigvalsh(linear[1] + Sigma)
    assert condition_ratio(*z, Sigma) == pytest.approx(values[0] / values[1] / (lin[0] / lin[1]))
    assert condition_ratio(*z, np.zeros((2, 2))) == pytest.approx(condition_ratio(*z))


RANGE, BEARING = st.floats(0.05, 100), st.floats(-np.pi, np.pi)
SIGMA_RANGE, SIGMA_BEARING = st.floats(1e-4, 2), st.floats(1e-4, 1.0)


@given(RANGE, BEARING, SIGMA_RANGE, SIGMA_BEARING, st.sampled_from(CLOSED), st.floats(-np.pi, np.pi))
def test_turning_the_frame_turns_the_result(r, theta, sr, sb, method, yaw):
    mean, cov = convert(r, theta, sr, sb, method)
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    turned_mean, turned_cov = convert_to_map([0, 0, yaw], np.zeros((3, 3)), r, theta, sr, sb, method)
    scale = np.abs(cov).max()
    np.testing.assert_allclose(turned_mean, R @ mean, atol=1e-9 * (1 + r))
    np.testing.assert_allclose(turned_cov, R @ cov @ R.T, atol=1e-9 * scale)
    assert np.linalg.eigvalsh(cov)[0] > -1e-12 * scale


@given(RANGE, BEARING, SIGMA_RANGE, SIGMA_BEARING, st.sampled_from(CLOSED))
def test_mirror_symmetry_and_scale(r, theta, sr, sb, method):
    mean, cov = convert(r, theta, sr, sb, method)
    mirrored_mean, mirrored_cov = convert(r, -theta, sr, sb, method)
    np.testing.assert_allclose(mirrored_mean, mean * [1, -1], atol=1e-12 * r)
    np.testing.assert_allclose(mirrored_cov, cov * [[1, -1], [-1, 1]], atol=1e-9 * np.abs(cov).max())
    scaled_mean, scaled_cov = convert(3 * r, theta, 3 * sr, sb, method)
    np.testing.assert_allclose(scaled_mean, 3 * mean, rtol=1e-9, atol=1e-12 * r)
    np.testing.assert_allclose(scaled_cov, 9 * cov, rtol=1e-7, atol=1e-9 * np.abs(cov).max())
    assert condition_ratio(3 * r, theta, 3 * sr, sb) == pytest.approx(condition_ratio(r, 0.0, sr, sb))


@given(RANGE, SIGMA_RANGE, SIGMA_BEARING, st.sampled_from(CLOSED))
def test_both_sides_of_the_seam_at_pi(r, sr, sb, method):
    left, right = convert(r, np.pi, sr, sb, method), convert(r, -np.pi, sr, sb, method)
    np.testing.assert_allclose(left[0], right[0], atol=1e-12 * r)
    np.testing.assert_allclose(left[1], right[1], atol=1e-12 * np.abs(left[1]).max())


ELEVATION = st.floats(-np.pi / 2, np.pi / 2)


@given(RANGE, BEARING, ELEVATION, SIGMA_RANGE, SIGMA_BEARING, SIGMA_BEARING, st.sampled_from(CLOSED))
def test_frames_seam_and_symmetry_in_3d(r, b, e, sr, sb, se, method):
    mean, cov = convert_spherical(r, b, e, sr, sb, se, method)
    straight_mean, straight_cov = convert_spherical(r, 0.0, e, sr, sb, se, method)
    # A bearing is a turn about the vertical; so is the robot's yaw.
    R = np.array([[np.cos(b), -np.sin(b), 0.0], [np.sin(b), np.cos(b), 0.0], [0.0, 0.0, 1.0]])
    turned = convert_spherical_to_map([0, 0, 0, 0, 0, b], np.zeros((6, 6)), r, 0.0, e, sr, sb, se, method)
    scale = np.abs(cov).max()
    for found in ((mean, cov), turned):
        np.testing.assert_allclose(found[0], R @ straight_mean, atol=1e-9 * (1 + r))
        np.testing.assert_allclose(found[1], R @ straight_cov @ R.T, atol=1e-9 * scale)
    for mirror, (bearing, elevation) in (([1, -1, 1], (-b, e)), ([1, 1, -1], (b, -e))):
        other_mean, other_cov = convert_spherical(r, bearing, elevation, sr, sb, se, method)
        np.testing.assert_allclose(other_mean, mean * mirror, atol=1e-9 * (1 + r))
        np.testing.assert_allclose(other_cov, cov * np.outer(mirror, mirror), atol=1e-9 * scale)
    left, right = (convert_spherical(r, side, e, sr, sb, se, method) for side in (np.pi, -np.pi))
    np.testing.assert_allclose(left[0], right[0], atol=1e-9 * (1 + r))
    np.testing.assert_allclose(left[1], right[1], atol=1e-9 * scale)
    assert np.linalg.eigvalsh(cov)[0] > -1e-9 * scale


@pytest.mark.parametrize("method", METHODS)
def test_arrays_are_many_single_conversions(method):
    rng = np.random.default_rng(4)
    r, theta = rng.uniform(1, 5, (3, 2)), rng.uniform(-3, 3, 2)
    mean, cov = convert(r, theta, 0.1, 0.2, method)
    assert mean.shape == (3, 2, 2)
    assert cov.shape == (3, 2, 2, 2)
    if method != "sampled":
        for i, j in np.ndindex(3, 2):
            single = convert(r[i, j], theta[j], 0.1, 0.2, method)
            np.testing.assert_allclose(mean[i, j], single[0])
            np.testing.assert_allclose(cov[i, j], single[1])
    assert isinstance(condition_ratio(1.0, 0.0, 0.1, 0.1), float)
    assert np.shape(condition_ratio(r, theta, 0.1, 0.2)) == (3, 2)


def test_tiny_noise_keeps_its_digits():
    """Variances of 1e-16 m² come out right: no difference of nearly equal numbers is taken."""
    _, cov = convert(10.0, 0.0, 1e-8, 1e-9, "mucm")
    np.testing.assert_allclose(np.diag(cov), [1e-16, 1e-16], rtol=1e-6)


def test_samples_are_seeded():
    first, second = (convert_samples(3, 1, 0.1, 0.2, 10, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert (convert_samples(3, 1, 0.1, 0.2, 10, seed=6) != first).all()


GOOD = {"range_": 1.0, "bearing": 0.5, "sigma_range": 0.1, "sigma_bearing": 0.1}


@pytest.mark.parametrize(
    "change",
    [
        {"range_": 0.0},
        {"range_": [1.0, -1.0]},
        {"range_": np.nan},
        {"bearing": 3.2},
        {"bearing": np.inf},
        {"sigma_range": 0.0},
        {"sigma_bearing": -0.1},
        {"sigma_bearing": np.nan},
        {"method": "magic"},
    ],
)
def test_bad_measurements_are_named(change):
    (name,) = change
    good = dict(GOOD, elevation=0.0, sigma_elevation=0.1)
    calls = [
        lambda: convert(**GOOD | change),
        lambda: convert_to_map([0, 0, 0], np.zeros((3, 3)), **GOOD | change),
        lambda: convert_spherical(**good | change),
    ]
    if name != "method":
        calls += [lambda: condition_ratio(**GOOD | change), lambda: convert_with_ratio(**GOOD | change)]
    for call in calls:
        with pytest.raises(InputError, match=rf"^{name} must"):
            call()


@pytest.mark.parametrize(
    ("pose", "covariance", "name"),
    [
        ([0, 0, 4.0], np.eye(3), "robot_pose yaw"),
        ([0, 0, np.nan], np.eye(3), "robot_pose"),
        ([0, 0], np.eye(3), "robot_pose"),
        ([0, 0, 0], -np.eye(3), "robot_covariance"),
        ([0, 0, 0], np.eye(2), "robot_covariance"),
        ([0, 0, 0], np.array([[1, 2, 0], [2, 1, 0], [0, 0, 1.0]]), "robot_covariance"),
        ([0, 0, 0], np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1.0]]), "robot_covariance"),
    ],
)
def test_bad_robot_poses_are_named(pose, covariance, name):
    with pytest.raises(InputError, match=rf"^{name} must"):
        convert_to_map(pose, covariance, **GOOD)


def test_single_precision_pi_is_an_angle():
    convert(1.0, np.float32(np.pi), 0.1, 0.1)

"""The switching filter against a plain Kalman filter, exact Bayesian integration and its own statistics."""

import itertools

import numpy as np
import pytest

from estimation.conversion.map_frame import convert_to_map
from estimation.conversion.switching import SwitchingBank, SwitchingFilter
from estimation.errors import InputError
from estimation.filters import kalman
from estimation.filters.constant_velocity import ConstantVelocity
from estimation.filters.gaussians import repairs
from estimation.metrics.statistics import anees_bounds, nees

MOTION = ConstantVelocity(0.6)
NOISE = np.diag([0.02**2, np.radians(2) ** 2])
ROBOT = np.array([[0.0049, 0.001, 0.0004], [0.001, 0.0049, -0.0003], [0.0004, -0.0003, 0.0012]])
EXACT = np.zeros((3, 3))
START = np.array([4.0, 1.0, -0.5, 0.8])
SPREAD = np.diag([0.05, 0.04, 0.1, 0.1])


def test_motion_model():
    F, Q = MOTION.matrices(0.3)
    half_F, half_Q = MOTION.matrices(0.15)
    np.testing.assert_allclose(half_F @ half_F, F)
    np.testing.assert_allclose(half_F @ half_Q @ half_F.T + half_Q, Q)
    # White acceleration of density q²: integrate it numerically.
    rng = np.random.default_rng(0)
    steps = 60
    dt = 0.3 / steps
    v = np.cumsum(0.6 * np.sqrt(dt) * rng.normal(size=(100_000, steps)), 1)
    x = v.sum(1) * dt
    np.testing.assert_allclose(np.cov(x, v[:, -1]), Q[::2, ::2], rtol=0.05)


def test_kalman_mode_is_a_kalman_filter():
    rng = np.random.default_rng(1)
    filter_ = SwitchingFilter(MOTION, START, SPREAD, k_crit=np.inf, decorrelated=False)
    mean, cov = START, SPREAD
    H = np.eye(2, 4)
    for _ in range(30):
        pose = np.array([*rng.normal(0, 0.1, 2), rng.uniform(-3, 3)])
        bearing = np.arctan2(1 - pose[1], 4 - pose[0]) - pose[2]
        z = np.array([4 + rng.normal(0, 0.1), np.angle(np.exp(1j * (bearing + rng.normal(0, 0.05))))])
        filter_.predict(0.1)
        filter_.update(pose, ROBOT, z, NOISE)
        mean, cov = kalman.predict(mean, cov, *MOTION.matrices(0.1))
        converted = convert_to_map(pose, ROBOT, *z, *np.sqrt(np.diag(NOISE)), "ucm")
        mean, cov, _ = kalman.update(mean, cov, converted[0], H, converted[1])
        np.testing.assert_allclose(filter_.mean, mean, atol=1e-10)
        np.testing.assert_allclose(filter_.covariance, cov, atol=1e-10)
    assert filter_.mode == "kf"


def test_the_covariance_lies_along_the_predicted_bearing():
    """One update by hand: UCM variances along and across the line to the prediction, not to the measurement."""
    z, tight = np.array([4.3, 0.4]), 0.01 * np.eye(4)
    _, turned = convert_to_map([0, 0, 0], EXACT, z[0], np.arctan2(START[1], START[0]), 0.02, np.radians(8))
    mean, measured = convert_to_map([0, 0, 0], EXACT, *z, 0.02, np.radians(8))
    noise = np.diag([0.02**2, np.radians(8) ** 2])
    for prior, R in ((tight, turned), (100 * tight, measured)):
        filter_ = SwitchingFilter(MOTION, START, prior, k_crit=np.inf)
        filter_.update(np.zeros(3), EXACT, z, noise)
        expected, cov, _ = kalman.update(START, prior, mean, np.eye(2, 4), R)
        np.testing.assert_allclose(filter_.mean, expected)
        np.testing.assert_allclose(filter_.covariance, cov, atol=1e-12)


def test_a_precise_measurement_of_a_vague_prior_keeps_the_covariance_definite():
    filter_ = SwitchingFilter(MOTION, [3.0, 1.0, 0, 0], 1e6 * np.eye(4), k_crit=np.inf)
    for _ in range(3):
        filter_.update(np.zeros(3), EXACT, [3.0, 0.3], np.diag([1e-6, 1e-6]) ** 2)
        np.linalg.cholesky(filter_.covariance)


def exact_posterior(robot_covariance, z, noise, count=150_000):
    """Posterior mean and covariance by importance sampling with the exact likelihood p(z | x).

    The robot's position is integrated by quadrature, its heading in closed form given the position.
    """
    rng = np.random.default_rng(2)
    x = rng.multivariate_normal(START, SPREAD, count)
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    P = robot_covariance
    root = np.linalg.cholesky(P[:2, :2] + 1e-12 * np.eye(2))
    slope = np.linalg.solve(P[:2, :2] + 1e-12 * np.eye(2), P[:2, 2])
    variance = noise[1, 1] + P[2, 2] - slope @ P[:2, 2]
    likelihood = np.zeros(count)
    for (a, wa), (b, wb) in itertools.product(zip(nodes, weights, strict=True), repeat=2):
        offset = root @ [a, b]
        seen = x[:, :2] - offset
        r = np.hypot(*seen.T)
        turn = np.angle(np.exp(1j * (np.arctan2(seen[:, 1], seen[:, 0]) - z[1] - slope @ offset)))
        likelihood += wa * wb * np.exp(-0.5 * (r - z[0]) ** 2 / noise[0, 0] - 0.5 * turn**2 / variance)
    w = likelihood / likelihood.sum()
    mean = w @ x
    return mean, (x - mean).T * w @ (x - mean)


@pytest.mark.parametrize("robot", [EXACT, ROBOT], ids=["exact pose", "uncertain pose"])
def test_particles_hold_the_exact_posterior(robot):
    noise = np.diag([0.03**2, 0.15**2])
    z = np.array([4.2, 0.35])
    expected_mean, expected = exact_posterior(robot, z, noise)
    means, covariances = [], []
    for seed in range(8):
        filter_ = SwitchingFilter(MOTION, START, SPREAD, k_crit=1.0001, particles=4000, seed=seed)
        filter_.update(np.zeros(3), robot, z, noise)
        assert filter_.mode == "pf"
        means.append(filter_.mean)
        covariances.append(filter_.covariance)
    sigma = np.sqrt(np.diag(expected))
    # One run strays by 0.03 standard deviations; the straight cells of the samples leave 0.02.
    np.testing.assert_allclose((np.mean(means, 0) - expected_mean) / sigma, 0, atol=0.06)
    np.testing.assert_allclose(
        np.mean(covariances, 0) / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=0.1
    )
    # Kalman filters are measurably off here: the test can tell them apart, and the plain from the decorrelated.
    errors = []
    for decorrelated in (False, True):
        gaussian = SwitchingFilter(MOTION, START, SPREAD, k_crit=np.inf, decorrelated=decorrelated)
        gaussian.update(np.zeros(3), robot, z, noise)
        errors.append(np.abs((gaussian.mean - expected_mean) / sigma).max())
    if robot is EXACT:
        assert errors[0] > 0.2
        assert 0.06 < errors[1] < errors[0]


def drive(ranges, **options):
    """Modes of a filter that sees a target straight ahead at the given ranges, with a certain robot position."""
    robot = np.diag([1e-6, 1e-6, np.radians(2) ** 2])
    filter_ = SwitchingFilter(MOTION, [ranges[0], 0, 0, 0], np.diag([0.01, 0.01, 0.01, 0.01]), **options)
    modes = []
    for r in ranges:
        filter_.predict(0.05)
        filter_.update(np.zeros(3), robot, [r, 0.0], NOISE)
        modes.append(filter_.mode)
    return filter_, modes


def test_modes_follow_the_ratio_and_return_after_the_interval():
    ranges = np.concatenate(
        [np.full(20, 1.0), np.linspace(1, 5, 40), np.linspace(5, 1, 40), np.full(300, 1.0)]
    )
    filter_, modes = drive(ranges, mardia_interval=15, particles=500, samples=60)
    assert modes[:20] == ["kf"] * 20
    first = modes.index("pf")
    assert 20 < first < 60
    assert modes[60] == "pf"
    assert modes[-1] == "kf"
    assert "kf" not in modes[first : first + 15]
    assert filter_.switches == 2
    assert filter_.tests >= 1
    assert filter_.particles is None
    np.testing.assert_allclose(filter_.mean[:2], [1.0, 0.0], atol=0.05)


def test_particles_that_nothing_bends_follow_the_kalman_filter_exactly():
    """Far away K asks for particles, but the target is known too well for the arc to bend among them."""
    noise, robot = np.diag([0.02**2, np.radians(3) ** 2]), np.diag([1e-4, 1e-4, 1e-4])
    rng = np.random.default_rng(5)
    switching, gaussian = (
        SwitchingFilter(MOTION, [9.0, 0.0, 0.0, 0.5], 0.001 * np.eye(4), particles=300, seed=2, **options)
        for options in ({}, {"k_crit": np.inf})
    )
    for step in range(40):
        z = np.array([9.0, 0.0]) + rng.normal(size=2) * np.sqrt(np.diag(noise))
        for filter_ in (switching, gaussian):
            filter_.predict(0.02)
            filter_.update(np.zeros(3), robot, z, noise)
        assert switching.mode == "pf"
        np.testing.assert_allclose(switching.mean, gaussian.mean, atol=1e-9)
        np.testing.assert_allclose(switching.covariance, gaussian.covariance, atol=1e-9)
        if step == 20:
            assert len(np.unique(switching.particles.states, axis=0)) == 300


def test_limits_that_stay_in_one_mode():
    assert set(drive(np.full(60, 1.0), k_crit=0.0, particles=100)[1]) == {"pf"}
    assert set(drive(np.full(60, 9.0), k_crit=np.inf)[1]) == {"kf"}
    far = drive(np.full(60, 9.0), particles=100)[0]
    assert far.mode == "pf"
    assert len(far.particles.states) == 100
    assert far.ratio > 1.075


def test_position_covariance_in_the_ratio():
    robot = np.diag([0.09, 0.09, np.radians(2) ** 2])
    for included, mode in ((True, "kf"), (False, "pf")):
        filter_ = SwitchingFilter(MOTION, START, SPREAD, position_in_ratio=included)
        filter_.update(np.zeros(3), robot, [6.0, 0.2], NOISE)
        assert filter_.mode == mode


def test_a_bank_is_many_filters():
    rng = np.random.default_rng(3)
    count = 6
    means = START + rng.normal(size=(count, 4))
    bank = SwitchingBank(
        MOTION, means, np.tile(SPREAD, (count, 1, 1)), k_crit=1.03, particles=200, samples=50, seed=9
    )
    singles = [
        SwitchingBank(MOTION, means[:1], SPREAD[None], k_crit=1.03, particles=200, samples=50, seed=9),
        SwitchingFilter(MOTION, means[0], SPREAD, k_crit=1.03, particles=200, samples=50, seed=9),
    ]
    modes = set()
    for step in range(15):
        z = np.column_stack([rng.uniform(1, 7, count), rng.uniform(-0.5, 0.5, count)])
        for f in (bank, *singles):
            f.predict(0.1)
        pose = np.array([0.1, 0.2, 0.1 * step])
        bank.update(pose, ROBOT, z, np.tile(NOISE, (count, 1, 1)))
        singles[0].update(pose, ROBOT, z[:1], NOISE)
        singles[1].update(pose, ROBOT, z[0], NOISE)
        np.testing.assert_array_equal(bank.means[0], singles[0].means[0])
        np.testing.assert_array_equal(bank.covariances[0], singles[1].covariance)
        modes |= set(bank.in_kalman_mode.tolist())
    assert modes == {True, False}


def test_only_the_named_targets_are_updated():
    bank = SwitchingBank(MOTION, np.tile(START, (3, 1)), np.tile(SPREAD, (3, 1, 1)))
    bank.update(np.zeros(3), ROBOT, [[4.2, 0.2]], NOISE, targets=[1])
    assert np.isnan(bank.ratio[[0, 2]]).all()
    np.testing.assert_array_equal(bank.means[[0, 2]], np.tile(START, (2, 1)))
    assert (bank.means[1] != START).any()


@pytest.mark.parametrize("k_crit", [np.inf, 0.0])
def test_consistency_on_the_models_own_targets(k_crit):
    """With truth drawn from the model the NEES of both modes is that of a consistent filter."""
    rng = np.random.default_rng(4)
    runs, steps, dt = 40, 25, 0.2
    F, Q = MOTION.matrices(dt)
    robot = np.diag([0.01, 0.01, 0.001])
    values = np.empty((runs, steps))
    for run in range(runs):
        truth = rng.multivariate_normal(START, SPREAD)
        filter_ = SwitchingFilter(MOTION, START, SPREAD, k_crit=k_crit, particles=600, samples=60, seed=run)
        for step in range(steps):
            truth = rng.multivariate_normal(F @ truth, Q)
            pose = rng.multivariate_normal([0, 0, 0], robot)
            z = np.array([np.hypot(*truth[:2]), np.arctan2(truth[1], truth[0])])
            z += rng.normal(size=2) * np.sqrt(np.diag(NOISE))
            filter_.predict(dt)
            filter_.update(pose, robot, z, NOISE)
            values[run, step] = nees(filter_.mean - truth, filter_.covariance)
    low, high = anees_bounds(runs, 4, 0.9999)
    assert low < values[:, -1].mean() < high
    assert low < values.mean() < high


def test_a_vague_prior_becomes_the_arc():
    """One measurement of a target that could be anywhere: the posterior is the measurement, bent."""
    noise = np.diag([0.02**2, 0.2**2])
    filter_ = SwitchingFilter(MOTION, [3.0, 1.0, 0, 0], np.diag([9.0, 9.0, 1.0, 1.0]), particles=2000)
    filter_.update(np.zeros(3), EXACT, [5.0, 0.0], noise)
    states, w = filter_.particles.states, np.exp(filter_.particles.log_weights)
    radius, turn = np.hypot(states[:, 0], states[:, 1]), np.arctan2(states[:, 1], states[:, 0])
    assert w @ radius == pytest.approx(5.0, abs=0.02)
    assert np.sqrt(w @ (radius - w @ radius) ** 2) < 0.08
    # The prior narrows it a little.
    assert np.sqrt(w @ (turn - w @ turn) ** 2) == pytest.approx(0.19, abs=0.03)
    # A Gaussian of the same moments is several times thicker along the bearing.
    assert np.sqrt(filter_.covariance[0, 0]) > 0.1


@pytest.mark.parametrize("distance", [2.0, 30.0])
def test_a_measurement_far_from_every_particle_is_survived(distance):
    filter_ = SwitchingFilter(MOTION, [6.0, 0, 0, 0], 0.01 * np.eye(4), k_crit=0.0, particles=300, samples=60)
    for _ in range(25):
        filter_.predict(0.1)
        filter_.update(np.zeros(3), EXACT, [6.0 + distance, 0.0], NOISE)
    assert np.isfinite(filter_.covariance).all()
    np.testing.assert_allclose(filter_.mean[0], 6.0 + distance, atol=0.3)


def test_seed_decides_the_draws():
    states = [drive(np.full(5, 8.0), particles=50, seed=s)[0].particles.states for s in (1, 1, 2)]
    np.testing.assert_array_equal(states[0], states[1])
    assert (states[0] != states[2]).any()


def test_a_refused_update_changes_nothing():
    filter_ = SwitchingFilter(MOTION, START, SPREAD)
    with pytest.raises(InputError):
        filter_.update(np.zeros(3), ROBOT, [4.0, np.nan], NOISE)
    np.testing.assert_array_equal(filter_.mean, START)
    np.testing.assert_array_equal(filter_.covariance, SPREAD)


@pytest.mark.parametrize("k_crit", [np.inf, 0.0])
def test_a_robot_covariance_indefinite_by_rounding_is_repaired_and_counted(k_crit):
    flat = np.outer([0.07, 0.07, 0.03], [0.07, 0.07, 0.03])
    rounded = flat.copy()
    rounded[0, 0] -= 1e-12
    assert np.linalg.eigvalsh(rounded)[0] < -1e-14
    before, found = repairs.count, []
    for covariance in (flat + 1e-9 * np.eye(3), rounded):
        filter_ = SwitchingFilter(MOTION, START, SPREAD, k_crit=k_crit)
        filter_.update(np.zeros(3), covariance, [4.2, 0.2], NOISE)
        found.append((filter_.mean, filter_.covariance))
    assert repairs.count == before + 1
    np.testing.assert_allclose(found[1][0], found[0][0], atol=1e-4)
    np.testing.assert_allclose(found[1][1], found[0][1], atol=1e-5)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"robot_pose": [0, 0, np.nan]}, "robot_pose"),
        ({"robot_pose": [0, 0, 3.3]}, "robot_pose"),
        ({"robot_pose": [0, 0]}, "robot_pose"),
        ({"robot_covariance": -np.eye(3)}, "robot_covariance"),
        ({"robot_covariance": np.full((3, 3), np.nan)}, "robot_covariance"),
        ({"robot_covariance": [[1, 2, 0], [2, 1, 0], [0, 0, 1]]}, "robot_covariance"),
        ({"robot_covariance": [[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]]}, "robot_covariance"),
        ({"robot_covariance": [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]}, "robot_covariance"),
        ({"robot_covariance": [[100, 0, 0], [0, 1e-3, 3e-3], [0, 3e-3, 1e-3]]}, "robot_covariance"),
        ({"measurement": [0.0, 0.0]}, "measurement"),
        ({"measurement": [-1.0, 0.0]}, "measurement"),
        ({"measurement": [1.0, 3.3]}, "measurement"),
        ({"measurement": [1.0, np.nan]}, "measurement"),
        ({"measurement": [1.0, 0.0, 0.0]}, "measurement"),
        ({"covariance": np.zeros((2, 2))}, "covariance"),
        ({"covariance": [[1, 0.1], [0.1, 1]]}, "covariance"),
        ({"covariance": [[1, 0], [0, np.inf]]}, "covariance"),
        ({"covariance": np.eye(3)}, "covariance"),
    ],
)
def test_bad_updates_are_named(change, name):
    good = {
        "robot_pose": np.zeros(3),
        "robot_covariance": ROBOT,
        "measurement": [4.0, 0.1],
        "covariance": NOISE,
    }
    with pytest.raises(InputError, match=rf"^{name} must"):
        SwitchingFilter(MOTION, START, SPREAD).update(**good | change)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"mean": [0, 0, 0]}, "mean"),
        ({"mean": [0, 0, 0, np.inf]}, "mean"),
        ({"covariance": np.zeros((4, 4))}, "covariance"),
        ({"covariance": np.diag([1, 1, 1, -1.0])}, "covariance"),
        ({"covariance": np.eye(3)}, "covariance"),
        ({"k_crit": -1}, "k_crit"),
        ({"particles": 3}, "particles"),
        ({"samples": 1}, "samples"),
        ({"mardia_interval": 0}, "mardia_interval"),
        ({"k_crit": np.nan}, "k_crit"),
        ({"seed": -1}, "seed"),
    ],
)
def test_bad_filters_are_named(change, name):
    with pytest.raises(InputError, match=rf"^{name} must"):
        SwitchingFilter(**{"motion": MOTION, "mean": START, "covariance": SPREAD} | change)


def test_bad_steps_and_accelerations_are_named():
    with pytest.raises(InputError, match=r"^acceleration must"):
        ConstantVelocity(0.0)
    for dt in (-0.1, np.nan):
        with pytest.raises(InputError, match=r"^dt must"):
            SwitchingFilter(MOTION, START, SPREAD).predict(dt)

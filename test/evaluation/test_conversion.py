"""The conversion experiment: its helpers against independent computations, and the figures it must reach."""

import numpy as np
import pytest

from estimation.conversion.polar import condition_ratio, convert, convert_samples
from evaluation.conversion import conversion_analysis as analysis
from evaluation.conversion import conversion_drive as driving
from evaluation.conversion import conversion_limits as limits
from evaluation.conversion import conversion_tracking as tracking
from evaluation.experiments import conversion as experiment
from evaluation.report import Report, RunOptions


@pytest.mark.parametrize("method", analysis.METHODS)
def test_exact_anes_is_the_limit_of_the_sampled(method):
    rng = np.random.default_rng(0)
    sigma = np.radians(12)
    sampled = np.mean([analysis.sampled_anes(sigma, method, rng) for _ in range(200)])
    assert sampled == pytest.approx(analysis.exact_anes(sigma, method), rel=0.05)


def test_exact_distance_is_that_of_a_histogram_fine_enough():
    """At a small angle both distributions fill the bins, and all readings agree."""
    rng = np.random.default_rng(1)
    sigma = np.radians(6)
    # Against Monte Carlo over the known densities: ln p = ln N(r, θ) - ln r.
    points = convert_samples(4, np.pi / 4, 0.02, sigma, 200_000, rng)
    r, theta = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    log_p = -0.5 * ((r - 4) / 0.02) ** 2 - 0.5 * ((theta - np.pi / 4) / sigma) ** 2
    log_p -= np.log(2 * np.pi * 0.02 * sigma) + np.log(r)
    for method in ("linear", "mucm"):
        mean, cov = convert(4, np.pi / 4, 0.02, sigma, method)
        offsets = points - mean
        log_q = -0.5 * np.einsum("ni,ij,nj->n", offsets, np.linalg.inv(cov), offsets)
        log_q -= np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(cov)[1]
        assert analysis.exact_kl(sigma, method) == pytest.approx((log_p - log_q).mean(), rel=0.03)


def test_linearisation_wins_only_where_empty_bins_are_skipped():
    rng = np.random.default_rng(2)
    found = {m: analysis.binned_kl(np.radians(10), m, rng) for m in ("linear", "mucm")}
    assert found["linear"].skipping_empty < found["mucm"].skipping_empty
    assert found["linear"].every_bin > found["mucm"].every_bin
    assert analysis.exact_kl(np.radians(10), "linear") > analysis.exact_kl(np.radians(10), "mucm")


def test_there_are_810_operating_points():
    assert len(set(limits.operating_points())) == 810


def test_predicted_angle_is_where_the_ratio_passes():
    for r, sr, position in ((4.0, 0.02, 0.0), (6.0, 0.03, 0.05)):
        angle = limits.predicted(r, sr, position)
        P = position**2 * np.eye(2)
        assert condition_ratio(r, 0.0, sr, angle, P) == pytest.approx(1.075, abs=1e-6)
    assert np.isnan(limits.predicted(1.0, 0.3, 0.0))


def test_measured_angle_is_close_to_the_predicted():
    found = limits.find_limit(4.0, 0.5, 0.02, 0.0, seed=3)
    assert np.degrees(found.measured) == pytest.approx(np.degrees(found.by_ratio), abs=0.5)


def test_walks_follow_the_scenario():
    walk = tracking.walk(3, 0, 13.0)
    assert walk.truth[0, :2] == pytest.approx([0.75, -1.5], abs=0.05)
    assert walk.truth[239, 1] == pytest.approx(4.5, abs=0.1)
    assert walk.truth[479, 1] == pytest.approx(-1.5, abs=0.1)
    robots = walk.robots - walk.robots.mean(0)
    np.testing.assert_allclose(np.cov(robots.T), tracking.ROBOT_COVARIANCE, atol=1e-3)


def test_critical_range_is_where_the_ratio_passes():
    P = np.diag([0.03**2, 0.03**2, np.radians(1.5) ** 2])
    sigma = np.hypot(np.radians(2), np.radians(1.5))
    for with_position in (False, True):
        r = driving.critical_range(P, np.radians(2), with_position)
        position = P[:2, :2] if with_position else None
        assert condition_ratio(r, 0.0, driving.SIGMA_RANGE, sigma, position) == pytest.approx(1.075, abs=1e-6)


def test_the_drive_is_localised_as_its_covariance_says():
    drive = driving.drive(0)
    assert drive.length == pytest.approx(24, abs=1)
    assert (np.linalg.eigvalsh(drive.covariances) > 0).all()


def test_figures_of_the_analysis(tmp_path):
    report = Report("conversion")
    options = RunOptions(out=tmp_path, quick=True)
    experiment.consistency(options, report)
    experiment.drive(options, report)
    figures = {key: figure.value for key, figure in report.every_figure().items()}
    assert figures["consistency/linear/consistent-up-to-deg"] == pytest.approx(2.5, abs=0.5)
    assert figures["consistency/ucm/largest-anes-2"] < 0.02
    assert figures["consistency/mucm/largest-anes-2"] < 0.02
    assert all(path.stat().st_size > 5000 for path in report.pictures)


def test_switching_costs_little_and_is_no_worse():
    scene = tracking.walk(1, 0, 3.0)
    runs = {
        name: tracking.track(scene, 0, **tracking.FILTERS[name]) for name in ("switching", "always Kalman")
    }
    np.testing.assert_array_equal(runs["switching"].error, runs["always Kalman"].error)
    assert set(runs["switching"].kinds) == {"KF"}
    far = tracking.track(tracking.walk(2, 0, 1.0), 0, position_in_ratio=False)
    assert far.kinds[0] == "KF to PF"
    assert set(far.kinds[1:]) == {"PF, samples"}

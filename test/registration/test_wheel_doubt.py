"""How far wheels are believed: learned, held against lines that say little, given up where lines refute them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from estimation.geometry.poses import between, compound, transform_points
from evaluation.scenes.small_robot import SHORT_RANGE
from registration.laser.prepared import NOISE
from registration.laser.scan import Scan
from registration.laser.surface import scan_surface
from registration.laser.target_lines import target_of
from registration.odometry.follower import Odometry
from registration.odometry.wheel_doubt import MEMORY, WheelDoubt, prediction_covariance
from registration.placement.refine import TUKEY, refine
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.robot import Drive, Wheels
from whereabouts.simulation.rooms import random_floor
from whereabouts.simulation.shapes import box


@pytest.mark.parametrize("share", [0.01, 0.3])
def test_share_of_the_doubt_is_that_of_the_errors(share: float) -> None:
    doubt, rng = WheelDoubt(), np.random.default_rng(3)
    motion = np.array([0.2, 0.0, 0.1])
    deviation = np.sqrt(share * np.diag(prediction_covariance(motion)))
    learned = []
    for number in range(40 * MEMORY):
        doubt.learn(motion, motion + deviation * rng.standard_normal(3))
        if number > 10 * MEMORY:
            learned.append(doubt.share.copy())
    assert np.mean(learned, axis=0) == pytest.approx(share, rel=0.25)
    np.testing.assert_allclose(doubt.covariance(motion), prediction_covariance(motion) * doubt.share)


def test_wheels_that_jump_are_not_doubted_more_than_any_prediction() -> None:
    doubt = WheelDoubt()
    for _ in range(10 * MEMORY):
        doubt.learn(np.array([3.0, 0.0, 1.0]), np.zeros(3))
    assert (doubt.share <= 1.0).all()


def test_prior_and_lines_are_weighed_as_least_squares_weighs_them() -> None:
    """Against a minimiser of the same sum that knows no derivatives: weights of lines, and squares of the prior."""
    rng = np.random.default_rng(5)
    scans = [
        Lidar(181, np.pi, sigma=0.01).scan(box(6.0, 4.0), np.array(pose), rng)
        for pose in ([0, 0, 0], [0.1, 0, 0])
    ]
    target, source = (scan_surface(seen.scan, NOISE, 80.0) for seen in scans)
    lines = target_of(target)
    free = refine(source, lines, np.zeros(3))
    expected = free.pose + np.array([0.02, -0.01, 0.004])
    prior = np.diag([3e4, 5e4, 4e5])
    held = refine(source, lines, free.pose.copy(), prior=(expected, prior))
    width = TUKEY * 0.012

    def cost(pose: np.ndarray) -> float:
        matched = held.matched >= 0
        at = transform_points(pose, source.points[matched])
        feet, normals = lines.points[held.matched[matched]], lines.normals[held.matched[matched]]
        off = ((at - feet) * normals).sum(axis=1) / width
        robust = np.where(np.abs(off) < 1.0, 1.0 - (1.0 - off**2) ** 3, 1.0).sum() * width**2 / 6.0
        away = pose - expected
        return float(robust / held.noise**2 + 0.5 * away @ prior @ away)

    best = minimize(cost, held.pose, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9}).x
    assert np.abs(held.pose - free.pose).max() > 1e-3
    np.testing.assert_allclose(held.pose, best, atol=6e-4)


def test_lines_that_say_little_do_not_lead_a_scan_away_from_good_wheels() -> None:
    """A robot of 3.5 m sight turns from a corridor into a door; bent by the turn, its scan slid by .3 m."""
    rng = np.random.default_rng(8)
    shapes, waypoints = random_floor(np.random.default_rng([7, 0]), 2)
    drive, wheels, odometry = Drive(waypoints, speed=0.22, turn_rate=0.8), Wheels(), Odometry()
    truth: list[np.ndarray] = []
    for stamp in np.arange(0.0, 25.0, 0.2):
        pose = drive(stamp)
        scan: Scan = SHORT_RANGE.scan(shapes, drive, rng, float(stamp)).scan
        odometry.register(scan, float(stamp), wheels.motion(truth[-1], pose, rng) if truth else None)
        truth.append(pose)
        error = between(between(truth[0], pose), odometry.pose)
        assert np.hypot(*error[:2]) < 0.25
    assert np.hypot(*error[:2]) < 0.1


def test_wheels_that_lie_are_given_up_where_lines_tell() -> None:
    """After many good steps, one of half a metre that was none."""
    rng = np.random.default_rng(9)
    lidar, odometry = Lidar(181, np.pi), Odometry()
    shapes, pose = box(6.0, 4.0), np.array([-1.5, 0.0, 0.3])
    for number in range(2 * MEMORY):
        step = np.array([0.02, 0.0, 0.01])
        pose = compound(pose, step)
        told = step if number < 2 * MEMORY - 1 else step + np.array([0.5, 0.0, 0.0])
        odometry.register(lidar.scan(shapes, pose, rng).scan, 0.2 * number, told)
    assert np.hypot(*odometry.increment[:2] - 0.0) < 0.06

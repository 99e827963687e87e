"""Scan odometry on simulated floors: drift, gaps, lying wheels, corridors, movers, deskewing, range offset."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from estimation.geometry.poses import between, compound, wrap_angle
from registration import Odometry, OdometryConfig, Scan
from registration.odometry.scan_odometry import ScanTracker
from whereabouts.simulation import (
    Drive,
    Lidar,
    Mover,
    Wheels,
    box,
    corridor,
    crowd,
    joined,
    outlines,
    polygon,
    random_floor,
)

LIDAR = Lidar(181)


def floor_run(
    seed: int, seconds: float = 60.0, lidar: Lidar = LIDAR
) -> tuple[list[Scan], np.ndarray, np.ndarray]:
    """Scans, true poses (N, 3) and wheel motions (N, 3) at 5 Hz."""
    rng = np.random.default_rng(seed)
    shapes, waypoints = random_floor(rng, rooms=2)
    drive, wheels = Drive(waypoints), Wheels()
    seen = [lidar.scan(shapes, drive(stamp), rng, stamp) for stamp in np.arange(0.0, seconds, 0.2)]
    truth = np.array([scan.pose for scan in seen])
    motions = [np.zeros(3)] + [wheels.motion(a, b, rng) for a, b in pairwise(truth)]
    return [scan.scan for scan in seen], truth, np.array(motions)


def final_error(odometry: Odometry, truth: np.ndarray) -> tuple[float, float]:
    error = between(between(truth[0], truth[-1]), odometry.pose)
    return float(np.hypot(*error[:2])), abs(float(error[2]))


@pytest.mark.parametrize("with_wheels", [True, False])
def test_follows_a_round_through_rooms(with_wheels: bool) -> None:
    scans, truth, motions = floor_run(1)
    odometry = Odometry()
    for scan, motion in zip(scans, motions, strict=True):
        odometry.register(scan, scan.stamp, motion if with_wheels else None)
        assert odometry.converged, odometry.reason
    away, turn = final_error(odometry, truth)
    assert away < 0.05
    assert turn < 0.01


def test_increments_compound_to_the_pose_and_their_covariance_is_right() -> None:
    scans, truth, motions = floor_run(2)
    odometry, pose, squares = Odometry(), np.zeros(3), []
    for k, (scan, motion) in enumerate(zip(scans, motions, strict=True)):
        odometry.register(scan, scan.stamp, motion)
        pose = compound(pose, odometry.increment)
        np.testing.assert_allclose(pose, odometry.pose, atol=1e-9)
        if k:
            error = odometry.increment - between(truth[k - 1], truth[k])
            error[2] = wrap_angle(error[2])
            squares.append(error @ np.linalg.solve(odometry.increment_covariance, error))
    assert 0.5 < np.mean(squares) / 3.0 < 2.0


@pytest.mark.parametrize("ahead", [0.65, -0.7, 0.8, 0.9])
def test_a_scan_that_agrees_is_believed_whatever_the_wheels_say(ahead: float) -> None:
    """The jump and the last motion lead to the same match, which is too far from the jump to be expected there."""
    scans, truth, motions = floor_run(5, seconds=30.0)
    jumps = range(60, 140, 10)
    for k in jumps:
        motions[k] = compound(motions[k], [ahead, 0.0, 0.0])
    odometry = Odometry()
    for k, (scan, motion) in enumerate(zip(scans, motions, strict=True)):
        odometry.register(scan, scan.stamp, motion)
        assert odometry.converged, odometry.reason
        assert final_error(odometry, truth[: k + 1])[0] < 0.05


@pytest.mark.parametrize("jump", [[1.0, 0.0, 0.0], [0.0, 0.0, np.deg2rad(60.0)]])
def test_recovers_from_wheels_that_jump(jump: list[float]) -> None:
    scans, truth, motions = floor_run(3, seconds=30.0)
    motions[80] = compound(motions[80], jump)
    odometry = Odometry()
    for scan, motion in zip(scans, motions, strict=True):
        odometry.register(scan, scan.stamp, motion)
    away, turn = final_error(odometry, truth)
    assert away < 0.1
    assert turn < 0.02
    assert odometry.converged


def test_stale_wheels_that_catch_up_do_no_harm() -> None:
    scans, truth, motions = floor_run(4, seconds=30.0)
    pending = np.zeros(3)
    for k in range(60, 66):
        pending, motions[k] = compound(pending, motions[k]), np.zeros(3)
    motions[66] = compound(pending, motions[66])
    odometry = Odometry()
    for k, (scan, motion) in enumerate(zip(scans, motions, strict=True)):
        odometry.register(scan, scan.stamp, motion)
        assert final_error(odometry, truth[: k + 1])[0] < 0.1, "no scan is pulled along"


@pytest.mark.parametrize("seed", [11, 14, 15])
def test_motion_is_known_where_the_map_is_lost(seed: int) -> None:
    """Carried to another floor: one step is a guess, those after it are not."""
    before, after = floor_run(seed, seconds=6.0), floor_run(seed + 50, seconds=4.0)
    odometry, steps = Odometry(), []
    for scan in before[0]:
        odometry.register(scan, scan.stamp)
    for k, scan in enumerate(after[0]):
        odometry.register(scan, before[0][-1].stamp + 0.2 * (k + 1))
        steps.append(odometry.increment)
    truth = after[1]
    for k in range(1, len(truth)):
        error = between(between(truth[k - 1], truth[k]), steps[k])
        assert np.hypot(*error[:2]) < 0.05, k
        assert abs(error[2]) < 0.03, k


def test_survives_blind_scans() -> None:
    scans, truth, motions = floor_run(5, seconds=30.0)
    blind = Scan(np.full(181, np.inf), scans[0].angle_min, scans[0].angle_increment, 0.05, 30.0)
    odometry, deviations = Odometry(), []
    for k, (scan, motion) in enumerate(zip(scans, motions, strict=True)):
        odometry.register(blind if 50 <= k < 54 else scan, scan.stamp, motion)
        assert odometry.unsure == (50 <= k < 54)
        deviations.append(np.sqrt(np.diag(odometry.covariance)))
    assert final_error(odometry, truth)[0] < 0.1
    assert (deviations[53] > 5.0 * deviations[49]).all(), "nothing tells of these motions"
    assert (deviations[-1] < 0.05).all(), "the map was found again"


@pytest.mark.parametrize("seed", [32, 34, 40])
def test_after_a_gap_the_motion_in_it_is_not_expected_again(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes, waypoints = random_floor(rng, rooms=3)
    drive, odometry, stamps = Drive(waypoints), Odometry(), np.arange(0.0, 15.0, 0.1)
    for stamp in stamps[(stamps < 7.95) | (stamps > 12.95)]:
        odometry.register(LIDAR.scan(shapes, drive(stamp), rng, stamp).scan, stamp)
    away, turn = final_error(odometry, np.array([drive(0.0), drive(stamps[-1])]))
    assert away < 0.1
    assert turn < 0.02


def test_a_corridor_is_filled_from_the_wheels_and_open_without() -> None:
    rng = np.random.default_rng(6)
    lidar = Lidar(181, range_max=8.0)
    guided = Odometry()
    for k in range(40):
        scan = lidar.scan(corridor(), (0.1 * k - 2.0, 0.2, 0.0), rng, 0.2 * k).scan
        guided.register(scan, scan.stamp, [0.1, 0.0, 0.0] if k else None)
    assert abs(guided.pose[0] - 3.9) < 0.1
    assert abs(guided.pose[1]) < 0.02
    sigma = np.sqrt(np.diag(guided.increment_covariance))
    assert sigma[0] > 5.0 * sigma[1]
    assert "open" in guided.reason


@pytest.mark.parametrize("rate", [5.0, 20.0])
def test_without_wheels_the_way_along_a_bare_corridor_is_said_to_be_unknown(rate: float) -> None:
    rng = np.random.default_rng(16)
    lidar = Lidar(360, 2.0 * np.pi * 359 / 360, 0.12, 3.5)
    hall = joined([corridor(), box(0.5, 0.4, (-9.0, 1.0, 0.0)), box(0.4, 0.4, (-8.0, -1.0, 0.0))])
    odometry, deviations = Odometry(), []
    for k in range(int(60 * rate)):
        x = -11.0 + 0.22 * k / rate
        scan = lidar.scan(hall, (x, 0.2, 0.0), rng, k / rate).scan
        odometry.register(scan, scan.stamp)
        deviations.append(np.sqrt(np.diag(odometry.covariance)[:2]))
        assert abs(odometry.pose[0] - (x + 11.0)) < 3.0 * deviations[-1][0] + 0.1, k
    assert abs(odometry.pose[0] - (x + 11.0)) > 3.0, "it was lost along the corridor"
    assert deviations[-1][0] < 20.0
    assert deviations[-1][1] < 0.1, "across nothing was lost"
    assert np.sqrt(odometry.increment_covariance[0, 0]) < 0.2, "a step is no longer than a sensor moves"


@pytest.mark.parametrize("seed", [0, 1])
def test_the_end_of_a_corridor_tells_the_way_as_soon_as_it_is_in_sight(seed: int) -> None:
    """Out of a room into a bare corridor of 4 m; the far wall of the room beyond is the only thing that tells."""
    near = [(0.0, 0.7), (0.0, 3.0), (-8.0, 3.0), (-8.0, -3.0), (0.0, -3.0), (0.0, -0.7)]
    beyond = [
        (0.0, 0.7),
        (4.0, 0.7),
        (4.0, 3.5),
        (11.9, 3.5),
        (11.9, -4.0),
        (4.0, -4.0),
        (4.0, -0.7),
        (0.0, -0.7),
    ]
    things = [box(0.8, 0.5, (-3.0, 2.0, 0.3)), box(0.6, 0.6, (-4.0, -2.0, 0.7))]
    world = joined([polygon(near, closed=False), polygon(beyond, closed=False), *things])
    lidar, rng, odometry = Lidar(361, range_max=12.0, sigma=0.015), np.random.default_rng(seed), Odometry()
    truth = []
    for k in range(90):
        pose = np.array([-2.5 + 0.06 * k, 0.02 * np.sin(0.1 * k), 0.02 * np.cos(0.1 * k)])
        truth.append(pose)
        odometry.register(lidar.scan(world, pose, rng, 0.1 * k).scan, 0.1 * k)
    assert final_error(odometry, np.array(truth))[0] < 0.1


def test_a_sensor_without_wheels_that_stops_where_nothing_tells_is_not_driven_on() -> None:
    rng = np.random.default_rng(12)
    lidar, odometry, x = Lidar(181, range_max=8.0), Odometry(), -11.0
    hall = joined([corridor(), box(0.5, 0.4, (-9.0, 1.0, 0.0)), box(0.4, 0.4, (-8.0, -1.0, 0.0))])
    for k in range(75):
        scan = lidar.scan(hall, (x, 0.2, 0.0), rng, 0.2 * k).scan
        odometry.register(scan, scan.stamp)
        if k < 25:
            x += 0.12
    passed = odometry.pose[0]
    assert "open" in odometry.reason
    for k in range(75, 150):
        scan = lidar.scan(hall, (x, 0.2, 0.0), rng, 0.2 * k).scan
        odometry.register(scan, scan.stamp)
    assert abs(odometry.pose[0] - passed) < 2.0


def test_a_scanner_that_is_covered_while_it_turns_is_not_turned_on() -> None:
    rng, room = np.random.default_rng(13), joined([box(9.0, 7.0), box(1.0, 0.5, (2.0, 1.0, 0.3))])
    odometry = Odometry()
    for k in range(70):
        seen = LIDAR.scan(room, (0.0, 0.0, 0.1 * min(k, 20)), rng, 0.2 * k).scan
        covered = replace(seen, ranges=np.full_like(seen.ranges, np.nan)) if 20 < k < 60 else seen
        odometry.register(covered, seen.stamp)
        assert odometry.unsure or not 20 < k < 60
    assert abs(odometry.pose[2] - 2.0) < 0.25


def test_people_around_are_neither_followed_nor_static() -> None:
    rng = np.random.default_rng(7)
    lidar, room = Lidar(361, 2.0 * np.pi * 360 / 361), box(9.0, 7.0)
    movers = crowd(rng, np.zeros(2), 4, (1.5, 2.5))
    odometry, moving, kept = Odometry(), 0, 0
    for k in range(25):
        seen = lidar.scan(joined([room, outlines(movers, 0.2 * k)]), (0.02 * k, 0.0, 0.01 * k), rng, 0.2 * k)
        odometry.register(seen.scan, seen.scan.stamp)
        if k > 5:
            points = seen.scan.points()[seen.owners[seen.scan.valid] > 0]
            static = {tuple(point) for point in np.round(odometry.static_points, 2)}
            moving += len(points)
            kept += sum(tuple(point) in static for point in np.round(points, 2))
    np.testing.assert_allclose(odometry.pose, [0.48, 0.0, 0.24], atol=0.03)
    assert kept < 0.5 * max(moving, 1)


@pytest.mark.parametrize("kind", ["person", "cylinder"])
def test_one_body_in_a_corridor_does_not_pull_the_robot_along_against_its_wheels(kind: str) -> None:
    rng, lidar = np.random.default_rng(7), Lidar(361, np.pi, range_max=12.0)
    walker = Mover(kind, np.array([5.0, 0.3, 0.0]), np.array([-0.8, 0.0]), size=0.4)
    odometry, errors = Odometry(), []
    for k in range(60):
        # It stands for two seconds, and then comes nearer.
        there = outlines([walker], max(0.1 * k - 2.0, 0.0))
        scan = lidar.scan(joined([corridor(), there]), (0.01 * k, 0.0, 0.0), rng, 0.1 * k).scan
        odometry.register(scan, 0.1 * k, np.array([0.01, 0.0, 0.0]) + rng.normal(0.0, [0.002, 0.002, 0.001]))
        if k:
            error = odometry.increment - [0.01, 0.0, 0.0]
            errors.append(error @ np.linalg.solve(odometry.increment_covariance, error) / 3.0)
    assert abs(odometry.pose[0] - 0.59) < 0.08
    assert np.mean(errors) < 2.0


def turning(time: float) -> np.ndarray:
    """A sensor that stands for 0.4 s, then drives and turns."""
    moved = max(time - 0.4, 0.0)
    return np.array([0.5 * moved - 1.0, 0.0, 0.6 * moved])


def test_motion_during_the_sweep_is_undone() -> None:
    rng = np.random.default_rng(8)
    lidar, room = Lidar(361, 1.5 * np.pi, sweep_time=0.1), box(8.0, 6.0)
    odometry, stamps = Odometry(), 0.15 * np.arange(30)
    for k, stamp in enumerate(stamps):
        scan = lidar.scan(room, turning, rng, stamp).scan
        odometry.register(scan, stamp, between(turning(stamps[k - 1]), turning(stamp)) if k else None)
    np.testing.assert_allclose(odometry.pose, between(turning(0.0), turning(stamps[-1])), atol=0.02)


def test_who_turns_in_the_sweep_is_known_by_the_wheels() -> None:
    """A slow scanner on a robot that starts and stops turning: the motion before says nothing of that in the sweep."""
    rng = np.random.default_rng(8)
    lidar, room, stamps = Lidar(361, 1.5 * np.pi, sweep_time=0.19), box(8.0, 6.0), 0.2 * np.arange(25)

    def starting(time: float) -> np.ndarray:
        return np.array(
            [0.1 * time - 1.0, 0.0, 1.5 * np.clip(time % 1.0 - 0.5, 0.0, 0.5) + 0.75 * (time // 1.0)]
        )

    away: dict[bool, list[np.ndarray]] = {False: [], True: []}
    for known, errors in away.items():
        odometry = Odometry()
        for k, stamp in enumerate(stamps):
            scan = lidar.scan(room, starting, rng, stamp).scan
            guess = between(starting(stamps[k - 1]), starting(stamp)) if k else None
            within = between(starting(stamp), starting(stamp + 0.19)) if known else None
            odometry.register(scan, stamp, guess, sweep=within)
            errors.append(between(between(starting(0.0), starting(stamp)), odometry.pose))
    worst = {known: np.abs(np.array(errors)).max(axis=0) for known, errors in away.items()}
    # It starts and stops within sweeps, too, so that some is left.
    assert (worst[True] < 0.35 * worst[False]).all()
    assert worst[True][2] < 0.03


@pytest.mark.parametrize("leap", [1.0, 1000.0])
def test_wheels_that_leap_do_not_bend_a_sweep_beyond_recognition(leap: float) -> None:
    lidar = Lidar(360, 2.0 * np.pi * 359 / 360, range_max=8.0, sigma=0.02, sweep_time=0.19)
    scans, truth, motions = floor_run(6, 10.0, lidar)
    motions[30][0] += leap
    odometry = Odometry()
    for k, (scan, motion) in enumerate(zip(scans, motions, strict=True)):
        odometry.register(scan, scan.stamp, motion)
        assert odometry.converged, odometry.reason
        assert final_error(odometry, truth[: k + 1])[0] < 0.1


@pytest.mark.parametrize("increment", [0.15, -0.15])
def test_a_period_given_as_the_time_of_a_beam_is_not_believed(increment: float) -> None:
    """A driver's mistake that would put each beam a minute after the one before."""
    rng, room, stamps = np.random.default_rng(8), box(8.0, 6.0), 0.15 * np.arange(30)
    odometry = Odometry()
    for stamp in stamps:
        scan = Lidar(361, 1.5 * np.pi).scan(room, turning(stamp), rng, stamp).scan
        odometry.register(replace(scan, time_increment=increment), stamp)
    np.testing.assert_allclose(odometry.pose, between(turning(0.0), turning(stamps[-1])), atol=0.02)


def test_a_range_offset_is_learned() -> None:
    rng = np.random.default_rng(9)
    shapes, waypoints = random_floor(rng, rooms=2)
    drive, tracker, last = Drive(waypoints), ScanTracker(), None
    for stamp in np.arange(0.0, 80.0, 0.2):
        seen = LIDAR.scan(shapes, drive(stamp), rng, stamp)
        scan = seen.scan
        ranges = np.where(scan.valid, scan.ranges + 0.03, scan.ranges)
        biased = Scan(ranges, scan.angle_min, scan.angle_increment, 0.05, 30.0, stamp)
        tracker.step(biased, stamp, np.zeros(3) if last is None else between(last, seen.pose))
        last = seen.pose
    assert 0.01 < tracker.offset.value < 0.05


def test_same_scans_same_poses() -> None:
    scans, _, motions = floor_run(10, seconds=10.0)
    outcomes = []
    for _ in range(2):
        odometry = Odometry()
        outcomes.append([odometry.register(s, s.stamp, m) for s, m in zip(scans, motions, strict=True)])
    np.testing.assert_array_equal(outcomes[0], outcomes[1])


def test_kiss_icp_stays_selectable_for_scans() -> None:
    scans, _, motions = floor_run(11, seconds=4.0)
    odometry = Odometry(OdometryConfig(scan_method="kiss_icp"))
    for k, (scan, motion) in enumerate(zip(scans, motions, strict=True)):
        seen = scan.without(np.full(len(scan), k in (8, 9)))
        pose = odometry.register(seen, scan.stamp, motion)
    assert pose.shape == (3,)
    assert odometry.covariance.shape == (3, 3)
    assert np.sqrt(odometry.covariance[0, 0]) < 0.5, "the map was found again after two blind scans"


@pytest.mark.parametrize("seed", [1, 2])
def test_good_wheels_hold_a_narrow_and_noisy_view(seed: int) -> None:
    """As of a depth camera: a wall slides along itself, and what comes into view is taken for something else."""
    rng = np.random.default_rng([8, seed])
    shapes, waypoints = random_floor(rng, 2)
    drive = Drive(waypoints, speed=0.5, turn_rate=0.8)
    lidar = Lidar(640, np.deg2rad(57.0), range_min=0.45, range_max=5.0, sigma=0.02)
    odometry, before, away = Odometry(), drive(0.0), []
    for time in np.arange(0.0, 40.0, 0.2):
        pose = drive(time)
        scan = lidar.scan(shapes, pose, rng, time).scan
        motion = between(before, pose) + rng.normal(0.0, 0.002, 3)
        odometry.register(scan, time, motion if time > 0.0 else None)
        before = pose
        away.append(np.hypot(*between(compound(drive(0.0), odometry.pose), pose)[:2]))
    assert max(away) < 0.3

"""Pairwise registration against simulation truth, its own inverse, and input it has to refuse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.errors import InputError
from estimation.geometry.poses import compound, inverse, transform_points, wrap_angle
from evaluation.scenes.scan_pairs import CROWDED, EASY, HARD, Difficulty, random_pair
from registration import Registration, Scan, align
from registration.laser.prepared import prepare
from whereabouts.simulation import Lidar, box, corridor, joined

ROUND = Lidar(361, 2.0 * np.pi * 360 / 361)


def error(registration: Registration, motion: np.ndarray) -> tuple[float, float]:
    """Metres and radians off."""
    turn = wrap_angle(registration.transform[2] - motion[2])
    return float(np.hypot(*(registration.transform[:2] - motion[:2]))), abs(float(turn))


@pytest.mark.parametrize("difficulty", [EASY, HARD, CROWDED])
def test_finds_the_true_motion(difficulty: Difficulty) -> None:
    rng = np.random.default_rng(11)
    for _ in range(40):
        pair = random_pair(rng, ROUND, difficulty)
        found = align(pair.source.scan, pair.target.scan)
        away, turn = error(found, pair.motion)
        assert away < 0.05
        assert turn < np.deg2rad(1.0)
        assert found.converged


def test_covariance_is_right_in_rooms() -> None:
    """Normalised errors squared average to the three dimensions, within what 150 draws allow."""
    rng = np.random.default_rng(12)
    squares = []
    for _ in range(150):
        pair = random_pair(rng, ROUND, EASY)
        found = align(pair.source.scan, pair.target.scan)
        error = found.transform - pair.motion
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 2.2 < np.mean(squares) < 4.2


def test_a_corridor_is_open_along_and_known_across() -> None:
    rng = np.random.default_rng(13)
    for _ in range(10):
        start = np.array([0.0, rng.uniform(-0.5, 0.5), 0.0])
        motion = np.array([0.3, rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1)])
        target = ROUND.scan(corridor(), start, rng).scan
        source = ROUND.scan(corridor(), start + motion, rng).scan
        found = align(source, target)
        sigma = np.sqrt(np.diag(found.covariance))
        assert sigma[0] > 0.3
        assert sigma[1] < 0.01
        assert abs(found.transform[1] - motion[1]) < 0.02
        assert abs(found.transform[0]) < 0.02  # kept from the guess, not invented
        assert "open" in found.reason


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_swapping_the_scans_inverts_the_motion(seed: int) -> None:
    pair = random_pair(np.random.default_rng(seed), ROUND, EASY)
    there = align(pair.source.scan, pair.target.scan)
    back = align(pair.target.scan, pair.source.scan)
    np.testing.assert_allclose(compound(there.transform, back.transform), np.zeros(3), atol=0.02)
    np.testing.assert_allclose(inverse(there.transform), back.transform, atol=0.02)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.6, 0.6))
def test_a_scan_moved_by_hand_is_found_again(seed: int, x: float, y: float, yaw: float) -> None:
    points = random_pair(np.random.default_rng(seed), ROUND, EASY).target.scan.points()
    found = align(transform_points(inverse([x, y, yaw]), points), points)
    assert found.converged
    np.testing.assert_allclose(found.transform[:2], [x, y], atol=0.01)
    assert abs(wrap_angle(found.transform[2] - yaw)) < 0.01


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.floats(-3.0, 3.0))
def test_turning_the_target_frame_turns_the_answer(seed: int, yaw: float) -> None:
    pair = random_pair(np.random.default_rng(seed), ROUND, EASY)
    source, target = pair.source.scan.points(), pair.target.scan.points()
    turned = align(source, transform_points([0.0, 0.0, yaw], target), guess=[0.0, 0.0, yaw])
    plain = align(source, target)
    expected = compound([0.0, 0.0, yaw], plain.transform)
    np.testing.assert_allclose(turned.transform[:2], expected[:2], atol=0.01)
    assert abs(wrap_angle(turned.transform[2] - expected[2])) < 0.01


def test_a_scan_on_itself_has_not_moved() -> None:
    scan = random_pair(np.random.default_rng(14), ROUND, EASY).target.scan
    found = align(scan, scan)
    assert found.converged
    np.testing.assert_allclose(found.transform, np.zeros(3), atol=3e-3)


def test_same_input_same_output() -> None:
    pair = random_pair(np.random.default_rng(15), ROUND, CROWDED)
    one, two = (align(pair.source.scan, pair.target.scan) for _ in range(2))
    np.testing.assert_array_equal(one.transform, two.transform)
    np.testing.assert_array_equal(one.covariance, two.covariance)


@pytest.mark.parametrize("method", ["icp", "point_to_line", "ndt"])
def test_the_other_methods_work_from_a_close_guess(method: str) -> None:
    rng = np.random.default_rng(16)
    for _ in range(5):
        pair = random_pair(rng, ROUND, EASY)
        guess = pair.motion + np.array([0.03, -0.03, 0.02])
        away, turn = error(align(pair.source.scan, pair.target.scan, guess, method), pair.motion)
        assert away < 0.05
        assert turn < np.deg2rad(1.0)


def scan_of(ranges: np.ndarray) -> Scan:
    return Scan(ranges, -0.5 * np.pi, np.pi / 360, 0.05, 30.0)


ROOM = random_pair(np.random.default_rng(17), Lidar(), EASY).target.scan


@pytest.mark.parametrize(
    "source",
    [
        scan_of(np.full(361, 30.0)),
        scan_of(np.full(361, np.nan)),
        scan_of(np.zeros(361)),
        ROOM.points()[:5],
        np.repeat(ROOM.points()[:3], 60, axis=0),
        np.zeros((0, 2)),
        np.full((100, 2), np.nan),
    ],
    ids=["maximum", "nan", "zero", "five points", "duplicates", "empty", "nan points"],
)
@pytest.mark.parametrize("method", ["robust", "icp", "point_to_line", "ndt"])
def test_poor_data_are_refused_and_said(source: Scan | np.ndarray, method: str) -> None:
    for found in (align(source, ROOM, method=method), align(ROOM, source, method=method)):
        assert not found.converged
        assert "points" in found.reason
        assert np.isfinite(found.transform).all()
        assert np.sqrt(np.diag(found.covariance)).min() > 0.1


def test_different_rooms_are_not_confidently_registered() -> None:
    rng = np.random.default_rng(18)
    for _ in range(60):
        one, other = (random_pair(rng, ROUND, EASY).target.scan for _ in range(2))
        found = align(one, other)
        assert not found.converged
        assert found.reason


@pytest.mark.parametrize("swapped", [False, True])
def test_a_mover_alone_does_not_fix_a_direction(swapped: bool) -> None:
    """What walks along a bare corridor is all that speaks for a motion along it."""
    rng = np.random.default_rng(19)
    scans = [
        ROUND.scan(joined([corridor(), box(0.6, 0.4, (x, 0.6, 0.3))]), (0.0, 0.0, yaw), rng).scan
        for x, yaw in ((1.5, 0.0), (1.6, 0.02))
    ]
    source, target = scans[::-1] if swapped else scans
    found = align(source, target)
    assert np.sqrt(found.covariance[0, 0]) > 0.3
    assert np.sqrt(found.covariance[1, 1]) < 0.05


def test_length_of_outline_is_not_made_of_noise() -> None:
    """Close to a scanner beams are denser than their noise; the outline is as long as it is nevertheless."""
    scan = Lidar(1081, np.deg2rad(270.0)).scan(box(1.6, 1.6), (0.0, 0.0, 0.0), np.random.default_rng(20)).scan
    assert prepare("scan", scan).length == pytest.approx(0.75 * 4 * 1.6, rel=0.05)


def test_duplicated_points_change_nothing_but_weights() -> None:
    points = ROOM.points()
    moved = transform_points(inverse([0.1, 0.05, 0.03]), points)
    found = align(np.repeat(moved, 3, axis=0), points)
    np.testing.assert_allclose(found.transform, [0.1, 0.05, 0.03], atol=0.01)


@pytest.mark.parametrize("method", ["robust", "icp", "point_to_line"])
def test_the_order_of_points_says_nothing(method: str) -> None:
    rng, pair = np.random.default_rng(21), random_pair(np.random.default_rng(22), ROUND, EASY)
    source, target = pair.source.scan.points(), pair.target.scan.points()
    one = align(source, target, pair.motion, method)
    other = align(rng.permutation(source), rng.permutation(target), pair.motion, method)
    np.testing.assert_allclose(other.transform, one.transform, atol=2e-3)
    deviations = [np.sqrt(np.diag(found.covariance)) for found in (one, other)]
    np.testing.assert_allclose(deviations[1], deviations[0], rtol=0.25)


def test_of_points_that_lie_within_their_noise_few_are_used() -> None:
    rng = np.random.default_rng(23)
    wall = np.column_stack((rng.uniform(-5.0, 5.0, 200_000), rng.normal(2.0, 0.01, 200_000)))
    surface = prepare("wall", wall).surface
    assert len(surface) < 4000
    assert np.median(np.abs(surface.normals[surface.lined, 1])) > 0.95


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((ROOM, ROOM, None, "magic"), "method"),
        ((ROOM, np.zeros((30, 3))), "target"),
        ((ROOM, np.zeros((30, 4))), "target"),
        ((ROOM, ROOM, [0.0, np.nan, 0.0]), "guess"),
        ((ROOM, ROOM, np.eye(4)), "guess"),
        ((np.zeros((30, 3)), np.zeros((30, 3)), None, "icp"), "method"),
    ],
)
def test_wrong_input_names_the_argument(arguments: tuple, named: str) -> None:
    with pytest.raises(InputError, match=named):
        align(*arguments)

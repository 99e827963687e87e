"""Metrics against brute force, closed forms and evo."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from estimation import metrics
from estimation.errors import InputError
from estimation.geometry.poses import compound, pose_to_matrix, pose_to_quaternion


def walk(rng, count, size):
    """A trajectory and a noisy copy of it."""
    scale = np.array([0.3, 0.1, 0.2] if size == 3 else [0.3, 0.1, 0.05, 0.03, 0.03, 0.2])
    truth, noisy = [np.zeros(size)], [np.full(size, 0.3)]
    for _ in range(count - 1):
        step = rng.normal(scale, scale)
        truth.append(compound(truth[-1], step))
        noisy.append(compound(noisy[-1], step + rng.normal(0, 0.02, size)))
    return np.array(truth), np.array(noisy)


def test_rmse():
    assert metrics.rmse([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))
    assert metrics.rmse([[3.0, 4.0], [0.0, 0.0]]) == pytest.approx(np.sqrt(12.5))


def test_nees_is_the_quadratic_form():
    rng = np.random.default_rng(0)
    errors = rng.normal(size=(4, 5, 3))
    A = rng.normal(size=(5, 3, 3))
    P = A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(3)
    expected = np.einsum("tni,nij,tnj->tn", errors, np.linalg.inv(P), errors)
    np.testing.assert_allclose(metrics.nees(errors, P), expected)
    assert isinstance(metrics.nees(errors[0, 0], P[0]), float)


def test_anees_bounds_hold_their_share():
    rng = np.random.default_rng(1)
    P = np.array([[2.0, 0.5], [0.5, 1.0]])
    errors = rng.multivariate_normal([0, 0], P, (4000, 25))
    means = metrics.nees(errors, P).mean(1)
    low, high = metrics.anees_bounds(25, 2, 0.9)
    assert ((low < means) & (means < high)).mean() == pytest.approx(0.9, abs=0.02)
    assert low < 2 < high


@pytest.mark.parametrize("size", [2, 3])
def test_alignment_is_the_best_rigid_one(size):
    rng = np.random.default_rng(2)
    source = rng.normal(size=(30, size)) * [3, 2, 1][:size]
    R = Rotation.from_euler("zyx", [2.5, 0, 0] if size == 2 else [2.5, 0.4, -1]).as_matrix()[:size, :size]
    target = source @ R.T + rng.normal(size=size) + rng.normal(0, 0.1, source.shape)
    T = metrics.align_points(source, target)
    assert np.linalg.det(T[:size, :size]) == pytest.approx(1.0)

    def cost(x):
        euler = [x[-1], 0, 0] if size == 2 else x[3:]
        turn = Rotation.from_euler("zyx", euler).as_matrix()[:size, :size]
        return ((source @ turn.T + x[:size] - target) ** 2).sum()

    ours = ((source @ T[:size, :size].T + T[:size, size] - target) ** 2).sum()
    starts = rng.normal(size=(6, 3 if size == 2 else 6))
    assert ours == pytest.approx(min(minimize(cost, x, tol=1e-10).fun for x in starts), rel=1e-5)


def test_alignment_never_reflects():
    square = np.array([[0.0, 0], [2, 0], [2, 1], [0, 1]])
    T = metrics.align_points(square, square * [1, -1])
    assert np.linalg.det(T[:2, :2]) == pytest.approx(1.0)


@pytest.mark.parametrize("size", [3, 6])
def test_ate_and_rpe_agree_with_evo(size):
    trajectory = pytest.importorskip("evo.core.trajectory")
    evo = pytest.importorskip("evo.core.metrics")
    truth, noisy = walk(np.random.default_rng(3), 80, size)
    paths = []
    for poses in (truth, noisy):
        position, q = pose_to_quaternion(poses)
        paths.append(trajectory.PosePath3D(positions_xyz=position, orientations_quat_wxyz=np.roll(q, 1, -1)))
    dimension = size // 3 + 1
    for align in (False, True):
        if align:
            paths[1].align(paths[0])
        ape = evo.APE(evo.PoseRelation.translation_part)
        ape.process_data(tuple(paths))
        ours = metrics.absolute_trajectory_error(noisy[:, :dimension], truth[:, :dimension], align)
        assert ours.rmse == pytest.approx(ape.get_statistic(evo.StatisticsType.rmse), rel=1e-6)
        assert ours.max == pytest.approx(ape.get_statistic(evo.StatisticsType.max), rel=1e-6)
    for relation, name in (("translation_part", "translation"), ("rotation_angle_rad", "rotation")):
        for delta, pairs in ((1, True), (7, True), (5, False)):
            rpe = evo.RPE(evo.PoseRelation[relation], delta, evo.Unit.frames, all_pairs=pairs)
            rpe.process_data(tuple(paths))
            ours = metrics.relative_pose_error(noisy, truth, delta, all_pairs=pairs)
            np.testing.assert_allclose(getattr(ours, name), rpe.error, atol=1e-7)


@pytest.mark.parametrize("size", [3, 6])
def test_rpe_is_that_of_the_definition(size):
    truth, noisy = walk(np.random.default_rng(4), 40, size)
    T, N = pose_to_matrix(truth), pose_to_matrix(noisy)
    path = [0.0]
    for a, b in itertools.pairwise(T):
        path.append(path[-1] + np.linalg.norm(b[:-1, -1] - a[:-1, -1]))
    ours = metrics.relative_pose_error(N, T, 1.5, "metres")
    expected = []
    for i in range(40):
        far = [j for j in range(i, 40) if path[j] - path[i] >= 1.5]
        if far:
            E = np.linalg.inv(np.linalg.inv(T[i]) @ T[far[0]]) @ np.linalg.inv(N[i]) @ N[far[0]]
            full = np.eye(3)
            full[: size // 3 + 1, : size // 3 + 1] = E[:-1, :-1]
            expected.append((np.linalg.norm(E[:-1, -1]), Rotation.from_matrix(full).magnitude(), i, far[0]))
    expected = np.array(expected)
    np.testing.assert_allclose(ours.translation, expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(ours.rotation, expected[:, 1], atol=1e-9)
    np.testing.assert_array_equal(ours.pairs, expected[:, 2:])
    chained = metrics.relative_pose_error(noisy, truth, 1.5, "metres", all_pairs=False).pairs
    np.testing.assert_array_equal(chained[1:, 0], chained[:-1, 1])


def test_rpe_of_evenly_spaced_poses_is_not_thrown_by_rounding():
    poses = np.zeros((101, 3))
    poses[:, 0] = np.arange(101) * 0.1
    pairs = metrics.relative_pose_error(poses, poses, 1.0, "metres").pairs
    assert (pairs[:, 1] - pairs[:, 0] == 10).all()


def test_relations_of_the_truth_are_zero_and_offsets_are_found():
    rng = np.random.default_rng(5)
    truth, _ = walk(rng, 60, 3)
    stamps = 100 + np.arange(60) * 0.1
    track = np.column_stack([stamps, truth])
    pairs = rng.integers(0, 60, (20, 2))
    offset = np.array([0.3, -0.4, 0.2])
    T = pose_to_matrix(truth)
    rows, shifted = [], []
    for i, j in pairs:
        E = np.linalg.inv(T[i]) @ T[j]
        pose = [E[0, 2], E[1, 2], np.arctan2(E[1, 0], E[0, 0])]
        rows.append([stamps[i] + 0.02, stamps[j] - 0.02, *pose])
        # δ such that δ⁻¹ · motion = offset.
        D = E @ np.linalg.inv(pose_to_matrix(offset))
        shifted.append([stamps[i], stamps[j], D[0, 2], D[1, 2], 0, 0, 0, np.arctan2(D[1, 0], D[0, 0])])
    exact = metrics.relations_error(track, rows)
    assert exact.used == 20
    assert exact.translation_mean == pytest.approx(0, abs=1e-9)
    assert exact.rotation_mean == pytest.approx(0, abs=1e-9)
    shifted = np.array(shifted)
    shifted[:, [5, 6]] = 0.7  # roll and pitch of a planar trajectory's relations are not used
    wrong = metrics.relations_error(track, shifted[:, [0, 1, 2, 3, 4, 5, 6, 7]])
    assert wrong.translation_mean == pytest.approx(0.5)
    assert wrong.rotation_mean == pytest.approx(0.2)
    assert wrong.translation_std == pytest.approx(0, abs=1e-9)
    rows[0][0] = 50.0
    some = metrics.relations_error(track, rows)
    assert (some.used, some.skipped) == (19, 1)


def test_association_is_nearest_within_tolerance():
    stamps = np.sort(np.random.default_rng(6).uniform(0, 10, 40))
    queries = np.random.default_rng(7).uniform(-1, 11, 200)
    gap = np.abs(stamps[None] - queries[:, None])
    expected = np.where(gap.min(1) <= 0.1, gap.argmin(1), -1)
    np.testing.assert_array_equal(metrics.associate(stamps, queries, 0.1), expected)
    assert metrics.associate([5.0], [5.01, 7.0], 0.1).tolist() == [0, -1]


POINTS = st.integers(0, 4).flatmap(lambda n: arrays(float, (n, 2), elements=st.floats(-3, 3)))


@given(POINTS, POINTS, st.floats(0.3, 4), st.sampled_from([1.0, 2.0]), st.sampled_from([0.5, 1.0, 2.0]))
@settings(max_examples=150)
def test_ospa_and_gospa_are_the_minimum_over_permutations(X, Y, c, p, alpha):
    small, large = sorted((X, Y), key=len)
    sums = [
        sum(min(c, np.linalg.norm(x - large[j])) ** p for x, j in zip(small, order, strict=True))
        for order in itertools.permutations(range(len(large)), len(small))
    ]
    surplus = len(large) - len(small)
    if len(large):
        expected = ((min(sums) + c**p * surplus) / len(large)) ** (1 / p)
        assert metrics.ospa(X, Y, c, p) == pytest.approx(expected)
    else:
        assert metrics.ospa(X, Y, c, p) == 0
    expected = (min(sums) + c**p / alpha * surplus) ** (1 / p)
    assert metrics.gospa(X, Y, c, p, alpha) == pytest.approx(expected)
    parts = metrics.gospa_parts(X, Y, c, p)
    assert parts.value == pytest.approx(metrics.gospa(X, Y, c, p))
    assert len(parts.pairs) + round(parts.missed / c**p * 2) == len(Y)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: metrics.rmse([]), "error"),
        (lambda: metrics.nees([1.0, 2.0], [[1.0, 2.0], [2.0, 1.0]]), "cov"),
        (lambda: metrics.nees([1.0, 2.0], np.eye(3)), "cov"),
        (lambda: metrics.nees([np.nan, 2.0], np.eye(2)), "error"),
        (lambda: metrics.anees_bounds(0, 2), "count"),
        (lambda: metrics.ospa([[0.0, 0.0]], [[0.0]], 1, 1), "X and Y"),
        (lambda: metrics.ospa([], [], 0, 1), "c"),
        (lambda: metrics.ospa([], [], 1, 0.5), "p"),
        (lambda: metrics.gospa([], [], 1, 1, 3), "alpha"),
        (lambda: metrics.relative_pose_error(np.zeros((5, 3)), np.zeros((5, 3)), 9), "delta"),
        (lambda: metrics.relative_pose_error(np.zeros((5, 3)), np.zeros((4, 3))), "estimate and reference"),
        (lambda: metrics.relative_pose_error(np.zeros((5, 3)), np.zeros((5, 3)), 1, "km"), "unit"),
        (lambda: metrics.relations_error(np.zeros((5, 4)), [[9, 9, 0, 0, 0]]), "relations"),
        (lambda: metrics.associate([2.0, 1.0], [1.0], 1), "stamps"),
        (lambda: metrics.absolute_trajectory_error(np.zeros((3, 2)), np.zeros((4, 2))), "estimate and"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(InputError, match=rf"^{name} "):
        call()

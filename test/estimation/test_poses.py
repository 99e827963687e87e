"""Compounding, Jacobians and conversions against matrices, numerical derivatives and scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from estimation.errors import InputError
from estimation.geometry import poses

ANGLE = st.floats(-10.0, 10.0)


def random_poses(rng, count, size, pitch_limit=1.3):
    if size == 3:
        return rng.uniform([-9, -9, -4], [9, 9, 4], (count, 3))
    limits = np.array([9, 9, 9, 3.1, pitch_limit, 3.1])
    return rng.uniform(-limits, limits, (count, 6))


def as_matrix(pose):
    """The homogeneous matrix, by scipy."""
    if pose.size == 3:
        out = np.eye(3)
        out[:2, :2] = Rotation.from_euler("z", pose[2]).as_matrix()[:2, :2]
        out[:2, 2] = pose[:2]
        return out
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("ZYX", pose[:2:-1]).as_matrix()
    out[:3, 3] = pose[:3]
    return out


def numerical_jacobian(function, at, step=1e-6):
    columns = []
    for axis in range(at.size):
        offset = np.zeros(at.size)
        offset[axis] = step
        difference = function(at + offset) - function(at - offset)
        angles = slice(2, None) if at.size == 3 else slice(3, None)
        difference[angles] = np.angle(np.exp(1j * difference[angles]))
        columns.append(difference / (2 * step))
    return np.stack(columns, -1)


@pytest.mark.parametrize("size", [3, 6])
def test_operations_are_matrix_products(size):
    rng = np.random.default_rng(1)
    for a, b in zip(random_poses(rng, 50, size), random_poses(rng, 50, size), strict=True):
        A, B = as_matrix(a), as_matrix(b)
        np.testing.assert_allclose(poses.pose_to_matrix(a), A, atol=1e-12)
        for pose, matrix in (
            (poses.compound(a, b), A @ B),
            (poses.inverse(a), np.linalg.inv(A)),
            (poses.between(a, b), np.linalg.inv(A) @ B),
            (poses.uncompound(a, b), A @ np.linalg.inv(B)),
            (poses.pose_from_matrix(A), A),
        ):
            np.testing.assert_allclose(as_matrix(pose), matrix, atol=1e-9)
            angles = pose[2:] if size == 3 else pose[3:]
            assert (np.abs(angles) <= np.pi).all()


@pytest.mark.parametrize("size", [3, 6])
def test_jacobians_are_the_numerical_derivatives(size):
    rng = np.random.default_rng(2)
    for a, b in zip(random_poses(rng, 40, size), random_poses(rng, 40, size), strict=True):
        # Stay a little away from the pitch where derivatives do not exist.
        if size == 6 and max(abs(poses.compound(a, b)[4]), abs(poses.inverse(a)[4])) > 1.5:
            continue
        J1, J2 = poses.compound_jacobians(a, b)
        close = {"rtol": 1e-5, "atol": 1e-5}
        np.testing.assert_allclose(J1, numerical_jacobian(lambda p, b=b: poses.compound(p, b), a), **close)
        np.testing.assert_allclose(J2, numerical_jacobian(lambda p, a=a: poses.compound(a, p), b), **close)
        np.testing.assert_allclose(poses.inverse_jacobian(a), numerical_jacobian(poses.inverse, a), **close)
        if size == 6 and abs(poses.between(a, b)[4]) > 1.5:
            continue
        Ja, Jb = poses.between_jacobians(a, b)
        np.testing.assert_allclose(Ja, numerical_jacobian(lambda p, b=b: poses.between(p, b), a), **close)
        np.testing.assert_allclose(Jb, numerical_jacobian(lambda p, a=a: poses.between(a, p), b), **close)


def test_printed_jacobians_of_se3():
    """K1, K2 of (42) and Q of (45), term by term as printed."""
    rng = np.random.default_rng(3)
    for a, b in zip(random_poses(rng, 20, 6, 0.6), random_poses(rng, 20, 6, 0.6), strict=True):
        ik = poses.compound(a, b)
        (phi_ik, th_ik, psi_ik), (th_ij, psi_ij), (phi_jk, th_jk) = ik[3:], a[4:], b[3:5]
        Rij, Rjk = as_matrix(a)[:3, :3], as_matrix(b)[:3, :3]
        turn, sec, tan = psi_ik - psi_ij, 1 / np.cos(th_ik), np.tan(th_ik)
        K1 = [
            [np.cos(th_ij) * np.cos(turn) * sec, np.sin(turn) * sec, 0],
            [-np.cos(th_ij) * np.sin(turn), np.cos(turn), 0],
            [(Rjk[0, 1] * np.sin(phi_ik) + Rjk[0, 2] * np.cos(phi_ik)) * sec, np.sin(turn) * tan, 1],
        ]
        roll = phi_ik - phi_jk
        K2 = [
            [1, np.sin(roll) * tan, (Rij[0, 2] * np.cos(psi_ik) + Rij[1, 2] * np.sin(psi_ik)) * sec],
            [0, np.cos(roll), -np.cos(th_jk) * np.sin(roll)],
            [0, np.sin(roll) * sec, np.cos(th_jk) * np.cos(roll) * sec],
        ]
        J1, J2 = poses.compound_jacobians(a, b)
        np.testing.assert_allclose(J1[3:, 3:], K1, atol=1e-9)
        np.testing.assert_allclose(J2[3:, 3:], K2, atol=1e-9)
        R, phi, psi = Rij, a[3], a[5]
        root = np.sqrt(1 - R[0, 2] ** 2)
        Q = [
            [-R[0, 0], -R[0, 1] * np.cos(phi), R[0, 2] * R[2, 2]],
            [R[0, 1] * root, -R[2, 2] * np.cos(psi) * root, R[1, 2] * root],
            [R[0, 2] * R[0, 0], -R[1, 2] * np.cos(psi), -R[2, 2]],
        ]
        J = poses.inverse_jacobian(a)[3:, 3:] * root**2
        np.testing.assert_allclose(np.delete(J.ravel(), 4), np.delete(np.ravel(Q), 4), atol=1e-9)
        # Row 2, column 2 is printed with cos(φ); the derivative has cos(ψ), as the column's last row has.
        np.testing.assert_allclose(J[1, 1], Q[1][1], atol=1e-9)


@pytest.mark.parametrize("size", [3, 6])
def test_batches_equal_single_calls(size):
    rng = np.random.default_rng(4)
    a, b = random_poses(rng, 12, size).reshape(3, 4, size), random_poses(rng, 4, size)
    J1, J2 = poses.compound_jacobians(a, b)
    inverse_jacobian = poses.inverse_jacobian(a)
    for i, j in np.ndindex(3, 4):
        np.testing.assert_allclose(poses.compound(a, b)[i, j], poses.compound(a[i, j], b[j]), atol=1e-12)
        np.testing.assert_allclose(poses.inverse(a)[i, j], poses.inverse(a[i, j]), atol=1e-12)
        np.testing.assert_allclose(J1[i, j], poses.compound_jacobians(a[i, j], b[j])[0], atol=1e-12)
        np.testing.assert_allclose(J2[i, j], poses.compound_jacobians(a[i, j], b[j])[1], atol=1e-12)
        np.testing.assert_allclose(inverse_jacobian[i, j], poses.inverse_jacobian(a[i, j]), atol=1e-12)


@pytest.mark.parametrize("size", [3, 6])
def test_propagated_covariance_is_that_of_samples(size):
    rng = np.random.default_rng(5)
    a, b = random_poses(rng, 2, size, 0.5)
    P, Q = (A @ A.T for A in rng.normal(size=(2, size, size)) * 0.004)
    offsets = (rng.multivariate_normal(np.zeros(size), cov, 100_000) for cov in (P, Q))
    samples = poses.compound(a + next(offsets), b + next(offsets))
    expected = np.cov(poses.wrap_angle(samples - poses.compound(a, b)).T)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    predicted = poses.compound_covariance(a, P, b, Q)
    np.testing.assert_allclose(predicted / scale, expected / scale, atol=0.025)
    assert np.abs((poses.compound_covariance(a, P, b, 0.0 * Q) - expected) / scale).max() > 0.05


def test_inverse_covariance_is_that_of_samples():
    rng = np.random.default_rng(6)
    a = np.array([3.0, -2.0, 1.1])
    P = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 3e-4, 0], [2e-5, 0, 1e-4]])
    samples = poses.inverse(rng.multivariate_normal(a, P, 100_000))
    np.testing.assert_allclose(poses.inverse_covariance(a, P), np.cov(samples.T), rtol=0.05, atol=1e-5)


def test_quaternions_against_scipy():
    rng = np.random.default_rng(8)
    for rotation in [*Rotation.random(60, rng=rng), *Rotation.from_euler("xyz", np.eye(3) * np.pi)]:
        q, R = rotation.as_quat(), rotation.as_matrix()
        np.testing.assert_allclose(poses.rotation_from_quaternion(3 * q), R, atol=1e-12)
        ours = poses.quaternion_from_rotation(R)
        assert ours[3] >= 0
        assert abs(ours @ q) == pytest.approx(1.0, abs=1e-12)
        euler = rotation.as_euler("ZYX")[::-1]
        np.testing.assert_allclose(poses.euler_from_quaternion(q), euler, atol=1e-9)
        assert abs(poses.quaternion_from_euler(euler) @ q) == pytest.approx(1.0, abs=1e-12)


@given(arrays(float, 4, elements=st.floats(-1, 1)))
def test_angles_of_one_quaternion_are_those_of_its_rotation(quaternion):
    if np.linalg.norm(quaternion) < 1e-3:
        quaternion = np.array([0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)])  # pitched straight down
    single = poses.euler_from_quaternion(quaternion)
    many = poses.euler_from_quaternion(quaternion[None])[0]
    np.testing.assert_allclose(
        Rotation.from_euler("xyz", single).as_matrix(),
        Rotation.from_euler("xyz", many).as_matrix(),
        atol=1e-9,
    )


def test_quaternion_round_trip_of_poses():
    rng = np.random.default_rng(9)
    se3, se2 = random_poses(rng, 30, 6), random_poses(rng, 30, 3)
    np.testing.assert_allclose(poses.pose_from_quaternion(*poses.pose_to_quaternion(se3)), se3, atol=1e-9)
    position, q = poses.pose_to_quaternion(se2)
    assert (position[:, 2] == 0).all()
    back = poses.pose_from_quaternion(position[:, :2], q)
    np.testing.assert_allclose(back[:, :2], se2[:, :2])
    np.testing.assert_allclose(np.cos(back[:, 2] - se2[:, 2]), 1.0, atol=1e-12)


def test_gimbal_lock_keeps_the_rotation_and_finite_jacobians():
    for pitch in (np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 1.5707):
        pose = np.array([1.0, 2.0, 3.0, 0.4, pitch, -1.2])
        R = as_matrix(pose)[:3, :3]
        euler = poses.euler_from_rotation(R)
        np.testing.assert_allclose(poses.rotation_from_euler(euler), R, atol=1e-7)
        assert np.isfinite(poses.compound_jacobians(pose, pose * 0)[0]).all()
    # A millimetre of yaw ambiguity grows as 1 / cos(pitch): the documented divergence.
    near = poses.compound_jacobians(np.array([0, 0, 0, 0.3, np.pi / 2 - 1e-3, 0.0]), np.array([0.0] * 6))[1]
    assert np.abs(near[3:, 3:]).max() > 200


@given(arrays(float, 3, elements=ANGLE), arrays(float, 3, elements=ANGLE))
def test_inverse_undoes_compound(a, b):
    np.testing.assert_allclose(as_matrix(poses.between(a, poses.compound(a, b))), as_matrix(b), atol=1e-9)
    np.testing.assert_allclose(poses.compound(a, poses.inverse(a)), 0, atol=1e-9)


@given(st.floats(-1e6, 1e6))
def test_wrapped_angles(angle):
    wrapped = poses.wrap_angle(angle)
    assert -np.pi < wrapped <= np.pi
    assert abs(np.exp(1j * angle) - np.exp(1j * wrapped)) < 1e-9
    assert (
        poses.wrap_angle(np.array([angle]))[0] == pytest.approx(wrapped, abs=1e-9)
        or abs(abs(wrapped) - np.pi) < 1e-9
    )


def test_wrap_angle_keeps_the_interval_half_open():
    assert poses.wrap_angle(-np.pi) == np.pi
    assert poses.wrap_angle(np.array([-np.pi, np.pi, 1e-20])).tolist() == [np.pi, np.pi, 1e-20]


def test_transformed_points():
    rng = np.random.default_rng(10)
    for size in (3, 6):
        pose = random_poses(rng, 1, size)[0]
        T = as_matrix(pose)
        points = rng.normal(size=(5, 7, size // 3 + 1))
        homogeneous = np.concatenate([points, np.ones((5, 7, 1))], -1) @ T.T
        np.testing.assert_allclose(poses.transform_points(pose, points), homogeneous[..., :-1], atol=1e-12)
        np.testing.assert_allclose(poses.transform_points(T, points), homogeneous[..., :-1], atol=1e-12)


def test_transform_points_keeps_missing_returns():
    out = poses.transform_points([1.0, 0, 0], [[np.nan, 1.0], [2.0, 3.0]])
    assert np.isnan(out[0, 0])
    np.testing.assert_allclose(out[1], [3.0, 3.0])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: poses.compound([0, 0, np.nan], [0, 0, 0]), "a"),
        (lambda: poses.compound([0, 0, 0], [0, np.inf, 0]), "b"),
        (lambda: poses.compound(np.zeros((2, 3)), [[0, 0, np.nan]] * 2), "b"),
        (lambda: poses.compound([0, 0], [0, 0, 0]), "a"),
        (lambda: poses.compound(np.zeros(6), np.zeros(3)), "a and b"),
        (lambda: poses.inverse([np.nan, 0, 0]), "a"),
        (lambda: poses.compound_jacobians([0, 0, 0], "abc"), "b"),
        (lambda: poses.pose_to_matrix(np.zeros(4)), "pose"),
        (lambda: poses.rotation_from_quaternion(np.zeros(4)), "quaternion"),
        (lambda: poses.transform_points(np.zeros(3), np.zeros((4, 3))), "points"),
        (lambda: poses.compound_covariance(np.zeros(3), np.eye(2), np.zeros(3), np.eye(3)), "a_covariance"),
        (lambda: poses.wrap_angle(float("nan")), "angle"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(InputError, match=rf"^{name} "):
        call()

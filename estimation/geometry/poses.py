"""Poses in SE(2) and SE(3), their compounding and its Jacobians (App. A.B of the loop-closure text).

A pose x_ij is the location of frame j with respect to frame i: `[x, y, yaw]` in SE(2) and
`[x, y, z, roll, pitch, yaw]` in SE(3), metres and radians, yaw-pitch-roll as in (40). All functions take
arrays (..., 3) or (..., 6), broadcast over the leading axes and return angles in (-π, π].

In SE(3) the Jacobians contain 1 / cos(pitch) of the result. Towards pitch = ±90° they, and every covariance
propagated with them, grow without bound: roll and yaw alone are then unobservable. |cos(pitch)| is kept
at 1e-7 or more, so that numbers stay finite; at exactly ±90° no Jacobian exists and theirs is not usable.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_floats, as_square, as_vectors, require_finite, require_fitting
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from estimation.geometry.rotations import (
    euler_from_quaternion,
    euler_from_rotation,
    euler_of,
    euler_rates,
    euler_rates_inverse,
    quaternion_from_euler,
    quaternion_from_rotation,
    require_rigid,
    rotation_2d,
    rotation_from_euler,
    rotation_from_quaternion,
    wrap_angle,
    wrap_scalar,
)

__all__ = [
    "between", "between_jacobians", "compound", "compound_covariance", "compound_jacobians",
    "euler_from_quaternion", "euler_from_rotation", "inverse", "inverse_covariance", "inverse_jacobian",
    "pose_from_matrix", "pose_from_quaternion", "pose_to_matrix", "pose_to_quaternion",
    "quaternion_from_euler", "quaternion_from_rotation", "rotation_2d", "rotation_from_euler",
    "rotation_from_quaternion", "transform_points", "uncompound", "wrap_angle",
]  # fmt: skip


def _pair(a: npt.ArrayLike, b: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Both poses as float arrays of one kind; the caller checks that they are finite."""
    a, b = as_floats("a", a), as_floats("b", b)
    for name, pose in (("a", a), ("b", b)):
        if pose.ndim == 0 or pose.shape[-1] not in (3, 6):
            raise InputError(f"{name} must have shape (..., 3) or (..., 6), not {pose.shape}")
    if a.shape[-1] != b.shape[-1]:
        raise InputError(f"a and b must both be SE(2) or both SE(3), not {a.shape} and {b.shape}")
    if a.shape != b.shape:
        require_fitting(a=a, b=b)
    return a, b


def _floats(name: str, pose: FloatArray) -> list[float]:
    """The three numbers of one SE(2) pose: plain floats are several times faster than array arithmetic."""
    values: list[float] = pose.tolist()
    if not math.isfinite(sum(values)):
        require_finite(name, pose)
    return values


def compound(a: npt.ArrayLike, b: npt.ArrayLike) -> FloatArray:
    """x_ik = a ⊕ b of a = x_ij and b = x_jk: (34) in SE(2), (39) in SE(3).

    a, b : (..., 3) or (..., 6), broadcast against each other. Raises InputError naming the argument that
    has another shape or is not finite.
    """
    a, b = _pair(a, b)
    if a.shape == b.shape == (3,):
        ax, ay, at = _floats("a", a)
        bx, by, bt = _floats("b", b)
        c, s = math.cos(at), math.sin(at)
        return np.array((ax + c * bx - s * by, ay + s * bx + c * by, wrap_scalar(at + bt)))
    require_finite("a", a)
    require_finite("b", b)
    if a.shape[-1] == 3:
        cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
        x = a[..., 0] + cos * b[..., 0] - sin * b[..., 1]
        y = a[..., 1] + sin * b[..., 0] + cos * b[..., 1]
        return np.stack([x, y, wrap_angle(a[..., 2] + b[..., 2])], -1)
    R = rotation_from_euler(a[..., 3:])
    position = (R @ b[..., :3, None])[..., 0] + a[..., :3]
    return np.concatenate([position, euler_of(R @ rotation_from_euler(b[..., 3:]))], -1)


def inverse(a: npt.ArrayLike) -> FloatArray:
    """x_ji = ⊖a of a = x_ij, (..., 3) or (..., 6): (36) in SE(2), (43) in SE(3)."""
    a = as_floats("a", a)
    if a.shape == (3,):
        ax, ay, at = _floats("a", a)
        cos, sin = math.cos(at), math.sin(at)
        return np.array((-ax * cos - ay * sin, ax * sin - ay * cos, wrap_scalar(-at)))
    a = as_vectors("a", a, 3, 6)
    if a.shape[-1] == 3:
        c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
        x = -a[..., 0] * c - a[..., 1] * s
        y = a[..., 0] * s - a[..., 1] * c
        return np.stack([x, y, wrap_angle(-a[..., 2])], -1)
    R = np.swapaxes(rotation_from_euler(a[..., 3:]), -1, -2)
    return np.concatenate([-(R @ a[..., :3, None])[..., 0], euler_of(R)], -1)


def between(a: npt.ArrayLike, b: npt.ArrayLike) -> FloatArray:
    """x_jk = ⊖a ⊕ b of a = x_ij and b = x_ik, the pose of b seen from a: (46c)."""
    a, b = _pair(a, b)
    if a.shape == b.shape == (3,):
        ax, ay, at = _floats("a", a)
        bx, by, bt = _floats("b", b)
        c, s, dx, dy = math.cos(at), math.sin(at), bx - ax, by - ay
        return np.array((c * dx + s * dy, c * dy - s * dx, wrap_scalar(bt - at)))
    return compound(inverse(a), b)


def uncompound(a: npt.ArrayLike, b: npt.ArrayLike) -> FloatArray:
    """x_ik = a ⊖ b = a ⊕ (⊖b) of a = x_ij and b = x_kj: (46b), whose last index pair is misprinted as i,k."""
    a, b = _pair(a, b)
    return compound(a, inverse(b))


def compound_jacobians(a: npt.ArrayLike, b: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """J1 = d(a ⊕ b)/da and J2 = d(a ⊕ b)/db, each (..., d, d): (35) in SE(2), (41)-(42) in SE(3).

    In SE(3) they are built from the matrices E that turn Euler rates into angular velocity: with
    R_ik = R_ij R_jk, ω_ik = ω_ij + R_ij ω_jk, so K1 = E_ik⁻¹ E_ij and K2 = E_ik⁻¹ R_ij E_jk.
    """
    a, b = _pair(a, b)
    if a.shape == b.shape == (3,):
        _, _, at = _floats("a", a)
        bx, by, _ = _floats("b", b)
        c, s = math.cos(at), math.sin(at)
        return (
            np.array(((1.0, 0.0, -(s * bx + c * by)), (0.0, 1.0, c * bx - s * by), (0.0, 0.0, 1.0))),
            np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))),
        )
    require_finite("a", a)
    require_finite("b", b)
    shape = np.broadcast_shapes(a.shape, b.shape)
    size = shape[-1]
    J1 = np.zeros((*shape, size))
    J2 = np.zeros((*shape, size))
    J1[..., range(size), range(size)] = 1.0
    if size == 3:
        R = rotation_2d(a[..., 2])
        J1[..., 0, 2] = -(R[..., 1, 0] * b[..., 0] + R[..., 0, 0] * b[..., 1])
        J1[..., 1, 2] = R[..., 0, 0] * b[..., 0] - R[..., 1, 0] * b[..., 1]
        J2[..., :2, :2] = R
        J2[..., 2, 2] = 1.0
        return J1, J2
    R = rotation_from_euler(a[..., 3:])
    E = euler_rates(a[..., 3:])
    reduce = euler_rates_inverse(compound(a, b)[..., 3:])
    lever = R @ b[..., :3, None]
    J1[..., :3, 3:] = np.cross(E, lever, axis=-2)
    J1[..., 3:, 3:] = reduce @ E
    J2[..., :3, :3] = R
    J2[..., 3:, 3:] = reduce @ R @ euler_rates(b[..., 3:])
    return J1, J2


def inverse_jacobian(a: npt.ArrayLike) -> FloatArray:
    """J⊖ = d(⊖a)/da, (..., d, d): (37) in SE(2), (44)-(45) in SE(3)."""
    a = as_vectors("a", a, 3, 6)
    out = np.zeros((*a.shape, a.shape[-1]))
    if a.shape[-1] == 3:
        c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
        out[..., 0, 0] = out[..., 1, 1] = -c
        out[..., 0, 1] = -s
        out[..., 1, 0] = s
        out[..., 0, 2] = a[..., 0] * s - a[..., 1] * c
        out[..., 1, 2] = a[..., 0] * c + a[..., 1] * s
        out[..., 2, 2] = -1.0
        return out
    back = np.swapaxes(rotation_from_euler(a[..., 3:]), -1, -2)
    E = euler_rates(a[..., 3:])
    out[..., :3, :3] = -back
    # d(Rᵀ) = -Rᵀ [ω]×, hence d(-Rᵀ t) = Rᵀ (ω × t) for every column ω of E.
    out[..., :3, 3:] = back @ np.cross(E, a[..., :3, None], axis=-2)
    out[..., 3:, 3:] = -euler_rates_inverse(inverse(a)[..., 3:]) @ back @ E
    return out


def between_jacobians(a: npt.ArrayLike, b: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Jacobians of `between(a, b)` with respect to a and b, (..., d, d): [J1⊕ J⊖, J2⊕], (47)."""
    J1, J2 = compound_jacobians(inverse(a), b)
    return J1 @ inverse_jacobian(a), J2


def compound_covariance(
    a: npt.ArrayLike, a_covariance: npt.ArrayLike, b: npt.ArrayLike, b_covariance: npt.ArrayLike
) -> FloatArray:
    """First-order covariance (..., d, d) of `compound(a, b)` of independent a and b."""
    J1, J2 = compound_jacobians(a, b)
    size = J1.shape[-1]
    P = as_square("a_covariance", repair_covariance(a_covariance, "a_covariance", False), size)
    Q = as_square("b_covariance", repair_covariance(b_covariance, "b_covariance", False), size)
    require_fitting(a_and_b=J1[..., 0], a_covariance=P[..., 0], b_covariance=Q[..., 0])
    out = J1 @ P @ np.swapaxes(J1, -1, -2) + J2 @ Q @ np.swapaxes(J2, -1, -2)
    return 0.5 * (out + np.swapaxes(out, -1, -2))


def inverse_covariance(a: npt.ArrayLike, covariance: npt.ArrayLike) -> FloatArray:
    """First-order covariance (..., d, d) of `inverse(a)`."""
    J = inverse_jacobian(a)
    P = as_square("covariance", repair_covariance(covariance, definite=False), J.shape[-1])
    require_fitting(a=J[..., 0], covariance=P[..., 0])
    out = J @ P @ np.swapaxes(J, -1, -2)
    return 0.5 * (out + np.swapaxes(out, -1, -2))


def pose_to_matrix(pose: npt.ArrayLike) -> FloatArray:
    """Homogeneous matrix: (..., 3, 3) of an SE(2) pose, (..., 4, 4) of an SE(3) pose."""
    pose = as_floats("pose", pose)
    if pose.shape == (3,):
        x, y, yaw = _floats("pose", pose)
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array(((c, -s, x), (s, c, y), (0.0, 0.0, 1.0)))
    pose = as_vectors("pose", pose, 3, 6)
    size = 2 if pose.shape[-1] == 3 else 3
    out = np.zeros((*pose.shape[:-1], size + 1, size + 1))
    out[..., :size, :size] = rotation_2d(pose[..., 2]) if size == 2 else rotation_from_euler(pose[..., 3:])
    out[..., :size, size] = pose[..., :size]
    out[..., size, size] = 1.0
    return out


def pose_from_matrix(matrix: npt.ArrayLike) -> FloatArray:
    """SE(2) pose (..., 3) of a homogeneous (..., 3, 3), SE(3) pose (..., 6) of a (..., 4, 4)."""
    T = require_rigid("matrix", as_square("matrix", matrix, 3, 4))
    if T.shape[-1] == 3:
        return np.stack([T[..., 0, 2], T[..., 1, 2], np.arctan2(T[..., 1, 0], T[..., 0, 0])], -1)
    return np.concatenate([T[..., :3, 3], euler_of(T[..., :3, :3])], -1)


def pose_to_quaternion(pose: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Position (..., 3) and quaternion (x, y, z, w) (..., 4) of an SE(2) or SE(3) pose."""
    pose = as_vectors("pose", pose, 3, 6)
    if pose.shape[-1] == 6:
        return pose[..., :3].copy(), quaternion_from_euler(pose[..., 3:])
    zero = np.zeros_like(pose[..., :1])
    euler = np.concatenate([zero, zero, pose[..., 2:]], -1)
    return np.concatenate([pose[..., :2], zero], -1), quaternion_from_euler(euler)


def pose_from_quaternion(position: npt.ArrayLike, quaternion: npt.ArrayLike) -> FloatArray:
    """SE(3) pose (..., 6) of a position (..., 3) and a quaternion (x, y, z, w) (..., 4).

    A position (..., 2) gives the SE(2) pose (..., 3) instead, with the quaternion's yaw.
    """
    position = as_vectors("position", position, 2, 3)
    euler = euler_from_quaternion(quaternion)
    if position.shape[:-1] != euler.shape[:-1]:
        raise InputError(f"position and quaternion must be as many, not {position.shape} and {euler.shape}")
    return np.concatenate([position, euler if position.shape[-1] == 3 else euler[..., 2:]], -1)


def transform_points(pose: npt.ArrayLike, points: npt.ArrayLike) -> FloatArray:
    """Points (..., 2|3) given in the frame of `pose`, expressed in the frame the pose is given in.

    pose : one pose, (3,) or a 3×3 matrix for 2D points, (6,) or a 4×4 matrix for 3D points.
    """
    T = as_floats("pose", pose)
    if T.shape in ((3,), (6,)):
        T = pose_to_matrix(T)
    elif T.shape in ((3, 3), (4, 4)):
        require_finite("pose", T)
    else:
        raise InputError(f"pose must have shape (3,), (6,), (3, 3) or (4, 4), not {T.shape}")
    size = T.shape[0] - 1
    points = as_floats("points", points)
    if points.ndim == 0 or points.shape[-1] != size:
        raise InputError(f"points must have shape (..., {size}) for this pose, not {points.shape}")
    return points @ T[:size, :size].T + T[:size, size]

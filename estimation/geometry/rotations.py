"""Rotations: Euler angles [roll, pitch, yaw], 3×3 matrices, quaternions (x, y, z, w); wrapping of angles.

The Euler convention is the one of (40), App. A.B, and of REP-103: R = Rz(yaw) Ry(pitch) Rx(roll).
At pitch = ±90° only a combination of roll and yaw is determined; roll is then reported as 0.
"""

from __future__ import annotations

import math
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_square, as_vectors
from estimation.errors import InputError

# cos(pitch) below this counts as gimbal lock: roll and yaw from such a matrix would be rounding noise.
GIMBAL_LOCK = 1e-7
# By which R Rᵀ may differ from the identity: of matrices that were written with few digits.
ROTATION_ROOM = 1e-2
# A quaternion shorter than this is none.
SHORTEST = 1e-6

_TWO_PI = 2.0 * math.pi


@overload
def wrap_angle(angle: float) -> float: ...


@overload
def wrap_angle(angle: npt.NDArray[np.float64]) -> FloatArray: ...


def wrap_angle(angle: float | npt.NDArray[np.float64]) -> float | FloatArray:
    """Angle (rad, scalar or array) brought into (-π, π]; angles already inside are returned unchanged."""
    if isinstance(angle, int | float):
        return wrap_scalar(angle)
    array = as_finite("angle", angle)
    wrapped = array - _TWO_PI * np.rint(array / _TWO_PI)
    return np.where(wrapped <= -math.pi, wrapped + _TWO_PI, wrapped)


def wrap_scalar(angle: float) -> float:
    """`wrap_angle` for one float."""
    if not math.isfinite(angle):
        raise InputError("angle must be finite")
    wrapped = math.remainder(angle, _TWO_PI)
    return wrapped + _TWO_PI if wrapped <= -math.pi else wrapped


def rotation_2d(yaw: npt.ArrayLike) -> FloatArray:
    """Rotation matrix (..., 2, 2) of a yaw angle (...), rad."""
    yaw = as_finite("yaw", yaw)
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def rotation_from_euler(euler: npt.ArrayLike) -> FloatArray:
    """Rotation matrix (..., 3, 3) of [roll, pitch, yaw] (..., 3), rad: (40)."""
    euler = as_vectors("euler", euler, 3)
    (sr, sp, sy), (cr, cp, cy) = (np.moveaxis(f(euler), -1, 0) for f in (np.sin, np.cos))
    out = np.empty((*euler.shape, 3))
    out[..., 0, 0] = cy * cp
    out[..., 0, 1] = -sy * cr + cy * sp * sr
    out[..., 0, 2] = sy * sr + cy * sp * cr
    out[..., 1, 0] = sy * cp
    out[..., 1, 1] = cy * cr + sy * sp * sr
    out[..., 1, 2] = -cy * sr + sy * sp * cr
    out[..., 2, 0] = -sp
    out[..., 2, 1] = cp * sr
    out[..., 2, 2] = cp * cr
    return out


def require_rotation(name: str, value: FloatArray) -> FloatArray:
    """Rotation matrices (..., d, d), unchanged; InputError where one scales, shears, mirrors or is not finite."""
    apart = np.abs(value @ np.swapaxes(value, -1, -2) - np.eye(value.shape[-1])).max(initial=0.0)
    if not apart <= ROTATION_ROOM or (np.linalg.det(value) < 0.0).any():
        raise InputError(f"{name} must be a rotation matrix; it scales, shears or mirrors")
    return value


def require_rigid(name: str, value: FloatArray) -> FloatArray:
    """Homogeneous matrices (..., d + 1, d + 1) of poses, unchanged; InputError for any other."""
    size = value.shape[-1] - 1
    require_rotation(name, value[..., :size, :size])
    if (np.abs(value[..., size, :] - np.eye(size + 1)[size]) > ROTATION_ROOM).any():
        raise InputError(f"{name} must have (0, ..., 0, 1) as its last row")
    return value


def euler_from_rotation(rotation: npt.ArrayLike) -> FloatArray:
    """[roll, pitch, yaw] (..., 3) of a rotation matrix (..., 3, 3).

    Pitch is in [-π/2, π/2], the others in (-π, π]. Roll is found by undoing yaw
    first, as in (39), which stays accurate close to gimbal lock.
    """
    return euler_of(require_rotation("rotation", as_square("rotation", rotation, 3)))


def euler_of(R: FloatArray) -> FloatArray:
    """`euler_from_rotation` of what is known to be rotations."""
    cos_pitch = np.hypot(R[..., 0, 0], R[..., 1, 0])
    locked = cos_pitch < GIMBAL_LOCK
    # Locked, with roll = 0: R[0, 1] = -sin(yaw), R[1, 1] = cos(yaw).
    yaw = np.where(locked, np.arctan2(-R[..., 0, 1], R[..., 1, 1]), np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    pitch = np.arctan2(-R[..., 2, 0], cos_pitch)
    s, c = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(R[..., 0, 2] * s - R[..., 1, 2] * c, R[..., 1, 1] * c - R[..., 0, 1] * s)
    return np.stack([np.where(locked, 0.0, roll), pitch, yaw], -1)


def euler_rates(euler: FloatArray) -> FloatArray:
    """E (..., 3, 3): angular velocity in the fixed frame = E(euler) · d[roll, pitch, yaw]/dt."""
    sp, cp = np.sin(euler[..., 1]), np.cos(euler[..., 1])
    sy, cy = np.sin(euler[..., 2]), np.cos(euler[..., 2])
    out = np.zeros((*euler.shape, 3))
    out[..., 0, 0] = cy * cp
    out[..., 1, 0] = sy * cp
    out[..., 2, 0] = -sp
    out[..., 0, 1] = -sy
    out[..., 1, 1] = cy
    out[..., 2, 2] = 1.0
    return out


def euler_rates_inverse(euler: FloatArray) -> FloatArray:
    """Inverse of `euler_rates`, (..., 3, 3); cos(pitch) is kept at least `GIMBAL_LOCK` in magnitude."""
    sp, cp = np.sin(euler[..., 1]), np.cos(euler[..., 1])
    cp = np.copysign(np.maximum(np.abs(cp), GIMBAL_LOCK), cp)
    sy, cy = np.sin(euler[..., 2]), np.cos(euler[..., 2])
    out = np.zeros((*euler.shape, 3))
    out[..., 0, 0] = cy / cp
    out[..., 0, 1] = sy / cp
    out[..., 1, 0] = -sy
    out[..., 1, 1] = cy
    out[..., 2, 0] = cy * sp / cp
    out[..., 2, 1] = sy * sp / cp
    out[..., 2, 2] = 1.0
    return out


def rotation_from_quaternion(quaternion: npt.ArrayLike) -> FloatArray:
    """Rotation matrix (..., 3, 3) of a quaternion (x, y, z, w) (..., 4); it is normalised first.

    Raises InputError for a quaternion of norm below 1e-6 (an unset message field, for instance).
    """
    q = as_vectors("quaternion", quaternion, 4)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if (norm < SHORTEST).any():
        raise InputError("quaternion must have a norm above 1e-6")
    rows = rotation_rows(*np.moveaxis(q / norm, -1, 0))
    return np.stack([np.stack(row, -1) for row in rows], -2)


def rotation_rows(x: Any, y: Any, z: Any, w: Any) -> list[list[Any]]:
    """Rows of the rotation matrix of a unit quaternion, of numbers or of arrays of one shape."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def quaternion_from_rotation(rotation: npt.ArrayLike) -> FloatArray:
    """Quaternion (x, y, z, w) (..., 4) with w ≥ 0 of a rotation matrix (..., 3, 3).

    The component of largest magnitude is found from the diagonal and the others are divided by it, so that
    no difference of nearly equal numbers is taken, whatever the rotation.
    """
    R = require_rotation("rotation", as_square("rotation", rotation, 3))
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    xy, xz, yz = R[..., 1, 0] + R[..., 0, 1], R[..., 0, 2] + R[..., 2, 0], R[..., 2, 1] + R[..., 1, 2]
    wx, wy, wz = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    # Row i is 4 q_i (x, y, z, w): each is the quaternion up to scale, the longest is the best conditioned.
    candidates = np.stack(
        [
            np.stack([1 + xx - yy - zz, xy, xz, wx], -1),
            np.stack([xy, 1 - xx + yy - zz, yz, wy], -1),
            np.stack([xz, yz, 1 - xx - yy + zz, wz], -1),
            np.stack([wx, wy, wz, 1 + xx + yy + zz], -1),
        ],
        -2,
    )
    best = np.argmax(np.diagonal(candidates, axis1=-2, axis2=-1), -1)
    q = np.take_along_axis(candidates, best[..., None, None], -2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., 3:] < 0, -q, q)


def quaternion_from_euler(euler: npt.ArrayLike) -> FloatArray:
    """Quaternion (x, y, z, w) (..., 4), w ≥ 0, of [roll, pitch, yaw] (..., 3), rad."""
    half = 0.5 * as_vectors("euler", euler, 3)
    (sr, sp, sy), (cr, cp, cy) = (np.moveaxis(f(half), -1, 0) for f in (np.sin, np.cos))
    x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    z, w = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
    q = np.stack([x, y, z, w], -1)
    return np.where(q[..., 3:] < 0, -q, q)


def euler_from_quaternion(quaternion: npt.ArrayLike) -> FloatArray:
    """[roll, pitch, yaw] (..., 3), rad, of a quaternion (x, y, z, w) (..., 4)."""
    q = as_vectors("quaternion", quaternion, 4)
    if q.ndim == 1 and (length := math.hypot(*q)) >= SHORTEST:
        return np.array(_euler_of_one(*(q / length).tolist()))
    return euler_from_rotation(rotation_from_quaternion(q))


def _euler_of_one(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Of a single quaternion of length one, as messages bring them: in plain numbers ten times as fast."""
    r00, r10, r20 = 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)
    r01, r11 = 2 * (x * y - z * w), 1 - 2 * (x * x + z * z)
    r02, r12 = 2 * (x * z + y * w), 2 * (y * z - x * w)
    cos_pitch = math.hypot(r00, r10)
    pitch = math.atan2(-r20, cos_pitch)
    if cos_pitch < GIMBAL_LOCK:
        return 0.0, pitch, math.atan2(-r01, r11)
    yaw = math.atan2(r10, r00)
    s, c = math.sin(yaw), math.cos(yaw)
    return math.atan2(r02 * s - r12 * c, r11 * c - r01 * s), pitch, yaw

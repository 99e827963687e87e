"""Planar and spatial poses behind one set of names: (3,) x, y, yaw or (4, 4) homogeneous matrices.

Covariances are over (x, y, yaw), or (x, y, z, rotation about x, y, z), both in the frame a motion starts from.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from estimation.checks import FloatArray, as_own
from estimation.geometry.poses import between, compound, inverse, pose_from_matrix
from estimation.geometry.rotations import require_rigid

MOST = 100.0  # m², rad²: of one step, so that sums stay well conditioned


def as_pose(name: str, value: npt.ArrayLike) -> FloatArray:
    """`value` as a finite pose of its own; InputError naming it otherwise."""
    pose = as_own(name, value, (3,), (4, 4))
    return pose if planar(pose) else require_rigid(name, pose)


def planar(pose: FloatArray) -> bool:
    """Whether a pose, or a stack of poses, is planar."""
    return pose.shape[-1] == 3


def identity(like: FloatArray) -> FloatArray:
    """No motion, of the same kind."""
    return np.zeros(3) if planar(like) else np.eye(4)


def compose(a: FloatArray, b: FloatArray) -> FloatArray:
    """b, given in the frame of a, in the frame a is given in."""
    return compound(a, b) if planar(a) else np.asarray(a @ b)


def invert(a: FloatArray) -> FloatArray:
    """The motion back."""
    if planar(a):
        return inverse(a)
    R, t = a[..., :3, :3], a[..., :3, 3]
    out = np.zeros_like(a)
    out[..., :3, :3] = np.swapaxes(R, -1, -2)
    out[..., :3, 3] = -np.einsum("...ji,...j->...i", R, t)
    out[..., 3, 3] = 1.0
    return out


def motion(a: FloatArray, b: FloatArray) -> FloatArray:
    """b as seen from a."""
    return between(a, b) if planar(a) else np.asarray(invert(a) @ b)


def positions(poses: FloatArray) -> FloatArray:
    """(..., 2 | 3) metres."""
    return poses[..., :2] if planar(poses) else poses[..., :3, 3]


def orthonormal(pose: FloatArray) -> FloatArray:
    """A pose (4, 4) whose rotation is one to the last digit: products of many would drift away from it."""
    U, _, Vt = np.linalg.svd(pose[:3, :3])
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = U @ Vt, pose[:3, 3]
    return out


def length(pose: FloatArray) -> float:
    """Metres of a motion."""
    return float(np.linalg.norm(positions(pose)))


def turn(pose: FloatArray) -> float:
    """Radians of a motion, not negative."""
    return float(turns(pose[None])[0])


def turns(poses: FloatArray) -> FloatArray:
    """`turn` of each of (N, 3) or (N, 4, 4), (N,) radians."""
    if planar(poses):
        return np.asarray(np.abs(np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))))
    R = poses[:, :3, :3]
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=-1)
    return np.asarray(np.arctan2(np.linalg.norm(axis, axis=-1), np.trace(R, axis1=1, axis2=2) - 1.0))


def rotation(pose: FloatArray) -> FloatArray:
    """B, (3, 3) or (6, 6): turns a covariance in the frame a motion ends in to the frame it starts from."""
    if planar(pose):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(np.kron(np.eye(2), pose[:3, :3]), dtype=np.float64)


def blend(a: FloatArray, b: FloatArray, share: float) -> FloatArray:
    """A pose on the way from a (share 0) to b (share 1), for poses that are close together."""
    step = motion(a, b)
    if planar(a):
        return compound(a, np.asarray(share * step, dtype=np.float64))
    part = np.eye(4)
    part[:3, :3] = Rotation.from_rotvec(share * Rotation.from_matrix(step[:3, :3]).as_rotvec()).as_matrix()
    part[:3, 3] = share * step[:3, 3]
    return np.asarray(a @ part)


def row(pose: FloatArray) -> FloatArray:
    """(3,) or, of a matrix, (6,) x, y, z, roll, pitch, yaw."""
    return pose if planar(pose) else pose_from_matrix(pose)


def doubt_of(like: FloatArray, metres: float, radians: float) -> FloatArray:
    """Covariance (3, 3) or (6, 6) of a pose of the same kind, alike in all directions, by its deviations."""
    size = 2 if planar(like) else 3
    return np.diag([metres**2] * size + [radians**2] * (1 if planar(like) else 3))


def lever(offset: FloatArray) -> FloatArray:
    """J, (3, 3) or (6, 6): how a start that is off displaces and turns what lies at `offset` (2,) or (3,) from it."""
    if len(offset) == 2:
        J = np.eye(3)
        J[:2, 2] = [-offset[1], offset[0]]
        return J
    x, y, z = offset
    J = np.eye(6)
    J[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return J


def grown(start: FloatArray, step: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Covariance of `step` from `start`, in the frame of `start`, by how the pose's grew from `before` to `after`.

    The covariances are of accumulated poses in the odometry frame; what is not positive in the difference is dropped.
    """
    R = rotation(start)
    size = 2 if planar(step) else 3
    J = lever(R[:size, :size] @ positions(step))
    more = R.T @ (after - J @ before @ J.T) @ R
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    return np.asarray((vectors * np.clip(values, 0.0, MOST)) @ vectors.T)

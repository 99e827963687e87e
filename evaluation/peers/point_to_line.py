"""A plain scan matcher that odometry is held against: trimmed point-to-line ICP onto the last key scan.

After Censi (2008): every point is drawn to the line through its two nearest neighbours, the worst fifth is left out.
No map, no search, no judgement: what everybody has within an afternoon. Its numbers are the usual ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.geometry.poses import between, compound, transform_points, wrap_angle
from registration import Scan

Array = NDArray[np.float64]
STEP, TURN = 0.3, 0.3  # metres and radians from the key scan at which the next one becomes it
GATE = 0.5  # metres within which points correspond
KEPT = 0.8  # of the correspondences
ITERATIONS = 20
SETTLED = 5e-4  # metres and radians
LEAST = 20  # correspondences


def match(points: Array, tree: cKDTree, guess: Array) -> Array | None:
    """Pose (3,) that lays points (N, 2) on those of the tree, from a guess; None where too few correspond."""
    pose, target = guess.copy(), np.asarray(tree.data)
    for _ in range(ITERATIONS):
        placed = transform_points(pose, points)
        away, index = tree.query(placed, k=2, distance_upper_bound=GATE)
        near = np.isfinite(away[:, 1])
        if near.sum() < LEAST:
            return None
        a, p, q = placed[near], target[index[near, 0]], target[index[near, 1]]
        along = q - p
        normal = np.column_stack((-along[:, 1], along[:, 0]))
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        residual = np.einsum("ij,ij->i", normal, a - p)
        kept = np.argsort(np.abs(residual))[: int(KEPT * len(residual))]
        a, normal, residual = a[kept], normal[kept], residual[kept]
        turning = normal[:, 1] * (a[:, 0] - pose[0]) - normal[:, 0] * (a[:, 1] - pose[1])
        J = np.column_stack((normal, turning))
        # What the lines leave open does not move.
        step = -np.linalg.pinv(J.T @ J, rcond=1e-6, hermitian=True) @ (J.T @ residual)
        pose = pose + step
        if np.abs(step).max() < SETTLED:
            break
    pose[2] = wrap_angle(pose[2])
    return np.asarray(pose)


class PointToLine:
    """Follows one scanner; `register` is that of `registration.Odometry`.

    pose : (3,) of the sensor in the frame of the first scan. unsure : the last scan fitted nothing within 0.5 m, and
    its pose is the guess.
    """

    def __init__(self) -> None:
        self.pose = np.zeros(3)
        self.unsure = False
        self._key: cKDTree | None = None
        self._key_pose = np.zeros(3)
        self._motion = np.zeros(3)

    def register(self, scan: Scan, stamp: float, guess: Array | None = None) -> Array:
        """Pose (3,) at a scan; without a guess the last motion goes on."""
        del stamp
        points = scan.points()
        before = self.pose
        if self._key is not None:
            predicted = compound(before, self._motion if guess is None else guess)
            found = match(points, self._key, between(self._key_pose, predicted))
            self.unsure = found is None
            self.pose = predicted if found is None else compound(self._key_pose, found)
            self._motion = between(before, self.pose)
        away = between(self._key_pose, self.pose)
        far = np.hypot(away[0], away[1]) > STEP or abs(away[2]) > TURN
        if len(points) >= LEAST and (self._key is None or self.unsure or far):
            self._key, self._key_pose = cKDTree(points), self.pose
        return self.pose

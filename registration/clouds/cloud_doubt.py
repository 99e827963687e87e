"""How far a cloud that is laid on another may be off, from what the pieces of its surfaces say one by one.

Neighbouring points err together: noise of a plane's normal, curvature and rings are shared by all points of a wall. So
a wall, a side of a cupboard, a patch of ground is one witness, a *piece*, and the covariance is that of the estimate
with each piece left out in turn (the jackknife of clustered residuals), from point-to-plane distances. What these would
still move adds to it. Noisy normals also tell along their planes, which is nothing: a direction counts as open where
hardly any piece contradicts the cloud once it is moved along.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from estimation.checks import FloatArray

OPEN_VARIANCE = 1.0  # m², mean square of how far points may be off along a direction that is open
# Edge of a piece in units of the extent of what both clouds see: NEES / 6 of simulated pairs moves by less than its
# spread over seeds between .1 and .3.
PIECE = 0.2
NEAR = 1.0  # metres within which a point belongs to a plane
ALIKE = 0.9  # cosine between the normals of a point and of its plane: where rings are sparse, many are random
ROBUST = 2.0  # Huber's bound, in standard deviations of a point off its plane
FAR = 3.0  # of those: from which on a point contradicts its plane
SHIFT = 9.0  # of those: by which a cloud is moved to see what contradicts
LEAST_PIECES = 2  # that have to contradict: one may have moved by itself
LEAST_POINTS = 10  # of a piece that has a say
SAMPLE = 5000  # points that are moved


@dataclass(frozen=True)
class _Planes:
    """Points (M, 3) of the target and the normals (M, 3) of their planes."""

    points: FloatArray
    normals: FloatArray
    tree: cKDTree

    def distances(self, points: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of points (N, 3) from the planes nearest to them, metres, NaN where none is near that is turned as theirs is.

        normals : (N, 3) of the points. Returns the normals of the planes (N, 3), too.
        """
        away, index = self.tree.query(points, distance_upper_bound=NEAR)
        near = np.isfinite(away)
        index = np.where(near, index, 0)
        planes = self.normals[index]
        near &= np.abs(np.einsum("ni,ni->n", planes, normals)) > ALIKE
        return np.where(near, np.einsum("ni,ni->n", planes, points - self.points[index]), np.nan), planes


def doubt(
    moving: Any, still: Any, transform: FloatArray, opened: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Covariance (6, 6) of (x, y, z, rotation about x, y, z) in the target's frame, and what is open.

    moving, still : small_gicp's clouds, thinned, with normals; `transform` (4, 4) lays one on the other. Open are
    motions (k, 6), each a shift or a turn about the sensor that moves half of the points by a metre at least; they are
    looked for where `opened` does not name them.
    """
    target = np.asarray(still.points())[:, :3]
    planes = _Planes(target, np.asarray(still.normals())[:, :3], cKDTree(target))
    points = np.asarray(moving.points())[:, :3] @ transform[:3, :3].T + transform[:3, 3]
    turned = np.asarray(moving.normals())[:, :3] @ transform[:3, :3].T
    off, normals = planes.distances(points, turned)
    near = np.isfinite(off)
    if near.sum() <= 6:
        return OPEN_VARIANCE * np.eye(6), np.empty((0, 6))
    points, turned, off, normals = points[near], turned[near], off[near], normals[near]
    sigma = max(1.4826 * float(np.median(np.abs(off))), 1e-6)
    arms = points - transform[:3, 3]
    # Turns are counted in metres that half of the points move at least.
    scale = np.repeat([1.0, 1.0 / np.median(np.linalg.norm(arms, axis=1))], 3)
    jacobian = np.hstack((normals, np.cross(arms, normals))) * scale
    weight = np.minimum(1.0, ROBUST * sigma / np.maximum(np.abs(off), sigma))
    pieces = _pieces(points, normals)
    if opened is None:
        some = slice(None, None, max(1, len(points) // SAMPLE))
        placed = np.abs(off[some]) > FAR * sigma
        moved = _Moved(planes, arms[some], turned[some], transform[:3, 3], pieces[some], placed)
        motions = _motions((jacobian * weight[:, None]).T @ jacobian) * scale
        said = np.array([moved.contradicting(SHIFT * sigma * motion, FAR * sigma) for motion in motions])
        opened = motions[said < LEAST_PIECES]
    covariance = jackknife(jacobian, weight, off, pieces, sigma) * scale[:, None] * scale
    return covariance + OPEN_VARIANCE * opened.T @ opened, opened


def _motions(information: FloatArray) -> FloatArray:
    """Shifts along, and turns about, the axes that (6, 6) `information` has of each, (6, 6): noise mixes the two."""
    motions = np.zeros((6, 6))
    for part in (slice(0, 3), slice(3, 6)):
        motions[part, part] = np.linalg.eigh(information[part, part])[1].T
    return motions


def kept(start: FloatArray, transform: FloatArray, opened: FloatArray) -> FloatArray:
    """`transform` (4, 4), but along the motions `opened` (k, 6) it stays where the `start` (4, 4) is."""
    turn = Rotation.from_matrix(transform[:3, :3] @ start[:3, :3].T).as_rotvec()
    moved = np.concatenate((transform[:3, 3] - start[:3, 3], turn))
    axes = opened / np.linalg.norm(opened, axis=1, keepdims=True)
    moved -= axes.T @ (axes @ moved)
    result = np.eye(4)
    result[:3, :3] = Rotation.from_rotvec(moved[3:]).as_matrix() @ start[:3, :3]
    result[:3, 3] = start[:3, 3] + moved[:3]
    return result


def _pieces(points: FloatArray, normals: FloatArray) -> NDArray[np.int64]:
    """Which piece each of the points (N, 3) is of: those of one cell whose normals are nearest to the same axis."""
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    cells = np.floor(points / (PIECE * max(float(np.linalg.norm(high - low)), 1e-3)))
    side = np.abs(normals).argmax(axis=1)
    return np.unique(np.column_stack((cells, side)), axis=0, return_inverse=True)[1].ravel()


def jackknife(
    jacobian: FloatArray, weight: FloatArray, off: FloatArray, pieces: NDArray[np.int64], sigma: float
) -> FloatArray:
    """Covariance (6, 6) of the motion that takes points back to their planes, by leaving out each of `pieces` (N,).

    jacobian : (N, 6) of the distances off the planes, `off` (N,), metres, which count by `weight` (N,).
    """
    count = pieces.max() + 1
    pulls = np.stack([np.bincount(pieces, weight * off * column) for column in jacobian.T], axis=1)
    each = np.empty((count, 6, 6))
    for i in range(6):
        for j in range(6):
            each[:, i, j] = np.bincount(pieces, weight * jacobian[:, i] * jacobian[:, j])
    information = each.sum(axis=0)
    prior = sigma**2 / OPEN_VARIANCE * np.eye(6)
    step = np.linalg.solve(information + prior, pulls.sum(axis=0))
    left = np.linalg.solve(information + prior - each, (pulls - each @ step)[:, :, None])[:, :, 0]
    covariance = sigma**2 * np.linalg.inv(information + prior) + np.outer(step, step)
    return covariance + (count - 1) / count * left.T @ left


@dataclass(frozen=True)
class _Moved:
    """What pieces say once the cloud is moved from where it is.

    arms : (N, 3) points from `origin`, about which a motion turns, with `normals` (N, 3), of `pieces` (N,). off : (N,),
    which lie off their planes already.
    """

    planes: _Planes
    arms: FloatArray
    normals: FloatArray
    origin: FloatArray
    pieces: NDArray[np.int64]
    off: NDArray[np.bool_]

    def contradicting(self, motion: FloatArray, far: float) -> int:
        """How many pieces lie `far` (metres) off their planes after a `motion` (6,), to and fro: the fewer of both."""
        against = []
        for move in (motion, -motion):
            turn = Rotation.from_rotvec(move[3:]).as_matrix().T
            after = self.planes.distances(self.arms @ turn + self.origin + move[:3], self.normals @ turn)[0]
            known = np.isfinite(after)
            rise = (np.abs(after[known]) > far).astype(np.float64) - self.off[known]
            count, risen = np.bincount(self.pieces[known]), np.bincount(self.pieces[known], rise)
            against.append(int(((count >= LEAST_POINTS) & (risen > 0.5 * count)).sum()))
        return min(against)

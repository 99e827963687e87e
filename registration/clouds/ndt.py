"""Normal distributions transform, in the plane (Biber and Strasser) and in space (Magnusson, Paper A section 4.3).

The target becomes a normal distribution per cell, in grids that overlap by half a cell. A pose is scored by
Σ exp(-½ d oᵀ C⁻¹ o) over the source's points, o the offset from the mean of the point's cell; Newton's method without
the second derivatives of the exponent, which stays a descent. In the plane d is 1. In space it makes the score close
to the log likelihood of a normal distribution among outliers, which reaches farther.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.checks import FloatArray

LEAST = {2: 3, 3: 5}  # points of a cell, by dimension
FLATTEST = {2: 1e-3, 3: 1e-2}  # share of a cell's largest variance that every other has at least
OUTLIERS = 0.55  # share of a point's likelihood that is not its cell's, Magnusson's value
CELLS = (60.0, 30.0, 15.0)  # edges of a cell in space, in units of the finest voxel, from coarse to fine
ITERATIONS = 60
STEP = 1e-4  # metres and radians below which the iterations have settled


class Gaussians:
    """Means (K, D) and inverse covariances (K, D, D) of the points (N, D) in each cell that holds enough."""

    def __init__(self, points: FloatArray, cell: float, shift: tuple[float, ...]) -> None:
        """cell : metres, edge. shift : of the grid, in cells."""
        self._cell, self._shift = cell, np.array(shift)
        places = self._places(points)
        self._low, self._shape = places.min(axis=0), np.ptp(places, axis=0) + 1
        keys, which, count = np.unique(self._keys(places), return_inverse=True, return_counts=True)
        dimension = points.shape[1]
        mean = np.column_stack([np.bincount(which, column) for column in points.T]) / count[:, None]
        offset = points - mean[which]
        covariance = np.empty((len(keys), dimension, dimension))
        for i, j in itertools.product(range(dimension), repeat=2):
            covariance[:, i, j] = np.bincount(which, offset[:, i] * offset[:, j]) / np.maximum(count - 1, 1)
        enough = count >= LEAST[dimension]
        values, vectors = np.linalg.eigh(covariance[enough])
        values = np.maximum(values, np.maximum(FLATTEST[dimension] * values[:, -1:], 1e-6))
        self.keys, self.mean = keys[enough], mean[enough]
        self.inverse = np.einsum("nij,nj,nkj->nik", vectors, 1.0 / values, vectors)

    def _places(self, points: FloatArray) -> NDArray[np.int64]:
        return np.floor(points / self._cell + self._shift).astype(np.int64)

    def _keys(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.ravel_multi_index(tuple((places - self._low).T), tuple(self._shape))

    def at(self, points: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Which points lie in a known cell, (k,), their offsets from its mean and its inverse covariance."""
        places = self._places(points)
        inside = np.flatnonzero(((places >= self._low) & (places < self._low + self._shape)).all(axis=1))
        if not len(self.keys):
            inside = inside[:0]
        keys = self._keys(places[inside])
        index = np.searchsorted(self.keys[:-1], keys)
        known = self.keys[index] == keys
        inside, index = inside[known], index[known]
        return inside, points[inside] - self.mean[index], self.inverse[index]


def grids_of(points: FloatArray, cell: float) -> list[Gaussians]:
    """The 2^D grids of `points` (N, D) that overlap by half a cell."""
    return [Gaussians(points, cell, shift) for shift in itertools.product((0.0, 0.5), repeat=points.shape[1])]


def among_outliers(cell: float) -> float:
    """Magnusson's d for cells of `cell` metres.

    The score then matches -log(c₁ exp(-½ q) + c₂) where q is 0, 1 and infinite.
    """
    c1, c2 = 10.0 * (1.0 - OUTLIERS), OUTLIERS / cell**3
    height = np.log(c1 + c2) - np.log(c2)
    return float(-2.0 * np.log((np.log(c1 * np.exp(-0.5) + c2) - np.log(c2)) / height))


def derivatives(
    grids: list[Gaussians], placed: FloatArray, width: float = 1.0
) -> tuple[float, FloatArray, FloatArray]:
    """Score of points (N, D) in the target's frame; gradient and curvature of its negative by a motion of them.

    The motion is (x, y, turn) or (x, y, z, turn about x, y, z), in the target's frame and about its origin.
    width : d of the score.
    """
    size = 3 if placed.shape[1] == 2 else 6
    score, g, H = 0.0, np.zeros(size), np.zeros((size, size))
    for grid in grids:
        inside, offset, inverse = grid.at(placed)
        pull = width * np.einsum("nij,nj->ni", inverse, offset)
        weight = np.exp(-0.5 * np.minimum(np.einsum("ni,ni->n", offset, pull), 80.0))
        jacobian = _jacobian(placed[inside])
        weighted = (width * weight)[:, None, None] * (inverse @ jacobian)
        score += float(weight.sum())
        g += np.einsum("nik,ni->k", weighted, offset)
        H += np.tensordot(jacobian, weighted, axes=((0, 1), (0, 1)))
    return score, g, H


def _jacobian(points: FloatArray) -> FloatArray:
    """(N, D, 3 | 6) of points (N, D) by a small motion of them."""
    n, dimension = points.shape
    jacobian = np.zeros((n, dimension, 3 if dimension == 2 else 6))
    jacobian[:, range(dimension), range(dimension)] = 1.0
    if dimension == 2:
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -points[:, 1], points[:, 0]
    else:
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            jacobian[:, i, 3 + j], jacobian[:, i, 3 + k] = points[:, k], -points[:, j]
    return jacobian


def newton(grids: list[Gaussians], placed: FloatArray, width: float = 1.0) -> FloatArray | None:
    """Motion (3,) or (6,) of the points that raises the score; None where no point lies in a known cell."""
    score, g, H = derivatives(grids, placed, width)
    return np.asarray(-np.linalg.lstsq(H, g, rcond=1e-9)[0]) if score > 0.0 else None


def ndt_clouds(
    source: FloatArray, target: FloatArray, start: FloatArray, leaf: float
) -> tuple[FloatArray, bool]:
    """Transform (4, 4) of `source` (N, 3) onto `target` (M, 3) from `start`, and whether it settled.

    Both evenly dense: where a scanner crowds points around itself, its own place is all they speak for.
    leaf : metres, the finest voxel; cells are multiples of it.
    """
    transform, settled = start.copy(), False
    for size in CELLS:
        grids, width = grids_of(target, size * leaf), among_outliers(size * leaf)
        settled = False
        for _ in range(ITERATIONS):
            move = newton(grids, source @ transform[:3, :3].T + transform[:3, 3], width)
            if move is None:
                return transform, False
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = Rotation.from_rotvec(move[3:]).as_matrix(), move[:3]
            transform = step @ transform
            if np.abs(move).max() < STEP:
                settled = True
                break
    return transform, settled

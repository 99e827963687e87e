"""Errors of trajectories: absolute (ATE), and the Freiburg relations metric."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_points, as_vectors
from estimation.errors import InputError
from estimation.geometry.poses import pose_to_matrix


@dataclass(frozen=True)
class TrajectoryErrors:
    """Distances (N,), m, of a trajectory to its reference after `transform` was applied to the trajectory."""

    errors: FloatArray
    transform: FloatArray

    @cached_property
    def rmse(self) -> float:
        """Root mean square, m."""
        return math.sqrt(float((self.errors**2).mean()))

    @cached_property
    def mean(self) -> float:
        """Mean, m."""
        return float(self.errors.mean())

    @cached_property
    def max(self) -> float:
        """Largest, m."""
        return float(self.errors.max())


@dataclass(frozen=True)
class RelationErrors:
    """The Freiburg metric: mean and standard deviation of |translational| (m) and |rotational| (rad) error.

    `translation` and `rotation` (M,) hold the single errors, NaN where a stamp had no partner; `used` and
    `skipped` count the relations. The standard deviation is that of the population, as in the benchmark.
    """

    translation: FloatArray
    rotation: FloatArray

    @property
    def used(self) -> int:
        """Relations both of whose stamps were found."""
        return int(np.isfinite(self.translation).sum())

    @property
    def skipped(self) -> int:
        """Relations left out because a stamp has no pose within the tolerance."""
        return int(np.isnan(self.translation).sum())

    @property
    def translation_mean(self) -> float:
        """m."""
        return float(np.nanmean(self.translation))

    @property
    def translation_std(self) -> float:
        """m."""
        return float(np.nanstd(self.translation))

    @property
    def rotation_mean(self) -> float:
        """rad."""
        return float(np.nanmean(self.rotation))


def _motions(T: FloatArray, pairs: npt.NDArray[np.int64]) -> FloatArray:
    return np.linalg.inv(T[pairs[:, 0]]) @ T[pairs[:, 1]]


def _magnitudes(T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Length of the translation and angle of the rotation of homogeneous matrices (M, d + 1, d + 1)."""
    size = T.shape[-1] - 1
    R = T[:, :size, :size]
    if size == 2:
        angle = np.abs(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    else:
        # atan2 of both parts: arccos of the trace alone loses half the digits of small angles.
        axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], -1)
        angle = np.arctan2(np.linalg.norm(axis, axis=-1), np.trace(R, axis1=1, axis2=2) - 1.0)
    return np.linalg.norm(T[:, :size, size], axis=-1), angle


def align_points(source: npt.ArrayLike, target: npt.ArrayLike) -> FloatArray:
    """Rigid transform (d + 1, d + 1) that brings points `source` (N, d) closest to `target`, d = 2 or 3.

    Umeyama 1991 without scale: a proper rotation even where a reflection would fit better. With all points
    on a line in 3D the roll about it is arbitrary.
    """
    source, target = as_points("source", source, 2, 3), as_points("target", target, 2, 3)
    if source.shape != target.shape or len(source) == 0:
        raise InputError(f"source and target must be equally many points, not {source.shape}, {target.shape}")
    size = source.shape[1]
    centre_s, centre_t = source.mean(0), target.mean(0)
    U, _, Vt = np.linalg.svd((target - centre_t).T @ (source - centre_s))
    sign = np.ones(size)
    sign[-1] = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    T = np.eye(size + 1)
    T[:size, :size] = (U * sign) @ Vt
    T[:size, size] = centre_t - T[:size, :size] @ centre_s
    return T


def absolute_trajectory_error(
    estimate: npt.ArrayLike, reference: npt.ArrayLike, align: bool = True
) -> TrajectoryErrors:
    """Distances between associated positions (N, 2) or (N, 3), after the best rigid alignment if `align`.

    A trajectory of SE(2) poses [x, y, yaw] must be passed as its positions, `poses[:, :2]`.
    """
    estimate, reference = as_points("estimate", estimate, 2, 3), as_points("reference", reference, 2, 3)
    if estimate.shape != reference.shape or len(estimate) == 0:
        raise InputError(
            f"estimate and reference must be equally many positions, not {estimate.shape}, {reference.shape}"
        )
    size = estimate.shape[1]
    T = align_points(estimate, reference) if align else np.eye(size + 1)
    moved = estimate @ T[:size, :size].T + T[:size, size]
    return TrajectoryErrors(np.linalg.norm(moved - reference, axis=1), T)


def associate(stamps: npt.ArrayLike, queries: npt.ArrayLike, tolerance: float) -> npt.NDArray[np.int64]:
    """Index (M,) of the nearest of the ascending `stamps` (N,) to each query (M,); -1 beyond tolerance, s."""
    stamps, queries = as_vectors("stamps", stamps), as_vectors("queries", queries)
    if stamps.ndim != 1 or queries.ndim != 1:
        raise InputError(f"stamps (N,) and queries (M,) expected, not {stamps.shape} and {queries.shape}")
    if len(stamps) == 0 or (np.diff(stamps) < 0).any():
        raise InputError("stamps must be ascending and not empty")
    if not tolerance >= 0.0:
        raise InputError(f"tolerance must be a number of at least 0, not {tolerance!r}")
    right = np.clip(np.searchsorted(stamps, queries), 1, max(len(stamps) - 1, 1))
    right = np.minimum(right, len(stamps) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(queries - stamps[left] <= stamps[right] - queries, left, right)
    return np.where(np.abs(stamps[nearest] - queries) <= tolerance, nearest, -1)


def relations_error(
    trajectory: npt.ArrayLike, relations: npt.ArrayLike, tolerance: float = 0.05
) -> RelationErrors:
    """Errors over given relations (Kümmerle et al. 2009): |trans| and |rot| of (x_j ⊖ x_i) ⊖ δ_ij.

    trajectory : (N, 4) [stamp, x, y, yaw] or (N, 7) [stamp, x, y, z, roll, pitch, yaw], stamps ascending, s.
    relations : (M, 5) [stamp_i, stamp_j, x, y, yaw] or (M, 8), the benchmark's form; of a 2D trajectory only
    x, y and yaw of these are used. tolerance : largest distance of a stamp to its nearest pose, s.
    Raises InputError where no relation can be used.
    """
    track = as_points("trajectory", trajectory, 4, 7)
    relation = as_points("relations", relations, 5, 8)
    if track.shape[1] == 7 and relation.shape[1] == 5:
        raise InputError("relations must have 8 columns for a trajectory in 3D")
    expected = relation[:, 2:] if track.shape[1] == 7 or relation.shape[1] == 5 else relation[:, [2, 3, 7]]
    pairs = np.stack([associate(track[:, 0], relation[:, k], tolerance) for k in (0, 1)], -1)
    found = (pairs >= 0).all(1)
    if not found.any():
        raise InputError(f"relations must have stamps within tolerance = {tolerance} s of the trajectory")
    motion = _motions(pose_to_matrix(track[:, 1:]), pairs[found])
    translation, rotation = _magnitudes(np.linalg.inv(pose_to_matrix(expected[found])) @ motion)
    out = np.full((2, len(relation)), np.nan)
    out[0, found], out[1, found] = translation, rotation
    return RelationErrors(out[0], out[1])

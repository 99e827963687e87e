"""Errors of the motions between the poses of a trajectory (relative pose error, RPE)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, require_positive
from estimation.errors import InputError
from estimation.geometry.poses import pose_from_matrix, pose_to_matrix
from estimation.metrics.trajectory_metrics import relations_error


@dataclass(frozen=True)
class PoseErrors:
    """Errors of relative poses: translation (M,), m; rotation (M,), rad, in [0, π]; `pairs` (M, 2)."""

    translation: FloatArray
    rotation: FloatArray
    pairs: npt.NDArray[np.int64]


def relative_pose_error(
    estimate: npt.ArrayLike,
    reference: npt.ArrayLike,
    delta: float = 1,
    unit: Literal["steps", "metres"] = "steps",
    all_pairs: bool = True,
) -> PoseErrors:
    """Errors of the motions between poses `delta` apart: (ref_i⁻¹ ref_j)⁻¹ (est_i⁻¹ est_j).

    estimate, reference : (N, 3) SE(2), (N, 6) SE(3) Euler, or homogeneous matrices (N, 3, 3), (N, 4, 4); m, rad.
    unit "steps": j = i + delta. unit "metres": j is the first pose whose path along the reference is at least
    delta from i. `all_pairs` starts a pair at every pose, else where the last one ended.
    Raises InputError for unequal lengths and where no pair is that far apart.
    """
    require_positive("delta", delta)
    est, ref = _matrices("estimate", estimate), _matrices("reference", reference)
    if est.shape != ref.shape:
        raise InputError(f"estimate and reference must be equally many poses, not {est.shape}, {ref.shape}")
    if unit == "steps":
        path = np.arange(len(ref), dtype=np.float64)
    elif unit == "metres":
        step = np.linalg.norm(np.diff(ref[:, :-1, -1], axis=0), axis=1)
        path = np.concatenate([[0.0], np.cumsum(step)])
    else:
        raise InputError(f"unit must be 'steps' or 'metres', not {unit!r}")
    # Rounding of the running sum must not push a pair exactly delta apart to the next pose.
    ends = np.searchsorted(path, path + delta * (1 - 1e-9))
    pairs: list[tuple[int, int]] = []
    start = 0
    while start < len(path) and ends[start] < len(path):
        pairs.append((start, int(ends[start])))
        start = start + 1 if all_pairs else int(ends[start])
    if not pairs:
        raise InputError(f"delta must be below the length of the trajectory, {path[-1]:g} {unit}")
    index = np.array(pairs, dtype=np.int64)
    # The reference's own motions are relations, and the numbers of poses their stamps.
    motions = pose_from_matrix(np.linalg.inv(ref[index[:, 0]]) @ ref[index[:, 1]])
    numbered = np.column_stack((np.arange(len(est)), pose_from_matrix(est)))
    found = relations_error(numbered, np.column_stack((index, motions)), 0.25)
    return PoseErrors(found.translation, found.rotation, index)


def _matrices(name: str, poses: npt.ArrayLike) -> FloatArray:
    array = as_finite(name, poses)
    if array.ndim == 2 and array.shape[1] in (3, 6):
        return pose_to_matrix(array)
    if array.ndim == 3 and array.shape[1:] in ((3, 3), (4, 4)):
        return array
    raise InputError(f"{name} must have shape (N, 3), (N, 6), (N, 3, 3) or (N, 4, 4), not {array.shape}")

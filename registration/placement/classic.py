"""The reference's planar methods (section 2.5), selectable and compared: ICP, point-to-line ICP, NDT.

All start from a close guess, use every point within a fixed distance and no robust kernel. What they end at is
judged and given its covariance like any other registration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from estimation.geometry.poses import compound, transform_points, wrap_angle
from registration.clouds.ndt import ITERATIONS, STEP, grids_of, newton
from registration.laser.prepared import PreparedScan
from registration.laser.rigid import rigid_motion
from registration.placement.refine import KERNEL, TUKEY, Refined, refine

REACH = 1.0  # metres within which points correspond
CELL = 1.0  # metres, edge of an NDT cell


def icp(moving: PreparedScan, still: PreparedScan, start: FloatArray) -> Refined:
    """Point-to-point ICP (Besl and McKay), the minimisation of (2.17) in closed form."""
    target = still.surface.points
    tree = cKDTree(target)

    def step(placed: FloatArray) -> FloatArray | None:
        near, index = _corresponding(placed, tree)
        return np.asarray(rigid_motion(placed[near], target[index])) if len(near) >= 3 else None

    return _iterate(moving, still, start, step)


def point_to_line(moving: PreparedScan, still: PreparedScan, start: FloatArray) -> Refined:
    """Point-to-line ICP (Chen and Medioni): distances are measured across the target's lines."""
    lined = still.surface.lined
    target, normals = still.surface.points[lined], still.surface.normals[lined]
    tree = cKDTree(target)

    def step(placed: FloatArray) -> FloatArray | None:
        near, index = _corresponding(placed, tree)
        if len(near) < 3:
            return None
        a, n = placed[near], normals[index]
        jacobian = np.column_stack((n, n[:, 1] * a[:, 0] - n[:, 0] * a[:, 1]))
        residual = np.einsum("ij,ij->i", n, a - target[index])
        return np.asarray(-np.linalg.lstsq(jacobian, residual, rcond=1e-6)[0])

    return _iterate(moving, still, start, step)


def _corresponding(placed: FloatArray, tree: cKDTree) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which of the points (N, 2) have one of the target within REACH, (k,), and which that is, (k,)."""
    distance, index = tree.query(placed, distance_upper_bound=REACH)
    near = np.flatnonzero(np.isfinite(distance))
    return near, index[near]


def ndt(moving: PreparedScan, still: PreparedScan, start: FloatArray) -> Refined:
    """Normal distributions transform (Biber and Strasser): four overlapping grids of Gaussians."""
    grids = grids_of(still.surface.points, CELL) if len(still.surface) else []
    return _iterate(moving, still, start, lambda placed: newton(grids, placed))


def _iterate(
    moving: PreparedScan,
    still: PreparedScan,
    start: FloatArray,
    step: Callable[[FloatArray], FloatArray | None],
) -> Refined:
    """Apply `step`, a motion in the target frame of the points (N, 2) as they are placed, until it is nothing."""
    pose, settled = start.copy(), False
    if not len(moving.surface) or not still.surface.lined.any():
        return refine(moving.surface, still.target, pose, most=1)
    for _ in range(ITERATIONS):
        move = step(transform_points(pose, moving.surface.points))
        if move is None:
            break
        pose = compound(move, pose)
        if np.abs(move).max() < STEP:
            settled = True
            break
    pose[2] = wrap_angle(pose[2])
    # One look at the lines around the outcome gives its information; the pose stays what the method found.
    found = refine(moving.surface, still.target, pose.copy(), TUKEY * KERNEL, most=1)
    return replace(found, pose=pose, settled=settled)


CLASSIC = {"icp": icp, "point_to_line": point_to_line, "ndt": ndt}

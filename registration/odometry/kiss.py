"""Odometry on KISS-ICP: point-to-point registration against a voxel map.

Made for 3D clouds; planar scans are lifted to z = 0 for comparison. KISS-ICP gives a pose only. The
covariance here is that of point-to-plane residuals at the solution (plane normals of the cloud itself), so
a tunnel or a single wall shows as a large variance along what it leaves open.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from estimation.errors import InputError
from registration.clouds.cloud_doubt import OPEN_VARIANCE
from registration.odometry.odometry_step import Step

MINIMUM_POINTS = 10
NEIGHBOURS = 8
OPENED = 0.25  # of the variance of what is open, in one direction, from which on that is
COVARIANCE_POINTS = 700


class KissTracker:
    """Follows clouds (N, 3) against KISS-ICP's map.

    Parameters
    ----------
    max_range, voxel_size : metres. noise : standard deviation of a point against the map, metres.
    static_distance : a point this close to the previous cloud is static, metres.
    """

    def __init__(self, max_range: float, voxel_size: float, noise: float, static_distance: float) -> None:
        # Imported here: a user of planar scans needs neither the library nor the time to load it.
        from kiss_icp.config import KISSConfig
        from kiss_icp.config.config import DataConfig, MappingConfig, RegistrationConfig
        from kiss_icp.kiss_icp import KissICP

        self._engine = KissICP(
            KISSConfig(
                data=DataConfig(max_range=max_range, min_range=0.0, deskew=True),
                mapping=MappingConfig(voxel_size=voxel_size),
                # With more, sums are added up in another order each time.
                registration=RegistrationConfig(max_num_threads=1),
            )
        )
        self._noise = noise
        self._static_distance = static_distance
        self._previous: cKDTree | None = None
        self._blind = 0  # clouds in a row that could not be registered

    def step(self, cloud: FloatArray, guess: FloatArray | None, times: FloatArray | None) -> Step:
        """Register one cloud (N, 3) metres.

        guess : (4, 4) expected motion; times : (N,) in [0, 1], when in the sweep each point was measured.
        """
        engine = self._engine
        if guess is not None:
            engine.last_delta = _rigid(guess)
        predicted, before = engine.last_delta, engine.last_pose
        reason = f"only {len(cloud)} points; at least {MINIMUM_POINTS} are needed"
        frame = source = np.empty((0, 3))
        if len(cloud) >= MINIMUM_POINTS:
            registered = engine.register_frame(cloud, np.empty(0) if times is None else times)
            frame, source = (np.asarray(points) for points in registered)
            reason = "no point is within the longest range"
        if not len(source):
            engine.last_pose = _rigid(before @ predicted)
            reason += ": the pose is predicted"
            self._blind += 1
            # The doubt is gone once a cloud is laid on the map again.
            doubt, lasting = OPEN_VARIANCE * np.eye(6), np.zeros((6, 6))
            return Step(predicted.copy(), doubt, False, reason, 0.0, cloud[:0], lasting, self._blind * doubt)
        doubt_before, self._blind = self._blind * OPEN_VARIANCE * np.eye(6), 0
        previous, self._previous = self._previous, cKDTree(source)
        if previous is None:
            return Step(np.eye(4), np.zeros((6, 6)), True, "", 1.0, frame)
        increment = np.linalg.inv(before) @ engine.last_pose
        static, fitness = self._support(frame, source, increment, previous)
        covariance, reason = self._covariance(source, increment)
        if not reason and fitness < 0.3:
            reason = f"only {fitness:.0%} of the points agree with the previous cloud"
        return Step(increment, covariance + doubt_before, not reason, reason, fitness, static, covariance)

    def _support(
        self, frame: FloatArray, source: FloatArray, increment: FloatArray, previous: cKDTree
    ) -> tuple[FloatArray, float]:
        """Points of `frame` near the previous cloud, and the share of `source` that is.

        Only `source` is compared point by point; the frame's points go with the voxel they are in.
        """
        size = 1.5 * self._engine.config.mapping.voxel_size
        limit = max(self._static_distance, 2.0 * self._engine.config.mapping.voxel_size)
        moved = source @ increment[:3, :3].T + increment[:3, 3]
        distance, _ = previous.query(moved, distance_upper_bound=limit)
        near = np.isfinite(distance)
        return frame[_in_voxels(frame, source[near], size)], float(np.mean(near))

    def _covariance(self, source: FloatArray, increment: FloatArray) -> tuple[FloatArray, str]:
        points = source[:: max(1, len(source) // COVARIANCE_POINTS)]
        information = point_to_plane_information(points, self._noise)
        if not np.ptp(points[:, 2]):
            # A scan lifted to z = 0: what leaves the plane is not estimated, hence not open either.
            information[[2, 3, 4], [2, 3, 4]] = 1.0 / self._noise**2
        values, vectors = np.linalg.eigh(information)
        variances = 1.0 / np.maximum(values, 1.0 / OPEN_VARIANCE)
        covariance = (vectors * variances) @ vectors.T
        turn = np.kron(np.eye(2), increment[:3, :3])
        covariance = turn @ covariance @ turn.T
        if variances.max() > OPENED * OPEN_VARIANCE:
            return covariance, "the points leave a direction of motion open"
        return covariance, ""


def _rigid(matrix: FloatArray) -> FloatArray:
    """A motion (4, 4) without what rounding has added; the engine ends the process for a rotation that is none.

    Raises
    ------
    InputError : it is far from rigid.
    """
    left, scales, right = np.linalg.svd(matrix[:3, :3])
    if not (np.abs(scales - 1.0) < 1e-3).all() or np.linalg.det(left @ right) < 0.0:
        raise InputError("guess: a rotation and a translation expected")
    made = matrix.copy()
    made[:3, :3] = left @ right
    return made


def _in_voxels(points: FloatArray, marked: FloatArray, size: float) -> NDArray[np.bool_]:
    """Which `points` (N, 3) share a voxel of `size` metres with one of `marked` (M, 3)."""
    if not len(marked):
        return np.zeros(len(points), dtype=np.bool_)
    low = marked.min(axis=0)
    extent = np.floor((marked.max(axis=0) - low) / size).astype(np.int64) + 1
    strides = np.array([extent[1] * extent[2], extent[2], 1])
    # One row of zeros at the end answers for points outside.
    table = np.zeros(int(np.prod(extent)) + 1, dtype=np.bool_)
    table[np.floor((marked - low) / size).astype(np.int64) @ strides] = True
    cells = np.floor((points - low) / size).astype(np.int64)
    inside = ((cells >= 0) & (cells < extent)).all(axis=1)
    return np.asarray(table[np.where(inside, cells @ strides, len(table) - 1)])


def point_to_plane_information(points: FloatArray, noise: float) -> FloatArray:
    """Fisher information (6, 6) of a small motion of `points` (N, 3) m against their own planes.

    Motion is (x, y, z, rotation about x, y, z) in the points' frame; `noise` is the standard deviation of a
    point off its plane, metres. In points that all lie at one height the planes are upright.
    """
    if len(points) <= NEIGHBOURS:
        return np.zeros((6, 6))
    _, index = cKDTree(points).query(points, k=NEIGHBOURS)
    around = points[index] - points[index].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    normals = axes[:, :, 0 if np.ptp(points[:, 2]) else 1]
    jacobian = np.hstack((normals, np.cross(points, normals)))
    return jacobian.T @ jacobian / noise**2

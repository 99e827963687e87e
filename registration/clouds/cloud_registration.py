"""Registration of clouds from a guess, coarse to fine: generalised ICP by small_gicp, or the text's 3D NDT."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray, as_floats
from estimation.errors import InputError
from registration.clouds.cloud_doubt import OPEN_VARIANCE, doubt, kept
from registration.clouds.ndt import ndt_clouds
from registration.result import Registration

LEAST_POINTS = 100
LEAST_FITNESS = 0.4
# Of points that their planes are made of. Those of a scanner of 16 or 32 rings are single rings with ten, and rings lie
# on each other wherever the walls are; where points are dense, ten lie within their noise.
NEIGHBOURS = (10, 15, 20, 30, 60)
# Of the squared extents of a plane: the lesser over the larger from which on it is no line, and its thickness over the
# lesser from which on it is no plane.
WIDE, THICK = 0.1, 0.05
SAMPLE = 1000  # points at which that is measured
EVEN = 5.0  # edge of the voxels that NDT has one point of each, in units of the finest
# Ways from a guess to the end: voxel edges in units of the finest, and metres within which points correspond.
SCHEDULES = (
    ((8.0, 2.0), (4.0, 1.0), (1.0, 1.0)),
    ((2.0, 3.0), (2.0, 1.0), (1.0, 1.0)),
    ((1.0, 3.0), (1.0, 0.3), (1.0, 1.0)),
    ((1.0, 1.0),),
)


def checked_cloud(name: str, cloud: NDArray[np.float64]) -> FloatArray:
    """(N, 3) float64, what is not finite dropped."""
    points = as_floats(name, cloud)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{name}: array (N, 3) expected, got shape {points.shape}")
    return np.ascontiguousarray(points[np.isfinite(points).all(axis=1)])


def leaf_size(cloud: FloatArray) -> float:
    """Voxel edge for a cloud, metres: a six-hundredth of its extent, between 2 cm and 0.3 m."""
    low, high = np.quantile(cloud, (0.02, 0.98), axis=0)
    return float(np.clip(np.linalg.norm(high - low) / 600.0, 0.02, 0.3))


def too_few(source: FloatArray, target: FloatArray, start: FloatArray) -> Registration | None:
    """A refusal where a cloud has too few distinct points, else None."""
    for name, cloud in (("source", source), ("target", target)):
        distinct = _distinct(cloud[:: max(1, len(cloud) // SAMPLE)])
        if distinct < LEAST_POINTS:
            distinct = _distinct(cloud)
        if distinct < LEAST_POINTS:
            reason = f"{name} has {distinct} distinct points; at least {LEAST_POINTS} are needed"
            return Registration(start, OPEN_VARIANCE * np.eye(6), 0.0, False, reason)
    return None


def _distinct(cloud: FloatArray) -> int:
    return len(np.unique(np.round(cloud, 3), axis=0))


def align_clouds(
    source: FloatArray, target: FloatArray, start: FloatArray, close: bool = False
) -> Registration:
    """GICP of `source` on `target` (N, 3) metres from `start` (4, 4), which is within decimetres where `close`."""
    moving, still = checked_cloud("source", source), checked_cloud("target", target)
    refusal = too_few(moving, still, start)
    if refusal is not None:
        return refusal
    leaf, tree = leaf_size(still), cKDTree(still)
    schedules = SCHEDULES[1 if close else 0 :]
    sizes = {size for schedule in schedules for size, _ in schedule}
    surfaces = {size: _surfaces(moving, still, size * leaf) for size in sizes}
    best: tuple[float, FloatArray, bool] | None = None
    for schedule in schedules:
        transform = start
        for size, near in schedule:
            outcome = _gicp(surfaces[size], transform, near)
            transform = np.asarray(outcome.T_target_source)
        # A wrong minimum a degree away looks nearly as good: only a close look tells.
        score = -_distance(moving, tree, transform, 3.0 * leaf)
        if best is None or score > best[0]:
            best = score, transform, bool(outcome.converged)
    assert best is not None
    return _judged((moving, still), surfaces[1.0], leaf, start, best[1], best[2])


def align_clouds_ndt(source: FloatArray, target: FloatArray, start: FloatArray) -> Registration:
    """As `align_clouds` by the normal distributions transform, which the paper has in its place."""
    moving, still = checked_cloud("source", source), checked_cloud("target", target)
    refusal = too_few(moving, still, start)
    if refusal is not None:
        return refusal
    leaf = leaf_size(still)
    edge = EVEN * leaf
    transform, settled = ndt_clouds(thin(moving, edge), thin(still, edge), start, leaf)
    return _judged((moving, still), _surfaces(moving, still, leaf), leaf, start, transform, settled)


def _judged(
    clouds: tuple[FloatArray, FloatArray],
    surfaces: tuple[Any, Any, Any],
    leaf: float,
    start: FloatArray,
    transform: FloatArray,
    settled: bool,
) -> Registration:
    """What a `transform` (4, 4) of the first of `clouds` amounts to; what is open stays as at the `start`."""
    covariance, opened = doubt(*surfaces[:2], transform)
    if len(opened):
        settled = True  # along what is open it may slide for ever, but goes nowhere now
        transform = kept(start, transform, opened)
        covariance, _ = doubt(*surfaces[:2], transform, opened)
    fitness = overlap(*clouds, transform, 3.0 * leaf)
    reason = "the clouds leave a direction of motion open" if len(opened) else ""
    if not settled:
        reason = "the iterations did not settle"
    elif fitness < LEAST_FITNESS:
        reason = f"only {fitness:.0%} of the source overlaps the target"
    return Registration(transform, covariance, fitness, settled and fitness >= LEAST_FITNESS, reason)


def _surfaces(source: FloatArray, target: FloatArray, leaf: float) -> tuple[Any, Any, Any]:
    """Both clouds (N, 3) as small_gicp takes them, one point per voxel of `leaf` metres; the target's search tree."""
    # Imported here: planar registration needs neither the library nor the time to load it.
    import small_gicp

    count = _neighbours(target, leaf)
    still, tree = small_gicp.preprocess_points(target, downsampling_resolution=leaf, num_neighbors=count)
    moving, _ = small_gicp.preprocess_points(source, downsampling_resolution=leaf, num_neighbors=count)
    return moving, still, tree


def _gicp(surfaces: tuple[Any, Any, Any], start: FloatArray, near: float, most: int = 60) -> Any:
    import small_gicp

    moving, still, tree = surfaces
    return small_gicp.align(
        still,
        moving,
        tree,
        init_T_target_source=start,
        registration_type="GICP",
        max_correspondence_distance=near,
        max_iterations=most,
        translation_epsilon=1e-4,
        rotation_epsilon=1e-4,
    )


def _neighbours(cloud: FloatArray, leaf: float) -> int:
    """How many points around each its plane is made of: as few as make planes, no lines of a ring, no lumps."""
    points = thin(cloud, leaf)
    sample, tree = points[:: max(1, len(points) // SAMPLE)], cKDTree(points)
    for count in NEIGHBOURS[:-1]:
        _, index = tree.query(sample, k=min(count, len(points)))
        around = points[index] - points[index].mean(axis=1, keepdims=True)
        spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", around, around))
        thickness, width = (spread[:, :2] / np.maximum(spread[:, 1:], 1e-12)).T
        if np.quantile(width, 0.25) > WIDE and np.median(thickness) < THICK:
            return count
    return NEIGHBOURS[-1]


def polish(
    source: FloatArray, target: FloatArray, start: FloatArray, leaf: float, near: float
) -> tuple[FloatArray, bool]:
    """One GICP of thinned clouds (N, 3) from `start` (4, 4), and whether it settled.

    leaf : metres, voxel edge. near : metres within which points correspond.
    """
    outcome = _gicp(_surfaces(source, target, leaf), start, near)
    return np.asarray(outcome.T_target_source), bool(outcome.converged)


def overlap(source: FloatArray, target: FloatArray, transform: FloatArray, near: float) -> float:
    """Share of the source's voxels within `near` metres of the target, of those inside the target's extent."""
    placed = thin(source, near) @ transform[:3, :3].T + transform[:3, 3]
    low, high = target.min(axis=0) - near, target.max(axis=0) + near
    inside = placed[((placed >= low) & (placed <= high)).all(axis=1)]
    if len(inside) < 0.1 * len(placed):
        return 0.0
    distance, _ = cKDTree(target).query(inside, distance_upper_bound=near)
    return float(np.isfinite(distance).mean())


def _distance(source: FloatArray, target: cKDTree, transform: FloatArray, most: float) -> float:
    """Mean distance of the source's points from the target's, each counted up to `most` metres."""
    placed = source[:: max(1, len(source) // 10000)] @ transform[:3, :3].T + transform[:3, 3]
    distance, _ = target.query(placed, distance_upper_bound=most)
    return float(np.minimum(distance, most).mean())


def thin(cloud: FloatArray, leaf: float) -> FloatArray:
    """One point per voxel of `leaf` metres, (M, 3), of points (N, 3)."""
    cells = np.floor(cloud / leaf)
    low = cells.min(axis=0, initial=np.inf)
    extent = cells.max(axis=0, initial=-np.inf) - low + 1.0
    if len(cloud) and np.prod(extent) < 2.0**53:
        # One number each is sorted in a tenth of the time.
        cells = (cells - low) @ np.array([extent[1] * extent[2], extent[2], 1.0])
    _, first = np.unique(cells, axis=0, return_index=True)
    return cloud[np.sort(first)]

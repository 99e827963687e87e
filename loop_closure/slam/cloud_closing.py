"""Closures between clouds: a few keyframes' clouds fused and laid on others, and judged by overlap both ways.

Where the place is known to a metre or two, GICP goes on from there; where it is not, KISS-Matcher finds the rough
motion first (`registration.placement.align_globally`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_floats
from estimation.errors import InputError
from loop_closure.graph.edges import Edge
from loop_closure.keyframes import AROUND, Keyframes
from loop_closure.motions import invert, length, motion, orthonormal, turn
from registration.clouds.cloud_registration import align_clouds, overlap, polish, thin
from registration.clouds.feature_matching import match_features
from registration.placement.align_globally import align_globally

NEAR_ENOUGH = 1.5  # metres of standard deviation up to which a refinement finds its way
LEAST_FITNESS = 0.75  # share of the lesser overlap
CLOSE = 0.5  # metres within which points agree
LEAST_STANDING = 0.5  # the same of what stands upright: flat ground agrees with all flat ground
CLOSE_STANDING = 0.3
# Metres: edge of a column, and height from lowest to highest point from which it stands.
COLUMN, TALL = 0.5, 0.5
LEAST_POINTS = 200
SURE = 0.6  # both, of a placement in a finished map that is believed
FEATURE = 0.8  # metres, voxel edge of the features that clouds are matched by without a guess
LEAST_FEATURES = 10  # that have to correspond
FLOOR = np.array([0.02, 0.02, 0.03, 0.002, 0.002, 0.002])  # m and rad: what bent local clouds leave
LEAF = 0.25  # metres, voxel of a local cloud


def thinned(points: FloatArray, leaf: float = LEAF) -> FloatArray:
    """One point per voxel of `leaf` metres, (M, 3); what is not finite is dropped."""
    return np.ascontiguousarray(thin(points[np.isfinite(points).all(axis=1)], leaf))


def local_cloud(keyframes: Keyframes, k: int, back: float, fore: float) -> FloatArray:
    """Clouds of the path around keyframe `k` in its frame, (N, 3)."""
    first, last = keyframes.window(k, back, fore)
    parts = []
    for n in range(first, last + 1):
        points = keyframes[n].points
        assert points is not None
        step = motion(keyframes[k].odometry, keyframes[n].odometry)
        parts.append(points @ step[:3, :3].T + step[:3, 3])
    return thinned(np.concatenate(parts))


def polished_step(keyframes: Keyframes, points: FloatArray, step: FloatArray) -> FloatArray | None:
    """The motion (4, 4) from the last keyframe to a cloud (N, 3) taken `step` from it, laid on the path behind.

    Odometry of sparse clouds starts slowly and slips where it turns; None where the clouds do not say more.
    """
    target = local_cloud(keyframes, len(keyframes) - 1, AROUND, 0.0)
    if min(len(points), len(target)) < LEAST_POINTS:
        return None
    found = _settled(points, target, step)
    if found is None:
        return None
    off = motion(step, found)
    return found if length(off) < 0.8 and turn(off) < 0.2 else None


def _settled(source: FloatArray, target: FloatArray, guess: FloatArray) -> FloatArray | None:
    """`guess` (4, 4) refined, from far and then from near; None where that does not settle."""
    found, settled = polish(source, target, guess, LEAF, 1.5)
    found, settled = polish(source, target, found, LEAF, CLOSE) if settled else (found, False)
    return orthonormal(found) if settled and np.isfinite(found).all() else None


def lay(
    keyframes: Keyframes, j: int, k: int, guess: FloatArray, sigma: float, allowed: float
) -> tuple[Edge, float] | None:
    """Closure of keyframes `j` and `k` and its fitness; None where it cannot be believed.

    guess : (4, 4) of k in the frame of j. sigma : metres, how far it may be off. allowed : metres from the guess.
    """
    source = local_cloud(keyframes, k, AROUND, 0.0)
    target = local_cloud(keyframes, j, AROUND, AROUND)
    if min(len(source), len(target)) < LEAST_POINTS:
        return None
    if sigma <= NEAR_ENOUGH:
        found = align_clouds(source, target, guess, close=sigma < 0.5)
    else:
        found = align_globally(source, target)
    relative = orthonormal(found.transform)
    off = motion(guess, relative)
    if not found.converged or length(off) > allowed or turn(off) > 0.8:
        return None
    fitness = common(source, target, relative)
    if fitness < LEAST_FITNESS or common_standing(source, target, relative) < LEAST_STANDING:
        return None
    covariance = found.covariance + np.diag(FLOOR**2)
    return Edge(j, k, relative, 0.5 * (covariance + covariance.T), True), fitness


def common(source: FloatArray, target: FloatArray, relative: FloatArray, near: float = CLOSE) -> float:
    """The lesser overlap of two clouds, in [0, 1], `source` being at `relative` (4, 4)."""
    return min(overlap(source, target, relative, near), overlap(target, source, invert(relative), near))


def standing(points: FloatArray) -> FloatArray:
    """Points (M, 3) of columns along z that reach from low to high: walls, poles, trees, and no ground."""
    if not len(points):
        return points
    cells = np.floor(points[:, :2] / COLUMN).astype(np.int64)
    cells -= cells.min(axis=0)
    _, column = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True)
    low, high = (np.full(column.max() + 1, sign * np.inf) for sign in (1.0, -1.0))
    np.minimum.at(low, column, points[:, 2])
    np.maximum.at(high, column, points[:, 2])
    return points[(high - low)[column] > TALL]


def common_standing(source: FloatArray, target: FloatArray, relative: FloatArray) -> float:
    """`common` of what stands upright; 0 where too little does to tell."""
    upright = standing(source), standing(target)
    if min(len(part) for part in upright) < LEAST_POINTS:
        return 0.0
    return common(*upright, relative, CLOSE_STANDING)


def nearby(source: FloatArray, target: FloatArray, guess: FloatArray) -> tuple[FloatArray, float] | None:
    """Pose (4, 4) of cloud `source` in the frame of `target`, from one about a metre off, and how well both agree."""
    if min(len(source), len(target)) < LEAST_POINTS:
        return None
    found = _settled(source, target, guess)
    if found is None:
        return None
    everything, upright = common(source, target, found), common_standing(source, target, found)
    return (found, upright) if everything >= SURE and upright >= SURE else None


def anywhere(source: FloatArray, target: FloatArray) -> tuple[FloatArray, float] | None:
    """The same without a guess: by features that correspond."""
    if min(len(source), len(target)) < LEAST_POINTS:
        return None
    match = match_features(source, target, FEATURE)
    if match is None or match.inliers < LEAST_FEATURES:
        return None
    return nearby(source, target, match.transform)


def as_cloud(cloud: npt.ArrayLike) -> FloatArray:
    """`cloud` as an array (N, 3); InputError for another shape."""
    points = as_floats("scan", cloud)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"scan: Scan or cloud (N, 3) expected, got shape {points.shape}")
    return points

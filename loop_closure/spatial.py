"""Closures between clouds: a few keyframes' clouds fused and laid on others, and judged by overlap both ways.

Where the place is known to a metre or two, GICP goes on from there; where it is not, KISS-Matcher finds the rough
motion first (`registration.align_globally`).
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from loop_closure.graph import Edge
from loop_closure.keyframes import Keyframes
from loop_closure.motions import invert, length, motion, orthonormal, turn
from registration.align_globally import align_globally
from registration.result import Registration
from registration.spatial import align_clouds, overlap, polish

BACK, AROUND = 4.0, 4.0  # metres of path in the newer and to either side in the older local cloud
NEAR_ENOUGH = 1.5  # metres of standard deviation up to which a refinement finds its way
LEAST_FITNESS = 0.75  # share of the lesser overlap
CLOSE = 0.5  # metres within which points agree
FLOOR = np.array([0.02, 0.02, 0.03, 0.002, 0.002, 0.002])  # m and rad: what bent local clouds leave
LEAF = 0.25  # metres, voxel of a local cloud


def thinned(points: FloatArray, leaf: float = LEAF) -> FloatArray:
    """One point per voxel of `leaf` metres, (M, 3); what is not finite is dropped."""
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return finite
    _, first = np.unique(np.floor(finite / leaf).astype(np.int64), axis=0, return_index=True)
    return np.ascontiguousarray(finite[np.sort(first)])


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
    target = local_cloud(keyframes, len(keyframes) - 1, BACK, 0.0)
    if min(len(points), len(target)) < 200:
        return None
    found, settled = polish(points, target, step, LEAF, 1.5)
    found, settled = polish(points, target, found, LEAF, 0.5) if settled else (found, False)
    found = orthonormal(found)
    off = motion(step, found)
    return found if settled and length(off) < 0.8 and turn(off) < 0.2 else None


def lay(
    keyframes: Keyframes, j: int, k: int, guess: FloatArray, sigma: float, allowed: float
) -> tuple[Edge, float] | None:
    """Closure of keyframes `j` and `k` and its fitness; None where it cannot be believed.

    guess : (4, 4) of k in the frame of j. sigma : metres, how far it may be off. allowed : metres from the guess.
    """
    source = local_cloud(keyframes, k, BACK, 0.0)
    target = local_cloud(keyframes, j, AROUND, AROUND)
    if min(len(source), len(target)) < 200:
        return None
    found: Registration
    if sigma <= NEAR_ENOUGH:
        found = align_clouds(source, target, guess, close=sigma < 0.5)
    else:
        found = align_globally(source, target)
    relative = orthonormal(found.transform)
    off = motion(guess, relative)
    if not found.converged or length(off) > allowed or turn(off) > 0.8:
        return None
    fitness = min(
        overlap(source, target, relative, CLOSE),
        overlap(target, source, invert(relative), CLOSE),
    )
    if fitness < LEAST_FITNESS:
        return None
    covariance = found.covariance + np.diag(FLOOR**2)
    return Edge(j, k, relative, 0.5 * (covariance + covariance.T), True), fitness

"""Objects behind others of known size, or out of a camera's view: absence says nothing (section 2.5.2, (2.10))."""

from __future__ import annotations

import numba
import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import ndtr

from estimation.checks import FloatArray
from world_model.anchoring.attributes import FLATTEST, Quantities
from world_model.anchoring.loops.leaves import MOVING, REST, IntArray, Leaves
from world_model.camera.view import CameraView

SMALL = 0.05  # m: width and height of an object whose size is not known
SURELY = 0.9
FARTHEST = 3.0  # Standard deviations beyond a body at which nothing is within it
LEAST_SIGMA = 0.01


def hide(
    leaves: Leaves,
    chosen: IntArray,
    count: int,
    clear: FloatArray,
    sensor: FloatArray,
    quantities: Quantities,
) -> None:
    """Lower the probability `clear` (n,) of being in view of leaves that others cover, in place.

    sensor (8,) as in `clearance`. What covers is surely there, and of a size that was measured.
    """
    here = leaves.behavior[:, REST] + leaves.behavior[:, MOVING]
    covers = np.flatnonzero((leaves.track >= 0) & (here > SURELY))
    covers = covers[quantities.told(leaves, covers, "size")[1]]
    if len(covers) == 0:
        return
    own = np.full((len(leaves.track), 2), SMALL)
    own[covers] = extents(leaves, covers, quantities).T
    _cover(leaves, chosen[:count], clear, covers, own, sensor)


def restrict(
    leaves: Leaves, chosen: IntArray, clear: FloatArray, view: CameraView, quantities: Quantities
) -> None:
    """Lower the probability `clear` of being in view of the leaves `chosen` (n,) as a view tells, in place."""
    index = np.flatnonzero(clear[: len(chosen)] > 0.0)
    positions, variances = spots(leaves, chosen[index])
    size, known = quantities.told(leaves, chosen[index], "size")
    sizes = np.where(known, np.maximum(size, SMALL), quantities.small("size"))
    clear[index] *= view.seen(positions, np.sqrt(variances), sizes)


def free(
    leaves: Leaves, slots: IntArray, positions: FloatArray, covariances: FloatArray, quantities: Quantities
) -> FloatArray:
    """Probability (M,) that what is at positions (M, 3) is outside of the bodies of the leaves `slots`.

    The middles of two things are no nearer to each other than the smaller side of one; whose size nobody measured is
    small.
    """
    result = np.ones(len(positions))
    if "size" not in quantities.names or len(slots) == 0 or len(positions) == 0:
        return result
    side = extents(leaves, slots, quantities).min(0)
    middle, spread = spots(leaves, slots)
    away = cdist(middle, positions)
    blur = np.sqrt(spread[:, None] + covariances.diagonal(axis1=1, axis2=2).max(1))
    body, at = np.nonzero(away < side[:, None] + FARTHEST * blur)
    off, width, scale = away[body, at], side[body], blur[body, at]
    inside = ndtr((width - off) / scale) - ndtr((-width - off) / scale)
    here = leaves.behavior[slots, REST] + leaves.behavior[slots, MOVING]
    np.multiply.at(result, at, 1.0 - here[body] * inside)
    return result


def spots(leaves: Leaves, slots: IntArray) -> tuple[FloatArray, FloatArray]:
    """Where leaves most probably are (n, 3), m, and the largest variance of that (n,), m²."""
    moving = leaves.behavior[slots, MOVING] > leaves.behavior[slots, REST]
    covariances = np.where(moving[:, None, None], leaves.moving_cov[slots, :3, :3], leaves.rest_cov[slots])
    middle = np.where(moving[:, None], leaves.moving[slots, :3], leaves.rest[slots])
    return middle, covariances.diagonal(axis1=1, axis2=2).max(1, initial=0.0)


def extents(leaves: Leaves, slots: IntArray, quantities: Quantities) -> FloatArray:
    """Widths and heights (2, n) from the diagonal, and from height by width where that is known."""
    size, known = quantities.told(leaves, slots, "size")
    size = np.where(known, size, quantities.small("size"))
    ratio, known = quantities.told(leaves, slots, "ratio")
    ratio = np.where(known, np.maximum(ratio, FLATTEST), 1.0)
    width = np.maximum(size, 0.0) / np.sqrt(2.0 + ratio**2)
    return np.stack([width, ratio * width])


@numba.njit(cache=True)
def _place(leaves, i):  # type: ignore[no-untyped-def]
    """Where a leaf most probably is, and how well that is known, m."""
    moving = leaves.behavior[i, MOVING] > leaves.behavior[i, REST]
    variance = 0.0
    for a in range(3):
        v = leaves.moving_cov[i, a, a] if moving else leaves.rest_cov[i, a, a]
        variance = max(variance, v)
    return (leaves.moving[i, :3] if moving else leaves.rest[i]), np.sqrt(variance)


@numba.njit(cache=True)
def _cover(leaves, chosen, clear, covers, extents, sensor):  # type: ignore[no-untyped-def]
    for k in range(chosen.size):
        if clear[k] <= 0.0:
            continue
        i = chosen[k]
        x, sigma = _place(leaves, i)
        dx, dy = x[0] - sensor[0], x[1] - sensor[1]
        distance = np.sqrt(dx * dx + dy * dy)
        if distance <= 0.0:
            continue
        for c in range(covers.size):
            o = covers[c]
            if leaves.track[o] == leaves.track[i]:
                continue
            y, spread = _place(leaves, o)
            ox, oy = y[0] - sensor[0], y[1] - sensor[1]
            along = (ox * dx + oy * dy) / distance
            # In front of it, not beside it.
            if along <= 0.05 or along > distance - 0.5 * max(extents[o, 0], SMALL):
                continue
            share = along / distance
            blur = max(np.sqrt((share * sigma) ** 2 + spread**2), LEAST_SIGMA)
            across = abs(ox * dy - oy * dx) / distance
            half = 0.5 * share * extents[i, 0] + blur
            cover = (0.5 * extents[o, 0] + half - across) / (2.0 * half)
            if cover <= 0.0:
                continue
            above = abs(y[2] - sensor[2] - share * (x[2] - sensor[2]))
            half = 0.5 * share * extents[i, 1] + blur
            upright = (0.5 * extents[o, 1] + half - above) / (2.0 * half)
            if upright > 0.0:
                clear[k] *= 1.0 - min(cover, 1.0) * min(upright, 1.0)

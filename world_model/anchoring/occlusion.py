"""Objects behind others of known size, or out of a camera's view: absence says nothing (section 2.5.2, (2.10))."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import ndtr

from estimation.checks import FloatArray
from world_model.anchoring.attributes import FLATTEST, Quantities
from world_model.anchoring.loops.leaves import IntArray, Leaves
from world_model.camera.camera_view import CameraView
from world_model.state import SURE

SMALL = 0.05  # m: width and height of an object whose size is not known
FARTHEST = 3.0  # Standard deviations beyond a body at which nothing is within it
LEAST_SIGMA = 0.01


def hide(
    leaves: Leaves, chosen: IntArray, clear: FloatArray, sensor: FloatArray, quantities: Quantities
) -> None:
    """Lower the probability `clear` (n,) of being in view of the leaves `chosen` (n,) that others cover, in place.

    sensor (8,) as in `clearance`. What covers is surely there, and of a size that was measured.
    """
    covers = np.flatnonzero((leaves.track >= 0) & (leaves.here(slice(None)) > SURE))
    covers = covers[quantities.told(leaves, covers, "size")[1]]
    index = np.flatnonzero(clear > 0.0)
    slots = chosen[index]
    if len(covers) == 0 or len(slots) == 0:
        return
    (off, variance), (front, spread) = spots(leaves, slots), spots(leaves, covers)
    off, front = off - sensor[:3], front - sensor[:3]
    own = np.full((2, len(leaves.track)), SMALL)
    own[:, covers] = extents(leaves, covers, quantities)
    distance = np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-9)[:, None]
    along = off[:, :2] @ front[:, :2].T / distance
    share = along / distance
    # In front of it, not beside it.
    before = (along > 0.05) & (along <= distance - 0.5 * np.maximum(own[0, covers], SMALL))
    before &= leaves.track[covers] != leaves.track[slots, None]
    blur = np.maximum(np.sqrt(share**2 * variance[:, None] + spread), LEAST_SIGMA)
    across = np.abs(np.outer(off[:, 1], front[:, 0]) - np.outer(off[:, 0], front[:, 1])) / distance
    above = np.abs(front[:, 2] - share * off[:, 2:])
    covered = before * np.ones(share.shape)
    for side, away in zip(own, (across, above), strict=True):
        half = 0.5 * share * side[slots, None] + blur
        covered *= np.clip((0.5 * side[covers] + half - away) / (2.0 * half), 0.0, 1.0)
    clear[index] *= (1.0 - covered).prod(1)


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
    np.multiply.at(result, at, 1.0 - leaves.here(slots)[body] * inside)
    return result


def spots(leaves: Leaves, slots: IntArray) -> tuple[FloatArray, FloatArray]:
    """Where leaves most probably are (n, 3), m, and the largest variance of that (n,), m²."""
    middle, covariances = leaves.spots(slots)
    return middle, covariances.diagonal(axis1=1, axis2=2).max(1, initial=0.0)


def extents(leaves: Leaves, slots: IntArray, quantities: Quantities) -> FloatArray:
    """Widths and heights (2, n) from the diagonal, and from height by width where that is known."""
    size, known = quantities.told(leaves, slots, "size")
    size = np.where(known, size, quantities.small("size"))
    ratio, known = quantities.told(leaves, slots, "ratio")
    ratio = np.where(known, np.maximum(ratio, FLATTEST), 1.0)
    width = np.maximum(size, 0.0) / np.sqrt(2.0 + ratio**2)
    return np.stack([width, ratio * width])

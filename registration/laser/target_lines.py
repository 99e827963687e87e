"""What a scan is registered against: lines, and a hash of square cells that says who lies near a spot.

It answers in constant time, in any extent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from registration.laser.surface import Surface

CELL = 0.25  # metres
APART = 0.025  # metres between points of one line that are worth finding
EMPTY = -1


@dataclass(frozen=True)
class TargetLines:
    """Lines to register against: points (M, 2) on them, normals, tilt and signed as in `Surface`; their hash."""

    points: FloatArray
    normals: FloatArray
    tilt: FloatArray
    heads: NDArray[np.int32]
    following: NDArray[np.int32]
    signed: bool = True


def target_of(surface: Surface) -> TargetLines:
    """A surface, its points in the order of beams, as the target of a registration."""
    points, size = surface.feet, 256
    while size < 2 * len(points):
        size *= 2
    heads, following = np.empty(size, dtype=np.int32), np.empty(len(points), dtype=np.int32)
    fill(points, surface.normals, APART, heads, following)
    return TargetLines(points, surface.normals, surface.tilt, heads, following, surface.signed)


@njit(cache=True, inline="always")
def bucket_of(i, j, mask):  # type: ignore[no-untyped-def]
    """Bucket of cell (i, j); `mask` is the number of buckets, a power of two, less one."""
    return ((i * 73856093) ^ (j * 19349663)) & mask


@njit(cache=True)
def fill(points, normals, apart, heads, following):  # type: ignore[no-untyped-def]
    """Chain points (N, 2) into their buckets; `heads` (power of two,) and `following` (N,) are written.

    Points of a line closer than `apart` metres to the last one taken are left out: their line is known.
    """
    heads[:] = EMPTY
    mask = len(heads) - 1
    taken = EMPTY
    for k in range(len(points)):
        following[k] = EMPTY
        if taken != EMPTY:
            dx, dy = points[k, 0] - points[taken, 0], points[k, 1] - points[taken, 1]
            same = normals[k, 0] * normals[taken, 0] + normals[k, 1] * normals[taken, 1]
            if same > 0.95 and dx * dx + dy * dy < apart * apart:
                continue
        taken = k
        cell = bucket_of(math.floor(points[k, 0] / CELL), math.floor(points[k, 1] / CELL), mask)
        following[k] = heads[cell]
        heads[cell] = k


@njit(cache=True)
def nearest(x, y, nx, ny, radius, agree, signed, points, normals, heads, following):  # type: ignore[no-untyped-def]
    """Nearest point within `radius` metres whose normal agrees with (nx, ny) to a cosine of `agree`.

    Without `signed`, normals that point the opposite way agree too. Returns its index or -1. A point without a
    line has a zero normal and is never found.
    """
    mask = len(heads) - 1
    own_i, own_j = math.floor(x / CELL), math.floor(y / CELL)
    left, below = x - own_i * CELL, y - own_j * CELL
    inside = min(left, CELL - left, below, CELL - below)
    best, found = radius * radius, EMPTY
    # Ring by ring around its own cell, until none can have a nearer one.
    for ring in range(math.ceil(radius / CELL) + 1):
        if ring > 0 and ((ring - 1) * CELL + inside) ** 2 >= best:
            break
        for i in range(own_i - ring, own_i + ring + 1):
            across = max(i * CELL - x, x - (i + 1) * CELL, 0.0)
            step = 1 if abs(i - own_i) == ring else 2 * ring
            for j in range(own_j - ring, own_j + ring + 1, step):
                along = max(j * CELL - y, y - (j + 1) * CELL, 0.0)
                if across * across + along * along >= best:
                    continue
                k = heads[bucket_of(i, j, mask)]
                while k != EMPTY:
                    dx, dy = x - points[k, 0], y - points[k, 1]
                    square = dx * dx + dy * dy
                    if square < best:
                        cosine = nx * normals[k, 0] + ny * normals[k, 1]
                        if cosine >= agree or (not signed and cosine <= -agree):
                            best, found = square, k
                    k = following[k]
    return found


@njit(cache=True)
def any_near(x, y, reach, points, heads, following):  # type: ignore[no-untyped-def]
    """Whether any point lies within `reach` metres."""
    mask = len(heads) - 1
    for i in range(math.floor((x - reach) / CELL), math.floor((x + reach) / CELL) + 1):
        for j in range(math.floor((y - reach) / CELL), math.floor((y + reach) / CELL) + 1):
            k = heads[bucket_of(i, j, mask)]
            while k != EMPTY:
                dx, dy = x - points[k, 0], y - points[k, 1]
                if dx * dx + dy * dy <= reach * reach:
                    return True
                k = following[k]
    return False

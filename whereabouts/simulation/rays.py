"""Where rays first meet an outline."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from whereabouts.simulation.shapes import Array, Shapes


@njit(cache=True)
def _meet_segment(ox, oy, dx, dy, segment):  # type: ignore[no-untyped-def]
    """Distance along the ray to a segment, inf where they do not meet."""
    sx, sy = segment[2] - segment[0], segment[3] - segment[1]
    cross = dx * sy - dy * sx
    if abs(cross) < 1e-12:
        return math.inf
    px, py = segment[0] - ox, segment[1] - oy
    along = (px * sy - py * sx) / cross
    share = (px * dy - py * dx) / cross
    if along <= 0.0 or share < 0.0 or share > 1.0:
        return math.inf
    return along


@njit(cache=True)
def _meet_circle(ox, oy, dx, dy, circle):  # type: ignore[no-untyped-def]
    px, py = circle[0] - ox, circle[1] - oy
    middle = px * dx + py * dy
    apart = px * px + py * py - middle * middle
    reach = circle[2] * circle[2] - apart
    if reach < 0.0:
        return math.inf
    half = math.sqrt(reach)
    if middle - half > 0.0:
        return middle - half
    return math.inf


@njit(cache=True)
def _cast(origins, angles, segments, circles, max_range):  # type: ignore[no-untyped-def]
    count = len(angles)
    ranges = np.full(count, math.inf)
    hits = np.full(count, -1, dtype=np.int64)
    for ray in range(count):
        ox, oy = origins[ray, 0], origins[ray, 1]
        dx, dy = math.cos(angles[ray]), math.sin(angles[ray])
        best, hit = max_range, -1
        for k in range(len(segments)):
            along = _meet_segment(ox, oy, dx, dy, segments[k])
            if along < best:
                best, hit = along, k
        for k in range(len(circles)):
            along = _meet_circle(ox, oy, dx, dy, circles[k])
            if along < best:
                best, hit = along, len(segments) + k
        if hit >= 0:
            ranges[ray], hits[ray] = best, hit
    return ranges, hits


def cast(
    shapes: Shapes, origins: Array, angles: Array, max_range: float = np.inf
) -> tuple[Array, NDArray[np.int64]]:
    """First outline met by each ray.

    Parameters
    ----------
    origins : (N, 2) metres, or (2,) for all. angles : (N,) radians, in the world frame.
    max_range : metres; nothing at or beyond it is seen.

    Returns
    -------
    ranges : (N,) metres, inf where nothing is met. owners : (N,) of what is met, -1 for nothing.
    """
    ranges, hits = cast_shapes(shapes, origins, angles, max_range)
    owners = np.concatenate((shapes.segment_owners, shapes.circle_owners, np.array([-1])))
    return ranges, owners[hits]


def cast_shapes(
    shapes: Shapes, origins: Array, angles: Array, max_range: float = np.inf
) -> tuple[Array, NDArray[np.int64]]:
    """As `cast`, but which outline is met: (N,) segment k, or len(segments) + circle k, or -1."""
    starts = np.ascontiguousarray(np.broadcast_to(origins, (len(angles), 2)), dtype=np.float64)
    headings = np.asarray(angles, dtype=np.float64)
    found: tuple[Array, NDArray[np.int64]] = _cast(
        starts, headings, shapes.segments, shapes.circles, max_range
    )
    return found

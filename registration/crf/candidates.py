"""The points of a scan nearest to given ones, found along its beams without a tree."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.sight import beam_at
from registration.crf.beams import Beams, half_window, length
from registration.motion import Array


@njit(cache=True)
def _nearest(x, y, radius, most, xy, ranges, number, angle_min, step, found, squares):  # type: ignore[no-untyped-def]
    """Write the points nearest to (x, y), nearest first, and return how many there are."""
    beams = len(ranges)
    around = round(2.0 * math.pi / abs(step))
    centre = beam_at(x, y, angle_min, step)
    half = half_window(length(x, y), radius, step, around // 2)
    count = 0
    distance, farthest = length(x, y), radius
    # Beams outwards from the one that looks there, until none can be nearer than those that were found.
    for away in range(half + 1):
        if count == most:
            angle = (away - 0.5) * abs(step)
            # Less than its sine.
            if 0.0 < angle < 1.5 and distance * angle * (1.0 - angle * angle / 6.0) > farthest:
                break
        for side in range(1 if away == 0 else 2):
            j = centre - away if side == 0 else centre + away
            if j >= around:
                j -= around
            elif j < 0:
                j += around
            if j < 0 or j >= beams or not abs(ranges[j] - distance) <= farthest:
                continue
            square = (x - xy[j, 0]) ** 2 + (y - xy[j, 1]) ** 2
            if square > radius * radius or (count == most and square >= squares[count - 1]):
                continue
            at = min(count, most - 1)
            while at > 0 and squares[at - 1] > square:
                squares[at], found[at] = squares[at - 1], found[at - 1]
                at -= 1
            squares[at], found[at] = square, number[j]
            count = min(count + 1, most)
            if count == most:
                farthest = math.sqrt(squares[count - 1])
    return count


@njit(cache=True)
def _one_nearest(points, radius, xy, ranges, number, angle_min, step):  # type: ignore[no-untyped-def]
    nearest = np.full(len(points), -1, dtype=np.int64)
    found, squares = np.empty(1, dtype=np.int64), np.empty(1)
    for i in range(len(points)):
        if _nearest(
            points[i, 0], points[i, 1], radius, 1, xy, ranges, number, angle_min, step, found, squares
        ):
            nearest[i] = found[0]
    return nearest


def nearest_points(b: Beams, points: Array, radius: float) -> NDArray[np.int64]:
    """(n,) point of b (numbers in `b.points`) nearest to each of the points (n, 2) within `radius` metres, or -1."""
    return np.asarray(_one_nearest(points, radius, b.xy, b.ranges, b.number, b.angle_min, b.step))

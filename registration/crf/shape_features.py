"""Association local features (section IV.C.1): patterns around a point, the same pattern around another.

Twelve numbers for a point of the first scan and a candidate of the second: differences of distance, angle and geodesic
length to the first, third and fifth neighbour, of range, and the distance between the two as they are and registered.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from registration.crf.beams import Beams
from registration.laser.outline import length
from registration.laser.prepared import once

NAMES = (
    "distance 1", "distance 3", "distance 5", "angle 1", "angle 3", "angle 5",
    "geodesic 1", "geodesic 3", "geodesic 5", "radius", "translation", "registered translation",
)  # fmt: skip
FAR = 3.0  # metres at which differences are cut off


@njit(cache=True)
def _patterns(points, patterns):  # type: ignore[no-untyped-def]
    """Distance, angle and geodesic length to the first, third and fifth neighbour of each point, (n, 9)."""
    n = len(points)
    for i in range(n):
        for m in range(3):
            step = 2 * m + 1
            low, high = max(i - step, 0), min(i + step, n - 1)
            ahead = high if i + step < n else low
            patterns[i, m] = math.hypot(points[ahead, 0] - points[i, 0], points[ahead, 1] - points[i, 1])
            ux, uy = points[low, 0] - points[i, 0], points[low, 1] - points[i, 1]
            vx, vy = points[high, 0] - points[i, 0], points[high, 1] - points[i, 1]
            patterns[i, 3 + m] = abs(math.atan2(ux * vy - uy * vx, ux * vx + uy * vy))
            length = 0.0
            for k in range(min(i, ahead), max(i, ahead)):
                length += math.hypot(points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1])
            patterns[i, 6 + m] = length


@njit(cache=True)
def _compare(points, patterns, others, others_patterns, states, chosen, features):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        c, s = math.cos(chosen[i, 2]), math.sin(chosen[i, 2])
        x = chosen[i, 0] + c * points[i, 0] - s * points[i, 1]
        y = chosen[i, 1] + s * points[i, 0] + c * points[i, 1]
        own = length(x, y)
        for k in range(states.shape[1]):
            j = states[i, k]
            if j < 0:
                features[i, k, :] = FAR
                continue
            for m in range(9):
                features[i, k, m] = min(abs(patterns[i, m] - others_patterns[j, m]), FAR)
            u, v = others[j, 0], others[j, 1]
            features[i, k, 9] = min(abs(own - length(u, v)), FAR)
            features[i, k, 10] = min(length(points[i, 0] - u, points[i, 1] - v), FAR)
            features[i, k, 11] = min(length(x - u, y - v), FAR)


@once
def patterns_of(beams: Beams) -> FloatArray:
    """What surrounds each point, (n, 9): distance, angle, geodesic length to neighbours 1, 3 and 5."""
    patterns = np.zeros((len(beams), 9))
    if len(beams) > 1:
        _patterns(beams.points, patterns)
    return patterns


def pair_features(a: Beams, b: Beams, states: NDArray[np.int64], chosen: FloatArray) -> FloatArray:
    """(n, K, 12) features of each point and candidate; `chosen` (n, 3) is the motion each point is taken to have."""
    features = np.empty((*states.shape, len(NAMES)))
    _compare(a.points, patterns_of(a), b.points, patterns_of(b), states, chosen, features)
    return features

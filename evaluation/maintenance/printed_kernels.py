"""(3.6) to (3.10) as printed: what a way to an object brings, look by look, and the object to go for."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# mypy: disable-error-code="no-untyped-def"


@njit(cache=True)
def expected(item, pose, room, variances):
    """Gain of going for an object, nat (3.6), and the metres to drive: fake measurements at each time step.

    variances : (N,) m².
    """
    now = variances.copy()
    low, high, variance = room.sensors[0, 0], room.sensors[0, 1], room.sensors[0, 2]
    dx, dy = room.positions[item, 0] - pose[0], room.positions[item, 1] - pose[1]
    gain, length = 0.0, math.hypot(dx, dy)
    for k in range(1, max(math.ceil(length / room.stride - 1e-9), 1) + 1):
        share = min(k * room.stride / max(length, 1e-12), 1.0)
        x, y = pose[0] + share * dx, pose[1] + share * dy
        for i in range(len(now)):
            now[i] += room.growth[i]
            if low <= math.hypot(room.positions[i, 0] - x, room.positions[i, 1] - y) <= high:
                # Two axes of half a logarithm each.
                gain += math.log((now[i] + variance) / variance)
                now[i] *= variance / (now[i] + variance)
    return gain, length


@njit(cache=True)
def best_as_printed(pose, room, variances, numbers):
    """a* of (3.10): the object of the largest utility (3.9) among those of (3.7), -1 where that set is empty.

    numbers : threshold, weight, norm and scale of a `PrintedRule`.
    """
    threshold, weight, norm, scale = numbers[0], numbers[1], numbers[2], numbers[3]
    chosen, most = -1, -np.inf
    for i in range(len(variances)):
        gain, length = expected(i, pose, room, variances)
        utility = gain / norm - weight * length / scale
        if gain > threshold and utility > most:
            chosen, most = i, utility
    return chosen

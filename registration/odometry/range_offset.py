"""A range scanner's constant offset, learned from how its own views of a wall disagree.

Time-of-flight scanners read every range too long or too short by up to some centimetres, with temperature and
surface. A wall seen head on is then displaced, seen at a grazing angle it is not: corridors bend, always to the
same side, and odometry turns with them. The same effect makes the offset visible: between two views of a line from
different angles the residual is the offset times the difference of their cosines.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from registration.laser.surface import Surface
from registration.laser.target_lines import TargetLines
from registration.placement.refine import TUKEY, Refined, off_line

# Of use in a corridor without an end and over long drives.
LIMIT = 0.06  # metres an offset can have
PRIOR = 0.01  # metres, standard deviation of the offset before anything is seen
# Share of its beams that a scan counts for: residuals of neighbours share the map's errors.
COUNTS = 0.1
FADING = 0.9995  # per keyframe: the offset follows the temperature


@njit(cache=True)
def _evidence(points, pose, target, normals, facing, matched, noise):  # type: ignore[no-untyped-def]
    """Information about the offset and its gradient, with the pose's own freedom taken out."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    H, cross = np.zeros((3, 3)), np.zeros(3)
    own = gradient = 0.0
    g = np.zeros(3)
    J = np.empty(3)
    for k in range(len(points)):
        m = matched[k]
        if m < 0:
            continue
        r, u, rx, ry, nx, ny = off_line(
            points[k, 0], points[k, 1], c, s, pose, target[m], normals[m], TUKEY * noise
        )
        if u >= 1.0:
            continue
        w = (1.0 - u) * (1.0 - u) / (noise * noise)
        b = (nx * rx + ny * ry) / max(math.hypot(rx, ry), 1e-6) - facing[m]
        J[0], J[1], J[2] = nx, ny, ny * rx - nx * ry
        for i in range(3):
            g[i] += w * r * J[i]
            cross[i] += w * b * J[i]
            for j in range(3):
                H[i, j] += w * J[i] * J[j]
        own += w * b * b
        gradient += w * b * r
    for i in range(3):
        H[i, i] += 1e-3
    share = np.linalg.solve(H, cross)
    return own - np.dot(cross, share), gradient - np.dot(g, share)


class RangeOffset:
    """Running least-squares estimate of a scanner's range offset, metres; positive where it reads too long."""

    def __init__(self) -> None:
        self.value = 0.0
        self._information = PRIOR**-2.0

    def learn(self, surface: Surface, refined: Refined, target: TargetLines, facing: FloatArray) -> None:
        """Take in one scan that has been corrected by `value` and registered to a map."""
        information, gradient = _evidence(
            surface.points, refined.pose, target.points, target.normals, facing, refined.matched, refined.noise
        )  # fmt: skip
        if not math.isfinite(information) or information <= 0.0:
            return
        information, gradient = COUNTS * information, COUNTS * gradient
        self._information = FADING * self._information + (1.0 - FADING) * PRIOR**-2.0 + information
        self.value += (gradient - PRIOR**-2.0 * (1.0 - FADING) * self.value) / self._information
        self.value = min(max(self.value, -LIMIT), LIMIT)

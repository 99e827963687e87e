"""Do two scans, or two local maps, agree? Overlap of their outlines, and what one sees where the other saw nothing.

A point of one scan that lies in front of what the other measured in that direction stands in space the other saw
through: either it moved or the motion is wrong. Points behind, or outside the other's view, say nothing.
Lengths of outline are compared, not beams: something close covers many beams and little else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.sight import THROUGH, look
from registration.laser.local_map import SPACING
from registration.laser.prepared import ScanView
from registration.laser.submap import CELL, Submap
from registration.laser.surface import Surface
from registration.laser.target_lines import TargetLines, any_near

DOUBT = 0.04  # metres, standard deviation of a point of one scan in the frame of another laid on it


@njit(cache=True)
def _weigh(  # type: ignore[no-untyped-def]
    points, spacing, pose, target, heads, following, ranges, angle_min, step, near, labels
):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(points)):
        x = pose[0] + c * points[k, 0] - s * points[k, 1]
        y = pose[1] + s * points[k, 0] + c * points[k, 1]
        reach = max(near, min(0.75 * spacing[k], 0.4))
        if any_near(x, y, reach, target, heads, following):
            labels[k] = 0
        elif look(x, y, DOUBT, ranges, angle_min, step) == THROUGH:
            labels[k] = 1
        else:
            labels[k] = -1


@dataclass(frozen=True)
class Agreement:
    """Metres of outline of one scan or local map judged against the other.

    labels : (N,) per point: 0 agrees, 1 stands in space the other saw through, -1 cannot be judged.
    """

    agreeing: float
    standing: float
    unknown: float
    labels: NDArray[np.int64]

    @property
    def length(self) -> float:
        """Metres of the whole outline."""
        return self.agreeing + self.standing + self.unknown

    @property
    def share(self) -> float:
        """Agreeing share of the outline, judged or not."""
        return self.agreeing / max(self.length, 1e-9)


def weigh(
    source: Surface, target: TargetLines, seen: ScanView, pose: FloatArray, near: float = 0.06
) -> Agreement:
    """Outline of `source`, at `pose` (3,) in the target frame, against the target and what its sensor saw.

    near : metres between points that agree.
    """
    labels = np.empty(len(source), dtype=np.int64)
    _weigh(
        source.points, source.spacing, pose, target.points, target.heads, target.following, seen.ranges,
        seen.angle_min, seen.step, near, labels,
    )  # fmt: skip
    unknown, agreeing, standing = np.bincount(labels + 1, source.length, 3).tolist()
    return Agreement(agreeing, standing, unknown, labels)


@njit(cache=True)
def _label(source, pose, points, heads, following, seen, origin, near, labels):  # type: ignore[no-untyped-def]
    height, width = seen.shape
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(source)):
        x = pose[0] + c * source[k, 0] - s * source[k, 1]
        y = pose[1] + s * source[k, 0] + c * source[k, 1]
        if any_near(x, y, near, points, heads, following):
            labels[k] = 0
            continue
        labels[k] = -1
        i, j = math.floor((x - origin[0]) / CELL), math.floor((y - origin[1]) / CELL)
        inside = 0 <= i < width and 0 <= j < height
        if inside and seen[j, i] and not any_near(x, y, 2.0 * near, points, heads, following):
            labels[k] = 1


def judge(source: Submap, target: Submap, pose: FloatArray, near: float = 0.12) -> Agreement:
    """Outline of `source`, at `pose` (3,) in the target's frame, against the target.

    near : metres between outlines that agree; a point stands in seen space only beyond twice that.
    """
    labels = np.empty(len(source), dtype=np.int64)
    _label(
        source.points, pose, target.points, target.target.heads, target.target.following, target.seen,
        target.origin, near, labels,
    )  # fmt: skip
    unknown, agreeing, standing = (np.bincount(labels + 1, minlength=3) * SPACING).tolist()
    return Agreement(agreeing, standing, unknown, labels)

"""Do two scans agree? Overlap of their outlines, and what one sees where the other saw nothing.

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

from registration.buckets import any_near
from registration.motion import Array
from registration.refine import Target
from registration.scan import Scan
from registration.surface import Surface


@dataclass(frozen=True)
class View:
    """What a scan saw in each direction: ranges (B,) with inf where nothing came back; none for a point set."""

    ranges: Array
    angle_min: float
    step: float


def view_of(scan: Scan | None) -> View:
    """View of a scan; of a point set, None, one that contradicts nothing."""
    if scan is None:
        return View(np.zeros(0), 0.0, 1.0)
    return View(np.where(scan.valid, scan.ranges, np.inf), scan.angle_min, scan.angle_increment)


@njit(cache=True)
def _weigh(  # type: ignore[no-untyped-def]
    points, spacing, lengths, pose, target, heads, following, ranges, angle_min, step, near, margin, labels
):
    """Metres of outline that agree, that stand in seen space, and that cannot be judged."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    agreeing = standing = unknown = 0.0
    beams = len(ranges)
    for k in range(len(points)):
        x = pose[0] + c * points[k, 0] - s * points[k, 1]
        y = pose[1] + s * points[k, 0] + c * points[k, 1]
        length = lengths[k]
        reach = max(near, min(0.75 * spacing[k], 0.4))
        if any_near(x, y, reach, target, heads, following):
            agreeing += length
            labels[k] = 0
            continue
        labels[k] = -1
        if beams > 0:
            bearing = math.atan2(y, x)
            b = (bearing - angle_min) / step
            around = 2.0 * math.pi / abs(step)
            b -= math.floor((b + 0.5) / around) * around
            i = math.floor(b + 0.5)
            if 0 <= i < beams:
                seen = math.inf
                for j in range(max(i - 1, 0), min(i + 2, beams)):
                    # The nearest of the neighbouring beams: next to an edge nothing can be said.
                    seen = min(seen, ranges[j]) if math.isfinite(ranges[j]) else seen
                if math.isfinite(ranges[i]) and math.hypot(x, y) < seen - margin:
                    standing += length
                    labels[k] = 1
                    continue
        unknown += length
    return agreeing, standing, unknown


@dataclass(frozen=True)
class Agreement:
    """Metres of outline of one scan judged against the other.

    labels : (N,) per point: 0 agrees, 1 stands in space the other saw through, -1 cannot be judged.
    """

    agreeing: float
    standing: float
    unknown: float
    labels: NDArray[np.int64]

    @property
    def share(self) -> float:
        """Agreeing share of what can be judged, 0 where nothing can."""
        judged = self.agreeing + self.standing
        return self.agreeing / judged if judged > 0.0 else 0.0


def weigh(
    source: Surface, target: Target, seen: View, pose: Array, near: float = 0.06, margin: float = 0.15
) -> Agreement:
    """Outline of `source`, at `pose` (3,) in the target frame, against the target and what its sensor saw.

    near : metres between points that agree. margin : metres in front of what was seen that contradict.
    """
    labels = np.empty(len(source), dtype=np.int64)
    agreeing, standing, unknown = _weigh(
        source.points, source.spacing, source.length, pose, target.points, target.heads, target.following,
        seen.ranges, seen.angle_min, seen.step, near, margin, labels,
    )  # fmt: skip
    return Agreement(agreeing, standing, unknown, labels)

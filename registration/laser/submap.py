"""Local maps: the scans of the last metres of path fused into one outline, with the space they saw through.

A single scan of a forward-looking scanner has little in common with one taken the other way; what was seen along a
few metres of path has. Odometry over those metres is good to centimetres, so its poses are taken as they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from registration.laser.local_map import SPACING, LineMap
from registration.laser.prepared import NOISE, PreparedScan
from registration.laser.surface import Surface
from registration.laser.target_lines import TargetLines, target_of

CELL = 0.1  # metres, of rasters
# Metres from the sensor; farther points are too sparse and turned too far by errors of the heading.
FAR = 25.0
MARGIN = 0.2  # metres in front of what a beam hit
STRIDE = 0.7  # cells from one that is marked to the next
RADIUS = 60.0  # metres around the last scan's sensor that are kept


@dataclass(frozen=True)
class Submap:
    """Fused outline of several scans, in the frame of an anchor pose.

    surface : points (N, 2) and normals. target : the same, hashed. seen : (H, W) whether a cell of CELL metres was
    seen through; origin : (2,) metres, lower left corner of cell (0, 0).
    """

    surface: Surface
    target: TargetLines
    seen: NDArray[np.bool_]
    origin: FloatArray

    def __len__(self) -> int:
        return len(self.surface)

    @property
    def points(self) -> FloatArray:
        """(N, 2) metres."""
        return self.surface.points


def fuse(scans: Sequence[PreparedScan], poses: FloatArray, workspace: LineMap | None = None) -> Submap:
    """Local map of scans taken at `poses` (K, 3) in the frame of the anchor, in the order they were taken.

    workspace : a map to fuse in, cleared first; its memory is not part of the result.
    """
    local = workspace if workspace is not None else LineMap(RADIUS, np.inf)
    local.clear()
    travelled = 0.0
    for rank, (item, pose) in enumerate(zip(scans, poses, strict=True)):
        travelled += 0.0 if rank == 0 else float(np.hypot(*(pose[:2] - poses[rank - 1][:2])))
        local.add(item.surface, item.view, np.ascontiguousarray(pose), travelled)
    count, lines = len(local), local.target
    points, normals, tilt = (kept[:count].copy() for kept in (lines.points, lines.normals, lines.tilt))
    spacing, pieces = np.full(count, SPACING), np.zeros(count, dtype=np.int64)
    surface = Surface(points, points, normals, tilt, spacing, spacing, pieces, NOISE, 0.0)
    return Submap(surface, target_of(surface), *_seen_space(scans, poses))


def _seen_space(scans: Sequence[PreparedScan], poses: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    low = np.asarray(poses)[:, :2].min(axis=0) - FAR
    high = np.asarray(poses)[:, :2].max(axis=0) + FAR
    width, height = (np.ceil((high - low) / CELL).astype(int) + 1).tolist()
    seen = np.zeros((height, width), dtype=np.bool_)
    for item, pose in zip(scans, poses, strict=True):
        _see(seen, low, pose, item.view.ranges, item.view.angle_min, item.view.step)
    # Rooms are smaller than what could have been seen, and many local maps are kept.
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if not len(rows):
        return seen[:1, :1].copy(), low
    cut = seen[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy()
    return cut, low + CELL * np.array([columns[0], rows[0]])


@njit(cache=True)
def _see(seen, origin, pose, ranges, angle_min, step):  # type: ignore[no-untyped-def]
    """Mark cells beams pass on their way, ending MARGIN in front of what they or their neighbours hit."""
    beams = len(ranges)
    height, width = seen.shape
    for k in range(beams):
        reach = ranges[k]
        if not math.isfinite(reach):
            continue
        for j in (k - 1, k + 1):
            # Next to an edge the beam's own width decides what it hits.
            if 0 <= j < beams and math.isfinite(ranges[j]):
                reach = min(reach, ranges[j] + 0.5)
        reach = min(reach - MARGIN, FAR)
        angle = pose[2] + angle_min + k * step
        dx, dy = STRIDE * math.cos(angle), STRIDE * math.sin(angle)
        x, y = (pose[0] - origin[0]) / CELL, (pose[1] - origin[1]) / CELL
        for _ in range(math.floor(reach / (STRIDE * CELL)) + 1):
            if 0.0 <= x < width and 0.0 <= y < height:
                # Signed numbers would be looked at for being counted from the end.
                seen[np.uint64(y), np.uint64(x)] = True
            x += dx
            y += dy

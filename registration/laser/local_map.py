"""The surroundings as line elements, fused from many scans: what scan odometry registers against.

An element is a point on a surface with the surface's normal. A scan that sees it again moves it along its normal
only, by a running mean, so that noise averages out and nothing slides along walls. Elements that later beams pass
through are taken out: they were somebody passing by.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.sight import THROUGH, look
from registration.laser.prepared import ScanView
from registration.laser.surface import Surface
from registration.laser.target_lines import CELL, EMPTY, TargetLines, bucket_of, fill, nearest

SPACING = 0.06  # metres between elements of one surface
# Cosine between normals of one element; 0.6, as in `refine`, is worse on csail and better on belgioioso.
FUSED = 0.7
MOST_HITS = 40.0  # an element goes on following a surface that moves a little
DOUBT = 0.08  # metres, standard deviation of an element where a scan looks: the map bends
SIGHT = 12.0  # metres within which the map is straight enough to tell what beams pass
CAPACITY = 8192
BUCKETS = 16384


class Elements(NamedTuple):
    """Elements as arrays of one length, of which the first so many are in use.

    points, normals : (C, 2). tilt : (C,) as in `Surface`. facing : (C,) mean cosine between the normal and the beams
    that saw it. hits : (C,) scans that saw it. seen : (C,) metres travelled when one last did.
    """

    points: FloatArray
    normals: FloatArray
    tilt: FloatArray
    facing: FloatArray
    hits: FloatArray
    seen: FloatArray


@njit(cache=True)
def _insert(points, normals, tilt, pose, now, elements, heads, following, count):  # type: ignore[no-untyped-def]
    """Fuse a scan's points at `pose` into the elements; returns the new number of elements."""
    element, element_normal, element_tilt, facing, hits, seen = elements
    c, s = math.cos(pose[2]), math.sin(pose[2])
    mask = len(heads) - 1
    # Information that this scan has given to the direction of each element: lines of points beside each other are made
    # from the same points, and count once.
    given = np.zeros(len(element))
    for k in range(len(points)):
        x = pose[0] + c * points[k, 0] - s * points[k, 1]
        y = pose[1] + s * points[k, 0] + c * points[k, 1]
        nx = c * normals[k, 0] - s * normals[k, 1]
        ny = s * normals[k, 0] + c * normals[k, 1]
        far = max(math.hypot(points[k, 0], points[k, 1]), 1e-6)
        front = (normals[k, 0] * points[k, 0] + normals[k, 1] * points[k, 1]) / far
        if tilt[k] < math.inf:
            m = nearest(x, y, nx, ny, SPACING, FUSED, True, element, element_normal, heads, following)
        else:
            # Without a line of its own it goes with any element.
            m = nearest(x, y, nx, ny, 0.5 * SPACING, -2.0, True, element, element_normal, heads, following)
        if m >= 0:
            w = hits[m]
            mx, my = element_normal[m, 0], element_normal[m, 1]
            off = mx * (x - element[m, 0]) + my * (y - element[m, 1])
            gain = 1.0 / (w + 1.0)
            element[m, 0] += mx * off * gain
            element[m, 1] += my * off * gain
            if 1.0 / tilt[k] > given[m]:
                a, b = 1.0 / element_tilt[m], 1.0 / tilt[k] - given[m]
                given[m] += b
                mx, my = a * mx + b * nx, a * my + b * ny
                length = math.hypot(mx, my)
                element_normal[m, 0], element_normal[m, 1] = mx / length, my / length
                # Bounded: a surface is never straighter than the next scan may show it to be.
                element_tilt[m] = max(1.0 / (a + b), 2e-5)
            facing[m] += (front - facing[m]) * gain
            hits[m] = min(w + 1.0, MOST_HITS)
            seen[m] = now
        elif count < len(element):
            m = count
            count += 1
            element[m, 0], element[m, 1] = x, y
            element_normal[m, 0], element_normal[m, 1] = nx, ny
            element_tilt[m] = tilt[k]
            given[m] = 1.0 / tilt[k]
            facing[m] = front
            hits[m] = 1.0
            seen[m] = now
            cell = bucket_of(math.floor(x / CELL), math.floor(y / CELL), mask)
            following[m] = heads[cell]
            heads[cell] = m
    return count


@njit(cache=True)
def _seen_through(points, normals, pose, clear, ranges, angle_min, step, through):  # type: ignore[no-untyped-def]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(points)):
        dx, dy = points[k, 0] - pose[0], points[k, 1] - pose[1]
        through[k] = False
        if dx * dx + dy * dy < SIGHT * SIGHT and abs(normals[k, 0] * dx + normals[k, 1] * dy) >= clear:
            through[k] = look(c * dx + s * dy, c * dy - s * dx, DOUBT, ranges, angle_min, step) == THROUGH


@njit(cache=True)
def _keep(elements, count, x, y, radius, oldest):  # type: ignore[no-untyped-def]
    """Move what stays to the front; returns how many stay."""
    point, normal, tilt, facing, hits, seen = elements
    kept = 0
    for k in range(count):
        dx, dy = point[k, 0] - x, point[k, 1] - y
        if hits[k] <= 0.0 or dx * dx + dy * dy > radius * radius or seen[k] < oldest:
            continue
        point[kept, 0], point[kept, 1] = point[k, 0], point[k, 1]
        normal[kept, 0], normal[kept, 1] = normal[k, 0], normal[k, 1]
        tilt[kept], facing[kept], hits[kept], seen[kept] = tilt[k], facing[k], hits[k], seen[k]
        kept += 1
    return kept


class LineMap:
    """Elements around the sensor, in the odometry frame.

    radius : metres from the sensor within which elements are kept.
    memory : metres of travel after which an element not seen again is dropped.
    """

    def __init__(self, radius: float, memory: float) -> None:
        self.radius, self.memory = radius, memory
        flat = (np.zeros(CAPACITY) for _ in range(4))
        self._all = Elements(np.zeros((CAPACITY, 2)), np.zeros((CAPACITY, 2)), *flat)
        self._heads = np.full(BUCKETS, EMPTY, dtype=np.int32)
        self._following = np.full(CAPACITY, EMPTY, dtype=np.int32)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def points(self) -> FloatArray:
        """(M, 2) metres."""
        return self._all.points[: self._count]

    @property
    def target(self) -> TargetLines:
        """The elements as the target of a registration; a view, valid until the next change."""
        return TargetLines(*self._all[:3], self._heads, self._following)

    @property
    def facing(self) -> FloatArray:
        """Mean cosine between each element's normal and the beams that saw it, (M,); a view."""
        return self._all.facing

    def seen_through(self, view: ScanView, pose: FloatArray, clear: float = 0.0) -> NDArray[np.bool_]:
        """Which elements stand in space that a scan taken at `pose` (3,) saw through, (M,).

        clear : metres the sensor stands at least off the plane of such an element. Of one that is seen edge on, an
            error of the map decides on which side of it a beam passes.
        """
        through = np.empty(self._count, dtype=np.bool_)
        _seen_through(
            self.points, self._all.normals, pose, clear, view.ranges, view.angle_min, view.step, through
        )  # fmt: skip
        return through

    def clear(self) -> None:
        """Forget everything."""
        self._count = 0
        self._heads[:] = EMPTY

    def add(self, surface: Surface, view: ScanView, pose: FloatArray, travelled: float) -> None:
        """Fuse a scan taken at `pose` (3,) after `travelled` metres."""
        if len(view.ranges) > 2 and self._count:
            self._all.hits[: self._count][self.seen_through(view, pose)] -= 2.0
        self._prune(pose, travelled)
        self._count = int(
            _insert(
                surface.feet, surface.normals, surface.tilt, pose, travelled, self._all, self._heads,
                self._following, self._count,
            )
        )  # fmt: skip

    def _prune(self, pose: FloatArray, travelled: float) -> None:
        # When there is no room left, what has not been seen for longest goes first.
        memory = self.memory
        radius = self.radius
        while True:
            self._count = int(_keep(self._all, self._count, pose[0], pose[1], radius, travelled - memory))
            if self._count < 0.8 * CAPACITY:
                break
            memory, radius = 0.7 * memory, 0.9 * radius
        # Elements move by fusing, and out of their cell: chained anew each time.
        fill(self.points, self._all.normals, 0.0, self._heads, self._following)

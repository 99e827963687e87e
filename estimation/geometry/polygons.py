"""Plane polygons: checks, containment, areas, and the probability of a Gaussian inside."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.special import owens_t

from estimation.checks import FloatArray, as_finite
from estimation.errors import InputError

LEAST_VARIANCE = 1e-12  # m²; an exact position is a very narrow Gaussian


def check_outline(name: str, corners: npt.ArrayLike) -> FloatArray:
    """Corners (N, 2), m, counterclockwise and not closed. Raises InputError where they bound no area."""
    outline = as_finite(name, corners)
    if outline.ndim != 2 or outline.shape[1] != 2:
        raise InputError(f"{name} must be corners (N, 2), not of shape {outline.shape}")
    if len(outline) > 1 and np.array_equal(outline[0], outline[-1]):
        outline = outline[:-1]
    if len(outline) < 3:
        raise InputError(f"{name} must have at least three corners, not {len(outline)}")
    if _crosses_itself(outline):
        raise InputError(f"{name} must not cross itself")
    area = signed_area(outline)
    if abs(area) < 1e-9:
        raise InputError(f"{name} must have an area, its corners lie on a line")
    return outline if area > 0.0 else np.ascontiguousarray(outline[::-1])


def signed_area(polygon: FloatArray) -> float:
    """m², positive for counterclockwise corners (N, 2)."""
    x, y = (polygon - polygon[0]).T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def points_inside(polygon: FloatArray, points: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether points (..., 2) are inside corners (N, 2): crossings of a ray to the right."""
    x, y = points[..., 0, None], points[..., 1, None]
    ax, ay = polygon.T
    bx, by = np.roll(polygon, -1, axis=0).T
    spans = (ay > y) != (by > y)
    rise = np.where(by == ay, 1.0, by - ay)
    crossing = ax + (y - ay) * (bx - ax) / rise
    result: npt.NDArray[np.bool_] = (spans & (x < crossing)).sum(-1) % 2 == 1
    return result


def outline_distance(polygon: FloatArray, points: FloatArray) -> FloatArray:
    """Metres (...) from points (..., 2), inside or not, to the nearest edge of corners (N, 2)."""
    along = np.roll(polygon, -1, axis=0) - polygon
    offset = points[..., None, :] - polygon
    share = np.clip((offset * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12), 0.0, 1.0)
    return np.linalg.norm(offset - share[..., None] * along, axis=-1).min(-1)


def gaussian_mass(
    corners: FloatArray, starts: Sequence[int], mean: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Probability (P,) of a plane Gaussian, mean (2,), covariance (2, 2), inside each of P counterclockwise polygons.

    corners : (V, 2) of all polygons, one after the other; starts : first corner of each. In coordinates in which
    the Gaussian is round, the triangle of an edge with the mean has the mass of its angle less what lies beyond the
    edge, which is Owen's T function.
    """
    a = _whitened(corners - mean, covariance)
    ends = [*starts[1:], len(corners)]
    b = np.roll(a, -1, axis=0)
    b[np.array(ends) - 1] = a[np.array(starts)]
    along = b - a
    length = np.hypot(along[:, 0], along[:, 1])
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    h = np.maximum(np.abs(cross) / np.maximum(length, 1e-300), 1e-100)
    scale = np.maximum(length, 1e-300) * h
    ta, tb = np.clip([(a * along).sum(1) / scale, (b * along).sum(1) / scale], -1e100, 1e100)
    angle = (np.arctan(tb) - np.arctan(ta)) / (2.0 * np.pi)
    triangles = np.sign(cross) * (angle - (owens_t(h, tb) - owens_t(h, ta)))
    result: FloatArray = np.clip(np.add.reduceat(triangles, starts), 0.0, 1.0)
    return result


def interval_mass(low: float, high: float, mean: float, variance: float) -> float:
    """Probability of a Gaussian in [low, high]."""
    scale = math.sqrt(2.0 * max(variance, LEAST_VARIANCE))
    return 0.5 * (math.erf((high - mean) / scale) - math.erf((low - mean) / scale))


def clipped_area(polygon: FloatArray, box: FloatArray) -> float:
    """m² of a counterclockwise polygon (N, 2) inside a rectangle ((x0, x1), (y0, y1))."""
    corners = polygon
    for axis in (0, 1):
        for bound, sign in ((box[axis][0], 1.0), (box[axis][1], -1.0)):
            corners = _half_plane(corners, axis, float(bound), sign)
            if len(corners) < 3:
                return 0.0
    return max(signed_area(corners), 0.0)


def box_share(polygon: FloatArray, height: tuple[float, float], box: FloatArray) -> float:
    """Share of a box ((x0, x1), (y0, y1)[, (z0, z1)]) that is inside a polygon with a height."""
    (x0, x1), (y0, y1) = box[:2]
    base = (x1 - x0) * (y1 - y0)
    share = clipped_area(polygon, box) / base if base > 0.0 else 0.0
    if len(box) == 3:
        z0, z1 = box[2]
        low, high = max(height[0], z0), min(height[1], z1)
        share *= (high - low) / (z1 - z0) if high > low else float(z1 == z0 == low == high)
    return float(min(max(share, 0.0), 1.0))


def _whitened(points: FloatArray, covariance: FloatArray) -> FloatArray:
    """Points (V, 2) in coordinates in which the covariance is the unit matrix; orientation is kept."""
    xx = max(float(covariance[0, 0]), LEAST_VARIANCE)
    sx = math.sqrt(xx)
    slope = float(covariance[0, 1]) / xx
    sy = math.sqrt(max(float(covariance[1, 1]) - slope * slope * xx, LEAST_VARIANCE))
    return np.column_stack([points[:, 0] / sx, (points[:, 1] - slope * points[:, 0]) / sy])


def _half_plane(corners: FloatArray, axis: int, bound: float, sign: float) -> FloatArray:
    """Part of a polygon with sign * (coordinate - bound) >= 0 (Sutherland and Hodgman)."""
    depth = sign * (corners[:, axis] - bound)
    kept: list[FloatArray] = []
    for index in range(len(corners)):
        before, here = depth[index - 1], depth[index]
        if (before < 0.0) != (here < 0.0):
            share = before / (before - here)
            kept.append(corners[index - 1] + share * (corners[index] - corners[index - 1]))
        if here >= 0.0:
            kept.append(corners[index])
    return np.array(kept) if kept else np.zeros((0, 2))


def _crosses_itself(outline: FloatArray) -> bool:
    """Whether two edges that do not follow each other meet, or a corner comes twice."""
    a, b = outline, np.roll(outline, -1, axis=0)
    n = len(outline)
    if len(np.unique(outline, axis=0)) < n:
        return True

    def side(p: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
        """Sign of the turn p -> q -> r, (n, n)."""
        return np.asarray(
            np.sign(
                (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1])
                - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
            )
        )

    A, B, C, D = a[:, None], b[:, None], a[None], b[None]
    meet = (side(A, B, C) * side(A, B, D) < 0.0) & (side(C, D, A) * side(C, D, B) < 0.0)
    return bool(meet.any())

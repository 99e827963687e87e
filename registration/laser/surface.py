"""From scans and point sets to surfaces: end points with the line their neighbours lie on.

Correspondence by structure starts here. A neighbourhood ends where the surface does (at a jump in range) and
is taken on one side only next to a corner, so that normals do not turn there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from registration.laser.scan import Scan

# Metres a neighbourhood extends to either side, more where beams are farther apart; and the most one point stands for.
REACH = 0.3
MOST_NEIGHBOURS = 40  # beams to either side
WAVERING = 0.1  # rad², variance of a normal's direction from which on there is no line
OUTLYING = 16.0  # squared deviations off a line from which on a point is no part of it
GRAZING = 0.12  # sine of the smallest angle between a beam and a surface
JOINED = 6.0  # deviations of a range between neighbours on one surface


@dataclass(frozen=True)
class Surface:
    """End points and their surface, sensor frame.

    points : (N, 2) metres. feet : (N, 2) the points moved onto the line of their neighbourhood, which takes
    most of the range noise off them. normals : (N, 2) unit, zero for a point without a line.
    tilt : (N,) variance of each normal's direction, rad², inf without a line.
    spacing : (N,) metres to the farther neighbour. length : (N,) metres of outline a point stands for, at most
    `REACH`. pieces : (N,) number of the connected piece a point is on.
    noise : metres, how far points lie off their own lines. leverage : mean variance of a foot, in units of a
    point's.
    signed : whether normals are known to point towards the sensor.
    """

    points: FloatArray
    feet: FloatArray
    normals: FloatArray
    tilt: FloatArray
    spacing: FloatArray
    length: FloatArray
    pieces: NDArray[np.int64]
    noise: float
    leverage: float
    signed: bool = True

    def __len__(self) -> int:
        return len(self.points)

    @property
    def lined(self) -> NDArray[np.bool_]:
        """Which points have a line, (N,)."""
        return np.isfinite(self.tilt)


@njit(cache=True)
def _sums(x, y):  # type: ignore[no-untyped-def]
    """Running sums of 1, x, y, xx, xy, yy: any window's moments are a difference of two rows."""
    sums = np.zeros((len(x) + 1, 5))
    for k in range(len(x)):
        sums[k + 1, 0] = sums[k, 0] + x[k]
        sums[k + 1, 1] = sums[k, 1] + y[k]
        sums[k + 1, 2] = sums[k, 2] + x[k] * x[k]
        sums[k + 1, 3] = sums[k, 3] + x[k] * y[k]
        sums[k + 1, 4] = sums[k, 4] + y[k] * y[k]
    return sums


@njit(cache=True)
def _fit(sums, first, last):  # type: ignore[no-untyped-def]
    """Total least squares line through points first..last: centre, normal, spread along, mean square off."""
    n = last - first + 1
    mx = (sums[last + 1, 0] - sums[first, 0]) / n
    my = (sums[last + 1, 1] - sums[first, 1]) / n
    xx = sums[last + 1, 2] - sums[first, 2] - n * mx * mx
    xy = sums[last + 1, 3] - sums[first, 3] - n * mx * my
    yy = sums[last + 1, 4] - sums[first, 4] - n * my * my
    half = math.sqrt((0.5 * (xx - yy)) * (0.5 * (xx - yy)) + xy * xy)
    along, off = 0.5 * (xx + yy) + half, max(0.5 * (xx + yy) - half, 0.0)
    # Eigenvector of the smaller eigenvalue, from the better conditioned row.
    nx, ny = (xy, off - xx) if xx > yy else (off - yy, xy)
    length = math.sqrt(nx * nx + ny * ny)
    if length > 0.0:
        nx, ny = nx / length, ny / length
    else:
        nx, ny = 1.0, 0.0
    # Two degrees of freedom went into the line.
    return mx, my, nx, ny, along, off / max(n - 2, 1)


@njit(cache=True)
def _windows(x, y, beams, step, noise):  # type: ignore[no-untyped-def]
    """First and last point of each neighbourhood (N, 2), distance to the farther neighbour, connected piece."""
    n = len(x)
    ends = np.empty((n, 2), dtype=np.int64)
    spacing = np.zeros(n)
    gaps = np.zeros(n)
    joined = np.zeros(n, dtype=np.bool_)  # with the next point
    pieces = np.zeros(n, dtype=np.int64)
    for i in range(n - 1):
        missed = beams[i + 1] - beams[i]
        gaps[i] = math.hypot(x[i + 1] - x[i], y[i + 1] - y[i])
        near = math.sqrt(min(x[i] * x[i] + y[i] * y[i], x[i + 1] * x[i + 1] + y[i + 1] * y[i + 1]))
        joined[i] = missed <= 3 and gaps[i] <= max(JOINED * noise, missed * step * near / GRAZING)
        pieces[i + 1] = pieces[i] if joined[i] else pieces[i] + 1
    first = last = 0
    for i in range(n):
        reach = max(REACH, 3.5 * step * math.sqrt(x[i] * x[i] + y[i] * y[i]))
        reach *= reach
        # Both ends only move on: along a surface, what was too far behind stays too far.
        if i > 0 and not joined[i - 1]:
            first = i
        first = max(first, i - MOST_NEIGHBOURS)
        while first < i and (x[first] - x[i]) ** 2 + (y[first] - y[i]) ** 2 > reach:
            first += 1
        last = max(last, i)
        while last > i and (x[last] - x[i]) ** 2 + (y[last] - y[i]) ** 2 > reach:
            last -= 1
        while last < n - 1 and joined[last] and last - i < MOST_NEIGHBOURS:
            if (x[last + 1] - x[i]) ** 2 + (y[last + 1] - y[i]) ** 2 > reach:
                break
            last += 1
        ends[i, 0], ends[i, 1] = first, last
        if first < i:
            spacing[i] = gaps[i - 1]
        if last > i:
            spacing[i] = max(spacing[i], gaps[i])
    return ends, spacing, pieces


@njit(cache=True)
def _lines(x, y, beams, step, noise):  # type: ignore[no-untyped-def]
    """Line of each point of a sweep; `beams` numbers the points, `step` is the angle between beams."""
    n = len(x)
    ends, spacing, pieces = _windows(x, y, beams, step, noise)
    sums = _sums(x, y)
    feet = np.empty((n, 2))
    normals = np.zeros((n, 2))
    tilt = np.full(n, math.inf)
    roughness = np.empty(n)
    lined = 0
    leverage = 0.0
    for i in range(n):
        feet[i, 0], feet[i, 1] = x[i], y[i]
        first, last = ends[i, 0], ends[i, 1]
        if last - first < 2:
            continue
        mx, my, nx, ny, along, square = _fit(sums, first, last)
        count = last - first + 1
        if square > 4.0 * noise * noise:
            # A bend: the straighter side alone, if it is long enough to have a direction.
            for side in range(2):
                a, b = (first, i) if side == 0 else (i, last)
                if b - a >= 3:
                    sx, sy, px, py, length, rest = _fit(sums, a, b)
                    if rest < 0.5 * square:
                        mx, my, nx, ny, along, square = sx, sy, px, py, length, rest
                        count = b - a + 1
        variance = max(square, noise * noise) / max(along, 1e-9)
        if variance > WAVERING:
            continue
        if nx * x[i] + ny * y[i] > 0.0:
            nx, ny = -nx, -ny
        off = nx * (x[i] - mx) + ny * (y[i] - my)
        # Its foot would move it by more than noise.
        if off * off > OUTLYING * max(noise * noise, square):
            continue
        feet[i, 0], feet[i, 1] = x[i] - off * nx, y[i] - off * ny
        normals[i, 0], normals[i, 1] = nx, ny
        tilt[i] = variance
        roughness[lined] = square
        beside = -ny * (x[i] - mx) + nx * (y[i] - my)
        leverage += 1.0 / count + beside * beside / max(along, 1e-9)
        lined += 1
    rough = math.sqrt(np.median(roughness[:lined])) if lined else noise
    return feet, normals, tilt, spacing, pieces, rough, leverage / max(lined, 1)


def scan_surface(
    scan: Scan,
    noise: float,
    max_range: float = np.inf,
    offset: float = 0.0,
    sweep: tuple[FloatArray, FloatArray] | None = None,
) -> Surface:
    """Surface of a scan.

    noise : standard deviation of a range. max_range : the farthest used. offset : what ranges read too long; metres.
    sweep : motion (3,) of the sensor, and the share (N,) of it that it is away when each beam is sent.
    """
    keep = scan.valid
    if np.isfinite(max_range):
        keep &= np.where(keep, scan.ranges, np.inf) <= max_range
    beams = np.flatnonzero(keep)
    ranges = scan.ranges[beams] - offset
    bearings = scan.angle_min + scan.angle_increment * beams
    if sweep is not None:
        bearings += sweep[1][beams] * sweep[0][2]
    points = np.empty((len(beams), 2))
    points[:, 0] = ranges * np.cos(bearings)
    points[:, 1] = ranges * np.sin(bearings)
    if sweep is not None:
        points += sweep[1][beams, None] * sweep[0][:2]
    step = abs(scan.angle_increment)
    x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
    feet, normals, tilt, spacing, pieces, rough, leverage = _lines(x, y, beams, step, noise)
    length = _lengths(points, normals, spacing, step)
    return Surface(points, feet, normals, tilt, spacing, length, pieces, rough, leverage)


@njit(cache=True)
def _lengths(points, normals, spacing, step):  # type: ignore[no-untyped-def]
    """Metres of outline within a beam's share of the circle.

    Not the distance between neighbours: close by, where beams are denser than their noise, that is mostly noise.
    """
    length = np.empty(len(points))
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        far = math.hypot(x, y)
        facing = abs(normals[k, 0] * x + normals[k, 1] * y) / max(far, 1e-9)
        if facing == 0.0:  # no line
            length[k] = min(spacing[k], far * step / GRAZING, REACH)
        else:
            length[k] = min(far * step / max(facing, GRAZING), REACH)
    return length


def points_surface(points: FloatArray, noise: float) -> Surface:
    """Surface of points (N, 2) in any order: the line of each through its neighbours within `REACH`."""
    n = len(points)
    tilt, spacing, leverage = np.full(n, np.inf), np.zeros(n), 0.0
    feet, normals = points.copy(), np.zeros((n, 2))
    pieces = np.zeros(n, dtype=np.int64)
    if n < 3:
        return Surface(points, feet, normals, tilt, spacing, spacing.copy(), pieces, noise, 1.0, False)
    tree = cKDTree(points)
    distance, index = tree.query(points, k=min(n, 30))
    reach = np.maximum(REACH, 1.01 * distance[:, 2])
    inside = distance <= np.minimum(reach, 1.0)[:, None]
    count = inside.sum(axis=1)
    weight = inside[:, :, None] / count[:, None, None]
    centre = (weight * points[index]).sum(axis=1)
    offset = np.where(inside[:, :, None], points[index] - centre[:, None], 0.0)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset))
    square = values[:, 0] / np.maximum(count - 2, 1)
    along = np.maximum(values[:, 1], 1e-9)
    variance = np.maximum(square, noise**2) / along
    off = np.einsum("ni,ni->n", vectors[:, :, 0], points - centre)
    good = (count >= 3) & (variance <= WAVERING) & (off**2 <= OUTLYING * np.maximum(noise**2, square))
    # Duplicates lie at no distance: the spacing is that to the first neighbour elsewhere.
    spacing = np.minimum(np.where(distance > 1e-6, distance, np.inf).min(axis=1), 1.0)
    normals[good], tilt[good] = vectors[good, :, 0], variance[good]
    feet[good] -= off[good, None] * vectors[good, :, 0]
    if good.any():
        beside = np.einsum("ni,ni->n", vectors[:, :, 1], points - centre)[good]
        leverage = float(np.mean(1.0 / count[good] + beside**2 / along[good]))
        noise = float(np.sqrt(np.median(square[good])))
    length = np.minimum(spacing, REACH)
    return Surface(points, feet, normals, tilt, spacing, length, pieces, noise, leverage, False)

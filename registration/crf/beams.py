"""Scans as the joint model sees them: returns in the order of their beams, with what each beam saw through."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from registration.motion import Array
from registration.scan import Scan

AGREES, FREE, HIDDEN, UNSEEN, CLEAR = 0, 1, 2, 3, 4
NEAR = 0.03  # metres off an outline up to which a point may be noise, at the least
SIGMAS = 3.5  # standard deviations of the noise the scans themselves show, likewise
MARGIN = 2.0  # of the same: how far in front of, or behind, what a beam saw before that says anything
NEARER = 0.7  # of the median range: what is near
EMPTY = 5  # beams in a row without return, around one, that say that nothing near is there
LONGEST = 0.5  # metres of outline taken to run on between two beams


@dataclass(frozen=True, eq=False)
class Beams:
    """A scan made ready.

    xy : (B, 2) metres, end point of each beam, NaN without a return. ranges : (B,) inf without a return.
    clear : (B,) metres up to which a beam without return says that nothing is there, 0 where it does not.
    beams : (n,) which beams returned. points : (n, 2) their end points. spacing : (n,) metres between beams on a
    surface faced head-on there, at least the scanner's own noise. pieces : (n,) number of the connected piece.
    around : beams of a full turn.
    """

    xy: Array
    ranges: Array
    clear: Array
    beams: NDArray[np.int64]
    points: Array
    spacing: Array
    pieces: NDArray[np.int64]
    angle_min: float
    step: float

    def __len__(self) -> int:
        return len(self.beams)


@lru_cache(maxsize=8)  # a scan is compared with several others
def beams_of(scan: Scan) -> Beams:
    """`Beams` of a scan; not to be written to."""
    valid = scan.valid
    ranges = np.where(valid, scan.ranges, np.inf)
    bearings = scan.bearings
    xy = np.full((len(scan), 2), np.nan)
    xy[valid, 0] = ranges[valid] * np.cos(bearings[valid])
    xy[valid, 1] = ranges[valid] * np.sin(bearings[valid])
    beams = np.flatnonzero(valid)
    points = np.ascontiguousarray(xy[beams])
    step = scan.angle_increment if len(scan) > 1 else 1e-3
    spacing = np.maximum(abs(step) * ranges[beams], 0.02)
    return Beams(
        xy,
        ranges,
        _clear(ranges),
        beams,
        points,
        spacing,
        _pieces(points, beams, abs(step)),
        scan.angle_min,
        step,
    )


def _clear(ranges: Array) -> Array:
    """What no return says: single beams get lost, but something near does not lose `EMPTY` beams in a row."""
    lost = ~np.isfinite(ranges)
    if lost.all() or not lost.any():
        return np.zeros(len(ranges))
    run = np.convolve(lost, np.ones(EMPTY), mode="same") >= EMPTY
    return np.where(run, NEARER * float(np.median(ranges[~lost])), 0.0)


@njit(cache=True, inline="always")
def _aligned(ux, uy, vx, vy):  # type: ignore[no-untyped-def]
    """Whether two directions agree to about 15°."""
    return ux * vx + uy * vy > 0.965 * math.sqrt((ux * ux + uy * uy) * (vx * vx + vy * vy))


@njit(cache=True)
def _joined(points, beams, step, i, j, fresh):  # type: ignore[no-untyped-def]
    """Whether point j goes on where point i left off; `fresh`: i has nothing before it on its piece."""
    dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    gap = math.hypot(dx, dy)
    near = min(math.hypot(points[i, 0], points[i, 1]), math.hypot(points[j, 0], points[j, 1]))
    across = min(beams[j] - beams[i], 6) * step * near
    if gap <= min(max(0.1, 4.0 * across), 1.5):
        return True
    if gap > min(max(0.1, 15.0 * across), 1.5):
        return False
    # Along a flank seen at a grazing angle points are far apart, but go on in one direction.
    if not fresh and _aligned(points[i, 0] - points[i - 1, 0], points[i, 1] - points[i - 1, 1], dx, dy):
        return True
    if j + 1 < len(points):
        ex, ey = points[j + 1, 0] - points[j, 0], points[j + 1, 1] - points[j, 1]
        return math.hypot(ex, ey) < 1.5 * gap and _aligned(ex, ey, dx, dy)
    return False


@njit(cache=True)
def _pieces(points, beams, step):  # type: ignore[no-untyped-def]
    """Number of the connected piece of each point: a piece ends where the next point jumps away.

    A single false reading does not end it.
    """
    n = len(points)
    pieces = np.full(n, -1, dtype=np.int64)
    count = 0
    for i in range(n):
        if pieces[i] < 0:
            pieces[i] = count
            count += 1
        fresh = i == 0 or pieces[i - 1] != pieces[i]
        if i + 1 < n and pieces[i + 1] < 0 and _joined(points, beams, step, i, i + 1, fresh):
            pieces[i + 1] = pieces[i]
        elif i + 2 < n and pieces[i + 1] < 0 and _joined(points, beams, step, i, i + 2, fresh):
            pieces[i + 2] = pieces[i]
    return pieces


@njit(cache=True, inline="always")
def beam_at(x, y, angle_min, step):  # type: ignore[no-untyped-def]
    """Number of the beam that looks at (x, y); may lie outside the scan."""
    b = (math.atan2(y, x) - angle_min) / step
    around = 2.0 * math.pi / abs(step)
    b -= math.floor((b + 0.5) / around) * around
    return math.floor(b + 0.5)


@njit(cache=True, inline="always")
def _off_segment(x, y, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Distance from (x, y) to the segment a, b."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    share = 0.0
    if square > 0.0:
        share = min(max(((x - ax) * dx + (y - ay) * dy) / square, 0.0), 1.0)
    return math.hypot(x - ax - share * dx, y - ay - share * dy)


@njit(cache=True, inline="always")
def half_window(distance, radius, step, most):  # type: ignore[no-untyped-def]
    """Beams to either side between which everything within `radius` of a point at `distance` lies."""
    if distance <= radius * 1.02:
        return most
    return min(int(math.asin(radius / distance) / abs(step)) + 1, most)


@njit(cache=True)
def off_outline(x, y, radius, xy, ranges, angle_min, step):  # type: ignore[no-untyped-def]
    """Distance from (x, y) to a scan's outline, `radius` where that is farther."""
    count = len(ranges)
    stride = abs(step)
    around = round(2.0 * math.pi / stride)
    centre = beam_at(x, y, angle_min, step)
    distance = math.hypot(x, y)
    best = radius
    for away in range(around // 2 + 1):
        # Beams outwards from the one that looks there, until none can be nearer than what was found.
        angle = (away - 1.5) * stride
        if angle > 0.0 and distance > best and (angle >= 0.5 * math.pi or distance * math.sin(angle) > best):
            break
        for side in range(2):
            if away == 0 and side == 1:
                continue
            j = centre + away if side == 0 else centre - away
            if j >= around:
                j -= around
            elif j < 0:
                j += around
            if j < 0 or j >= count or not ranges[j] < math.inf or abs(ranges[j] - distance) > best + LONGEST:
                continue
            best = min(best, math.hypot(x - xy[j, 0], y - xy[j, 1]))
            after = j + 1
            if after < count and ranges[after] < math.inf:
                length = math.hypot(xy[after, 0] - xy[j, 0], xy[after, 1] - xy[j, 1])
                # Only surfaces run on between beams, not jumps from one thing to the next.
                if length < max(0.08, min(6.0 * stride * min(ranges[j], ranges[after]), LONGEST)):
                    best = min(best, _off_segment(x, y, xy[j, 0], xy[j, 1], xy[after, 0], xy[after, 1]))
    return best


TOUCHING = 1.0001


@njit(cache=True)
def sight(x, y, near, xy, ranges, clear, angle_min, step, wide=3.0):  # type: ignore[no-untyped-def]
    """(label, distance off the outline): how a scan sees the spot (x, y).

    wide : the distance is told up to so many times `near`; the label needs no more than `TOUCHING`.

    AGREES: on its outline; FREE: it saw through there; HIDDEN: behind what it saw; UNSEEN: no beam tells; CLEAR:
    near, and nothing came back from there.
    """
    radius = wide * near
    off = off_outline(x, y, radius, xy, ranges, angle_min, step)
    if off <= near:
        return AGREES, off
    count = len(ranges)
    around = round(2.0 * math.pi / abs(step))
    centre = beam_at(x, y, angle_min, step)
    if centre < 0 or centre >= count:
        return UNSEEN, off
    distance = math.hypot(x, y)
    if not ranges[centre] < math.inf:
        return (CLEAR if distance < clear[centre] else UNSEEN), off
    nearest, farthest = math.inf, 0.0
    for k in range(-1, 2):
        j = (centre + k) % around
        if j < count and ranges[j] < math.inf:
            nearest = min(nearest, ranges[j])
            farthest = max(farthest, ranges[j])
    if distance < nearest - MARGIN * near:
        return FREE, off
    if distance > farthest + MARGIN * near:
        return HIDDEN, off
    return UNSEEN, off


@njit(cache=True)
def sightings(points, near, wanted, pose, xy, ranges, clear, angle_min, step, wide=3.0):  # type: ignore[no-untyped-def]
    """`sight` of points (n, 2) moved by pose (3,): labels (n,) and distances off the outline (n,).

    Points that are not `wanted` (n,) are taken to be unseen and far off.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    labels, offs = np.empty(len(points), dtype=np.int64), np.empty(len(points))
    for k in range(len(points)):
        if not wanted[k]:
            labels[k], offs[k] = UNSEEN, wide * near[k]
            continue
        x = pose[0] + c * points[k, 0] - s * points[k, 1]
        y = pose[1] + s * points[k, 0] + c * points[k, 1]
        labels[k], offs[k] = sight(x, y, near[k], xy, ranges, clear, angle_min, step, wide)
    return labels, offs


def seen_by(a: Beams, b: Beams, pose: Array, noise: float) -> tuple[NDArray[np.int64], Array]:
    """How scan b sees the points of a moved by pose (3,): labels (n,), metres off b's outline (n,).

    noise : metres, standard deviation of points off the other scan's outline (`noise_between`).
    """
    near = nearness(a, noise)
    found: tuple[NDArray[np.int64], Array] = sightings(
        a.points, near, np.ones(len(a), dtype=np.bool_), pose, b.xy, b.ranges, b.clear, b.angle_min, b.step
    )
    return found


def nearness(a: Beams, noise: float) -> Array:
    """(n,) metres off an outline up to which each point of a may be noise."""
    return np.maximum(max(NEAR, SIGMAS * noise), 0.3 * a.spacing)


def noise_between(a: Beams, b: Beams, pose: Array) -> float:
    """Standard deviation, metres, of the points of a off the outline of b under pose (3,), 0.005 to 0.05."""
    near = np.full(len(a), 0.1)
    labels, offs = sightings(
        a.points, near, np.ones(len(a), dtype=np.bool_), pose, b.xy, b.ranges, b.clear, b.angle_min, b.step
    )
    agreeing = offs[labels == AGREES]
    return float(np.clip(1.48 * np.median(agreeing), 0.005, 0.05)) if len(agreeing) >= 10 else 0.02

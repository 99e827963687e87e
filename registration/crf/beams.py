"""Scans made ready to be compared: returns in the order of their beams, with what each beam saw through."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.sight import beam_at
from registration.laser.outline import TOUCHING, WIDE, length, sightings
from registration.laser.prepared import once
from registration.laser.scan import Scan

NEAR = 0.03  # metres off an outline up to which a point may be noise, at the least
SIGMAS = 3.5  # standard deviations of the noise the scans themselves show, likewise
NEARER = 0.7  # of the median range: what is near
EMPTY = 5  # beams in a row without return, around one, that say that nothing near is there
FARTHEST = 1.0  # metres between neighbouring beams on one surface
ARM = 0.12  # metres to either side of a corner
HOLLOW = 0.6  # radians that an outline turns away from the scanner, from which it is two parts
MOST_OFF = 0.1  # metres off an outline that may be noise, before it is known


@dataclass(frozen=True, eq=False)
class Beams:
    """A scan made ready.

    xy : (B, 2) metres, end point of each beam, NaN without a return. ranges : (B,) inf without a return.
    clear : (B,) metres up to which a beam without return says that nothing is there, 0 where it does not.
    beams : (n,) which beams returned. points : (n, 2) their end points. spacing : (n,) metres between beams on a
    surface faced head-on there, at least the scanner's own noise. pieces : (n,) number of the connected piece.
    number : (B,) of each beam's point in `points`, -1 without a return.
    """

    xy: FloatArray
    ranges: FloatArray
    clear: FloatArray
    beams: NDArray[np.int64]
    points: FloatArray
    spacing: FloatArray
    pieces: NDArray[np.int64]
    number: NDArray[np.int64]
    angle_min: float
    step: float

    def __len__(self) -> int:
        return len(self.beams)

    @cached_property
    def parts(self) -> NDArray[np.int64]:
        """(n,) number of the part of each point on its piece; see `parts_of`."""
        return np.asarray(parts_of(self.points, self.pieces, np.sign(self.step)))

    @cached_property
    def gaps(self) -> FloatArray:
        """(n,) metres from each point to the farther neighbour on the same surface, 0 without one."""
        gaps = np.hypot(*np.diff(self.points, axis=0).T)
        gaps = np.where((np.diff(self.pieces) == 0) & (gaps < FARTHEST), gaps, 0.0)
        return np.maximum(np.append(gaps, 0.0), np.insert(gaps, 0, 0.0))


@once
def beams_of(scan: Scan) -> Beams:
    """`Beams` of a scan."""
    valid = scan.valid
    ranges = np.where(valid, scan.ranges, np.inf)
    bearings = scan.bearings
    xy = np.full((len(scan), 2), np.nan)
    xy[valid, 0] = ranges[valid] * np.cos(bearings[valid])
    xy[valid, 1] = ranges[valid] * np.sin(bearings[valid])
    beams = np.flatnonzero(valid)
    number = np.full(len(scan), -1, dtype=np.int64)
    number[beams] = np.arange(len(beams))
    points = np.ascontiguousarray(xy[beams])
    step = scan.angle_increment if len(scan) > 1 else 1e-3
    spacing = np.maximum(abs(step) * ranges[beams], 0.02)
    pieces = _pieces(points, beams, abs(step))
    return Beams(
        xy, ranges, _clear(ranges), beams, points, spacing, pieces, number, scan.angle_min, step
    )  # fmt: skip


def _clear(ranges: FloatArray) -> FloatArray:
    """What no return says: single beams get lost, but something near does not lose `EMPTY` beams in a row."""
    lost = ~np.isfinite(ranges)
    if lost.all():
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
    gap = length(dx, dy)
    near = min(length(points[i, 0], points[i, 1]), length(points[j, 0], points[j, 1]))
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
        return length(ex, ey) < 1.5 * gap and _aligned(ex, ey, dx, dy)
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


@njit(cache=True)
def parts_of(points, pieces, side):  # type: ignore[no-untyped-def]
    """Number (n,) of the part of each point: a piece is cut at hollow corners, where one thing stands before another.

    side : 1.0 where beams go counterclockwise, -1.0 else.
    """
    n = len(points)
    turn = np.zeros(n)
    for i in range(n):
        low = high = i
        ux = uy = vx = vy = 0.0
        while low > 0 and pieces[low - 1] == pieces[i] and math.hypot(ux, uy) < ARM:
            low -= 1
            ux, uy = points[i, 0] - points[low, 0], points[i, 1] - points[low, 1]
        while high < n - 1 and pieces[high + 1] == pieces[i] and math.hypot(vx, vy) < ARM:
            high += 1
            vx, vy = points[high, 0] - points[i, 0], points[high, 1] - points[i, 1]
        if min(math.hypot(ux, uy), math.hypot(vx, vy)) > 0.5 * ARM:
            turn[i] = side * math.atan2(ux * vy - uy * vx, ux * vx + uy * vy)
    parts = np.zeros(n, dtype=np.int64)
    for i in range(1, n):
        cut = turn[i - 1] > HOLLOW and turn[i - 1] >= turn[i] and turn[i - 1] >= turn[max(i - 2, 0)]
        parts[i] = parts[i - 1] + (cut or pieces[i] != pieces[i - 1])
    return parts


@njit(cache=True)
def ends_of(pieces, count):  # type: ignore[no-untyped-def]
    """First and last point of each piece, (P, 4), and the points before and beyond it, -1 and n at the ends.

    count : (P,) points of each. Single readings beside a piece are no edge of anything.
    """
    n = len(pieces)
    ends = np.full((len(count), 4), -1, dtype=np.int64)
    for k in range(n):
        if ends[pieces[k], 0] < 0:
            ends[pieces[k], 0] = k
        ends[pieces[k], 1] = k
    for p in range(len(count)):
        before, beyond = ends[p, 0] - 1, ends[p, 1] + 1
        while before > 0 and count[pieces[before]] == 1:
            before -= 1
        while beyond < n - 1 and count[pieces[beyond]] == 1:
            beyond += 1
        ends[p, 2], ends[p, 3] = before, beyond
    return ends


def sighted(
    a: Beams,
    b: Beams,
    pose: FloatArray,
    near: FloatArray,
    wanted: NDArray[np.bool_] | None = None,
    wide: float = TOUCHING,
) -> tuple[NDArray[np.int64], FloatArray]:
    """How scan b sees the points of a moved by pose (3,): labels (n,), metres off b's outline (n,); see `sightings`."""
    asked = np.ones(len(a), dtype=np.bool_) if wanted is None else wanted
    found: tuple[NDArray[np.int64], FloatArray] = sightings(
        a.points, near, asked, pose, b.xy, b.ranges, b.clear, b.angle_min, b.step, wide
    )
    return found


def seen_by(
    a: Beams, b: Beams, pose: FloatArray, noise: float, wide: float = WIDE
) -> tuple[NDArray[np.int64], FloatArray]:
    """As `sighted`; noise : metres, standard deviation of points off the other scan's outline (`first_look`)."""
    return sighted(a, b, pose, nearness(a, noise), wide=wide)


def moved(points: FloatArray, motion: FloatArray) -> FloatArray:
    """Points (n, 2), or one (2,), moved by a motion (3,)."""
    c, s = math.cos(motion[2]), math.sin(motion[2])
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + motion[:2])


@njit(cache=True)
def shifted(points, motion):  # type: ignore[no-untyped-def]
    """As `moved`, in compiled functions: points (n, 2) moved by a motion (3,)."""
    c, s = math.cos(motion[2]), math.sin(motion[2])
    there = np.empty_like(points)
    for i in range(len(points)):
        there[i, 0] = motion[0] + c * points[i, 0] - s * points[i, 1]
        there[i, 1] = motion[1] + s * points[i, 0] + c * points[i, 1]
    return there


class Seen(NamedTuple):
    """What a scan saw, by beam: xy (B, 2), number (B,) and ranges (B,) as of `Beams`."""

    xy: Any
    number: Any
    ranges: Any
    angle_min: float
    step: float


def seen(beams: Beams) -> Seen:
    """What a scan saw, for compiled functions."""
    return Seen(beams.xy, beams.number, beams.ranges, beams.angle_min, beams.step)


@njit(cache=True)
def point_there(x, y, there):  # type: ignore[no-untyped-def]
    """Point that the beam saw which looks at (x, y), -1 for none; that beam, beyond the last where none looks there."""
    beam = int(beam_at(x, y, there.angle_min, there.step))
    return (there.number[beam] if beam < len(there.number) else -1), beam


@njit(cache=True)
def nearest_point(x, y, reach, there):  # type: ignore[no-untyped-def]
    """Point that a scan saw nearest to (x, y), closer than `reach` metres, -1 for none; how far that is, metres."""
    count, away = len(there.number), length(x, y)
    first, last = 0, count
    around = round(2.0 * math.pi / abs(there.step))
    if away > reach:
        beam = int(beam_at(x, y, there.angle_min, there.step))
        beside = int(math.asin(reach / away) / abs(there.step)) + 2
        if 2 * beside < around:
            first, last = beam - beside, beam + beside + 1
    best, found = reach * reach, -1
    for k in range(first, last):
        j = k + around if k < 0 else k - around if k >= around else k
        if j < count:
            square = (x - there.xy[j, 0]) ** 2 + (y - there.xy[j, 1]) ** 2
            if square < best:
                best, found = square, there.number[j]
    return found, math.sqrt(best)


def per_beam(
    a: Beams, b: Beams, partners: NDArray[np.int64], clusters: NDArray[np.int64], probability: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Points of b, clusters and probabilities of the points of a, (n,), by beam: (N,), -1 and NaN without return."""
    beams = np.full((2, len(a.ranges)), -1, dtype=np.int64)
    beams[:, a.beams] = np.where(partners >= 0, b.beams[np.maximum(partners, 0)], -1), clusters
    probabilities = np.full(len(a.ranges), np.nan)
    probabilities[a.beams] = probability
    return beams[0], beams[1], probabilities


def nearness(a: Beams, noise: float) -> FloatArray:
    """(n,) metres off an outline up to which each point of a may be noise."""
    return np.maximum(max(NEAR, SIGMAS * noise), 0.3 * a.spacing)


def first_look(a: Beams, b: Beams, pose: FloatArray) -> tuple[float, NDArray[np.int64], FloatArray]:
    """Noise of the points of a off the outline of b under pose (3,), and how b sees them then (`seen_by`).

    The noise is a standard deviation, metres, 0.005 to 0.05.
    """
    noise, labels, offs = _first_look(a.points, a.spacing, pose, b.xy, b.ranges, b.clear, b.angle_min, b.step)
    return float(noise), labels, offs


@njit(cache=True)
def _first_look(points, spacing, pose, xy, ranges, clear, angle_min, step):  # type: ignore[no-untyped-def]
    all_of_them = np.ones(len(points), dtype=np.bool_)
    # A little wider than where the label alone is asked for, which is answered without distances.
    most = np.full(len(points), MOST_OFF)
    _, offs = sightings(points, most, all_of_them, pose, xy, ranges, clear, angle_min, step, 1.01)
    agreeing = offs[offs <= MOST_OFF]
    noise = min(max(1.48 * np.median(agreeing), 0.005), 0.05) if len(agreeing) >= 10 else 0.02
    near = np.maximum(max(NEAR, SIGMAS * noise), 0.3 * spacing)
    labels, offs = sightings(points, near, all_of_them, pose, xy, ranges, clear, angle_min, step, WIDE)
    return noise, labels, offs

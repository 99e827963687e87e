"""What speaks for and against each point of a scan having moved, beside the groups that were found.

A point alone says little: the flank of a cart agrees with where it was, and what a walker hides stands. Its piece says
more: how much of it was seen through, hidden or still in place, its shape, what the scan beside it shows, and how much
of it is in groups.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.sight import AGREES, HIDDEN, THROUGH, UNSEEN
from registration.crf.beams import ends_of, nearness, point_there, seen, shifted
from registration.crf.setup import Start
from registration.laser.outline import CLEAR

NAMES = (
    # Of the point: how b sees it, and what is around it on its piece.
    "off", "depth", "in group", "run", "agreeing near", "seen through near", "hidden near", "to mover",
    # Of its piece.
    "agreeing", "seen through", "hidden", "unseen", "points seen through", "in groups",
    "piece to mover", "mean depth", "out of view", "hidden by new",
    "extent", "chord", "bulge", "dent", "lower edge", "higher edge",
    # Of its part of the piece, from one hollow corner to the next: what touches something else.
    "part agreeing", "part seen through", "part hidden", "part unseen", "part in groups", "part to mover",
    "part extent", "part chord", "part lower edge", "part higher edge",
    # Of the cluster it is in, -1 without.
    "cluster agreeing", "cluster seen through",
    # Of both scans: how much goes on.
    "scan seen through", "scan hidden", "scan new",
)  # fmt: skip
FAR = 2.0  # metres at which distances and depths are cut off
LONG = 8.0  # metres, of a piece, likewise
WIDE = 2.0  # metres, of how far a piece bends off its chord, likewise
MOST = 30.0  # points, of what is counted, likewise
AROUND = 6  # points of a piece to either side that are near
NOTHING_BESIDE = -3.0  # in place of an edge, at the ends of a scan


class Here(NamedTuple):
    """Points (n, 2) of scan a, their ranges (n,), m, and (n,) the numbers of what they are in: the piece, its part, the
    cluster. sight (n,) : how b sees them. off (n,) : how far off its outline they are, by what may be noise."""

    points: Any
    ranges: Any
    pieces: Any
    parts: Any
    clusters: Any
    sight: Any
    off: Any


def evidence(begun: Start, clusters: NDArray[np.int64]) -> FloatArray:
    """(n, len(NAMES)) for the points of scan a in `clusters` (n,), see `groups_as_labels`."""
    a = begun.a
    here = Here(
        a.points,
        a.ranges[a.beams],
        a.pieces,
        a.parts,
        clusters,
        begun.sight,
        begun.off / nearness(a, begun.noise),
    )
    return np.asarray(_evidence(here, seen(begun.b), begun.registration.transform, begun.fresh))


@njit(cache=True)
def _evidence(here, there, motion, fresh):  # type: ignore[no-untyped-def]
    """See `evidence`. motion (3,) : of the background. fresh (m,) : how scan a sees the points of b."""
    n = len(here.points)
    new = (fresh == THROUGH) | (fresh == CLEAR)
    told, away = _told(here, there, motion, new), _to_movers(here.points, here.clusters)
    pieces, count, nearest = of_pieces(here.pieces, told, away)
    shapes, ends = _shapes(here.points, here.ranges, here.pieces, count)
    parts, part_count, part_nearest = of_pieces(here.parts, told, away)
    part_shapes, _ = _shapes(here.points, here.ranges, here.parts, part_count)
    groups, _, _ = of_pieces(np.maximum(here.clusters, 0), told, away)
    near = _around(here.points, here.pieces, ends, told)
    whole = np.array([told[:, 1].sum() / n, told[:, 2].sum() / n, new.sum() / max(len(new), 1)])
    rows = np.empty((n, len(NAMES)))
    for i in range(n):
        p, q, g, row = here.pieces[i], here.parts[i], here.clusters[i], rows[i]
        row[0], row[1], row[2], row[7] = min(here.off[i], 3.0), told[i, 5], told[i, 4], away[i]
        row[3:7] = near[i]
        row[8:12], row[12], row[13] = pieces[p, :4], min(pieces[p, 1] * count[p], MOST), pieces[p, 4]
        row[14], row[15:18], row[18:24] = nearest[p], pieces[p, 5:], shapes[p]
        row[24:29], row[29] = parts[q, :5], part_nearest[q]
        row[30:32], row[32:34] = part_shapes[q, :2], part_shapes[q, 4:]
        row[34], row[35] = (groups[g, 0], groups[g, 1]) if g > 0 else (-1.0, -1.0)
        row[36:] = whole
    return rows


@njit(cache=True)
def _told(here, there, motion, new):  # type: ignore[no-untyped-def]
    """Whether each point agrees, is seen through, hidden, unseen, in a group; how far it is behind what scan b saw,
    whether it is out of its view, and hidden by what is `new` (m,) there: (n, 8)."""
    told = np.zeros((len(here.points), 8))
    moved_there = shifted(here.points, motion)
    for i in range(len(told)):
        label, x, y = here.sight[i], moved_there[i, 0], moved_there[i, 1]
        told[i, 0], told[i, 1] = label == AGREES, label in (THROUGH, CLEAR)
        told[i, 2], told[i, 3], told[i, 4] = label == HIDDEN, label == UNSEEN, here.clusters[i] > 0
        other, beam = point_there(x, y, there)
        told[i, 6] = beam >= len(there.number)
        if other >= 0:
            told[i, 5] = min(max(math.hypot(x, y) - there.ranges[beam], -FAR), FAR)
            told[i, 7] = label == HIDDEN and new[other]
    return told


@njit(cache=True)
def _to_movers(points, clusters):  # type: ignore[no-untyped-def]
    """Metres (n,) from each point to the nearest one in a group, at most `FAR`."""
    movers = points[clusters > 0]
    away = np.full(len(points), FAR * FAR)
    for i in range(len(points)):
        for j in range(len(movers)):
            away[i] = min(away[i], (points[i, 0] - movers[j, 0]) ** 2 + (points[i, 1] - movers[j, 1]) ** 2)
    return np.sqrt(away)


@njit(cache=True)
def of_pieces(number, values, away):  # type: ignore[no-untyped-def]
    """Means (P, K) of values (n, K) over the piece that each point is on, how many points it has (P,), and the least
    `away` (n,) among them, at most `FAR`.

    number : (n,) of the piece, from 0.
    """
    pieces = number.max() + 1 if len(number) else 0
    means, count = np.zeros((pieces, values.shape[1])), np.zeros(pieces)
    nearest = np.full(pieces, FAR)
    for i in range(len(number)):
        p = number[i]
        count[p] += 1.0
        nearest[p] = min(nearest[p], away[i])
        for k in range(values.shape[1]):
            means[p, k] += values[i, k]
    for p in range(pieces):
        for k in range(values.shape[1]):
            means[p, k] /= max(count[p], 1.0)
    return means, count, nearest


@njit(cache=True)
def _around(points, pieces, ends, seen):  # type: ignore[no-untyped-def]
    """What is near on the pieces, (n, 4): length of the run of points that b sees alike, and the shares among
    `AROUND` points to either side that agree, are seen through and hidden."""
    n = len(points)
    near = np.zeros((n, 4))
    first = 0
    for i in range(n):
        low, high = max(i - AROUND, ends[pieces[i], 0]), min(i + AROUND, ends[pieces[i], 1])
        for j in range(low, high + 1):
            for k in range(3):
                near[i, 1 + k] += seen[j, k]
        near[i, 1:] /= high - low + 1
        if i and (pieces[i] != pieces[i - 1] or seen[i, 0] != seen[i - 1, 0] or seen[i, 1] != seen[i - 1, 1]):
            near[first:i, 0] = min(near[i - 1, 0], LONG)
            first = i
        elif i:
            step = math.hypot(points[i, 0] - points[i - 1, 0], points[i, 1] - points[i - 1, 1])
            near[i, 0] = near[i - 1, 0] + step
    if n:
        near[first:, 0] = min(near[n - 1, 0], LONG)
    return near


@njit(cache=True)
def _shapes(points, ranges, pieces, count):  # type: ignore[no-untyped-def]
    """Extent, chord, greatest distances off it, and edges of each piece, (P, 6); its `ends_of`."""
    ends = ends_of(pieces, count)
    shapes = np.zeros((len(count), 6))
    for p in range(len(count)):
        f, l, before, beyond = ends[p]
        ux, uy = points[l, 0] - points[f, 0], points[l, 1] - points[f, 1]
        chord = np.hypot(ux, uy)
        left, right, low, high = points[f, 0], points[f, 0], points[f, 1], points[f, 1]
        for k in range(f, l + 1):
            if pieces[k] == p:
                x, y = points[k]
                left, right, low, high = min(left, x), max(right, x), min(low, y), max(high, y)
                off = (x - points[f, 0]) * uy - (y - points[f, 1]) * ux
                off /= max(chord, 1e-6)
                shapes[p, 2] = max(shapes[p, 2], min(off, WIDE))
                shapes[p, 3] = max(shapes[p, 3], min(-off, WIDE))
        shapes[p, 0] = min(np.hypot(right - left, high - low), LONG)
        shapes[p, 1] = min(chord, LONG)
        lower = min(max(ranges[before] - ranges[f], -FAR), FAR) if before >= 0 else NOTHING_BESIDE
        higher = min(max(ranges[beyond] - ranges[l], -FAR), FAR) if beyond < len(points) else NOTHING_BESIDE
        shapes[p, 4], shapes[p, 5] = min(lower, higher), max(lower, higher)
    return shapes, ends

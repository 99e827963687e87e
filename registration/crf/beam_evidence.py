"""What speaks for and against each point of a scan having moved, beside the groups that were found.

A point alone says little: the flank of a cart agrees with where it was, and what a walker hides stands. Its piece says
more: how much of it was seen through, hidden or still in place, its shape, what the scan beside it shows, and how much
of it is in groups.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from estimation.geometry.sight import AGREES, HIDDEN, THROUGH, UNSEEN
from registration.crf.beams import ends_of, moved, nearness, point_at
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


def evidence(begun: Start, clusters: NDArray[np.int64]) -> FloatArray:
    """(n, len(NAMES)) for the points of scan a in `clusters` (n,), see `groups_as_labels`."""
    a, moving, new = begun.a, clusters > 0, _through(begun.fresh)
    # The first five are how b sees a point, and whether it is in a group; the others `_behind`.
    through, hidden = _through(begun.sight), begun.sight == HIDDEN
    sights = (begun.sight == AGREES, through, hidden, begun.sight == UNSEEN, moving)
    seen = np.column_stack((*sights, *_behind(begun, hidden, new)))
    away = cKDTree(a.points[moving]).query(a.points, distance_upper_bound=FAR)[0]
    away = np.minimum(away, FAR)
    off = np.minimum(begun.off / nearness(a, begun.noise), 3.0)
    ranges = a.ranges[a.beams]
    means, count, nearest = of_pieces(a.pieces, seen, away)
    shapes, ends = _shapes(a.points, ranges, a.pieces, count)
    some = np.minimum(means[:, 1] * count, MOST)
    pieces = np.column_stack((means[:, :4], some, means[:, 4], nearest, means[:, 5:], shapes))
    means, count, nearest = of_pieces(a.parts, seen, away)
    shapes, _ = _shapes(a.points, ranges, a.parts, count)
    parts = np.column_stack((means[:, :5], nearest, shapes[:, :2], shapes[:, 4:]))
    cluster = of_pieces(np.maximum(clusters, 0), seen, away)[0][:, :2]
    cluster[0] = -1.0
    return np.column_stack(
        (
            *(off, seen[:, 5], moving, _around(a.points, a.pieces, ends, seen), away),
            *(pieces[a.pieces], parts[a.parts], cluster[np.maximum(clusters, 0)]),
            np.broadcast_to((through.mean(), hidden.mean(), new.mean() if len(new) else 0.0), (len(a), 3)),
        )
    )


def _through(sight: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which points were seen through."""
    return np.asarray((sight == THROUGH) | (sight == CLEAR))


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


def _behind(begun: Start, hidden: NDArray[np.bool_], new: NDArray[np.bool_]) -> FloatArray:
    """How far the points are behind what scan b saw, whether they are out of its view, and hidden by what is new there.

    (3, n); new : (m,) of the points of b.
    """
    b, there = begun.b, moved(begun.a.points, begun.registration.transform)
    other, inside = point_at(b, there)
    seen = other >= 0
    depth = np.zeros((3, len(other)))
    depth[0, seen] = np.hypot(*there[seen].T) - b.ranges[b.beams[other[seen]]]
    np.clip(depth[0], -FAR, FAR, out=depth[0])
    depth[1] = ~inside
    depth[2, seen] = hidden[seen] & new[other[seen]]
    return depth

"""What speaks for and against each point of a scan having moved, beside the groups that were found.

A point alone says little: the flank of a cart agrees with where it was, and what a walker hides stands. Its piece says
more: how much of it was seen through, hidden or still in place, its shape, what the scan beside it shows, and how much
of it is in groups.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from estimation.geometry.sight import AGREES, HIDDEN, THROUGH, UNSEEN
from registration.crf.beams import Beams, ends_of, moved, nearness, point_at
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
ARM = 0.12  # metres to either side of a corner
HOLLOW = 0.6  # radians that an outline turns away from the scanner, from which it is two parts
NOTHING_BESIDE = -3.0  # in place of an edge, at the ends of a scan


@dataclass(frozen=True, eq=False)
class Pieces:
    """Points by the piece (n,) they are on: how many (P,), and means and sums over them."""

    number: NDArray[np.int64]
    count: FloatArray

    @classmethod
    def of(cls, number: NDArray[np.int64]) -> Pieces:
        return cls(number, np.bincount(number).astype(np.float64))

    def total(self, values: FloatArray) -> FloatArray:
        """(P,) sums of values (n,)."""
        return np.asarray(np.bincount(self.number, values, len(self.count)), dtype=np.float64)

    def mean(self, values: FloatArray) -> FloatArray:
        """(n,) mean over the piece of each point, of values (n,)."""
        return np.asarray((self.total(values) / self.count)[self.number])


def evidence(begun: Start, clusters: NDArray[np.int64]) -> FloatArray:
    """(n, len(NAMES)) for the points of scan a in `clusters` (n,), see `groups_as_labels`."""
    a = begun.a
    through = ((begun.sight == THROUGH) | (begun.sight == CLEAR)).astype(np.float64)
    seen = {
        "agreeing": (begun.sight == AGREES).astype(np.float64),
        "seen through": through,
        "hidden": (begun.sight == HIDDEN).astype(np.float64),
        "unseen": (begun.sight == UNSEEN).astype(np.float64),
        "in groups": (clusters > 0).astype(np.float64),
    }
    away = np.minimum(cKDTree(a.points[clusters > 0]).query(a.points)[0], FAR)
    pieces, parts = Pieces.of(a.pieces), Pieces.of(parts_of(a.points, a.pieces, np.sign(a.step)))
    columns, ends = _of_pieces(a, seen, away, pieces)
    columns |= {f"part {name}": values for name, values in _of_pieces(a, seen, away, parts)[0].items()}
    columns |= {"piece to mover": columns["to mover"], "to mover": away, "in group": seen["in groups"]}
    columns["points seen through"] = np.minimum(pieces.total(through), MOST)[a.pieces]
    columns |= _around(begun, seen, ends) | _behind(begun, seen["hidden"], pieces)
    columns |= _of_cluster(clusters, seen) | _of_scans(begun, seen)
    return np.column_stack([columns[name] for name in NAMES])


def _of_pieces(
    a: Beams, seen: dict[str, FloatArray], away: FloatArray, pieces: Pieces
) -> tuple[dict[str, FloatArray], NDArray[np.int64]]:
    """How a piece is seen, how far it is from what moves and its shape, by its points, (n,) each; its `ends_of`."""
    columns = {name: pieces.mean(values) for name, values in seen.items()}
    nearest = np.full(len(pieces.count), FAR)
    np.minimum.at(nearest, pieces.number, away)
    columns["to mover"] = nearest[pieces.number]
    shapes, ends = _shapes(a.points, a.ranges[a.beams], pieces.number, pieces.count)
    names = ("extent", "chord", "bulge", "dent", "lower edge", "higher edge")
    return columns | dict(zip(names, shapes[pieces.number].T, strict=True)), ends


def _of_scans(begun: Start, seen: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """What is the same for all points."""
    new = (begun.fresh == THROUGH) | (begun.fresh == CLEAR)
    shares = {
        "scan seen through": seen["seen through"].mean(),
        "scan hidden": seen["hidden"].mean(),
        "scan new": new.mean() if len(new) else 0.0,
    }
    return {name: np.full(len(begun.a), share) for name, share in shares.items()}


def _around(begun: Start, seen: dict[str, FloatArray], ends: NDArray[np.int64]) -> dict[str, FloatArray]:
    """What is near on the pieces."""
    a = begun.a
    columns: dict[str, FloatArray] = {}
    index = np.arange(len(a))
    low = np.maximum(index - AROUND, ends[a.pieces, 0])
    high = np.minimum(index + AROUND, ends[a.pieces, 1]) + 1
    for name in ("agreeing", "seen through", "hidden"):
        sums = np.concatenate(([0.0], np.cumsum(seen[name])))
        columns[f"{name} near"] = (sums[high] - sums[low]) / (high - low)
    kind = seen["agreeing"] + 2.0 * seen["seen through"]
    breaks = np.concatenate(([True], (np.diff(kind) != 0.0) | (np.diff(a.pieces) != 0)))
    steps = np.where(breaks, 0.0, np.hypot(*np.diff(a.points, axis=0, prepend=a.points[:1]).T))
    runs = np.cumsum(breaks) - 1
    columns["run"] = np.minimum(np.bincount(runs, steps), LONG)[runs]
    columns["off"] = np.minimum(begun.off / nearness(a, begun.noise), 3.0)
    return columns


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
def _shapes(points, ranges, pieces, count):  # type: ignore[no-untyped-def]
    """Extent, chord, greatest distances off it, and edges of each piece, (P, 6); its `ends_of`."""
    ends = ends_of(pieces, count)
    shapes = np.zeros((len(count), 6))
    for p in range(len(count)):
        f, l, before, beyond = ends[p]
        ux, uy = points[l, 0] - points[f, 0], points[l, 1] - points[f, 1]
        chord = np.hypot(ux, uy)
        low, high = points[f].copy(), points[f].copy()
        for k in range(f, l + 1):
            if pieces[k] == p:
                low, high = np.minimum(low, points[k]), np.maximum(high, points[k])
                off = (points[k, 0] - points[f, 0]) * uy - (points[k, 1] - points[f, 1]) * ux
                off /= max(chord, 1e-6)
                shapes[p, 2] = max(shapes[p, 2], min(off, WIDE))
                shapes[p, 3] = max(shapes[p, 3], min(-off, WIDE))
        shapes[p, 0] = min(np.hypot(high[0] - low[0], high[1] - low[1]), LONG)
        shapes[p, 1] = min(chord, LONG)
        left = min(max(ranges[before] - ranges[f], -FAR), FAR) if before >= 0 else NOTHING_BESIDE
        right = min(max(ranges[beyond] - ranges[l], -FAR), FAR) if beyond < len(points) else NOTHING_BESIDE
        shapes[p, 4], shapes[p, 5] = min(left, right), max(left, right)
    return shapes, ends


def _behind(begun: Start, hidden: FloatArray, pieces: Pieces) -> dict[str, FloatArray]:
    """How far the points are behind what scan b saw, and whether that is new there or stood before."""
    b, there = begun.b, moved(begun.a.points, begun.registration.transform)
    other, inside = point_at(b, there)
    seen = other >= 0
    fresh = np.where(seen, begun.fresh[np.maximum(other, 0)], -1)
    depth = np.zeros(len(other))
    depth[seen] = np.hypot(*there[seen].T) - b.ranges[b.beams[other[seen]]]
    depth = np.clip(depth, -FAR, FAR)
    return {
        "depth": depth,
        "mean depth": pieces.mean(depth),
        "out of view": pieces.mean((~inside).astype(np.float64)),
        "hidden by new": pieces.mean(hidden * ((fresh == THROUGH) | (fresh == CLEAR))),
    }


def _of_cluster(clusters: NDArray[np.int64], seen: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """How b sees the other points of the cluster of each point."""
    own = np.maximum(clusters, 0)
    count = np.maximum(np.bincount(own), 1)
    return {
        f"cluster {name}": np.where(clusters > 0, (np.bincount(own, values) / count)[own], -1.0)
        for name, values in seen.items()
        if name in ("agreeing", "seen through")
    }

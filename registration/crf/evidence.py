"""What speaks for and against each point of a scan having moved, beside the groups that were found.

A point alone says little: the flank of a cart agrees with where it was, and what a walker hides stands. Its piece says
more: how much of it was seen through, hidden or still in place, its shape, what the scan beside it shows, and how much
of it is in groups.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.sight import AGREES, HIDDEN, THROUGH, UNSEEN
from registration.crf.beams import Beams, ends_of, moved, nearness, point_at
from registration.crf.setup import Start
from registration.motion import Array
from registration.outline import CLEAR

NAMES = (
    # Of the point: how b sees it, and what is around it on its piece.
    "off", "depth", "in group", "run", "agreeing near", "seen through near", "hidden near", "to mover",
    # Of its piece.
    "agreeing", "seen through", "hidden", "unseen", "points seen through", "in groups",
    "piece to mover", "mean depth", "out of view", "hidden by new",
    "extent", "chord", "bulge", "dent", "lower edge", "higher edge",
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


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Points by the piece (n,) they are on: how many (P,), and means and sums over them."""

    number: NDArray[np.int64]
    count: Array

    def total(self, values: Array) -> Array:
        """(P,) sums of values (n,)."""
        return np.asarray(np.bincount(self.number, values, len(self.count)), dtype=np.float64)

    def mean(self, values: Array) -> Array:
        """(n,) mean over the piece of each point, of values (n,)."""
        return np.asarray((self.total(values) / self.count)[self.number])


def evidence(begun: Start, clusters: NDArray[np.int64]) -> Array:
    """(n, len(NAMES)) for the points of scan a in `clusters` (n,), see `groups_as_labels`."""
    a = begun.a
    pieces = _Pieces(a.pieces, np.bincount(a.pieces).astype(np.float64))
    through = ((begun.sight == THROUGH) | (begun.sight == CLEAR)).astype(np.float64)
    seen = {
        "agreeing": (begun.sight == AGREES).astype(np.float64),
        "seen through": through,
        "hidden": (begun.sight == HIDDEN).astype(np.float64),
    }
    columns = {name: pieces.mean(values) for name, values in seen.items()}
    columns["unseen"] = pieces.mean((begun.sight == UNSEEN).astype(np.float64))
    columns["points seen through"] = np.minimum(pieces.total(through), MOST)[a.pieces]
    columns |= _around(begun, seen, pieces) | _behind(begun, seen["hidden"], pieces)
    columns |= _of_groups(a, clusters, pieces) | _of_cluster(clusters, seen)
    columns |= _of_scans(begun, seen)
    return np.column_stack([columns[name] for name in NAMES])


def _of_scans(begun: Start, seen: dict[str, Array]) -> dict[str, Array]:
    """What is the same for all points."""
    new = (begun.fresh == THROUGH) | (begun.fresh == CLEAR)
    shares = {
        "scan seen through": seen["seen through"].mean(),
        "scan hidden": seen["hidden"].mean(),
        "scan new": new.mean() if len(new) else 0.0,
    }
    return {name: np.full(len(begun.a), share) for name, share in shares.items()}


def _around(begun: Start, seen: dict[str, Array], pieces: _Pieces) -> dict[str, Array]:
    """Shape of the pieces, and what is near on them."""
    a = begun.a
    shapes, ends = _shapes(a.points, a.ranges[a.beams], a.pieces, pieces.count)
    names = ("extent", "chord", "bulge", "dent", "lower edge", "higher edge")
    columns = {name: shapes[a.pieces, k] for k, name in enumerate(names)}
    index = np.arange(len(a))
    low = np.maximum(index - AROUND, ends[a.pieces, 0])
    high = np.minimum(index + AROUND, ends[a.pieces, 1]) + 1
    for name, values in seen.items():
        sums = np.concatenate(([0.0], np.cumsum(values)))
        columns[f"{name} near"] = (sums[high] - sums[low]) / (high - low)
    kind = seen["agreeing"] + 2.0 * seen["seen through"]
    breaks = np.concatenate(([True], (np.diff(kind) != 0.0) | (np.diff(a.pieces) != 0)))
    steps = np.where(breaks, 0.0, np.hypot(*np.diff(a.points, axis=0, prepend=a.points[:1]).T))
    runs = np.cumsum(breaks) - 1
    columns["run"] = np.minimum(np.bincount(runs, steps), LONG)[runs]
    columns["off"] = np.minimum(begun.off / nearness(a, begun.noise), 3.0)
    return columns


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


def _behind(begun: Start, hidden: Array, pieces: _Pieces) -> dict[str, Array]:
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


def _of_groups(a: Beams, clusters: NDArray[np.int64], pieces: _Pieces) -> dict[str, Array]:
    """Whether points and their pieces are in groups that may have moved, and how far it is to those."""
    moving = clusters > 0
    away = np.minimum(cKDTree(a.points[moving]).query(a.points)[0], FAR)
    nearest = np.full(len(pieces.count), FAR)
    np.minimum.at(nearest, a.pieces, away)
    return {
        "in group": moving.astype(np.float64),
        "in groups": pieces.mean(moving.astype(np.float64)),
        "to mover": away,
        "piece to mover": nearest[a.pieces],
    }


def _of_cluster(clusters: NDArray[np.int64], seen: dict[str, Array]) -> dict[str, Array]:
    """How b sees the other points of the cluster of each point."""
    own = np.maximum(clusters, 0)
    count = np.maximum(np.bincount(own), 1)
    return {
        f"cluster {name}": np.where(clusters > 0, (np.bincount(own, values) / count)[own], -1.0)
        for name, values in seen.items()
        if name != "hidden"
    }

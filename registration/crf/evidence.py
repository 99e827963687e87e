"""What speaks for and against each point of a scan having moved, beside the groups that were found.

A point alone says little: the flank of a cart agrees with where it was, and what a walker hides stands. Its piece says
more: how much of it was seen through, hidden or still in place, its shape, what the scan beside it shows, and how well
the best motion of an object that is near explains it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.sight import AGREES, HIDDEN, THROUGH, UNSEEN
from registration.crf.beams import Beams, ends_of, moved, nearness, point_at, sighted
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
    # Of the motion that explains most of its piece, -1 without.
    "piece agrees moved", "piece through moved", "piece in group",
    "shift", "turn", "gain per point", "group agrees moved", "group through moved", "group stood",
    # Of both scans: how much goes on.
    "scan seen through", "scan hidden", "scan new", "objects", "range", "noise",
)  # fmt: skip
FAR = 2.0  # metres at which distances and depths are cut off
LONG = 8.0  # metres, of a piece, likewise
WIDE = 2.0  # metres, of how far a piece bends off its chord, likewise
MOST = 30.0  # points, of what is counted, likewise
MARGIN = 0.5  # metres around a group within which its motion is considered
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
    columns |= _of_motion(begun, seen, pieces) | _of_scans(begun, seen)
    return np.column_stack([columns[name] for name in NAMES])


def _of_scans(begun: Start, seen: dict[str, Array]) -> dict[str, Array]:
    """What is the same for all points, but for the range."""
    a, n = begun.a, len(begun.a)
    new = (begun.fresh == THROUGH) | (begun.fresh == CLEAR)
    of_all = {
        "scan seen through": seen["seen through"].mean(),
        "scan hidden": seen["hidden"].mean(),
        "scan new": new.mean() if len(new) else 0.0,
        "objects": float(len(begun.found)),
        "noise": begun.noise,
    }
    return {name: np.full(n, value) for name, value in of_all.items()} | {"range": a.ranges[a.beams]}


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


def _of_motion(begun: Start, seen: dict[str, Array], pieces: _Pieces) -> dict[str, Array]:
    """How the motion that explains most of each piece explains it, and the group that it came from."""
    first, end = NAMES.index("piece agrees moved"), NAMES.index("scan seen through")
    n, objects = len(begun.a), len(begun.found)
    columns = {name: np.full(n, -1.0) for name in NAMES[first:end]}
    if objects == 0:
        return columns
    members = np.column_stack([group.members for group in begun.found])
    active = near_groups(begun.a, members)
    doubt = nearness(begun.a, begun.noise)
    sight = np.column_stack(
        [
            sighted(begun.a, begun.b, group.motion, doubt, active[:, k])[0]
            for k, group in enumerate(begun.found)
        ]
    )
    agrees, through = (((sight == kind) & active).astype(np.float64) for kind in (AGREES, THROUGH))
    votes = np.array(
        [pieces.total(agrees[:, k] - through[:, k] + 2.0 * members[:, k]) for k in range(objects)]
    )
    near = np.array([pieces.total(active[:, k].astype(np.float64)) for k in range(objects)]) > 0.0
    best = np.where(near, votes, -np.inf).argmax(axis=0)[begun.a.pieces]
    told = np.asarray(near.any(axis=0))[begun.a.pieces]
    point = np.arange(n)
    found = {
        "piece agrees moved": pieces.mean(agrees[point, best]),
        "piece through moved": pieces.mean(through[point, best]),
        "piece in group": pieces.mean(members[point, best].astype(np.float64)),
    }
    found |= {name: values[best] for name, values in _moves(begun, members, seen, agrees, through).items()}
    for name, values in found.items():
        columns[name][told] = values[told]
    return columns


def near_groups(a: Beams, members: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n, D) points around each group of `members` (n, D), and of its pieces."""
    active = np.zeros_like(members)
    for d in range(members.shape[1]):
        points = a.points[members[:, d]]
        if len(points):
            low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
            rooted = np.zeros(int(a.pieces.max()) + 1, dtype=bool)
            rooted[a.pieces[members[:, d]]] = True
            active[:, d] = ((a.points >= low) & (a.points <= high)).all(axis=1) | rooted[a.pieces]
    return active


def _moves(
    begun: Start, members: NDArray[np.bool_], seen: dict[str, Array], agrees: Array, through: Array
) -> dict[str, Array]:
    """Of each group (D,): its displacement against the background, and what that explains of it."""
    starts, background = members.astype(np.float64), begun.registration.transform
    size = np.maximum(starts.sum(axis=0), 1.0)
    middles = (starts.T @ begun.a.points) / size[:, None]
    motions = np.array([group.motion for group in begun.found])
    shifts = [
        np.hypot(*(moved(middle[None], motion) - moved(middle[None], background))[0])
        for middle, motion in zip(middles, motions, strict=True)
    ]
    return {
        "shift": np.array(shifts),
        "turn": np.abs(motions[:, 2] - background[2]),
        "gain per point": np.array([group.gain for group in begun.found]) / size,
        "group agrees moved": (starts * agrees).sum(axis=0) / size,
        "group through moved": (starts * through).sum(axis=0) / size,
        "group stood": starts.T @ seen["agreeing"] / size,
    }

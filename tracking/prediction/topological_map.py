"""Instantaneous topological map as modified in section 4.4.1 of the anchoring text.

Nodes summarise where people have been, edges which places follow each other. Against the original map, nodes that come
close are merged instead of deleted, and each node keeps its latest points: its position is their mean and their
covariance gives the observation probability of the hidden Markov model built on it. One point costs O(nodes).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.checks import FloatArray, as_points, require_count, require_positive
from estimation.errors import InputError

IntArray = NDArray[np.int64]


@dataclass
class MapChanges:
    """What one trajectory did to the map.

    removed : nodes that are gone. merged : (gone, kept), nodes that live on in another. linked : (i, j), new edges, of
    which some may be gone again.
    """

    removed: list[int] = field(default_factory=list)
    merged: list[tuple[int, int]] = field(default_factory=list)
    linked: list[tuple[int, int]] = field(default_factory=list)


class TopologicalMap:
    """Growing map of places.

    resolution : e_max, m: a point farther than this from every node founds a new one.
    window : N_p,max, points kept per node, the latest.

    Nodes are numbered from 0; a number is not used again before `compact`. `positions` (size, 2) m has a row for each,
    infinite for those that are gone.
    """

    def __init__(self, resolution: float, window: int = 100) -> None:
        self.resolution = require_positive("resolution", resolution)
        self.window = require_count("window", window, 2)
        self.positions: FloatArray = np.zeros((0, 2))
        self._points: list[FloatArray] = []
        self._counts: list[int] = []
        self.neighbours: dict[int, set[int]] = {}

    def __len__(self) -> int:
        return len(self.neighbours)

    @property
    def size(self) -> int:
        """Rows in use, nodes that are gone included."""
        return len(self.positions)

    @property
    def nodes(self) -> IntArray:
        """Numbers of the nodes that are there, ascending."""
        return np.flatnonzero(np.isfinite(self.positions[:, 0]))

    @property
    def edges(self) -> list[tuple[int, int]]:
        """Pairs (i, j) with i < j."""
        return sorted((i, j) for i, linked in self.neighbours.items() for j in linked if i < j)

    def points(self, node: int) -> FloatArray:
        """(n, 2) m: the points a node keeps."""
        return self._points[node][: min(self._counts[node], self.window)]

    def covariance(self, node: int, scale: float, floor: float) -> FloatArray:
        """(2, 2) m²: `scale` times the covariance of the node's points, no axis below `floor` m².

        With few points it is drawn towards that of points spread evenly over a disc of the map's resolution.
        """
        points = self.points(node)
        prior = self.resolution**2 / 16.0 * np.eye(2)
        centred = points - points.mean(axis=0)
        spread = (centred.T @ centred + 4.0 * prior) / (len(points) + 4.0)
        values, vectors = np.linalg.eigh(scale * spread)
        return np.asarray((vectors * np.maximum(values, floor)) @ vectors.T)

    def nearest(self, points: ArrayLike) -> IntArray:
        """Number of the node closest to each point of (N, 2), (N,). Raises InputError where the map is empty."""
        if not self.neighbours:
            raise InputError("the topological map is empty: insert a trajectory first")
        asked = as_points("points", points, 2)
        away = np.square(asked[:, None, :] - self.positions[None]).sum(axis=2)
        return np.asarray(away.argmin(axis=1))

    def insert(self, points: ArrayLike) -> MapChanges:
        """Take in the points (N, 2) m of one trajectory, in order: the four steps of section 4.4.1."""
        changes = MapChanges()
        for point in as_points("points", points, 2):
            self._insert(point, changes)
        return changes

    def move(self, moved: Callable[[FloatArray], FloatArray]) -> None:
        """Take all nodes and their points to another frame."""
        for node in self.nodes.tolist():
            self.points(node)[:] = moved(self.points(node))
            self._place(node)

    def compact(self) -> IntArray:
        """Number the nodes that are there anew, from 0; the new number of each old one (size,), -1 where it is gone."""
        kept = self.nodes
        number = np.full(self.size, -1, dtype=np.int64)
        number[kept] = np.arange(len(kept))
        self.positions = self.positions[kept]
        self._points = [self._points[node] for node in kept.tolist()]
        self._counts = [self._counts[node] for node in kept.tolist()]
        self.neighbours = {
            int(number[node]): {int(number[other]) for other in sorted(linked)}
            for node, linked in sorted(self.neighbours.items())
        }
        return number

    def as_arrays(self) -> dict[str, NDArray[Any]]:
        """Positions, kept points and edges, for storage."""
        return {
            "positions": self.positions,
            "points": np.concatenate([np.zeros((0, 2)), *map(self.points, range(self.size))]),
            "counts": np.array(self._counts, dtype=np.int64),
            "edges": np.array(self.edges, dtype=np.int64).reshape(-1, 2),
        }

    def from_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Take over what `as_arrays` gave."""
        size = len(arrays["positions"])
        self.positions = np.array(arrays["positions"], dtype=np.float64).reshape(size, 2)
        self._counts = np.broadcast_to(arrays["counts"], size).astype(np.int64).tolist()
        self._points = [np.zeros((self.window, 2)) for _ in range(size)]
        ends = np.cumsum(np.minimum(self._counts, self.window))
        for node, part in enumerate(np.split(arrays["points"], ends[:-1]) if size else []):
            self._points[node][: len(part)] = part
        self.neighbours = {node: set() for node in self.nodes.tolist()}
        for a, b in arrays["edges"].tolist():
            self._link(a, b, MapChanges())

    def _insert(self, point: FloatArray, changes: MapChanges) -> None:
        if len(self.neighbours) < 2:
            first = next(iter(self.neighbours), None)
            if first is not None and np.hypot(*(point - self.positions[first])) <= self.resolution:
                self._associate(first, point)
                return
            new = self._create(point)
            if first is not None:
                self._link(first, new, changes)
            return
        away = np.square(self.positions - point).sum(axis=1)
        n = int(away.argmin())
        away[n] = np.inf
        s = int(away.argmin())
        self._link(n, s, changes)
        self._prune(n, s, changes)
        at_n, at_s = self.positions[n], self.positions[s]
        outside_thales = float((point - at_n) @ (point - at_s)) > 0.0
        if outside_thales and float(np.square(point - at_n).sum()) > self.resolution**2:
            self._link(n, self._create(point), changes)
            return
        if float(np.square(at_n - at_s).sum()) < 0.25 * self.resolution**2:
            self._merge(s, n, changes)
        self._associate(n, point)

    def _prune(self, n: int, s: int, changes: MapChanges) -> None:
        """Step 2: edges whose Thales sphere holds s are no Delaunay edges; nodes left alone go."""
        at_n, at_s = self.positions[n], self.positions[s]
        for m in sorted(self.neighbours[n] - {s}):
            if float((at_n - at_s) @ (self.positions[m] - at_s)) < 0.0:
                self.neighbours[n].discard(m)
                self.neighbours[m].discard(n)
                if not self.neighbours[m]:
                    self._drop(m)
                    changes.removed.append(m)

    def _merge(self, gone: int, kept: int, changes: MapChanges) -> None:
        both = np.concatenate((self.points(gone), self.points(kept)))[-self.window :]
        self._points[kept][: len(both)] = both
        self._counts[kept] = len(both)
        for linked in sorted(self.neighbours[gone] - {kept}):
            self._link(kept, linked, changes)
        self._drop(gone)
        self._place(kept)
        changes.merged.append((gone, kept))

    def _create(self, point: FloatArray) -> int:
        node = self.size
        self.positions = np.vstack((self.positions, point))
        self._points.append(np.zeros((self.window, 2)))
        self._counts.append(0)
        self.neighbours[node] = set()
        self._associate(node, point)
        return node

    def _associate(self, node: int, point: FloatArray) -> None:
        self._points[node][self._counts[node] % self.window] = point
        self._counts[node] += 1
        self._place(node)

    def _place(self, node: int) -> None:
        self.positions[node] = self.points(node).mean(axis=0)

    def _link(self, a: int, b: int, changes: MapChanges) -> None:
        if b not in self.neighbours[a]:
            changes.linked.append((a, b))
        self.neighbours[a].add(b)
        self.neighbours[b].add(a)

    def _drop(self, node: int) -> None:
        for linked in self.neighbours.pop(node):
            self.neighbours[linked].discard(node)
        self.positions[node] = np.inf

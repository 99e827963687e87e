"""Closures that a person takes out: found by where they are, taken out as one revisit, and not made again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from loop_closure.graph.edges import Edge
from loop_closure.motions import positions

REVISIT = 10.0  # metres of path, at both ends, within which closures belong to one revisit


class Refused:
    """Revisits that were said to be none, by the metres travelled until both of their ends."""

    def __init__(self) -> None:
        self._ends: list[tuple[float, float]] = []

    def add(self, edge: Edge, paths: FloatArray) -> None:
        """Closures about `edge` are not wanted; `paths` (N,) : metres travelled until each keyframe."""
        self._ends.append((float(paths[edge.a]), float(paths[edge.b])))

    def holds(self, edge: Edge, paths: FloatArray) -> bool:
        """Whether a closure belongs to such a revisit."""
        return any(_near(paths[edge.a] - a, paths[edge.b] - b) for a, b in self._ends)


def same_revisit(edges: Sequence[Edge], number: int, paths: FloatArray) -> set[int]:
    """Numbers of the closures among `edges` that belong to the revisit of the one with `number`, itself included."""
    found, waiting = {number}, [number]
    while waiting:
        one = edges[waiting.pop()]
        for other, edge in enumerate(edges):
            close = _near(paths[edge.a] - paths[one.a], paths[edge.b] - paths[one.b])
            if edge.closure and other not in found and close:
                found.add(other)
                waiting.append(other)
    return found


def nearest_closure(
    edges: Sequence[Edge], poses: FloatArray, point: npt.ArrayLike
) -> tuple[Edge, float] | None:
    """The closure drawn nearest to a point of the map, and how far away, m; None where there is no closure.

    poses : (N, 3) or (N, 4, 4) of the keyframes. point : (2,) m. A closure is drawn as the line between its ends.
    """
    closures = [edge for edge in edges if edge.closure]
    if not closures:
        return None
    where = positions(poses)[:, :2]
    first = where[[edge.a for edge in closures]]
    along = where[[edge.b for edge in closures]] - first
    away = np.asarray(point, dtype=np.float64)[:2] - first
    share = np.clip((away * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    distances = np.linalg.norm(away - share[:, None] * along, axis=1)
    best = int(np.argmin(distances))
    return closures[best], float(distances[best])


def _near(first: float, second: float) -> bool:
    return bool(abs(first) < REVISIT and abs(second) < REVISIT)

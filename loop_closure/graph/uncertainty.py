"""How far off a place may be: uncertainty of every node of a graph relative to one, along the best path of edges.

Any other path could only make it better, so this errs on the safe side, and it costs one shortest-path search.
"""

from __future__ import annotations

import heapq

import numpy as np
import numpy.typing as npt
from numba import njit

from estimation.checks import FloatArray
from loop_closure.graph.edges import Edge
from loop_closure.growing_array import GrowingArray
from loop_closure.keyframes import Keyframes
from loop_closure.motions import planar, positions

# Metres at which the turn error of an edge is weighed against its position error in choosing a path.
ARM = 5.0
BENT, PER_METRE = (
    (0.03, 0.01),
    (0.01, 0.001),
)  # metres and radians of a path that was measured, and per metre of it
SLACK = 0.1  # metres that guessed steps add to a distance from which on it is asked whether closures say more
NONE = -1  # ends a chain
DEVIATIONS = 2.5  # within which something is looked for, and may be off
NEAR, TURNED = 0.3, 0.1  # metres and radians that are added: local maps and scans are not exact
FOUND = (0.2, 0.05)  # metres and radians by which a pose that was found in a map may be off
WHOLE = 30.0  # metres of path from which on more path adds nothing: odometry bends, and closures hold it


def window(sigma: float, turn: float) -> tuple[float, float]:
    """Metres and radians within which a place is that is known to `sigma` m and `turn` rad."""
    return DEVIATIONS * sigma + NEAR, DEVIATIONS * turn + TURNED


class Uncertainty:
    """Variances of the edges of a growing graph."""

    def __init__(self) -> None:
        self._best: dict[tuple[int, int], int] = {}
        self._spread = GrowingArray((2,))
        # Edge e leads to row 2 e of `_to` and back to row 2 e + 1; each node chains the ways that start there.
        self._to, self._following = GrowingArray((), np.int64), GrowingArray((), np.int64)
        self._heads = GrowingArray((), np.int64, NONE)
        self._read = 0

    def reset(self) -> None:
        """Forget all edges: some were taken out."""
        self.__init__()  # type: ignore[misc]

    def behind(self, edges: list[Edge]) -> bool:
        """Whether some of the edges were not taken in yet."""
        return self._read < len(edges)

    def learn(self, edges: list[Edge], most: int | None = None) -> None:
        """Take in the edges that are new since the last call, `most` of them."""
        new = edges[self._read :] if most is None else edges[self._read : self._read + most]
        for edge, spread in zip(new, _variances(new), strict=True):
            known = self._best.get((edge.a, edge.b))
            if known is None:
                self._add(edge.a, edge.b, spread)
            elif sum(spread) < self._spread.rows[known].sum():
                self._spread.rows[known] = spread
        self._read += len(new)

    def _add(self, a: int, b: int, spread: tuple[float, float]) -> None:
        """One more pair of nodes."""
        self._best[a, b] = len(self._best)
        self._spread.append(spread)
        self._heads.reach(max(a, b) + 1)
        heads = self._heads.rows
        for start, end in ((a, b), (b, a)):
            self._following.append(heads[start])
            heads[start] = len(self._to)
            self._to.append(end)

    def around(self, poses: FloatArray, node: int) -> tuple[FloatArray, FloatArray]:
        """Standard deviations of position (N,) m and heading (N,) rad of all nodes relative to `node`.

        A turn error at an edge displaces what lies behind it by its distance, so that sums of σ², σ² p and σ² p·p
        along the path are all that is needed. Nodes that no edge leads to are infinitely far off.
        """
        places = np.zeros((len(poses), 3))
        where = positions(poses)
        places[:, : where.shape[1]] = where
        self._heads.reach(len(poses))
        return _walk(node, places, self._heads.rows, self._following.rows, self._to.rows, self._spread.rows)


@njit(cache=True)
def _walk(start, places, heads, following, to, spread):  # type: ignore[no-untyped-def]
    """Deviations (N,) m and (N,) rad along the shortest paths from node `start` (Dijkstra)."""
    count = len(places)
    sums = np.zeros((count, 6))
    sigma, turn, distance = np.full(count, np.inf), np.full(count, np.inf), np.full(count, np.inf)
    distance[start] = 0.0
    came = np.full(count, NONE)  # the way that leads to each node
    heap = [(0.0, start)]
    while len(heap):
        so_far, n = heapq.heappop(heap)
        if sigma[n] < np.inf:
            continue
        if came[n] != NONE:
            p = to[came[n] ^ 1]
            t, r = spread[came[n] >> 1, 0], spread[came[n] >> 1, 1]
            square = 0.0
            for a in range(3):
                square += places[n, a] * places[n, a]
                sums[n, 3 + a] = sums[p, 3 + a] + r * places[n, a]
            sums[n, 0] = sums[p, 0] + t
            sums[n, 1] = sums[p, 1] + r
            sums[n, 2] = sums[p, 2] + r * square
        lever = sums[n, 2]
        for a in range(3):
            lever += places[n, a] * (places[n, a] * sums[n, 1] - 2.0 * sums[n, 3 + a])
        sigma[n], turn[n] = np.sqrt(max(sums[n, 0] + lever, 0.0)), np.sqrt(sums[n, 1])
        way = heads[n]
        while way != NONE:
            further = so_far + spread[way >> 1, 0] + ARM * ARM * spread[way >> 1, 1]
            if to[way] < count and further < distance[to[way]]:
                distance[to[way]], came[to[way]] = further, way
                heapq.heappush(heap, (further, to[way]))
            way = following[way]
    return sigma, turn


def apart(
    keyframes: Keyframes, uncertainty: Uncertainty, poses: FloatArray, i: int, j: npt.NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (M,) m and rad between keyframe `i` and each of `j`, for those along the path around it.

    By the path, with the steps in it that were guessed; or by closures, where these have tied together since what
    guessed steps leave open.
    """
    paths = keyframes.paths
    away = np.minimum(np.abs(paths[i] - paths[j]), WHOLE)
    slack = keyframes.slack(i, j)
    if slack.max(initial=0.0) > SLACK:
        slack = np.minimum(slack, uncertainty.around(poses, i)[0][j])
    position, heading = (start + more * away for start, more in zip(BENT, PER_METRE, strict=True))
    return np.hypot(position, slack), heading


def _variances(edges: list[Edge]) -> list[tuple[float, float]]:
    """Largest variance of position and of heading of each."""
    if not edges:
        return []
    size = 2 if planar(edges[0].motion) else 3
    whole = np.array([edge.covariance for edge in edges])
    blocks = whole[:, :size, :size], whole[:, size:, size:]
    position, heading = (np.linalg.eigvalsh(block)[:, -1].tolist() for block in blocks)
    return list(zip(position, heading, strict=True))

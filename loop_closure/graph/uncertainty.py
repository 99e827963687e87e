"""How far off a place may be: uncertainty of every node of a graph relative to one, along the best path of edges.

Any other path could only make it better, so this errs on the safe side, and it costs one shortest-path search.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from estimation.checks import FloatArray
from loop_closure.graph.pose_graph import Edge
from loop_closure.keyframes import Keyframes
from loop_closure.motions import planar, positions

ARM = (
    5.0  # metres at which the turn error of an edge is weighed against its position error in choosing a path
)
SLACK = 0.1  # metres that guessed steps add to a distance from which on it is asked whether closures say more
WHOLE = 30.0  # metres of path from which on more path adds nothing: odometry bends, and closures hold it


class Uncertainty:
    """Variances of the edges of a growing graph."""

    def __init__(self) -> None:
        self._best: dict[tuple[int, int], int] = {}
        self._ends = np.empty((16, 2), dtype=np.int64)
        self._spread = np.empty((16, 2))
        self._read = 0
        self._sorted: tuple[npt.NDArray[np.int64], FloatArray] | None = None

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
            pair = edge.a, edge.b
            known = self._best.get(pair)
            if known is None:
                known = self._best[pair] = len(self._best)
                if known == len(self._ends):
                    self._ends = np.concatenate((self._ends, np.empty_like(self._ends)))
                    self._spread = np.concatenate((self._spread, np.empty_like(self._spread)))
                self._ends[known], self._spread[known] = pair, spread
            elif sum(spread) < self._spread[known].sum():
                self._spread[known] = spread
        self._read += len(new)
        self._sorted = None if new else self._sorted

    def around(self, poses: FloatArray, node: int) -> tuple[FloatArray, FloatArray]:
        """Standard deviations of position (N,) m and heading (N,) rad of all nodes relative to `node`.

        A turn error at an edge displaces what lies behind it by its distance, so that sums of σ², σ² p and σ² p·p
        along the path are all that is needed.
        """
        count = len(poses)
        ends, spread = self._in_order()
        matrix = csr_matrix((spread @ [1.0, ARM**2], (ends[:, 0], ends[:, 1])), shape=(count, count))
        distance, previous = dijkstra(matrix, directed=False, indices=node, return_predecessors=True)
        places = np.zeros((count, 3))
        where = positions(poses)
        places[:, : where.shape[1]] = where
        starts = np.searchsorted(ends[:, 1], np.arange(count + 1))
        return _walk(np.argsort(distance), previous, places, ends[:, 0].copy(), starts, spread)

    def _in_order(self) -> tuple[npt.NDArray[np.int64], FloatArray]:
        """Ends and variances in the order of the edges' far ends, so that a walk finds each by its pair."""
        if self._sorted is None:
            ends, spread = self._ends[: len(self._best)], self._spread[: len(self._best)]
            order = np.lexsort((ends[:, 0], ends[:, 1]))
            self._sorted = ends[order], spread[order]
        return self._sorted


@njit(cache=True)
def _walk(order, previous, places, firsts, starts, spread):  # type: ignore[no-untyped-def]
    count = len(places)
    sums = np.zeros((count, 6))
    sigma, turn = np.full(count, np.inf), np.full(count, np.inf)
    for n in order:
        p = previous[n]
        if p >= 0:
            low, high = min(p, n), max(p, n)
            for k in range(starts[high], starts[high + 1]):
                if firsts[k] == low:
                    t, r = spread[k, 0], spread[k, 1]
                    square = 0.0
                    for a in range(3):
                        square += places[n, a] * places[n, a]
                        sums[n, 3 + a] = sums[p, 3 + a] + r * places[n, a]
                    sums[n, 0] = sums[p, 0] + t
                    sums[n, 1] = sums[p, 1] + r
                    sums[n, 2] = sums[p, 2] + r * square
                    break
        lever = sums[n, 2]
        for a in range(3):
            lever += places[n, a] * (places[n, a] * sums[n, 1] - 2.0 * sums[n, 3 + a])
        sigma[n], turn[n] = np.sqrt(max(sums[n, 0] + lever, 0.0)), np.sqrt(sums[n, 1])
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
    return np.hypot(0.03 + 0.01 * away, slack), 0.01 + 0.001 * away


def _variances(edges: list[Edge]) -> list[tuple[float, float]]:
    """Largest variance of position and of heading of each."""
    if not edges:
        return []
    size = 2 if planar(edges[0].motion) else 3
    whole = np.array([edge.covariance for edge in edges])
    blocks = whole[:, :size, :size], whole[:, size:, size:]
    position, heading = (np.linalg.eigvalsh(block)[:, -1].tolist() for block in blocks)
    return list(zip(position, heading, strict=True))

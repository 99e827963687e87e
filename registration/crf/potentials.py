"""Potentials of the joint model as weighted features (equation (1), section IV.C), in the log domain.

The association node of a point has its candidates as states and the outlier last; its clustering node has the
background, the objects, and the outlier last. Three kinds of edges: along each chain, and between the two nodes of a
point, which is where the motions couple the chains (registered translation, cluster inlier).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from registration.crf.beams import AGREES, FREE, WIDE, Beams, length, sightings
from registration.motion import Array

WEIGHTS = (
    "data boosting", "outlier boosting", "registered translation", "cluster inlier", "cluster contradiction",
    "sequence", "near sequence", "pairwise outlier", "pairwise outlier entry", "pairwise distance",
    "pairwise translation", "cluster distance", "cluster outlier", "free space", "not visible", "background",
    "start", "cluster sequence", "neighbour weight", "neighbour stiffness", "neighbour distance",
    "cluster outlier entry", "cluster outlier pair",
)  # fmt: skip
# What is a cost in every sense has no negative weight; biases may have.
SIGNED = frozenset(
    ("pairwise outlier", "pairwise outlier entry", "cluster outlier", "background", "cluster outlier entry",
     "cluster outlier pair")
)  # fmt: skip
DISTANCE = WEIGHTS.index("cluster distance")
OUT_OF_REACH = -100.0  # log potential of a motion that is not considered for a point
CUT = 9.0  # squared distances, in tolerances, beyond which a point fits no worse


@dataclass(eq=False)
class Potentials:
    """Log potentials of one pair of scans.

    association (n, K + 1), clustering (n, D + 1): local. links (n, D + 1, K + 1): between the nodes of a point.
    association_edges (n - 1, K + 1, K + 1), clustering_edges (n - 1, D + 1, D + 1): from point i to i + 1.
    A state that does not exist has -inf in `association`.
    """

    association: Array
    clustering: Array
    links: Array
    association_edges: Array
    clustering_edges: Array

    def score(self, associations: NDArray[np.int64], clusters: NDArray[np.int64]) -> float:
        """Unnormalised log probability of a labelling by states, (n,) and (n,)."""
        i, e = np.arange(len(associations)), np.arange(len(associations) - 1)
        total = self.association[i, associations].sum() + self.clustering[i, clusters].sum()
        total += self.links[i, clusters, associations].sum()
        total += self.association_edges[e, associations[:-1], associations[1:]].sum()
        total += self.clustering_edges[e, clusters[:-1], clusters[1:]].sum()
        return float(total)


@dataclass(eq=False)
class Problem:
    """Everything the potentials are made of that the labels do not change.

    states : (n, K) candidates, -1 none. data : (n, K) and outlier : (n,) boosted scores in [-0.5, 0.5].
    starts : (n, D) whether the point was in the group a motion came from; active : (n, D) whether it
        is considered for the point at all.
    near : (n,) metres off an outline that are noise.
    grain : (n,) metres between associated points that are noise and the beams' spacing.
    motions : (D, 3), updated in line.
    first : (n,) state of each point's nearest candidate at the start, K without.
    seen : (n,) and (n,) how b sees the points under the background's motion, where it is known already.
    wide : how far `off` is told, see `beams.sightings`; `TOUCHING` is enough where no weight asks for it.
    sight, off : (n, D) how b sees each point under each motion.
    """

    a: Beams
    b: Beams
    states: NDArray[np.int64]
    data: Array
    outlier: Array
    starts: NDArray[np.bool_]
    active: NDArray[np.bool_]
    near: Array
    grain: Array
    motions: Array
    first: NDArray[np.int64]
    linked: bool = True
    seen: tuple[NDArray[np.int64], Array] | None = None
    wide: float = WIDE
    sight: NDArray[np.int64] = field(init=False)
    off: Array = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.motions)
        self.sight = np.empty((len(self.a), count), dtype=np.int64)
        self.off = np.empty((len(self.a), count))
        before = np.full(self.motions.shape, np.nan)
        if self.seen is not None:
            self.sight[:, 0], self.off[:, 0] = self.seen
            before[0] = self.motions[0]
        self.look(before)

    def look(self, before: Array | None = None) -> None:
        """Recompute what depends on the motions; those that are as `before` (D, 3) show the same."""
        count = len(self.motions)
        changed = np.ones(count, dtype=bool) if before is None else (self.motions != before).any(axis=1)
        for d in np.flatnonzero(changed):
            self.sight[:, d], self.off[:, d] = sightings(
                self.a.points, self.near, self.active[:, d], self.motions[d],
                self.b.xy, self.b.ranges, self.b.clear, self.b.angle_min, self.b.step, self.wide,
            )  # fmt: skip

    def potentials(self, weights: Array, earlier: Potentials | None = None) -> Potentials:
        """Potentials under `weights` (23,) of `WEIGHTS`; neighbour stiffness is that of the first associations.

        earlier : those under the same weights and other motions, whose association edges still hold.
        """
        n, k, d = len(self.a), self.states.shape[1], len(self.motions)
        made = Potentials(
            np.zeros((n, k + 1)), np.zeros((n, d + 1)), np.zeros((n, d + 1, k + 1)),
            np.zeros((max(n - 1, 0) if earlier is None else 0, k + 1, k + 1)), np.zeros((max(n - 1, 0), d + 1, d + 1)),
        )  # fmt: skip
        _local(
            weights, self.states, self.data, self.outlier, self.starts, self.active, self.near, self.sight, self.off,
            made.association, made.clustering,
        )  # fmt: skip
        if self.linked:
            _links(
                weights, self.a.points, self.b.points, self.states, self.active, self.motions, self.grain, made.links
            )  # fmt: skip
        if earlier is not None:
            made.association_edges = earlier.association_edges
        else:
            _association_edges(
            weights, self.a.points, self.b.points, self.b.beams, self.states, self.motions[0], self.grain,
            np.sign(self.a.step * self.b.step), made.association_edges,
        )  # fmt: skip
        _clustering_edges(
            weights, self.a.points, self.b.points, self.states, self.active, self.motions, self.grain, self.first,
            made.clustering_edges,
        )  # fmt: skip
        return made


@njit(cache=True)
def _local(w, states, data, outlier, starts, active, near, sight, off, association, clustering):  # type: ignore[no-untyped-def]
    n, most = states.shape
    count = sight.shape[1]
    for i in range(n):
        for k in range(most):
            association[i, k] = w[0] * data[i, k] if states[i, k] >= 0 else -math.inf
        association[i, most] = w[1] * outlier[i]
        for d in range(count):
            if not active[i, d]:
                clustering[i, d] = OUT_OF_REACH
                continue
            u = off[i, d] / near[i]
            value = -w[DISTANCE] * min(u * u, CUT) / CUT
            if sight[i, d] == FREE:
                value -= w[13]
            elif sight[i, d] != AGREES:
                value -= w[14]
            if d == 0:
                value += w[15]
            elif starts[i, d]:
                value += w[16]
            clustering[i, d] = value
        clustering[i, count] = w[12]


@njit(cache=True)
def _links(w, points, others, states, active, motions, near, links):  # type: ignore[no-untyped-def]
    n, most = states.shape
    count = len(motions)
    for d in range(count):
        c, s = math.cos(motions[d, 2]), math.sin(motions[d, 2])
        for i in range(n):
            if not active[i, d]:
                continue
            x = motions[d, 0] + c * points[i, 0] - s * points[i, 1]
            y = motions[d, 1] + s * points[i, 0] + c * points[i, 1]
            for k in range(most):
                j = states[i, k]
                if j < 0:
                    break
                square = (x - others[j, 0]) ** 2 + (y - others[j, 1]) ** 2
                links[i, d, k] = -w[2] * min(square / (near[i] * near[i]), CUT) / CUT
            links[i, d, most] = -w[4]
    for i in range(n):
        for k in range(most):
            links[i, count, k] = -w[4]
        links[i, count, most] = w[3]


@njit(cache=True)
def _association_edges(w, points, others, beams, states, background, near, direction, edges):  # type: ignore[no-untyped-def]
    n, most = states.shape
    c, s = math.cos(background[2]), math.sin(background[2])
    for i in range(n - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        tx, ty = c * dx - s * dy, s * dx + c * dy
        gap = length(dx, dy)
        scale = near[i] + near[i + 1]
        for k in range(most):
            j = states[i, k]
            for m in range(most):
                q = states[i + 1, m]
                if j < 0 or q < 0:
                    break
                ux, uy = others[q, 0] - others[j, 0], others[q, 1] - others[j, 1]
                value = 0.0
                ahead = direction * (beams[q] - beams[j])
                if ahead == 1:
                    value += w[5]
                elif ahead == 0 or ahead == 2:
                    value += w[6]
                value -= w[9] * min(abs(gap - length(ux, uy)) / scale, 3.0) / 3.0
                value -= w[10] * min(length(ux - tx, uy - ty) / scale, 3.0) / 3.0
                edges[i, k, m] = value
            edges[i, k, most] = -w[8]
            edges[i, most, k] = -w[8]
        edges[i, most, most] = w[7]


@njit(cache=True)
def _clustering_edges(w, points, others, states, active, motions, near, associations, edges):  # type: ignore[no-untyped-def]
    n, most = states.shape
    count = len(motions)
    first, second = np.empty((count, 2)), np.empty((count, 2))
    for i in range(n - 1):
        gap = length(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
        scale = near[i] + near[i + 1]
        stiff = 0.0
        k, m = associations[i], associations[i + 1]
        if k < most and m < most and states[i, k] >= 0 and states[i + 1, m] >= 0:
            j, q = states[i, k], states[i + 1, m]
            other = length(others[q, 0] - others[j, 0], others[q, 1] - others[j, 1])
            stiff = math.exp(-abs(gap - other) / scale)
        same = w[17] + w[18] * math.exp(-gap / 0.3) + w[19] * stiff
        for d in range(count):
            c, s = math.cos(motions[d, 2]), math.sin(motions[d, 2])
            first[d, 0] = motions[d, 0] + c * points[i, 0] - s * points[i, 1]
            first[d, 1] = motions[d, 1] + s * points[i, 0] + c * points[i, 1]
            second[d, 0] = motions[d, 0] + c * points[i + 1, 0] - s * points[i + 1, 1]
            second[d, 1] = motions[d, 1] + s * points[i + 1, 0] + c * points[i + 1, 1]
        for d in range(count):
            for e in range(count):
                if d == e:
                    edges[i, d, e] = same
                elif active[i, d] and active[i + 1, e]:
                    apart = length(second[e, 0] - first[d, 0], second[e, 1] - first[d, 1])
                    edges[i, d, e] = -w[20] * min(abs(apart - gap) / scale, 3.0) / 3.0
            edges[i, d, count] = -w[21]
            edges[i, count, d] = -w[21]
        edges[i, count, count] = w[22]

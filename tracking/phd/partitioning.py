"""Partitioners: distance partitioning (Section 4.1), K-means (4.2), exhaustive enumeration, and one return per cell."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri

from estimation.checks import FloatArray
from estimation.errors import InputError
from tracking.mixture.components import IntArray
from tracking.mixture.phd_config import PhdConfig
from tracking.phd.partition_kernels import k_means, single_linkage
from tracking.phd.partitions import Choice, PartitionBuilder, Partitions, PredictedTargets
from tracking.phd.subpartitions import Subpartitions

# 10 returns have 115975 partitions; more is a mistake and not a wish.
MOST_EXHAUSTIVE = 10


class Partitioner(Protocol):
    """Chooses the partitions the filter weighs."""

    thinned: int

    def partition(self, points: FloatArray, targets: PredictedTargets) -> Partitions:
        """Partitions of the returns (N, 2)."""


class Singletons:
    """Every return a cell of its own: what point targets give."""

    thinned = 0

    def partition(self, points: FloatArray, targets: PredictedTargets) -> Partitions:
        """The one partition, return by return a group."""
        builder = PartitionBuilder()
        for i in range(len(points)):
            builder.group([((builder.cell(np.array([i])),), 0.0)])
        return builder.build()


def all_partitions(count: int) -> Iterator[list[list[int]]]:
    """Every partition of range(count) into non-empty cells (Bell number many)."""
    if count == 0:
        yield []
        return
    for partition in all_partitions(count - 1):
        yield [*partition, [count - 1]]
        for i, cell in enumerate(partition):
            yield [*partition[:i], [*cell, count - 1], *partition[i + 1 :]]


class Exhaustive:
    """All partitions of the scan, without any approximation; for tests and tiny scans."""

    thinned = 0

    def partition(self, points: FloatArray, targets: PredictedTargets) -> Partitions:
        """One group with every partition. Raises InputError for more than 10 returns."""
        if len(points) > MOST_EXHAUSTIVE:
            raise InputError(f"partitioner 'all' takes at most {MOST_EXHAUSTIVE} returns, not {len(points)}")
        builder = PartitionBuilder()
        if len(points):
            builder.group(
                [
                    (tuple(builder.cell(np.array(cell)) for cell in partition), 0.0)
                    for partition in all_partitions(len(points))
                ]
            )
        return builder.build()


class KMeans:
    """K-means for K from 1 to the number of returns, in place of distances: the text's comparison (4.2)."""

    def __init__(self, config: PhdConfig) -> None:
        self.most = config.max_partitions
        self.thinned = 0

    def partition(self, points: FloatArray, targets: PredictedTargets) -> Partitions:
        """One group with a partition per K."""
        builder = PartitionBuilder()
        if len(points):
            numbers = np.unique(np.linspace(1, len(points), self.most).astype(int))
            self.thinned += len(points) > self.most
            choices: list[Choice] = []
            for k in numbers:
                cluster, _ = k_means(points, int(k), 20)
                order = np.argsort(cluster, kind="stable")
                ends = [0, *(np.flatnonzero(np.diff(cluster[order])) + 1).tolist(), len(order)]
                cells = [order[a:b] for a, b in pairwise(ends)]
                choices.append((tuple(builder.cell(cell) for cell in cells), 0.0))
            builder.group(choices)
        return builder.build()


class Tree:
    """Single-linkage tree of the returns up to a distance, and the members of its nodes."""

    def __init__(self, points: FloatArray, longest: float) -> None:
        pairs = cKDTree(points).query_pairs(longest, output_type="ndarray").astype(np.int64)
        distances = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
        order = np.argsort(distances, kind="stable")
        first, second = np.ascontiguousarray(pairs[order].T)
        self.merges, joined = single_linkage(len(points), first, second)
        self.heights = distances[order][joined]
        self.members: list[IntArray] = list(np.arange(len(points))[:, None])
        self.root = np.arange(len(points))
        for k, (a, b) in enumerate(self.merges.tolist()):
            self.members.append(np.concatenate([self.members[a], self.members[b]]))
            self.root[self.members[-1]] = len(points) + k


class Distances:
    """Single linkage at every threshold that changes anything between σ√δ_low and σ√δ_high (Section 4.1).

    Returns that even the largest threshold leaves apart form independent groups (see
    `tracking.phd.partitions`), as long as no predicted target may have caused both. With sub-partitions each
    group also gets the partitions of `Subpartitions`.
    """

    def __init__(self, config: PhdConfig, thresholds: tuple[float, float] | None = None) -> None:
        """`thresholds` (m) replace those of the configuration."""
        if thresholds is None:
            low, high = config.measurement_noise * np.sqrt(
                chdtri(2, np.subtract(1.0, config.distance_probabilities))
            )
            thresholds = float(low), float(high)
        self.low, self.high = thresholds
        self.most = config.max_partitions
        self.subpartitions = Subpartitions(config) if config.subpartitions else None
        self.thinned = 0

    def partition(self, points: FloatArray, targets: PredictedTargets) -> Partitions:
        """Partitions of the returns (N, 2), in groups."""
        builder = PartitionBuilder()
        if len(points) == 0:
            return builder.build()
        tree = Tree(points, self.high)
        groups = tree.root.copy()
        gated = np.zeros((len(targets.means), len(points)), dtype=bool)
        if self.subpartitions is not None:
            gated = self.subpartitions.gate(points, targets)
            groups = _linked(groups, gated)
        for indices, merges in self._grouped(tree, groups):
            if len(indices) == 1:
                builder.group([((builder.cell(indices),), 0.0)])
                continue
            choices = self._cuts(tree, indices, merges, builder)
            if self.subpartitions is not None:
                near = np.flatnonzero(gated[:, indices].any(1))
                choices += self.subpartitions.choices(points, indices, targets, near, choices, builder)
            builder.group(choices)
        return builder.build()

    @staticmethod
    def _grouped(tree: Tree, groups: IntArray) -> Iterator[tuple[IntArray, list[int]]]:
        """Returns and merges of every group."""
        order = np.argsort(groups, kind="stable")
        bounds = np.flatnonzero(np.diff(groups[order])) + 1
        merges: dict[int, list[int]] = {}
        for k in range(len(tree.merges)):
            merges.setdefault(int(groups[tree.members[len(groups) + k][0]]), []).append(k)
        for indices in np.split(order, bounds):
            yield indices, merges.get(int(groups[indices[0]]), [])

    def _cuts(
        self, tree: Tree, indices: IntArray, merges: list[int], builder: PartitionBuilder
    ) -> list[Choice]:
        """The group's distinct partitions, from the smallest threshold to the largest."""
        count = len(tree.root)
        nodes = dict.fromkeys(indices.tolist())
        cuts: list[list[int]] = []
        for position, k in enumerate(merges):
            height = tree.heights[k]
            if height > self.low and (position == 0 or tree.heights[merges[position - 1]] < height):
                cuts.append(list(nodes))
            for child in tree.merges[k].tolist():
                del nodes[child]
            nodes[count + k] = None
        cuts.append(list(nodes))
        if len(cuts) > self.most:
            self.thinned += 1
            cuts = [cuts[i] for i in np.unique(np.linspace(0, len(cuts) - 1, self.most).astype(int))]
        cells = {node: builder.cell(tree.members[node]) for cut in cuts for node in cut}
        return [(tuple(cells[node] for node in cut), 0.0) for cut in cuts]


def _linked(groups: IntArray, gated: np.ndarray) -> IntArray:
    """Groups joined wherever one target gates returns of several."""
    parent = {int(group): int(group) for group in np.unique(groups)}

    def find(group: int) -> int:
        while parent[group] != group:
            group = parent[group]
        return group

    for row in gated:
        reached = [find(int(group)) for group in np.unique(groups[row])]
        for group in reached[1:]:
            parent[find(group)] = find(reached[0])
    return np.array([find(int(group)) for group in groups])


def make_partitioner(config: PhdConfig) -> Partitioner:
    """The partitioner named by the configuration."""
    if config.partitioner == "kmeans":
        return KMeans(config)
    if config.partitioner == "all":
        return Exhaustive()
    if config.partitioner == "single":
        middle = config.measurement_noise * float(np.sqrt(chdtri(2, 1.0 - config.distance_probabilities[1])))
        return Distances(config, (middle, middle))
    return Distances(config)

"""Partitions of a scan into cells, kept so that far-apart groups of returns are weighted independently.

The sum over partitions in (7) and (9e) factorises over groups of returns that no considered cell joins: a
partition of the scan is any choice of one partition per group. A scan of many separate targets therefore costs the
sum of its groups and not their product, and each group has its own distance threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from tracking.mixture.components import IntArray

# A partition of a group: the indices of its cells, and the log of how many like it the partition stands for.
Choice = tuple[tuple[int, ...], float]


@dataclass
class PredictedTargets:
    """What the filter expects to see: positions (K, 2), their covariances (K, 2, 2)."""

    means: FloatArray
    covariances: FloatArray

    @classmethod
    def none(cls) -> PredictedTargets:
        """Nothing."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2, 2)))


@dataclass
class Partitions:
    """C distinct cells and the partitions made of them, flat.

    Cell c holds the returns `members[starts[c] : starts[c + 1]]`. Entry e says that partition `partition[e]`
    contains cell `cell[e]`; partition p belongs to group `group[p]` and stands for exp(`multiplicity[p]`) alike.
    """

    members: IntArray
    starts: IntArray
    cell: IntArray
    partition: IntArray
    group: IntArray
    multiplicity: FloatArray

    def cells(self) -> list[tuple[int, ...]]:
        """The cells as tuples of returns."""
        return [tuple(part.tolist()) for part in np.split(self.members, self.starts[1:-1])]

    def as_sets(self) -> list[frozenset[tuple[int, ...]]]:
        """Every partition of its group, as a set of cells."""
        cells = self.cells()
        return [
            frozenset(cells[c] for c in self.cell[self.partition == p].tolist())
            for p in range(len(self.group))
        ]


class PartitionBuilder:
    """Collects cells and partitions, each once."""

    def __init__(self) -> None:
        self._cells: dict[bytes, int] = {}
        self._members: list[IntArray] = []
        self._groups: list[dict[tuple[int, ...], float]] = []

    def cell(self, members: IntArray) -> int:
        """Index of the cell with these returns."""
        members = members.copy()
        members.sort()
        key = members.tobytes()
        found = self._cells.get(key)
        if found is None:
            found = self._cells[key] = len(self._members)
            self._members.append(members)
        return found

    def size(self, cell: int) -> int:
        """Number of returns in a cell."""
        return len(self._members[cell])

    def members(self, cell: int) -> IntArray:
        """Returns of a cell."""
        return self._members[cell]

    def group(self, choices: list[Choice]) -> None:
        """One group's partitions; of equal ones that which stands for most stays."""
        unique: dict[tuple[int, ...], float] = {}
        for cells, multiplicity in choices:
            key = tuple(sorted(cells))
            unique[key] = max(unique.get(key, -np.inf), multiplicity)
        self._groups.append(unique)

    def build(self) -> Partitions:
        """Everything collected, flat."""
        flat = [cells for group in self._groups for cells in group]
        sizes = np.array([len(cells) for cells in flat], dtype=np.int64)
        lengths = np.array([len(members) for members in self._members], dtype=np.int64)
        return Partitions(
            np.concatenate([np.zeros(0, dtype=np.int64), *self._members]),
            np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
            np.array([c for cells in flat for c in cells], dtype=np.int64),
            np.repeat(np.arange(len(flat)), sizes),
            np.repeat(np.arange(len(self._groups)), [len(group) for group in self._groups]),
            np.array([value for group in self._groups for value in group.values()], dtype=np.float64),
        )

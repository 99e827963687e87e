"""How well identities were kept: switches (CLEAR MOT) and IDF1, from matched trajectories."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

Array = NDArray[np.float64]


def _matched(cost: Array, near: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """The cheapest pairs (row, column) of those that are near; who has nobody else needs no search."""
    alone = near & (near.sum(1, keepdims=True) == 1) & (near.sum(0, keepdims=True) == 1)
    pairs = [(int(i), int(j)) for i, j in zip(*np.nonzero(alone), strict=True)]
    left = near & ~alone
    rows, columns = np.flatnonzero(left.any(1)), np.flatnonzero(left.any(0))
    if len(rows):
        chosen = zip(*linear_sum_assignment(cost[np.ix_(rows, columns)]), strict=True)
        pairs += [(int(rows[i]), int(columns[j])) for i, j in chosen if near[rows[i], columns[j]]]
    return sorted(pairs)


@dataclass
class IdentityScore:
    """Collects frames; positions within `near` metres may be matched.

    switches : times an object was matched with another id than before. mixed : objects matched with more than
    one id, or ids with more than one object.
    """

    near: float
    switches: int = 0
    true_count: int = 0
    found_count: int = 0
    _last: dict[Hashable, Hashable] = field(default_factory=dict)
    _together: Counter[tuple[Hashable, Hashable]] = field(default_factory=Counter)
    _matched: Counter[tuple[Hashable, Hashable]] = field(default_factory=Counter)
    _true: Counter[Hashable] = field(default_factory=Counter)
    _found: Counter[Hashable] = field(default_factory=Counter)

    def add(self, true: Mapping[Any, Array], ids: Sequence[Hashable], positions: Array) -> None:
        """One frame: true positions by object; ids and positions (N, 3) that were found."""
        names = list(true)
        self._true.update(names)
        self._found.update(ids)
        self.true_count += len(names)
        self.found_count += len(ids)
        pairs: list[tuple[int, int]] = []
        if names and len(ids):
            apart = cdist(np.array([true[n] for n in names]), np.asarray(positions))
            near = apart < self.near
            for i, j in zip(*np.nonzero(near), strict=True):
                self._together[names[i], ids[j]] += 1
            # As in CLEAR MOT, yesterday's correspondence is kept where it is still possible.
            cost = np.where(near, apart, 1e6)
            column = {item: j for j, item in reversed(list(enumerate(ids)))}
            for i, name in enumerate(names):
                j = column.get(self._last.get(name), -1)
                if j >= 0 and near[i, j]:
                    cost[i, j] -= 1e3
            pairs = _matched(cost, near)
        for i, j in pairs:
            name = names[i]
            self.switches += name in self._last and self._last[name] != ids[j]
            self._last[name] = ids[j]
            self._matched[name, ids[j]] += 1

    @property
    def idf1(self) -> float:
        """Share of detections with the identity of the best one-to-one matching of trajectories (Ristani 2016)."""
        true, found = list(self._true), list(self._found)
        if not true and not found:
            return 1.0
        shared = np.zeros((len(true), len(found)))
        for (name, item), count in self._together.items():
            shared[true.index(name), found.index(item)] = count
        rows, columns = linear_sum_assignment(-shared)
        return 2.0 * float(shared[rows, columns].sum()) / (self.true_count + self.found_count)

    @property
    def mixed(self) -> int:
        """Objects that had several ids, and ids that had several objects, each beyond the first."""
        by_true = Counter(name for name, _ in self._matched)
        by_id = Counter(item for _, item in self._matched)
        return sum(n - 1 for n in by_true.values()) + sum(n - 1 for n in by_id.values())

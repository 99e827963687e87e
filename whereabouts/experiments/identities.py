"""How well identities were kept: switches (CLEAR MOT) and IDF1, from matched trajectories."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]


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
    misses: int = 0
    false: int = 0
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
            apart = np.linalg.norm(
                np.array([true[n] for n in names])[:, None] - np.asarray(positions)[None], axis=2
            )
            for i, j in zip(*np.nonzero(apart < self.near), strict=True):
                self._together[names[i], ids[j]] += 1
            # As in CLEAR MOT, yesterday's correspondence is kept where it is still possible.
            cost = np.where(apart < self.near, apart, 1e6)
            for i, name in enumerate(names):
                if self._last.get(name) in ids:
                    j = list(ids).index(self._last[name])
                    if apart[i, j] < self.near:
                        cost[i, j] -= 1e3
            chosen = zip(*linear_sum_assignment(cost), strict=True)
            pairs = [(i, j) for i, j in chosen if apart[i, j] < self.near]
        for i, j in pairs:
            name = names[i]
            self.switches += name in self._last and self._last[name] != ids[j]
            self._last[name] = ids[j]
            self._matched[name, ids[j]] += 1
        self.misses += len(names) - len(pairs)
        self.false += len(ids) - len(pairs)

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

"""People who walk beside each other: they mostly leave together."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from tracking.intentions.observations import at_times

# Walks remembered with their times: whoever walked beside somebody who is present has only just left.
LATEST = 30


class Company:
    """The latest learned walks with their times."""

    def __init__(self) -> None:
        self._walks: deque[FloatArray] = deque(maxlen=LATEST)

    def learn(self, rows: FloatArray) -> None:
        """Remember one finished walk (N, 3) x, y, t."""
        self._walks.append(rows)

    def move(self, moved: Callable[[FloatArray], FloatArray]) -> None:
        """Take all walks to another frame."""
        walks = [np.column_stack((moved(rows[:, :2]), rows[:, 2])) for rows in self._walks]
        self._walks = deque(walks, maxlen=LATEST)

    def as_arrays(self) -> dict[str, NDArray[Any]]:
        """What is remembered, for storage."""
        counts = np.array([len(rows) for rows in self._walks], dtype=np.int64)
        return {"company": np.concatenate((np.zeros((0, 3)), *self._walks)), "company_counts": counts}

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `as_arrays` gave, nothing where there is none. Raises ValueError where it does not fit."""
        rows = np.asarray(arrays.get("company", np.zeros((0, 3))), dtype=np.float64)
        counts = np.asarray(arrays.get("company_counts", np.zeros(0))).astype(np.int64)
        if rows.shape != (int(counts.sum()), 3) or (counts < 1).any() or not np.isfinite(rows).all():
            raise ValueError("the latest walks do not fit together")
        self._walks = deque(np.split(rows, np.cumsum(counts)[:-1]) if len(counts) else [], maxlen=LATEST)

    def apart(self, rows: FloatArray, known: int) -> FloatArray:
        """Mean distance (known,) m of a partial walk (N, 3) to each of the `known` walks learned, at the same times.

        Infinite for those that were not there at the same time.
        """
        distances = np.full(known, np.inf)
        for back, walk in enumerate(reversed(self._walks), start=1):
            if back > known:
                break
            if walk[-1, 2] < rows[0, 2] or walk[0, 2] > rows[-1, 2]:
                continue
            low, high = np.searchsorted(rows[:, 2], (walk[0, 2], walk[-1, 2] + 1e-9))
            if high <= low:
                continue
            both = rows[low:high]
            distances[known - back] = np.hypot(*(at_times(walk, both[:, 2]) - both[:, :2]).T).mean()
        return distances

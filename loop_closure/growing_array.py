"""An array that rows are added to one by one, without copying it each time."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


class GrowingArray:
    """Rows of one shape and kind.

    Parameters
    ----------
    row : shape of one row. dtype : of its values. empty : value of rows that were not written yet.
    """

    def __init__(
        self, row: tuple[int, ...] = (), dtype: npt.DTypeLike = np.float64, empty: float = 0
    ) -> None:
        self._empty = empty
        self._count = 0
        self._all = np.full((16, *row), empty, dtype=dtype)

    @classmethod
    def of(cls, rows: npt.NDArray[Any]) -> GrowingArray:
        """A copy of `rows` (N, ...), to be added to."""
        made = cls(rows.shape[1:], rows.dtype)
        made.reach(len(rows))
        made.rows[:] = rows
        return made

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> npt.NDArray[Any]:
        """(N, ...), a view; rows that are added later are not in it."""
        return self._all[: self._count]

    def append(self, row: npt.ArrayLike) -> None:
        """One more row."""
        self.reach(self._count + 1)
        self._all[self._count - 1] = row

    def reach(self, count: int) -> None:
        """Have `count` rows at least; new ones are `empty`."""
        if count > len(self._all):
            longer = np.full((2 * count, *self._all.shape[1:]), self._empty, dtype=self._all.dtype)
            longer[: self._count] = self.rows
            self._all = longer
        self._count = max(self._count, count)

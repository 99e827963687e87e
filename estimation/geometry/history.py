"""Values by stamp over a limited time, for looking up between two of them."""

from __future__ import annotations

import bisect
from typing import Generic, TypeVar

Value = TypeVar("Value")


class StampedHistory(Generic[Value]):
    """Values ordered by stamp (integer nanoseconds), the newest `length` nanoseconds of them.

    Values may arrive in any order; a second one for a stamp replaces the first.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._stamps: list[int] = []
        self._values: list[Value] = []

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def oldest(self) -> int | None:
        """Stamp of the oldest value, None while empty."""
        return self._stamps[0] if self._stamps else None

    @property
    def newest(self) -> int | None:
        """Stamp of the newest value, None while empty."""
        return self._stamps[-1] if self._stamps else None

    def clear(self) -> None:
        """Forget everything."""
        self._stamps.clear()
        self._values.clear()

    def insert(self, stamp: int, value: Value) -> None:
        """Add a value, and drop those that have become too old."""
        index = bisect.bisect_left(self._stamps, stamp)
        if index < len(self._stamps) and self._stamps[index] == stamp:
            self._values[index] = value
            return
        self._stamps.insert(index, stamp)
        self._values.insert(index, value)
        outdated = bisect.bisect_left(self._stamps, self._stamps[-1] - self._length)
        if outdated:
            del self._stamps[:outdated], self._values[:outdated]

    def forget_after(self, stamp: int) -> None:
        """Drop values newer than `stamp`."""
        keep = bisect.bisect_right(self._stamps, stamp)
        del self._stamps[keep:], self._values[keep:]

    def latest(self, count: int) -> list[tuple[int, Value]]:
        """The newest values with their stamps, oldest of them first; fewer than `count` if there are not as many."""
        return list(zip(self._stamps[-count:], self._values[-count:], strict=True))

    def around(self, stamp: int) -> tuple[Value, Value, float] | None:
        """The values before and after a stamp, and how far it is from the first to the second, 0 to 1.

        None where the stamp lies outside the history.
        """
        index = bisect.bisect_left(self._stamps, stamp)
        if index == len(self._stamps) or (index == 0 and self._stamps[0] != stamp):
            return None
        if self._stamps[index] == stamp:
            return self._values[index], self._values[index], 0.0
        before, after = self._stamps[index - 1], self._stamps[index]
        return self._values[index - 1], self._values[index], (stamp - before) / (after - before)

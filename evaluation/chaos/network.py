"""A network that loses: what stands between a publisher and its reader."""

from __future__ import annotations

from typing import Generic, TypeVar

import numpy as np

Item = TypeVar("Item")


class Link(Generic[Item]):
    """Loses, doubles and delays a share of what is sent; what is delayed comes after what was sent later.

    lost, doubled, delayed : shares. longest : messages sent meanwhile by which one is late at most.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        lost: float = 0.2,
        doubled: float = 0.1,
        delayed: float = 0.2,
        longest: int = 20,
    ) -> None:
        self._rng = rng
        self._lost, self._doubled, self._delayed, self._longest = lost, doubled, delayed, longest
        self._under_way: list[tuple[int, Item]] = []

    def send(self, item: Item) -> list[Item]:
        """What arrives now."""
        self._under_way = [(left - 1, kept) for left, kept in self._under_way]
        here = [] if self._rng.random() < self._lost else [item]
        if here and self._rng.random() < self._delayed:
            self._under_way.append((int(self._rng.integers(1, self._longest + 1)), item))
            here = []
        if self._rng.random() < self._doubled:
            here *= 2
        here += [kept for left, kept in self._under_way if left <= 0]
        self._under_way = [(left, kept) for left, kept in self._under_way if left > 0]
        return here

    def rest(self) -> list[Item]:
        """What is still under way, once nothing more is sent."""
        rest, self._under_way = [kept for _, kept in self._under_way], []
        return rest

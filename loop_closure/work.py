"""Work cut into steps: what takes long is begun with one scan and goes on with the next ones.

A function that is a generator yields before each step about how long that takes. `at_once` runs it through; `Allowance`
runs as much of it as one scan may cost. What is done with which scan depends on the scans alone, never on a clock, so
that the same scans give the same map to the last digit.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")
Steps = Generator[float, None, T]
"""Yields before each step about how many ms it takes on one core of a desktop computer."""


def at_once(steps: Steps[T]) -> T:
    """All steps one after the other; what they return."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            value: T = end.value
            return value


class Job:
    """Steps that can be left off and gone on with.

    steps : nothing of them is done before `go_on`.
    """

    def __init__(self, steps: Steps[None]) -> None:
        self._steps = steps
        self._next: float | None = 0.0  # cost of the step that is next; None once all are done

    @property
    def done(self) -> bool:
        """Whether no step is left."""
        return self._next is None

    def go_on(self, allowance: Allowance) -> None:
        """Do steps while there is allowance for them."""
        while self._next is not None and allowance.take(self._next):
            self._next = next(self._steps, None)


class Allowance:
    """What one scan may cost.

    Parameters
    ----------
    most : ms; None for as much as it takes. The first step is done whatever it costs.
    """

    def __init__(self, most: float | None) -> None:
        self._most = most
        self._spent = 0.0

    def take(self, cost: float) -> bool:
        """Whether there is allowance for a step of `cost` ms, which then counts as taken."""
        if self._most is not None and self._spent > 0.0 and self._spent + cost > self._most:
            return False
        self._spent += cost
        return True

"""How much time a sensor leaves for each of its scans, and how much of it labels take."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from statistics import median

# Of the time between scans. What is left is for the labels that take longer than most, so that the next scan is still
# answered within its own period.
SHARE = 0.6
PERIODS = 25  # times between scans that are remembered; their median is the sensor's, whatever is lost
DURATIONS = 9  # of labels, that are remembered
HOPE = 0.995  # of the expected duration after a scan there was no time for, so that it is tried again, seldom


class Pace:
    """When labels of a scan have to be ready.

    Counted from the scan's arrival, not from the beginning of work on it: one that had to wait has less time left, or
    none, so that a delay is not handed on from scan to scan.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self.reset()

    def reset(self) -> None:
        """Forget all scans."""
        self._periods: deque[float] = deque(maxlen=PERIODS)
        self._stamp: float | None = None
        self._arrived = 0.0

    def begin(self, stamp: float, arrived: float) -> None:
        """A scan of `stamp`, s, that reached the process at `arrived`, s of the clock."""
        if self._stamp is not None and stamp > self._stamp:
            self._periods.append(stamp - self._stamp)
        self._stamp, self._arrived = stamp, arrived

    @property
    def left(self) -> float:
        """Seconds from now until `SHARE` of the time between scans has passed since this one came."""
        if not self._periods:
            return float("inf")
        return self._arrived + SHARE * median(self._periods) - self._clock()


class Duration:
    """What a piece of work usually takes: the median, so that one hiccup says nothing."""

    def __init__(self) -> None:
        self._taken: deque[float] = deque(maxlen=DURATIONS)
        self._hope = 1.0

    @property
    def expected(self) -> float:
        """Seconds; 0 as long as nothing is known."""
        return self._hope * median(self._taken) if self._taken else 0.0

    def took(self, seconds: float) -> None:
        """It was done, in so many seconds."""
        self._taken.append(seconds)
        self._hope = 1.0

    def not_done(self) -> None:
        """There was no time for it."""
        self._hope *= HOPE

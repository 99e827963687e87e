"""Tracks of a tracker, kept until they end: what a node learns from, and what it predicts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from estimation.checks import FloatArray, require_positive


class TrackKeeper:
    """Observations of each label, in the order of their stamps.

    timeout : s after which a track that is neither seen nor known to be hidden has ended.
    longest : observations kept per track, the latest; somebody who stays for days must not fill the memory.
    """

    def __init__(self, timeout: float = 2.0, longest: int = 20000) -> None:
        self.timeout = require_positive("timeout", timeout)
        self.longest = longest
        self._rows: dict[int, list[tuple[float, float, float]]] = {}
        self._alive: dict[int, float] = {}
        self.stamp = -np.inf

    def __len__(self) -> int:
        return len(self._rows)

    def observe(
        self, stamp: float, positions: Mapping[int, FloatArray], hidden: Iterable[int] = ()
    ) -> list[FloatArray]:
        """Take in the positions (2,) by label seen at `stamp` s; tracks (N, 3) x, y, t that have ended, by label.

        hidden : labels that are still tracked though nothing of them is seen; where they are hidden is no place that
        people go to. A stamp that is not newer than a track's last one adds nothing to it.
        """
        for label in (*positions, *hidden):
            self._alive[label] = max(stamp, self._alive.get(label, stamp))
        for label, position in positions.items():
            rows = self._rows.setdefault(label, [])
            if not rows or stamp > rows[-1][2]:
                rows.append((float(position[0]), float(position[1]), stamp))
                if len(rows) > self.longest:
                    del rows[: len(rows) - self.longest]
        self.stamp = max(self.stamp, stamp)
        over = sorted(label for label, last in self._alive.items() if self.stamp - last > self.timeout)
        for label in over:
            del self._alive[label]
        return [np.array(self._rows.pop(label)) for label in over if label in self._rows]

    def present(self) -> dict[int, FloatArray]:
        """Tracks (N, 3) that have not ended, by label."""
        return {label: np.array(rows) for label, rows in sorted(self._rows.items())}

    def finish(self) -> list[FloatArray]:
        """All tracks, as ended; none is left."""
        ended = list(self.present().values())
        self._rows.clear()
        self._alive.clear()
        return ended

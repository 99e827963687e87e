"""What stands still around the sensor: which places were seen empty, and which were seen occupied, some time ago.

A person stands where nothing was before. A grid of the surroundings counts, per cell, scans that saw it empty and scans
that saw something in it. Scans enter it with a delay, so that somebody who walks does not become his own background.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import numpy.typing as npt
from numba import njit

from estimation.checks import FloatArray
from tracking.people.people_sweep import Sweep

NOBODY: FloatArray = np.zeros((0, 2))
CELL, REACH = 0.1, 15.0  # m, edge of a cell, and how far the grid reaches around the sensor
STEP = 0.7  # cells from one place of a beam to the next
DELAY, MEMORY = 1.0, 20.0  # s, before a scan counts, and of the counts
KNOWN = 5.0  # scans after which a cell is known


class Background:
    """Counts of empty and occupied per cell of a torus around the sensor, in the frame of the poses."""

    def __init__(self) -> None:
        size = 1 << math.ceil(math.log2(2.0 * REACH / CELL + 2))
        self.size = size
        self.counts = np.zeros((size, size, 2), dtype=np.float32)
        self.owner = np.full((size, size), np.iinfo(np.int64).min, dtype=np.int64)
        self.seen = np.zeros((size, size), dtype=np.int64)
        self._scans = 0
        self._waiting: deque[tuple[float, FloatArray]] = deque()
        self._last: float | None = None
        self.forgot = False

    def clear(self) -> None:
        """Forget everything; `forgot` until scans count again."""
        self.forgot = True
        self.owner[:] = np.iinfo(np.int64).min
        self._waiting.clear()
        self._last = None

    def add(
        self,
        sweep: Sweep,
        stamp: float,
        ignore: npt.NDArray[np.bool_],
        people: FloatArray = NOBODY,
        near: float = 0.0,
    ) -> None:
        """A scan; beams of `ignore` (N,) hit people: they only say what is empty before them.

        people (T, 2) : m, where they are now. Beams that have waited and end less than `near` m from one of them are
        taken for his: who stands was there before it was known that he is somebody.
        """
        hits = np.where(ignore | (sweep.ranges >= REACH), 0.0, 1.0)
        ways = np.cos(sweep.angles), np.sin(sweep.angles)
        clear = np.minimum(sweep.clear, 2.0 * REACH)
        rays = np.column_stack((sweep.origins, *ways, clear, hits))[clear > 0.0]
        self._waiting.append((stamp, rays))
        while self._waiting and self._waiting[0][0] <= stamp - DELAY:
            then, old = self._waiting.popleft()
            ends = old[:, :2] + old[:, 4:5] * old[:, 2:4]
            gaps = np.linalg.norm(ends[:, None] - people[None], axis=2)
            old[gaps.min(axis=1, initial=np.inf) < near, 5] = 0.0
            dt = 0.0 if self._last is None else min(max(then - self._last, 0.0), 1.0)
            self._last = then
            keep = math.exp(-dt / MEMORY)
            self._scans += 1
            self.forgot = False
            grid = self.counts, self.owner, self.seen
            _insert(*grid, self._scans, old, CELL, REACH, keep)

    def evidence(self, points: FloatArray, away: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """How surely each point (M, 2) lies where it was empty, where something stood, and where nobody has looked.

        away : (M,) metres from the scanner, the farther the less well a place is known. All (M,) in [0, 1].
        """
        slack = 0.05 + 0.02 * away
        return _evidence(self.counts, self.owner, points, slack, CELL)


@njit(cache=True)
def _insert(counts, owner, seen, scan, rays, cell, reach, keep):  # type: ignore[no-untyped-def]
    """One scan, number `scan`: every cell counts once, occupied before empty.

    One body, with nothing called: a call for every cell would take most of the time.
    """
    mask = owner.shape[0] - 1
    for empty in range(2):
        for k in range(len(rays)):
            x, y, c, s, clear = rays[k, 0], rays[k, 1], rays[k, 2], rays[k, 3], rays[k, 4]
            # A cell before the return the beam is not sure to have been in the open.
            steps = int((min(clear, reach) - cell) / (STEP * cell)) if empty else int(rays[k, 5])
            for step in range(1, steps + 1):
                along = step * STEP * cell if empty else clear
                i, j = math.floor((x + c * along) / cell), math.floor((y + s * along) / cell)
                a, b = i & mask, j & mask
                # Rays reach less than half way round the torus: what this scan saw is no other place.
                if seen[a, b] == scan:
                    continue
                seen[a, b] = scan
                name = (i << 32) ^ (j & 0xFFFFFFFF)
                if owner[a, b] != name:
                    owner[a, b] = name
                    counts[a, b, 0] = 0.0
                    counts[a, b, 1] = 0.0
                counts[a, b, 0] = counts[a, b, 0] * keep + empty
                counts[a, b, 1] = counts[a, b, 1] * keep + (1 - empty)


@njit(cache=True)
def _evidence(counts, owner, points, slack, cell):  # type: ignore[no-untyped-def]
    fresh, old, unseen = np.zeros(len(points)), np.zeros(len(points)), np.ones(len(points))
    size = owner.shape[0]
    for k in range(len(points)):
        i, j = math.floor(points[k, 0] / cell), math.floor(points[k, 1] / cell)
        # What is known no better than this could be anywhere, and looking there takes for ever.
        rings = math.ceil(min(max(slack[k] / cell, 1.0), size / 8.0))
        empty, most, looked = 0.0, 0.0, 0.0
        for di in range(-rings, rings + 1):
            for dj in range(-rings, rings + 1):
                a, b = (i + di) & (size - 1), (j + dj) & (size - 1)
                if owner[a, b] != (((i + di) << 32) ^ ((j + dj) & 0xFFFFFFFF)):
                    continue
                passes, hits = counts[a, b, 0], counts[a, b, 1]
                looked = max(looked, passes + hits)
                if hits > 0.0:
                    # One return against many beams through the cell is an edge or dust, not a thing that stands.
                    most = max(most, (hits / (hits + passes)) * min(1.0, hits / 4.0))
                if di == 0 and dj == 0:
                    empty = passes
        share = min(1.0, empty / KNOWN)
        fresh[k] = share * max(0.0, 1.0 - most / 0.08)
        old[k] = min(1.0, most / 0.5)
        unseen[k] = max(0.0, 1.0 - looked / KNOWN)
    return fresh, old, unseen

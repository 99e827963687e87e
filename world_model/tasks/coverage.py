"""Where to look next when nothing in view says so: what of the floor has been looked at, and what more there may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.grid_paths import GridPaths
from estimation.geometry.places import Place, Places
from world_model.tasks.maintenance_kernels import resampled
from world_model.tasks.ways import CLEARANCE

IntArray = npt.NDArray[np.int64]
CELL = 0.5  # metres
MARGIN = 2.0  # metres
# On a floor nobody knows, metres: seen well enough to know its furniture, and how fast what is beyond becomes unlikely;
# how far it may go on beyond what has been seen; between candidates, of which there are MOST along a side at most.
# Who comes in stands at a wall: out on that side is DOOR times farther.
PASSED, OUTER, COARSE, MOST, DOOR = 4.0, 6.0, 1.5, 25, 5.0


class Coverage:
    """Which cells of a floor were within `view` metres of the robot, and in sight.

    grid : its reachable cells are the floor. places : else the rooms are. known : (N, 2) metres; where there are none,
    the floor extends MARGIN around these.
    """

    def __init__(
        self, view: float, grid: OccupancyGrid | None, places: Places | None, known: FloatArray
    ) -> None:
        self.view = view
        self.grid = grid
        if grid is not None:
            low, high = bounds_of(grid)
        elif places is not None and len(places.rooms):
            corners = np.vstack([room.polygon for room in places.rooms])
            low, high = corners.min(axis=0), corners.max(axis=0)
        else:
            low, high = known.min(axis=0) - MARGIN, known.max(axis=0) + MARGIN
        x = np.arange(low[0] + 0.5 * CELL, max(high[0], low[0] + CELL), CELL)
        y = np.arange(low[1] + 0.5 * CELL, max(high[1], low[1] + CELL), CELL)
        self._cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if grid is not None:
            self._cells = self._cells[grid.lookup(self._cells) < 0.0]
        self._seen = np.zeros(len(self._cells), dtype=np.bool_)
        self._within: dict[str, npt.NDArray[np.bool_]] = {}

    def look(self, place: FloatArray) -> None:
        """The robot was at a place (2,)."""
        near = np.flatnonzero(~self._seen & (np.hypot(*(self._cells - place).T) <= self.view))
        if self.grid is not None and len(near):
            offsets = self._cells[near] - place
            away = np.hypot(*offsets.T)
            free = self.grid.ray_cast(place, np.arctan2(offsets[:, 1], offsets[:, 0]), self.view)
            near = near[free >= away]
        self._seen[near] = True

    @property
    def share(self) -> float:
        """Share of the floor that has been looked at."""
        return float(self._seen.mean()) if len(self._seen) else 1.0

    def unseen(self, room: Place, spot: FloatArray | None = None, radius: float = 0.0) -> float:
        """Share of a room's cells, within `radius` of a `spot` (2,) if one is given, that are still to be seen."""
        inside = self._inside(room)
        if spot is not None:
            inside = inside & (np.hypot(*(self._cells - spot).T) <= radius)
        return float((~self._seen[inside]).mean()) if inside.any() else 0.0

    def _inside(self, room: Place) -> npt.NDArray[np.bool_]:
        if room.name not in self._within:
            self._within[room.name] = np.asarray(room.contains(self._cells))
        return self._within[room.name]

    def next_place(self, place: FloatArray, room: Place | None = None) -> FloatArray | None:
        """Where to look next from a place (2,), in a room or anywhere: much that is new for little driving.

        None when all has been seen.
        """
        open_cells = ~self._seen if room is None else ~self._seen & self._inside(room)
        numbers = np.flatnonzero(open_cells)
        left = self._cells[numbers]
        if not len(left):
            return None
        lengths = np.hypot(*(left - place).T)
        if self.grid is not None:
            lengths = GridPaths(self.grid, place, CLEARANCE).lengths(left)
        able = np.flatnonzero(np.isfinite(lengths))
        if not len(able):
            self._seen[numbers] = True
            return None
        # A few candidates are enough: those that are nearest by bearing and distance alike.
        order = able[np.argsort(lengths[able], kind="stable")]
        chosen = order[:: max(len(order) // 30, 1)]
        fresh = (np.hypot(*(left[chosen, None] - left[None]).transpose(2, 0, 1)) <= self.view).sum(axis=1)
        best = chosen[int(np.argmax(fresh / (lengths[chosen] + self.view)))]
        return np.asarray(left[best])


def where_more_is_seen(
    known: Sequence[FloatArray],
    track: Sequence[FloatArray],
    place: FloatArray,
    tried: Sequence[FloatArray] = (),
) -> FloatArray | None:
    """Where to go on from `place` (2,) on a floor nobody knows; None when all of it has been passed.

    The floor is taken to be the box of all objects seen, `known` (each (2,)), and of where the robot came in, with
    OUTER metres around, the less likely the farther out: rooms go on where nothing has been seen yet, though hardly
    behind where one came in. What is within PASSED metres of the robot's `track` counts as looked at by and large,
    enough to have seen furniture, and so do goals `tried`, reached or not. As for coverage, much that is new and
    likely for little driving.
    """
    been = np.concatenate((resampled(np.array(track), 1.0), np.reshape(tried, (-1, 2))))
    every = np.array([track[0], *known])
    low, high = every.min(axis=0), every.max(axis=0)
    step = max(COARSE, float((high - low + 2.0 * OUTER).max()) / MOST)
    x, y = (np.arange(low[a] - OUTER + 0.5 * step, high[a] + OUTER, step) for a in range(2))
    cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    left = cells[np.hypot(*(cells[:, None] - been[None]).transpose(2, 0, 1)).min(axis=1) > PASSED]
    if not len(left):
        return None
    below, above = np.maximum(low - left, 0.0), np.maximum(left - high, 0.0)
    below *= np.where(track[0] <= low, DOOR, 1.0)
    above *= np.where(track[0] >= high, DOOR, 1.0)
    outside = np.hypot(*(below + above).T)
    likely = np.exp(-outside / PASSED)
    lengths = np.hypot(*(left - place).T)
    near = np.hypot(*(left[:, None] - left[None]).transpose(2, 0, 1)) <= PASSED
    return np.asarray(left[int(np.argmax(likely * (near @ likely) / (lengths + PASSED)))])


def middle_of(grid: OccupancyGrid) -> FloatArray | None:
    """The free place nearest to the middle of what is free; None where nothing is."""
    free = grid.free
    if not free.any():
        return None
    off = [
        np.arange(len(share)) - np.average(np.arange(len(share)), weights=share) for share in _shares(free)
    ]
    away = np.where(free, off[0][:, None] ** 2 + off[1] ** 2, np.inf)
    return grid.centres(np.unravel_index(np.argmin(away), away.shape))


def bounds_of(grid: OccupancyGrid) -> tuple[FloatArray, FloatArray]:
    """Corners (2,), (2,) of the box around what is free, metres."""
    found = [np.flatnonzero(share) for share in _shares(grid.free)]
    low, high = ([int(cells[end]) if len(cells) else 0 for cells in found] for end in (0, -1))
    half = 0.5 * grid.resolution
    return grid.centres(low) - half, grid.centres(high) + half


def _shares(free: npt.NDArray[np.bool_]) -> tuple[IntArray, IntArray]:
    """How many cells of each row (H,), and of each column (W,), are free."""
    return free.sum(axis=1), free.sum(axis=0)

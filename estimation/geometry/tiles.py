"""Occupancy in tiles: memory follows what was seen, not how far apart it lies. Bounded views of it as dense grids.

Cells are those of `estimation.geometry.grid`, on a lattice through the map's origin: cell (j, i) spans i to i
+ 1 resolutions in x and j in y. A tile is 64 x 64 of them, 16 KiB.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from estimation.checks import FloatArray, as_vectors, require_positive
from estimation.geometry.grid import (
    FREE_BELOW,
    HIT,
    MISS,
    MOST,
    OCCUPIED_OVER,
    RESOLUTION,
    OccupancyGrid,
    placed_scan,
)
from estimation.geometry.grid_kernels import TILE, add_marks, mark_scan

Indices = npt.NDArray[np.int64]
Tiles = frozenset[tuple[int, int]]  # rows and columns
VIEW_CELLS = 25_000_000  # of a view, unless said otherwise: 250 x 250 m at 5 cm
VOID = 4  # parts are shown together where the box around them is at most so many times their own boxes


@dataclass(frozen=True)
class TileView:
    """A box of tiles that is looked at.

    low : row and column of its first tile. shape : rows and columns of tiles. left_out : seen tiles outside it.
    farthest : metres from the box's middle to the farthest of those.
    """

    low: tuple[int, int]
    shape: tuple[int, int]
    left_out: int = 0
    farthest: float = 0.0


class TiledGrid:
    """Log-odds of being occupied, in tiles that come into being when something is seen there.

    resolution : metres, edge of a cell.
    """

    def __init__(self, resolution: float = RESOLUTION) -> None:
        self.resolution = require_positive("resolution", resolution)
        # Zeros take no memory until they are written: room for twice as many tiles costs nothing.
        self._cells = np.zeros((16, TILE, TILE), dtype=np.float32)
        self._numbers: dict[tuple[int, int], int] = {}
        self._spare: list[int] = list(range(16))[::-1]

    def __len__(self) -> int:
        return len(self._numbers)

    @property
    def tiles(self) -> Indices:
        """Row and column (T, 2) of the tiles there are."""
        return np.array(list(self._numbers), dtype=np.int64).reshape(-1, 2)

    @property
    def nbytes(self) -> int:
        """Bytes that the tiles take."""
        return len(self) * self._cells[0].nbytes

    def integrate(
        self, pose: npt.ArrayLike, points: npt.ArrayLike, weight: float = 1.0, only: Tiles | None = None
    ) -> Tiles:
        """Add one scan: its end points are occupied, the way to them is free. Returns the tiles it touches.

        pose : (3,) x, y, yaw of the sensor in the map. points : (N, 2) returns in the sensor frame, metres.
        weight : 1 for one look; less where looks are not independent. A cell is changed once per scan.
        only : tiles outside which nothing is changed.
        Raises InputError: wrong shapes, numbers that are not finite, places that no map reaches.
        """
        indices, marks = mark_scan(*placed_scan(pose, points, self.resolution))
        touched = [(j, i) for j, i in indices.tolist()]
        numbers = [self._number(tile) if only is None or tile in only else -1 for tile in touched]
        add_marks(self._cells, np.array(numbers, dtype=np.int64), marks, weight * HIT, weight * MISS, MOST)
        return frozenset(touched)

    def erase(self, tiles: Tiles) -> None:
        """Forget what was seen in some tiles."""
        for tile in tiles & self._numbers.keys():
            number = self._numbers.pop(tile)
            self._cells[number] = 0.0
            self._spare.append(number)

    def _number(self, tile: tuple[int, int]) -> int:
        number = self._numbers.get(tile)
        if number is None:
            if not self._spare:
                count = len(self._cells)
                grown = np.zeros((2 * count, TILE, TILE), dtype=np.float32)
                grown[:count] = self._cells
                self._cells, self._spare = grown, list(range(count, 2 * count))[::-1]
            number = self._numbers[tile] = self._spare.pop()
        return number

    def lookup(self, points: npt.ArrayLike) -> FloatArray:
        """Log-odds (...) at points (..., 2); 0 where nothing was seen."""
        cells = np.floor(as_vectors("points", points, 2) / self.resolution).astype(np.int64)[..., ::-1]
        flat = cells.reshape(-1, 2)
        values = np.zeros(len(flat))
        for k, (j, i) in enumerate(flat.tolist()):
            number = self._numbers.get((j // TILE, i // TILE))
            if number is not None:
                values[k] = self._cells[number, j % TILE, i % TILE]
        return values.reshape(cells.shape[:-1])

    def occupied_points(self) -> FloatArray:
        """Centres (N, 2) of all occupied cells, metres."""
        found = [np.zeros((0, 2))]
        for tile, number in self._numbers.items():
            cells = np.argwhere(self._cells[number] > OCCUPIED_OVER) + np.array(tile) * TILE
            found.append((cells[:, ::-1] + 0.5) * self.resolution)
        return np.concatenate(found)

    # Views.

    def view(self, around: npt.ArrayLike | None = None, most: int = VIEW_CELLS) -> TileView:
        """All that was seen, if one box of `most` cells holds it and is not mostly void; the part that matters else.

        around : (2,) metres; the connected part nearest to it is shown, the largest without it, and others near that.
        A part that is itself too large is shown around the place.
        """
        tiles = self.tiles
        if not len(tiles):
            return TileView((0, 0), (0, 0))
        limit = max(most // TILE**2, 1)
        place = None if around is None else as_vectors("around", around, 2)[::-1] / (TILE * self.resolution)
        low, high = tiles.min(axis=0), tiles.max(axis=0)
        if not _fits(low, high, min(limit, VOID * len(tiles))):
            low, high = _joined(_parts(tiles), place, limit)
        if not _fits(low, high, limit):
            low, high = _cropped(low, high, place, limit)
        outside = tiles[((tiles < low) | (tiles > high)).any(axis=1)]
        away = np.hypot(*(outside - 0.5 * (low + high)).T).max(initial=0.0) * TILE * self.resolution
        shape = high - low + 1
        return TileView((int(low[0]), int(low[1])), (int(shape[0]), int(shape[1])), len(outside), float(away))

    def origin(self, view: TileView) -> FloatArray:
        """Lower left corner (2,) of a view, metres."""
        return np.array(view.low[::-1], dtype=np.float64) * (TILE * self.resolution)

    def dense(self, view: TileView | None = None) -> OccupancyGrid:
        """The cells of a view, or of what `view` chooses."""
        view = self.view() if view is None else view
        rows, columns = view.shape
        cells = np.zeros((rows * TILE, columns * TILE), dtype=np.float32)
        for j, i, number in self._within(view):
            cells[j : j + TILE, i : i + TILE] = self._cells[number]
        grid = OccupancyGrid(self.resolution, self.origin(view))
        grid.log_odds = cells
        return grid

    def values(self, view: TileView) -> npt.NDArray[np.int8]:
        """Occupancy (H, W) of a view for nav_msgs/OccupancyGrid: 0 free, 100 occupied, -1 unknown."""
        rows, columns = view.shape
        values = np.full((rows * TILE, columns * TILE), -1, dtype=np.int8)
        for j, i, number in self._within(view):
            cells = self._cells[number]
            tile = values[j : j + TILE, i : i + TILE]
            tile[cells < FREE_BELOW] = 0
            tile[cells > OCCUPIED_OVER] = 100
        return values

    def _within(self, view: TileView) -> list[tuple[int, int, int]]:
        """First row and column in the view, and number, of the tiles in it."""
        (low_j, low_i), (rows, columns) = view.low, view.shape
        return [
            ((j - low_j) * TILE, (i - low_i) * TILE, number)
            for (j, i), number in self._numbers.items()
            if 0 <= j - low_j < rows and 0 <= i - low_i < columns
        ]


def _fits(low: Indices, high: Indices, most: int) -> bool:
    return math.prod((high - low + 1).tolist()) <= most


def _parts(tiles: Indices) -> list[Indices]:
    """The tiles (T, 2) in parts that touch each other, also at corners; the largest part first."""
    tiles = tiles[np.lexsort(tiles.T[::-1])]
    pairs = cKDTree(tiles).query_pairs(1.5, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(tiles), len(tiles)))
    _, labels = connected_components(graph.tocsr(), directed=False)
    borders = np.cumsum(np.bincount(labels))[:-1]
    return sorted(np.split(tiles[np.argsort(labels, kind="stable")], borders), key=len, reverse=True)


def _joined(parts: list[Indices], place: FloatArray | None, limit: int) -> tuple[Indices, Indices]:
    """First and last tile of the box around the part that matters, and others where that is not mostly void."""
    lows = np.array([part.min(axis=0) for part in parts])
    highs = np.array([part.max(axis=0) for part in parts])
    first = 0
    if place is not None:
        first = int(np.argmin([np.hypot(*(part + 0.5 - place).T).min() for part in parts]))
    low, high = lows[first], highs[first]
    gaps = np.maximum(np.maximum(lows - high, low - highs), 0)
    sizes = np.prod(highs - lows + 1, axis=1)
    seen = int(sizes[first])
    for k in np.argsort(np.hypot(*gaps.T), kind="stable"):
        wider = np.minimum(low, lows[k]), np.maximum(high, highs[k])
        if k != first and _fits(*wider, min(limit, VOID * (seen + int(sizes[k])))):
            low, high = wider
            seen += int(sizes[k])
    return low, high


def _cropped(low: Indices, high: Indices, place: FloatArray | None, limit: int) -> tuple[Indices, Indices]:
    """A box of at most `limit` tiles around the place; it moves a quarter at a time, not with every step."""
    rows, columns = (high - low + 1).tolist()
    height = min(rows, max(math.isqrt(limit), limit // columns))
    shape = np.array([height, min(columns, limit // height)])
    middle = 0.5 * (low + high + 1) if place is None else place
    step = np.maximum(shape // 4, 1)
    wanted = (np.floor((middle - 0.5 * shape) / step + 0.5) * step).astype(np.int64)
    start = np.clip(wanted, low, high + 1 - shape)
    return start, start + shape - 1

"""Occupancy grid: integration of range scans, ray casting and coverage, files as nav2's map_saver writes them.

The array's row 0 is the lowest y and its column 0 the lowest x, as in nav_msgs/OccupancyGrid; the image in a file is
upside down against it, as map_saver has it. Cells hold log-odds of being occupied; 0 is unknown.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from estimation.checks import (
    FloatArray,
    as_finite,
    as_floats,
    as_number,
    as_own,
    as_points,
    as_vectors,
    require_positive,
)
from estimation.errors import InputError
from estimation.geometry.grid_kernels import MOST_TILES, TILE, cast_rays, mark_scan, mark_visible

Mask = npt.NDArray[np.bool_]
HIT, MISS, MOST = 0.85, -0.4, 6.0  # log-odds of one look; bound, so that a changed world is believed soon
OCCUPIED_OVER, FREE_BELOW = 0.6, -0.3  # log-odds; one hit is occupied, one look through is free
# Thresholds of the files. 205, the grey of unknown cells, is 0.19608: with map_saver's 0.25 it would be read as free.
OCCUPIED_SHARE, FREE_SHARE = 0.65, 0.196
# Width, height and largest grey, with comments between them.
PGM_HEAD = re.compile(rb"P5" + 3 * rb"(?:\s|#.*\n)+(\d+)" + rb"\s")
MODES = ("trinary", "scale", "raw")
SIGNATURE = "whereabouts"  # in a comment of the files written here
RESOLUTION = 0.05  # metres, edge of a cell
ROOM = 64  # cells of spare room when the grid grows
FARTHEST_CELL = 1e15  # what is beyond is as far: a larger number may not fit into an integer
MOST_CELLS = 1 << 26  # of a grid that grows; `estimation.geometry.tiles` is for what lies far apart
FARTHEST = float(1 << 31)  # cells from the origin


class OccupancyGrid:
    """Square cells of `resolution` metres, axes parallel to those of the map.

    Attributes
    ----------
    resolution : metres. origin : (2,) metres, lower left corner of cell (0, 0).
    log_odds : (H, W) float32, of being occupied; 0 is unknown.

    Parameters
    ----------
    log_odds : (H, W); an empty grid grows as scans are integrated.
    """

    def __init__(
        self,
        resolution: float = RESOLUTION,
        origin: npt.ArrayLike = (0.0, 0.0),
        log_odds: npt.ArrayLike | None = None,
    ) -> None:
        self.resolution = require_positive("resolution", resolution)
        self.origin = as_own("origin", origin, (2,))
        self.log_odds = np.zeros((0, 0), dtype=np.float32)
        if log_odds is not None:
            self.log_odds = as_floats("log_odds", log_odds).astype(np.float32)
        if self.log_odds.ndim != 2 or not np.isfinite(self.log_odds).all():
            raise InputError(
                f"log_odds: finite array (H, W) expected, got one of shape {self.log_odds.shape}"
            )

    @classmethod
    def from_values(
        cls, values: npt.ArrayLike, resolution: float, origin: npt.ArrayLike = (0.0, 0.0)
    ) -> OccupancyGrid:
        """Grid of occupancy values (H, W) as in nav_msgs/OccupancyGrid: 0 free to 100 occupied, -1 unknown.

        Raises InputError: values other than the whole numbers from -1 to 100, or not two-dimensional.
        """
        cells = np.asarray(as_floats("values", values) if not isinstance(values, np.ndarray) else values)
        whole = cells.dtype.kind in "iu" or (
            cells.dtype.kind == "f" and bool((cells == np.rint(cells)).all())
        )
        if cells.ndim != 2 or not whole or (cells.size and (cells.min() < -1 or cells.max() > 100)):
            raise InputError("values: array (H, W) of whole numbers from -1 to 100 expected")
        share = np.clip(np.arange(101), 1, 99) / 100
        # -1 is the last of the table.
        table = np.append(np.log(share / (1.0 - share)), 0.0).astype(np.float32)
        return cls(resolution, origin, table[cells.astype(np.int8, copy=False)])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (y) and columns (x)."""
        return self.log_odds.shape[0], self.log_odds.shape[1]

    @property
    def occupied(self) -> Mask:
        """Cells that are occupied, (H, W)."""
        return self.log_odds > OCCUPIED_OVER

    @property
    def free(self) -> Mask:
        """Cells that are free, (H, W)."""
        return self.log_odds < FREE_BELOW

    @property
    def unknown(self) -> Mask:
        """Cells nothing is known about, or both ways, (H, W)."""
        return ~(self.occupied | self.free)

    def values(self) -> npt.NDArray[np.int8]:
        """Occupancy (H, W) for nav_msgs/OccupancyGrid: 0 free, 100 occupied, -1 unknown."""
        return np.where(self.occupied, 100, np.where(self.free, 0, -1)).astype(np.int8)

    def cells(self, points: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Row and column (..., 2) of points (..., 2), metres; they may lie outside the grid."""
        array = as_vectors("points", points, 2)
        cells = np.clip(np.floor((array - self.origin) / self.resolution), -FARTHEST_CELL, FARTHEST_CELL)
        return cells.astype(np.int64)[..., ::-1]

    def centres(self, cells: npt.ArrayLike) -> FloatArray:
        """Points (..., 2) in the middle of cells (..., 2), row and column."""
        index = as_vectors("cells", cells, 2)[..., ::-1]
        return self.origin + (index + 0.5) * self.resolution

    def inside(self, cells: npt.ArrayLike) -> Mask:
        """Which cells (..., 2) the grid has."""
        index = np.asarray(cells)
        return np.asarray(((index >= 0) & (index < np.array(self.shape))).all(axis=-1))

    def window(self, low: npt.ArrayLike, high: npt.ArrayLike) -> tuple[slice, slice]:
        """Rows and columns of the cells in the box from `low` (2,) to `high` (2,), metres."""
        first, last = np.maximum(self.cells(low), 0), np.maximum(self.cells(high) + 1, 0)
        return slice(int(first[0]), int(last[0])), slice(int(first[1]), int(last[1]))

    def lookup(self, points: npt.ArrayLike) -> FloatArray:
        """Log-odds (...) at points (..., 2); 0 outside the grid."""
        index = self.cells(points)
        known = self.inside(index)
        safe = np.where(known[..., None], index, 0)
        if not self.log_odds.size:
            return np.zeros(index.shape[:-1])
        return np.where(known, self.log_odds[safe[..., 0], safe[..., 1]], 0.0)

    def include(self, low: npt.ArrayLike, high: npt.ArrayLike) -> None:
        """Grow, where needed, so that the box from `low` (2,) to `high` (2,), metres, is inside.

        Raises InputError: the grid would have more than MOST_CELLS cells.
        """
        low_cell, high_cell = self.cells(low), self.cells(high)
        if self.log_odds.size and self.inside(low_cell) and self.inside(high_cell):
            return
        first, last = low_cell - ROOM, high_cell + ROOM
        if self.log_odds.size:
            first, last = np.minimum(first, 0), np.maximum(last, np.array(self.shape) - 1)
        rows, columns = (float(n) for n in last - first + 1)
        if rows * columns > MOST_CELLS:
            raise InputError(f"a grid of {rows:.0f} x {columns:.0f} cells: {MOST_CELLS} at most")
        grown = np.zeros(tuple(last - first + 1), dtype=np.float32)
        height, width = self.shape
        grown[-first[0] : height - first[0], -first[1] : width - first[1]] = self.log_odds if height else 0.0
        self.origin = self.origin + first[::-1] * self.resolution
        self.log_odds = grown

    def integrate(self, pose: npt.ArrayLike, points: npt.ArrayLike, weight: float = 1.0) -> None:
        """Add one scan: its end points are occupied, the way to them is free.

        pose : (3,) x, y, yaw of the sensor in the map. points : (N, 2) returns in the sensor frame, metres.
        weight : 1 for one look; less where looks are not independent. A cell is changed once per scan.
        Raises InputError: wrong shapes, numbers that are not finite, or too far away for a grid that has all in it.
        """
        if as_number("weight", weight) < 0.0:
            raise InputError(f"weight must be at least 0, not {weight!r}")
        start, ends = placed_scan(pose, points, 1.0)
        every = np.vstack((ends, start[None]))
        self.include(every.min(axis=0), every.max(axis=0))
        tiles, marks = mark_scan(
            (start - self.origin) / self.resolution, (ends - self.origin) / self.resolution
        )
        change = np.array([0.0, weight * MISS, weight * HIT])
        for (j, i), mark in zip(tiles * TILE, marks, strict=True):
            cells = self.log_odds[j : j + TILE, i : i + TILE]
            seen = mark[: cells.shape[0], : cells.shape[1]]
            cells[seen > 0] = np.clip(cells + change[seen], -MOST, MOST)[seen > 0]

    def ray_cast(
        self, position: npt.ArrayLike, headings: npt.ArrayLike, max_range: float, through_unknown: bool = True
    ) -> FloatArray:
        """Distance (M,) to the first occupied cell along each heading, metres; inf where there is none.

        position : (2,) metres. headings : (M,) radians in the map frame. max_range : metres.
        through_unknown : whether unknown cells, and those outside the grid, let a ray pass.
        """
        origin = (as_own("position", position, (2,)) - self.origin) / self.resolution
        angles = np.atleast_1d(as_finite("headings", headings))
        if angles.ndim != 1:
            raise InputError(f"headings must have shape (M,), not {angles.shape}")
        reach = require_positive("max_range", max_range) / self.resolution
        cells = cast_rays(
            self.log_odds, origin, angles, reach, OCCUPIED_OVER, FREE_BELOW, bool(through_unknown)
        )
        return cells * self.resolution

    def visible(
        self, pose: npt.ArrayLike, max_range: float, opening: float = 2.0 * math.pi, margin: float = 0.0
    ) -> Mask:
        """Cells (H, W) in view of a sensor: those up to and with the first that is not free.

        pose : (3,) x, y, yaw. max_range : metres. opening : full angle of view, radians.
        margin : metres nearer than which nothing is seen. Union over poses is what a path has covered.
        """
        sensor = as_own("pose", pose, (3,))
        opening = min(require_positive("opening", opening), 2.0 * math.pi)
        if as_number("margin", margin) < 0.0:
            raise InputError(f"margin must be at least 0 m, not {margin!r}")
        seen = np.zeros(self.shape, dtype=np.bool_)
        if seen.size:
            start = (sensor[:2] - self.origin) / self.resolution
            reach = require_positive("max_range", max_range) / self.resolution
            # Half a cell at the end of the longest ray, so that no cell is stepped over.
            count = max(math.ceil(opening * reach * 2.0), 2)
            angles = sensor[2] + np.linspace(-0.5 * opening, 0.5 * opening, count)
            mark_visible(self.log_odds, seen, start, angles, reach, FREE_BELOW, margin / self.resolution)
        return seen

    def save(self, stem: Path | str, replace: Callable[[Path, bytes], None] | None = None) -> Path:
        """Write `stem`.pgm and `stem`.yaml as map_saver does; returns the path of the YAML file.

        replace : writes bytes to a path, atomically for instance; plain writing without it. The image comes first.
        """
        base = Path(stem)
        write = replace or (lambda path, data: path.write_bytes(data))
        image = np.where(self.occupied, 0, np.where(self.free, 254, 205)).astype(np.uint8)[::-1]
        header = f"P5\n# {SIGNATURE} {self.resolution:.3f} m/pix\n{image.shape[1]} {image.shape[0]}\n255\n"
        write(base.with_name(base.name + ".pgm"), header.encode("ascii") + image.tobytes())
        text = (
            f"# {SIGNATURE}\nimage: {base.name}.pgm\nmode: trinary\nresolution: {self.resolution:.6g}\n"
            f"origin: [{self.origin[0]:.6f}, {self.origin[1]:.6f}, 0]\nnegate: 0\n"
            f"occupied_thresh: {OCCUPIED_SHARE}\nfree_thresh: {FREE_SHARE}\n"
        )
        described = base.with_name(base.name + ".yaml")
        write(described, text.encode("utf-8"))
        return described

    @classmethod
    def load(cls, path: Path | str) -> OccupancyGrid:
        """Read a map from its YAML file: a PGM image in the modes trinary, scale and raw of nav2's map_server.

        Raises InputError: the file or its image is missing or malformed, or the map is turned against its axes.
        """
        import yaml

        source = Path(path)
        try:
            about = yaml.safe_load(source.read_text(encoding="utf-8"))
            image = _read_pgm((source.parent / about["image"]).read_bytes())
            resolution, origin = float(about["resolution"]), [float(value) for value in about["origin"]]
            negate, mode = bool(about.get("negate", 0)), about.get("mode", "trinary")
            over, below = float(about["occupied_thresh"]), float(about["free_thresh"])
        except (OSError, LookupError, TypeError, ValueError, ArithmeticError, yaml.YAMLError) as error:
            raise InputError(f"{source}: not a map that can be read: {error!r}") from error
        if len(origin) < 2 or (len(origin) > 2 and origin[2] != 0.0):
            raise InputError(f"{source}: an origin [x, y, 0] is expected, got {origin}")
        share = image / 255.0 if negate else 1.0 - image / 255.0
        if mode not in MODES or not below < over:
            raise InputError(
                f"{source}: a mode of {', '.join(MODES)} and free_thresh below occupied_thresh expected"
            )
        values = _values(share, mode, over, below)
        return cls.from_values(values[::-1], resolution, origin[:2])


def placed_scan(
    pose: npt.ArrayLike, points: npt.ArrayLike, resolution: float
) -> tuple[FloatArray, FloatArray]:
    """A scan's start (2,) and ends (N, 2) in the map, in units of `resolution` metres.

    pose : (3,) x, y, yaw of the sensor in the map. points : (N, 2) returns in the sensor frame, metres.
    Raises InputError: wrong shapes, numbers that are not finite, a place or a width that no grid can have.
    """
    sensor = as_own("pose", pose, (3,))
    found = as_points("points", points, 2)
    c, s = math.cos(sensor[2]), math.sin(sensor[2])
    start = sensor[:2] / resolution
    ends = (sensor[:2] + found @ np.array([[c, s], [-s, c]])) / resolution
    every = np.vstack((ends, start[None]))
    if float(np.abs(every).max()) > FARTHEST:
        raise InputError(f"pose: {float(np.hypot(*sensor[:2])):.3g} m from the origin is too far for a map")
    rows, columns = np.ptp(every, axis=0) / TILE + 2.0
    if rows * columns > MOST_TILES:
        raise InputError("points: the scan is too wide for a map")
    return start, ends


def is_grid_file(path: Path) -> bool:
    """Whether a .pgm or .yaml says of itself that `OccupancyGrid.save` wrote it."""
    try:
        with path.open("rb") as file:
            head = file.read(64)
    except OSError:
        return False
    return head.startswith((f"P5\n# {SIGNATURE} ".encode(), f"# {SIGNATURE}\n".encode()))


def _values(share: FloatArray, mode: str, over: float, below: float) -> FloatArray:
    """Occupancy (H, W), 0 to 100, -1 unknown, of how dark pixels are, in [0, 1]: as nav2's map_server reads them."""
    if mode == "raw":
        grey = np.rint(share * 255.0)
        return np.where(grey <= 100.0, grey, -1.0)
    between = np.rint((share - below) / (over - below) * 100.0) if mode == "scale" else -1.0
    return np.where(share > over, 100.0, np.where(share < below, 0.0, between))


def _read_pgm(data: bytes) -> npt.NDArray[np.float64]:
    """Grey values (H, W) of a binary PGM, top row first. ValueError where it is none."""
    head = PGM_HEAD.match(data)
    if head is None:
        raise ValueError("not a binary PGM (P5)")
    width, height, most = map(int, head.groups())
    if most > 255:
        raise ValueError("two bytes for each pixel")
    pixels = np.frombuffer(data, dtype=np.uint8, count=width * height, offset=head.end())
    return pixels.reshape(height, width).astype(np.float64) * (255.0 / most)

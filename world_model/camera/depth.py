"""What stands in the way: a depth image, or a level laser scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError

ENCODINGS = {"16UC1": (np.uint16, 1e-3), "mono16": (np.uint16, 1e-3), "32FC1": (np.float32, 1.0)}
"""Of depth images: the type of a pixel, and its unit in m."""
FLOOR_NOISE, NOISE = 0.005, 0.003
"""Standard deviation of a depth: m, and m per m² (stereo and structured light alike lose with the square)."""
BINS = 720  # of bearings
FARTHEST = 100.0  # m: a picture of which nothing is nearer is in another unit
FURNITURE = 0.5  # m: what stands on furniture is that far behind the edge that a level scanner meets


@dataclass(frozen=True)
class DepthImage:
    """metres (H, W) : how far ahead of the camera each pixel is; NaN where nobody knows. noise : standard deviation of
    a depth, m per m²: 0.003 of the depth cameras of indoor robots, 0.0008 of stereo with half a metre between the
    lenses, 0 of a lidar."""

    metres: npt.NDArray[np.float32]
    noise: float = NOISE

    @classmethod
    def decoded(
        cls, size: tuple[int, int], encoding: str, data: bytes, step: int = 0, big_endian: bool = False
    ) -> DepthImage:
        """From the fields of a sensor_msgs/Image: size (width, height), 16UC1 in mm or 32FC1 in m; 0 is unknown.

        Raises InputError naming what does not fit.
        """
        if encoding not in ENCODINGS:
            raise InputError(
                f"encoding: {' or '.join(ENCODINGS)} expected of a depth image, got {encoding!r}"
            )
        kind, unit = ENCODINGS[encoding]
        width, height = size
        pixel = np.dtype(kind).newbyteorder(">" if big_endian else "<")
        step = step or width * pixel.itemsize
        if width <= 0 or height <= 0 or step < width * pixel.itemsize:
            raise InputError(
                f"step: at least {width * pixel.itemsize} bytes for {width} x {height} pixels of {encoding} "
                f"expected, got {step}"
            )
        if len(data) < step * height:
            raise InputError(
                f"data: {step * height} bytes for {width} x {height} pixels expected, got {len(data)}"
            )
        rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)
        packed = np.ascontiguousarray(rows[:, : width * pixel.itemsize]).view(pixel)
        metres = packed.astype(np.float32) * np.float32(unit)
        with np.errstate(invalid="ignore"):
            metres[~((metres > 0.0) & np.isfinite(metres))] = np.nan
        nearest = float(np.fmin.reduce(metres, axis=None))
        if nearest > FARTHEST:
            raise InputError(
                f"data: {encoding} in units of {unit:g} m expected, the nearest depth is {nearest:g} m"
            )
        return cls(metres)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        height, width = self.metres.shape
        return width, height

    def sigma(self, metres: FloatArray) -> FloatArray:
        """Standard deviation (N,) m of depths (N,)."""
        return FLOOR_NOISE + self.noise * metres * metres

    def at(self, pixels: FloatArray) -> FloatArray:
        """Depth (N,) m at pixels (N, 2); NaN outside and where it is unknown."""
        height, width = self.metres.shape
        known = np.isfinite(pixels).all(1)
        index = np.zeros(pixels.shape, np.int64)
        index[known] = np.floor(pixels[known] + 0.5)
        known &= (index >= 0).all(1) & (index[:, 0] < width) & (index[:, 1] < height)
        found = np.full(len(pixels), np.nan)
        found[known] = self.metres[index[known, 1], index[known, 0]]
        return found

    def box(
        self, x0: float, y0: float, x1: float, y1: float, most: int = 32
    ) -> tuple[FloatArray, FloatArray]:
        """Known depths (N,) m within a part of the image, and their pixels (N, 2); at most about `most` a side."""
        height, width = self.metres.shape
        x0, y0, x1, y1 = np.clip([x0, y0, x1, y1], -1.0, [width, height, width, height])
        a, b = max(int(np.floor(x0 + 0.5)), 0), min(int(np.floor(x1 + 0.5)) + 1, width)
        c, d = max(int(np.floor(y0 + 0.5)), 0), min(int(np.floor(y1 + 0.5)) + 1, height)
        if a >= b or c >= d:
            return np.zeros(0), np.zeros((0, 2))
        rows, columns = np.arange(c, d, max((d - c) // most, 1)), np.arange(a, b, max((b - a) // most, 1))
        part = self.metres[np.ix_(rows, columns)].astype(np.float64)
        row, column = np.nonzero(np.isfinite(part))
        return part[row, column], np.column_stack([columns[column], rows[row]]).astype(np.float64)


class LevelScan:
    """How far away the nearest upright thing is in each direction around a camera, as a level scanner sees it.

    points (N, 3) : returns of the scanner, m. origin (3,) : the camera, in the same frame, whose z points up. What a
    scanner meets is taken to reach all the way up, and to have things on top of it.
    """

    def __init__(self, points: npt.ArrayLike, origin: npt.ArrayLike) -> None:
        self._origin = np.asarray(origin, dtype=np.float64)
        away = np.asarray(points, dtype=np.float64).reshape(-1, 3)[:, :2] - self._origin[:2]
        self._nearest = np.full(BINS, np.inf)
        np.minimum.at(self._nearest, self._bins(away), np.hypot(*away.T))
        # A bin that no return falls into lies between two that some do.
        beside = np.maximum(np.roll(self._nearest, 1), np.roll(self._nearest, -1))
        self._nearest = np.where(np.isinf(self._nearest), beside, self._nearest)

    @staticmethod
    def _bins(away: FloatArray) -> npt.NDArray[np.int64]:
        bearing = np.arctan2(away[:, 1], away[:, 0])
        return np.floor((bearing / (2.0 * np.pi) + 0.5) * BINS).astype(np.int64) % BINS

    def at(self, points: FloatArray) -> FloatArray:
        """Level distance (N,) m to what stands in the direction of points (N, 3); inf where nothing is known to."""
        return self._nearest[self._bins(points[:, :2] - self._origin[:2])]

    def hides(self, points: FloatArray) -> npt.NDArray[np.bool_]:
        """Which points (N, 3) are behind something."""
        away = np.hypot(*(points[:, :2] - self._origin[:2]).T)
        return np.asarray(self.at(points) < away - FURNITURE)

"""Pixels and directions: a pinhole with distortion, as sensor_msgs/CameraInfo describes it.

Frames are optical ones: x to the right, y down, z ahead. Pixel (0, 0) is the middle of the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_floats, as_own
from estimation.errors import InputError

TERMS = {"": 0, "none": 0, "plumb_bob": 5, "rational_polynomial": 8}
"""Distortion models, and how many of their terms count."""
LARGEST = 1 << 16  # pixels a side
ROUNDS = 30  # of the fixed point that takes distortion back
BEYOND = 1.1
"""How far beyond the corners of the image distortion is believed: its polynomial folds back somewhere farther out."""
WIDEST = 5.0  # m beside the middle, 1 m ahead: no pinhole sees more
NEAREST = 1e-3  # m ahead of the camera


@dataclass(frozen=True)
class CameraModel:
    """A lens. width, height, fx, fy, cx, cy : pixels. distortion (8,) : k1, k2, p1, p2, k3, k4, k5, k6, as OpenCV has
    them. turn (3, 3) : from the frame that tf knows to that of the lens.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: FloatArray = field(default_factory=lambda: np.zeros(8))
    turn: FloatArray = field(default_factory=lambda: np.eye(3))

    @classmethod
    def checked(
        cls,
        size: tuple[int, int],
        k: npt.ArrayLike,
        d: Sequence[float] = (),
        model: str = "",
        r: npt.ArrayLike = (),
        p: npt.ArrayLike = (),
        rectified: bool = False,
    ) -> CameraModel:
        """From the fields of a CameraInfo: size (width, height), K (9,), D, distortion_model, R (9,), P (12,).

        rectified : whether images are straightened; P alone counts then. Raises InputError naming the field.
        """
        width, height = (int(side) for side in as_own("size", size, (2,)))
        if not (0 < width <= LARGEST and 0 < height <= LARGEST):
            raise InputError(f"width and height: 1 to {LARGEST} pixels expected, got {width} x {height}")
        projection = as_floats("p", p)
        if rectified and projection.size == 12 and projection.any():
            matrix, name = projection.reshape(3, 4)[:, :3], "p"
        else:
            matrix, name = _nine(k, "k"), "k"
        fx, fy, cx, cy = float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2])
        if not (np.isfinite([fx, fy, cx, cy]).all() and fx > 0.0 and fy > 0.0):
            raise InputError(
                f"{name}: finite numbers with focal lengths above 0 expected, got fx {fx!r}, fy {fy!r}; "
                "is the camera calibrated?"
            )
        if not (-width < cx < 2 * width and -height < cy < 2 * height):
            raise InputError(
                f"{name}: a centre near the image of {width} x {height} expected, got {cx:g}, {cy:g}"
            )
        if rectified:
            return cls(width, height, fx, fy, cx, cy)
        return cls(width, height, fx, fy, cx, cy, _distortion(d, model), _turn(r))

    def part(self, binning: tuple[int, int] = (1, 1), roi: Sequence[int] = (0, 0, 0, 0)) -> CameraModel:
        """The lens of an image that is a part, roi (x, y, width, height), with pixels put together, binning (x, y).

        Zeros stand for the whole image and for single pixels. Raises InputError for a part outside of the image.
        """
        x, y, width, height = (int(value) for value in roi)
        if width == 0 or height == 0:
            x, y, width, height = 0, 0, self.width, self.height
        if min(x, y) < 0 or x + width > self.width or y + height > self.height:
            raise InputError(
                f"roi: {width} x {height} at {x}, {y} is not inside of {self.width} x {self.height}"
            )
        bx, by = (max(int(b), 1) for b in binning)
        size, focal = (max(width // bx, 1), max(height // by, 1)), (self.fx / bx, self.fy / by)
        centre = (self.cx - x + 0.5) / bx - 0.5, (self.cy - y + 0.5) / by - 0.5
        return CameraModel(*size, *focal, *centre, self.distortion, self.turn)

    def rays(self, pixels: npt.ArrayLike) -> FloatArray:
        """Directions (N, 3) of pixels (N, 2) in the frame that tf knows; not of unit length: as far ahead as 1 m."""
        at = _rows("pixels", pixels, 2)
        seen = (at - (self.cx, self.cy)) / (self.fx, self.fy)
        straight = seen.copy()
        if self.distortion.any():
            for _ in range(ROUNDS):
                radial, shift = _bent(straight, self.distortion)
                with np.errstate(all="ignore"):
                    straight = (seen - shift) / radial[:, None]
                outside = np.hypot(*straight.T) / self._fold
                straight /= np.maximum(outside, 1.0)[:, None]
            # A polynomial that makes no sense bends nothing.
            straight = np.where(np.isfinite(straight), straight, seen)
        return np.column_stack([straight, np.ones(len(at))]) @ self.turn

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels (N, 2) of points (N, 3) m in the frame that tf knows; NaN behind it and far beside the view."""
        local = _rows("points", points, 3) @ self.turn.T
        ahead = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = np.where(ahead[:, None] > NEAREST, local[:, :2] / ahead[:, None], np.nan)
        if self.distortion.any():
            flat[np.hypot(*flat.T) > self._reach] = np.nan
            radial, shift = _bent(flat, self.distortion)
            flat = flat * radial[:, None] + shift
        return flat * (self.fx, self.fy) + (self.cx, self.cy)

    def inside(self, pixels: FloatArray) -> npt.NDArray[np.bool_]:
        """Which pixels (N, 2) are of the image."""
        with np.errstate(invalid="ignore"):
            within = (pixels > -0.5) & (pixels < np.array([self.width - 0.5, self.height - 0.5]))
        return np.asarray(within.all(axis=1))

    @cached_property
    def border(self) -> FloatArray:
        """Directions (N, 3) around the edge of the image."""
        x, y = np.linspace(0.0, self.width - 1.0, 9), np.linspace(0.0, self.height - 1.0, 9)
        edge = [(a, b) for a in x for b in (y[0], y[-1])] + [(a, b) for a in (x[0], x[-1]) for b in y]
        return self.rays(edge)

    @cached_property
    def _reach(self) -> float:
        local = self.border @ self.turn.T
        return float(min(BEYOND * np.hypot(*(local[:, :2] / local[:, 2:]).T).max(), self._fold))

    @cached_property
    def _fold(self) -> float:
        """Distance from the middle, in the plane 1 m ahead, from which on the polynomial leads back in."""
        away = np.linspace(0.0, WIDEST, 1000)
        radial, _ = _bent(np.column_stack([away, np.zeros(1000)]), self.distortion)
        back = np.flatnonzero(np.diff(away * radial) <= 0.0)
        return float(away[back[0]]) if len(back) else np.inf


def _rows(name: str, values: npt.ArrayLike, size: int) -> FloatArray:
    """(N, size) of an array (..., size); empty ones of any shape."""
    rows = as_floats(name, values)
    if rows.size and (rows.ndim == 0 or rows.shape[-1] != size):
        raise InputError(f"{name} must have shape (N, {size}), not {rows.shape}")
    return rows.reshape(-1, size)


def _nine(values: npt.ArrayLike, name: str) -> FloatArray:
    matrix = as_floats(name, values)
    if matrix.size != 9 or not np.isfinite(matrix).all():
        raise InputError(f"{name}: nine finite numbers expected, got {matrix.ravel().tolist()}")
    return matrix.reshape(3, 3)


def _turn(values: npt.ArrayLike) -> FloatArray:
    matrix = as_floats("r", values)
    if matrix.size == 0 or not matrix.any():
        return np.eye(3)
    matrix = _nine(matrix, "r")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-3:
        raise InputError("r: a rotation expected")
    # R leads from the lens to the straightened frame, which is the one that tf knows.
    return matrix.T


def _distortion(d: Sequence[float], model: str) -> FloatArray:
    given = as_floats("d", d).ravel()
    if model not in TERMS and given.any():
        known = ", ".join(name for name in TERMS if name)
        raise InputError(f"distortion_model: one of {known} expected, got {model!r}; use straightened images")
    terms = TERMS.get(model, 0)
    if not np.isfinite(given).all() or (given.any() and len(given) < min(terms, 4)):
        raise InputError(f"d: {terms} finite numbers expected of {model}, got {given.tolist()}")
    if terms == 0 and given.any():
        raise InputError(f"d: nothing expected without a distortion_model, got {given.tolist()}")
    result = np.zeros(8)
    result[: min(terms, len(given))] = given[:terms]
    return result


def _bent(flat: FloatArray, distortion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radial factor (N,) and tangential shift (N, 2) at straight places (N, 2) in the plane 1 m ahead."""
    k1, k2, p1, p2, k3, k4, k5, k6 = distortion
    x, y = flat.T
    square = x * x + y * y
    with np.errstate(all="ignore"):
        radial = (1.0 + square * (k1 + square * (k2 + square * k3))) / (
            1.0 + square * (k4 + square * (k5 + square * k6))
        )
        shift = np.column_stack(
            [2.0 * p1 * x * y + p2 * (square + 2.0 * x * x), p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y]
        )
    return radial, shift

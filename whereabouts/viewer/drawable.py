"""Shapes: what can be drawn, by anything. Positions are metres in the frame their path ends in.

A path is the chain of frames from the map down and then a name, `map/odom/base_link/laser/scan`. A `Place` says how the
frame at its path lies in the one above. A shape replaces the one that was at its path before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Color = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class PlaceShape:
    """A frame: (4, 4), takes its points into the frame above. static : it holds for all times."""

    path: str
    matrix: Array
    static: bool = False


@dataclass(frozen=True, eq=False)
class Points:
    """positions (N, 3); colors one for all or (N, 3) of bytes; radius in m; labels one per point or none."""

    path: str
    positions: Array
    colors: Color | NDArray[np.uint8]
    radius: float = 0.03
    labels: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Lines:
    """Strips of (M, 3) each; width in m; a colour and a label for each strip, or one colour for all and no labels."""

    path: str
    strips: tuple[Array, ...]
    colors: Color | tuple[Color, ...]
    width: float = 0.03
    labels: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Boxes:
    """centers (N, 3) and full sizes (N, 3) along the axes of the frame; a colour and a label for each."""

    path: str
    centers: Array
    sizes: Array
    colors: tuple[Color, ...]
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Value:
    """A number over time."""

    path: str
    value: float


@dataclass(frozen=True)
class TextNote:
    """A sentence at a moment."""

    path: str
    text: str


Shape = PlaceShape | Points | Lines | Boxes | Value | TextNote

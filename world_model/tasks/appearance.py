"""What an object looks like, against what stands where it should be: size and colour (section 3.6)."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from world_model.symbols import Symbols, default_symbols

IntArray = npt.NDArray[np.int64]
GAP = 0.08  # m between returns of one thing at the most
FEWEST = 3  # Returns that make a thing
MOST = 500  # Returns that are looked at; of more, evenly some
BLUR = 0.04  # m: standard deviation of an extent, of noise and of what lies close by
TINTS = {"hue": math.radians(15.0), "saturation": 0.1, "value": 0.15}
"""Standard deviations of a colour by light and camera; hue in radians."""
MISNAMED = 0.05  # Probability that a colour was called otherwise


@dataclass(frozen=True)
class Appearance:
    """size : mean and variance of the diagonal, m and m²; None where it is not known. colors : {name: probability}."""

    size: tuple[float, float] | None = None
    colors: Mapping[str, float] = field(default_factory=dict)
    symbols: Symbols = field(default_factory=default_symbols)

    def log_odds(self, points: FloatArray, colors: FloatArray | None = None) -> float:
        """How much better the object explains the best of the things there than any other object does, nat.

        points (N, 3), m; colors (N, 3), red, green, blue in [0, 1], where they are known. 0 without points.
        """
        step = -(-len(points) // MOST) or 1
        points, colors = points[::step], None if colors is None else colors[::step]
        odds = [
            self._by_size(points[mine]) + (0.0 if colors is None else self._by_color(colors[mine]))
            for mine in things(points)
        ]
        return max(odds, default=0.0)

    def _by_size(self, points: FloatArray) -> float:
        """Sides that are not seen make a thing look smaller, but nothing makes it look larger."""
        if self.size is None:
            return 0.0
        over = float(np.linalg.norm(np.ptp(points, axis=0))) - self.size[0]
        sigma = math.sqrt(self.size[1] + BLUR**2)
        return math.log(max(0.5 * math.erfc(over / (sigma * math.sqrt(2.0))), 1e-6))

    def _by_color(self, colors: FloatArray) -> float:
        names = self.symbols.of_attribute("color")
        if not self.colors or not names:
            return 0.0
        hue, saturation, value = colorsys.rgb_to_hsv(*np.median(colors, axis=0).tolist())
        seen = {"hue": 2.0 * math.pi * hue, "saturation": saturation, "value": value}
        told = {name: (seen[name], sigma**2) for name, sigma in TINTS.items()}
        measured = {name: self.symbols.probability(name, {}, told) for name in names}
        total = sum(measured.values())
        if total <= 0.0:
            return 0.0
        fits = sum(measured[name] * self.colors.get(name, 0.0) for name in names) / total
        return math.log((1.0 - MISNAMED) * fits * len(names) + MISNAMED)


def things(points: FloatArray) -> list[IntArray]:
    """Indices of the returns (N, 3) of each thing: those that hang together."""
    if not len(points):
        return []
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(points), GAP, output_type="coo_matrix")
    count, labels = connected_components(pairs, directed=False)
    found = [np.flatnonzero(labels == label) for label in range(count)]
    return [mine for mine in found if len(mine) >= min(FEWEST, len(points))]

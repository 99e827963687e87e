"""What two-dimensional registration takes: a scan or a point set, made ready to be source and target."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.errors import InputError
from registration.consistency import View, view_of
from registration.refine import Target, target_of
from registration.scan import Scan
from registration.surface import Surface, points_surface, scan_surface

NOISE = 0.01  # metres, standard deviation of a range until the data show their own


@dataclass(frozen=True)
class Outline:
    """A scan or point set ready for registration: its lines, their hash, and what its sensor saw through."""

    surface: Surface
    target: Target
    view: View

    @property
    def length(self) -> float:
        """Metres of outline."""
        return float(self.surface.length.sum())

    def without(self, dropped: NDArray[np.bool_]) -> Outline:
        """The same, with the lines of `dropped` (N,) points ignored."""
        surface, target = self.surface, self.target
        tilt = np.where(dropped, np.inf, surface.tilt)
        normals = np.where(dropped[:, None], 0.0, surface.normals)
        bare = replace(surface, normals=normals, tilt=tilt)
        hidden = replace(target, normals=normals, tilt=tilt)
        return Outline(bare, hidden, self.view)


def outline_of(name: str, measurement: Scan | ArrayLike) -> Outline:
    """Outline of a `Scan` or of points (N, 2) metres; `name` is the argument an InputError speaks of."""
    if isinstance(measurement, Scan):
        surface = scan_surface(measurement, NOISE)
        return Outline(surface, target_of(surface), view_of(measurement))
    points = np.asarray(measurement, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"{name}: Scan or array (N, 2) or (N, 3) expected, got shape {points.shape}")
    surface = points_surface(points[np.isfinite(points).all(axis=1)], NOISE)
    return Outline(surface, target_of(surface), view_of(None))

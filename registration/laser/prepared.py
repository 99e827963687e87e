"""A scan prepared once: what odometry, closures, movers and people all start from.

End points with the line their neighbours lie on and the connected piece they belong to (`Surface`), what the sensor
saw in each direction (`View`), and, when something is to be laid on it, the hash of its lines (`Target`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.checks import FloatArray, as_floats
from estimation.errors import InputError
from estimation.geometry.sight import sight
from registration.laser.scan import Scan
from registration.laser.surface import Surface, points_surface, scan_surface
from registration.laser.target_lines import TargetLines, target_of

DENSE = 0.02  # metres; with more points, the neighbours of a point lie within their noise
NOISE = 0.01  # metres, standard deviation of a range until the data show their own


@dataclass(frozen=True)
class ScanView:
    """What a scan saw in each direction: ranges (B,) with inf where nothing came back; none for a point set."""

    ranges: FloatArray
    angle_min: float
    step: float

    def sight(self, points: FloatArray, pose: FloatArray, doubt: float) -> NDArray[np.int8]:
        """What the scan, taken at `pose` (3,), says about `points` (N, 2): labels of `geometry.sight`, (N,)."""
        return sight(points, pose, doubt, self.ranges, self.angle_min, self.step)


NOTHING_SEEN = ScanView(np.zeros(0), 0.0, 1.0)


def view_of(scan: Scan) -> ScanView:
    """View of a scan."""
    return ScanView(np.where(scan.valid, scan.ranges, np.inf), scan.angle_min, scan.angle_increment)


@dataclass(frozen=True)
class PreparedScan:
    """A scan or point set ready for registration, sensor frame: its lines and what its sensor saw through."""

    surface: Surface
    view: ScanView

    @cached_property
    def target(self) -> TargetLines:
        """The lines as the target of a registration."""
        return target_of(self.surface)

    @property
    def length(self) -> float:
        """Metres of outline."""
        return float(self.surface.length.sum())

    def without(self, dropped: NDArray[np.bool_]) -> PreparedScan:
        """The same, with the lines of `dropped` (N,) points ignored."""
        tilt = np.where(dropped, np.inf, self.surface.tilt)
        normals = np.where(dropped[:, None], 0.0, self.surface.normals)
        rest = PreparedScan(replace(self.surface, normals=normals, tilt=tilt), self.view)
        # The points stay where they are in the hash; without a normal none of them is found.
        rest.__dict__["target"] = replace(self.target, normals=normals, tilt=tilt)
        return rest


def prepare_scan(scan: Scan, max_range: float = np.inf) -> PreparedScan:
    """A scan ready for registration; points beyond `max_range` metres are not used."""
    return PreparedScan(scan_surface(scan, NOISE, max_range), view_of(scan))


def prepare(name: str, measurement: Scan | ArrayLike) -> PreparedScan:
    """A `Scan` or points (N, 2) metres ready for registration.

    name : the argument an error speaks of.

    Raises
    ------
    InputError : an array of another shape.
    """
    if isinstance(measurement, Scan):
        return prepare_scan(measurement)
    points = as_floats(name, measurement)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"{name}: Scan or array (N, 2) or (N, 3) expected, got shape {points.shape}")
    return PreparedScan(points_surface(_outline(points), NOISE), NOTHING_SEEN)


def _outline(points: FloatArray) -> FloatArray:
    """Finite points (M, 2) around the sensor, as a scan has them, one of each cell of `DENSE`, of points (N, 2).

    Whose residuals lean together is told by who is next to whom; and millions of points say no more than thousands.
    """
    finite = points[np.isfinite(points).all(axis=1)]
    # One number each is sorted in a tenth of the time.
    cells = np.floor(finite / DENSE).view(np.complex128)[:, 0]
    _, first = np.unique(cells, return_index=True)
    kept = finite[np.sort(first)]
    return kept[np.argsort(np.arctan2(kept[:, 1], kept[:, 0]), kind="stable")]


Of = TypeVar("Of")
Made = TypeVar("Made")


def once(make: Callable[[Of], Made]) -> Callable[[Of], Made]:
    """`make`, asked once in the life of a scan, which is compared with several others; not to be written to."""
    known: WeakKeyDictionary[Of, Made] = WeakKeyDictionary()

    @wraps(make)
    def made(scan: Of) -> Made:
        if scan not in known:
            known[scan] = make(scan)
        return known[scan]

    return made


@once
def prepared(scan: Scan) -> PreparedScan:
    """`PreparedScan` of a scan."""
    return prepare_scan(scan)

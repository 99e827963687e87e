"""Rotation-invariant features of one laser scan or point cloud: App. A.A of Paper A.

    place = features_2d(scan, max_range=50.0)
    place.values        (35,) features 1 to 35 in the order of App. A.A.1
    place.histograms    features 36 to 44: range histograms in bins of 0.1 to 3 m

Two places are compared by `loop_closure.pair_features`. The definitions are in `loop_closure.places.definitions`.

Scans. A no-return (NaN, infinite, outside [range_min, range_max)) and a range beyond `max_range` are points at
`max_range` in the direction of their beam: both are counted by feature 13 and both are full measurements to
feature 1. Order of acquisition is by increasing bearing, so a scanner mounted upside down changes nothing. In a full
circle the last beam is followed by the first; otherwise turning the scanner would change the features.

Clouds. A row that is not finite, or at the origin, is a no-return of unknown direction: it is a range of `max_range`
to every feature of ranges (1, 4, 6, 13, 22 to 24, 27, 28, the histograms), no point to those of positions. A driver
that leaves no-returns out of its clouds hides them from features 1 and 13. The order of the rows stands for the order
of acquisition, as drivers publish it; `scan_order` makes one for a cloud that has lost it. There is no last row
followed by the first: a cloud has many rings, and one step more or less among its points is nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numba
import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_floats, require_kind, require_positive
from estimation.errors import InputError
from loop_closure.places import definitions as define
from loop_closure.places.outlines import Outline, outline_of_scan
from loop_closure.places.signatures import outline_signature, range_quantiles
from registration.laser.scan import Scan

# Table 7.
BIN_WIDTHS = (0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0)
DISTANCE_GATE = 2.5
GROUP_MINIMUM = 3
RANGE_GATES = (1.0, 0.75, 0.5)
SCALARS_2D, SCALARS_3D = 35, 32


@dataclass(frozen=True, eq=False)
class PlaceFeatures:
    """What is kept of a scan or cloud to recognise its place.

    Parameters
    ----------
    values : (35,) in 2D or (32,) in 3D, the scalar features; units as in `loop_closure.places.definitions`.
    histograms : 9 arrays of counts, one per width of BIN_WIDTHS.
    max_range : r_max they were computed with, metres. Only places of equal r_max can be compared.
    outline : walls and free floor around the place, for models that look further than the text's features; None of a
        cloud.

    Raises
    ------
    InputError : values or histograms not one-dimensional or not finite, max_range not above 0.
    """

    values: FloatArray
    histograms: tuple[FloatArray, ...]
    max_range: float
    outline: Outline | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "max_range", require_positive("max_range", self.max_range))
        object.__setattr__(self, "values", _vector("values", self.values))
        object.__setattr__(self, "histograms", tuple(_vector("histograms", h) for h in self.histograms))

    @cached_property
    def profile(self) -> npt.NDArray[np.float32]:
        """The histograms standardised, so that a correlation coefficient is a dot product: (W,) single precision.

        Each is followed by one more entry, 1 for a constant histogram and 0 for any other. The correlation with a
        constant is undefined; by this entry it is 1 between two constants and 0 between a constant and another.
        """
        parts = []
        for histogram in self.histograms:
            centred = histogram - histogram.mean()
            flat = histogram.min() == histogram.max()
            parts.append(np.zeros_like(centred) if flat else centred / np.sqrt(centred @ centred))
            parts.append(np.array([float(flat)]))
        return np.concatenate(parts).astype(np.float32) if parts else np.zeros(0, dtype=np.float32)

    @cached_property
    def signature(self) -> npt.NDArray[np.float32]:
        """What `places.signatures` makes of it: (108,) with an outline; of a cloud (56,), with its scalars."""
        parts = [range_quantiles(self.histograms[0], self.max_range / len(self.histograms[0]))]
        if self.outline is None:
            parts.append(np.log(np.abs(self.values) + 1e-3))
        else:
            parts.append(outline_signature(self.outline))
        return np.concatenate(parts).astype(np.float32)


def _vector(name: str, value: npt.ArrayLike) -> FloatArray:
    array = as_finite(name, value)
    if array.ndim != 1 or array.size == 0:
        raise InputError(f"{name}: non-empty one-dimensional array expected, got shape {array.shape}")
    return array


def features_2d(scan: Scan, max_range: float, outline: Outline | None = None) -> PlaceFeatures:
    """The 35 scalar features and 9 range histograms of a planar scan, App. A.A.1, and its outline.

    A scan of no-returns only has features as well: those of nothing are 0. `outline` replaces that of the scan, such
    as by `LocalMap.outline()`.

    Raises
    ------
    InputError : a scan without beams, or max_range (metres) not above 0.
    """
    require_kind("scan", scan, Scan)
    limit = require_positive("max_range", max_range)
    count = len(scan)
    if count == 0:
        raise InputError("scan: at least one beam expected")
    r = np.where(scan.valid, np.minimum(scan.ranges, limit), limit)
    bearings, step = scan.bearings, abs(scan.angle_increment)
    if scan.angle_increment < 0.0:
        r, bearings = r[::-1].copy(), bearings[::-1]
    P = np.column_stack((r * np.cos(bearings), r * np.sin(bearings), np.zeros(count)))
    full_circle = count >= 3 and count * step >= 2.0 * np.pi - 0.5 * step
    multiples, starts = _bins(limit)
    values, counts = _describe_2d(r, P, full_circle, limit, multiples, starts)
    outline = outline_of_scan(scan) if outline is None else outline
    return PlaceFeatures(values, tuple(np.split(counts, starts[1:-1])), limit, outline)


def features_3d(points: npt.ArrayLike, max_range: float) -> PlaceFeatures:
    """The 32 scalar features and 9 range histograms of a point cloud (N, 3) in the sensor frame, App. A.A.2.

    Metres, rows in order of acquisition (see the module); non-finite rows are no-returns. A cloud of no-returns only
    has features as well: those of nothing are 0.

    Raises
    ------
    InputError : no rows, another shape than (N, 3), or max_range (metres) not above 0.
    """
    limit = require_positive("max_range", max_range)
    cloud = as_floats("points", points)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) == 0:
        raise InputError(f"points must have shape (N, 3) with N at least 1, not {cloud.shape}")
    multiples, starts = _bins(limit)
    values, counts = _describe_3d(np.ascontiguousarray(cloud), limit, multiples, starts)
    return PlaceFeatures(values, tuple(np.split(counts, starts[1:-1])), limit)


def scan_order(points: npt.ArrayLike, ring: float = 0.01) -> FloatArray:
    """A cloud (N, 3) that lost its order, in one a spinning scanner might have: ring by ring, by azimuth within.

    `ring` is the height of a ring in radians of elevation. Turning the cloud about the vertical axis moves only where
    each ring begins; about another axis it changes the order. Non-finite rows come last.
    """
    cloud = as_floats("points", points)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise InputError(f"points must have shape (N, 3), not {cloud.shape}")
    elevation = np.arctan2(cloud[:, 2], np.hypot(cloud[:, 0], cloud[:, 1]))
    azimuth = np.arctan2(cloud[:, 1], cloud[:, 0])
    return cloud[np.lexsort((azimuth, np.floor(elevation / require_positive("ring", ring))))]


@cache
def _bins(limit: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Bin widths as multiples of 5 cm, (9,), and where each of the histograms up to `limit` begins, (10,)."""
    widths = np.array(BIN_WIDTHS)
    # 50 / 0.1 must be 500 bins, whatever its last digit.
    counts = np.maximum(np.ceil(limit / widths - 1e-9), 1).astype(np.int64)
    return np.rint(widths * define.BINS_PER_METRE).astype(np.int64), np.concatenate(([0], np.cumsum(counts)))


@numba.njit(cache=True)
def _common(r, P, steps, limit, power):  # type: ignore[no-untyped-def]
    """Features 1 to 32: the same in 2D (power 2) and 3D (power 3)."""
    f = np.empty(SCALARS_3D)
    below = define.returns(r, limit)
    f[0], f[1] = define.content(r, limit, power), define.content(below, limit, power)
    f[2], f[3], f[4], f[5] = define.range_statistics(r, below, limit)
    f[6], f[7], f[8] = define.circularity(P, limit)
    f[9], f[10], f[11] = define.centroid(r, P, limit)
    f[12], f[13] = define.maximum_range(r, limit)
    f[14], f[15], f[16], f[17] = define.distance_and_regularity(r, steps, limit, DISTANCE_GATE)
    f[18], f[19] = define.curvature(r, P, steps, limit, DISTANCE_GATE)
    f[20], f[21] = define.kurtosis(below, limit), define.kurtosis(r, limit)
    f[22], f[23], f[24], f[25] = define.relative_range(r, steps, limit)
    for k in range(3):
        f[26 + 2 * k], f[27 + 2 * k] = define.range_difference(r, steps, RANGE_GATES[k] * limit)
    return f


@numba.njit(cache=True)
def _steps(P, full_circle):  # type: ignore[no-untyped-def]
    """Distance of each point (N, 3) to the next, (N,) in a full circle, else (N - 1,)."""
    n = len(P)
    steps = np.empty(n if full_circle else n - 1)
    for i in range(len(steps)):
        after = i + 1 if i + 1 < n else 0
        x, y, z = P[after, 0] - P[i, 0], P[after, 1] - P[i, 1], P[after, 2] - P[i, 2]
        steps[i] = np.sqrt(x * x + y * y + z * z)
    return steps


@numba.njit(cache=True)
def _describe_2d(r, P, full_circle, limit, multiples, starts):  # type: ignore[no-untyped-def]
    """Scalar features (35,) and concatenated histograms of ranges (N,) at positions (N, 3)."""
    steps = _steps(P, full_circle)
    values = np.empty(SCALARS_2D)
    common = _common(r, P, steps, limit, 2)
    for k in range(SCALARS_3D):
        values[k] = common[k]
    values[32], values[33] = define.groups(r, steps, DISTANCE_GATE, GROUP_MINIMUM)
    values[34] = define.angular_difference(r, P, steps, limit)
    return values, define.range_histograms(r, multiples, starts)


@numba.njit(cache=True)
def _describe_3d(points, limit, multiples, starts):  # type: ignore[no-untyped-def]
    """Scalar features (32,) and concatenated histograms of a cloud (N, 3)."""
    n = len(points)
    r, P = np.empty(n), np.empty((n, 3))
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        if not 0.0 < distance < np.inf:
            r[i] = limit
            P[i, :] = np.nan
            continue
        r[i] = min(distance, limit)
        scale = limit / distance if distance > limit else 1.0
        P[i, 0], P[i, 1], P[i, 2] = scale * x, scale * y, scale * z
    values = _common(r, P, _steps(P, False), limit, 3)
    return values, define.range_histograms(r, multiples, starts)

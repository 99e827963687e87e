"""Is the object where it should be? Looking into a region of interest (section 3.6).

Points inside the region speak for it; a region that was seen through and is empty speaks against it; a region behind
something else says nothing. Several frames are looked at, so that one bad frame decides nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from estimation.checks import FloatArray, as_vectors, require_count
from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.rotations import wrap_angle
from estimation.geometry.sight import AGREES, THROUGH, sight
from world_model.tasks.appearance import Appearance

CELLS = 9  # probes along each side of a region
PROBE = 0.02  # m, standard deviation of a probe: the map and the sensor's place in it
MARGIN = 0.1  # m in front of a probe that a return of a cloud may be and still show it
MAPPED = 0.15  # m around what the map has occupied that belongs to the map
BEHIND = 0.3  # m: what a cloud shows this near to a probe's direction decides about it
GAP = math.radians(15.0)  # between returns of a sensor that turns; beyond it may not look there
UNLIKE = math.log(0.1)  # log odds of the appearance below which what is there is something else
OCCLUDED, FOUND, NOT_FOUND = "occluded", "found", "not_found"


@dataclass(frozen=True)
class RegionBox:
    """A region: centre (3,) and size (3,) m, along the axes of the map.

    Raises InputError: a size that is not positive.
    """

    centre: FloatArray
    size: FloatArray

    def __post_init__(self) -> None:
        centre, size = as_vectors("centre", self.centre, 3), as_vectors("size", self.size, 3)
        if not (size > 0.0).all():
            raise InputError(f"region: a size above 0 along every axis expected, got {size.tolist()}")
        object.__setattr__(self, "centre", centre)
        object.__setattr__(self, "size", size)

    def contains(self, points: FloatArray) -> npt.NDArray[np.bool_]:
        """Which points (N, 3) are inside."""
        return np.asarray((np.abs(points - self.centre) <= 0.5 * self.size).all(axis=1))

    def probes(self) -> FloatArray:
        """(CELLS², 2) places spread over its floor."""
        ticks = np.linspace(-0.5, 0.5, CELLS)
        x, y = np.meshgrid(ticks * self.size[0], ticks * self.size[1])
        return np.stack([x.ravel(), y.ravel()], axis=1) + self.centre[:2]


@dataclass(frozen=True)
class Frame:
    """What one scan or cloud says about a region: points (N, 3) inside it, share of it that was seen, and
    colours (N, 3), red, green, blue in [0, 1], where they are known."""

    points: FloatArray
    visible: float
    colors: FloatArray | None = None


def look_with_scan(
    box: RegionBox,
    ranges: npt.ArrayLike,
    angle_min: float,
    angle_increment: float,
    range_max: float,
    sensor: npt.ArrayLike,
) -> Frame:
    """One planar scan.

    ranges : (B,) m, no-returns as inf, NaN or at least range_max. sensor : (4, 4) pose of the level scanner in the map.
    """
    pose = np.asarray(sensor, dtype=np.float64)
    height = float(pose[2, 3])
    low, high = box.centre[2] - 0.5 * box.size[2], box.centre[2] + 0.5 * box.size[2]
    measured = np.asarray(ranges, dtype=np.float64)
    if not low <= height <= high or not len(measured):
        return Frame(np.zeros((0, 3)), 0.0)
    # A scanner that hangs upside down sweeps the other way.
    sign = 1.0 if pose[2, 2] > 0.0 else -1.0
    first, step = sign * angle_min, sign * angle_increment
    place = np.array([pose[0, 3], pose[1, 3], math.atan2(pose[1, 0], pose[0, 0])])
    returned = np.isfinite(measured) & (measured < range_max) & (measured > 0.0)
    # Nothing came back: free as far as the sensor reaches. NaN tells nothing.
    seen = np.where(returned, measured, np.where(np.isnan(measured), np.inf, range_max))
    labels = sight(box.probes(), place, PROBE, seen, first, step)
    bearings = place[2] + first + step * np.flatnonzero(returned)
    ends = place[:2] + measured[returned, None] * np.column_stack((np.cos(bearings), np.sin(bearings)))
    points = np.column_stack((ends, np.full(len(ends), height)))
    visible = (labels == AGREES) | (labels == THROUGH)
    return Frame(points[box.contains(points)], float(visible.mean()))


def look_with_cloud(
    box: RegionBox,
    points: npt.ArrayLike,
    sensor: npt.ArrayLike,
    range_max: float,
    colors: FloatArray | None = None,
) -> Frame:
    """One cloud, points (N, 3) in the map, with colours (N, 3); sensor : (4, 4) its pose in the map."""
    cloud, pose = np.asarray(points, dtype=np.float64).reshape(-1, 3), np.asarray(sensor, dtype=np.float64)
    position = pose[:3, 3]
    # A return without a direction is none, as invalid pixels are sent.
    some = np.isfinite(cloud).all(axis=1) & (np.abs(cloud - position).max(axis=1, initial=0.0) > 1e-6)
    cloud, colors = cloud[some], None if colors is None else colors[some]
    mine = box.contains(cloud)
    inside, tints = cloud[mine], None if colors is None else colors[mine]
    if not len(cloud):
        return Frame(inside, 0.0, tints)
    probes = np.column_stack([box.probes(), np.full(CELLS * CELLS, box.centre[2])])
    offsets = probes - position
    away = np.linalg.norm(offsets, axis=1)
    rays = cloud - position
    lengths = np.linalg.norm(rays, axis=1)
    directions = rays / np.maximum(lengths, 1e-9)[:, None]
    bearings = offsets / np.maximum(away, 1e-9)[:, None]
    looked = _looked_along(directions @ pose[:3, :3], bearings @ pose[:3, :3])
    seen = 0
    for bearing, distance, in_view in zip(bearings, away, looked, strict=True):
        if distance > range_max:
            continue
        near = directions @ bearing > math.cos(math.atan2(0.5 * BEHIND, distance))
        # Nothing came back from there though the sensor looks there, or something at the probe or behind it.
        seen += float(np.median(lengths[near])) >= distance - MARGIN if near.any() else bool(in_view)
    return Frame(inside, seen / len(probes), tints)


def _looked_along(returned: FloatArray, bearings: FloatArray) -> npt.NDArray[np.bool_]:
    """Which `bearings` (M, 3) a sensor looks along that has returns along others (N, 3), unit vectors in its frame.

    A sensor that looks ahead sees what lies within the outline of its returns. One that turns about its z axis sees
    what lies between its highest and its lowest, less than GAP to the side of one.
    """
    ahead = returned.mean(axis=0)
    if (returned @ ahead).min() > 0.0:
        basis = np.linalg.svd(ahead[None])[2]  # the first row is along `ahead`
        basis[0] = ahead / np.linalg.norm(ahead)
        (depth, *across), (far, *aside) = (basis @ returned.T), (basis @ bearings.T)
        try:
            edges = ConvexHull((np.array(across) / depth).T).equations
        except QhullError:  # too few, or all in one line
            return np.zeros(len(bearings), dtype=np.bool_)
        spots = np.array(aside) / np.where(far > 0.0, far, np.nan)
        return np.asarray((edges[:, :2] @ spots + edges[:, 2:] <= 0.0).all(axis=0))
    turns, turn = (np.arctan2(each[:, 1], each[:, 0]) for each in (returned, bearings))
    order = np.sort(turns)
    place = np.searchsorted(order, turn)
    beside = np.abs(wrap_angle(np.stack([order[place - 1], order[place % len(order)]]) - turn)).min(axis=0)
    low, high = returned[:, 2].min(), returned[:, 2].max()
    return np.asarray((bearings[:, 2] >= low) & (bearings[:, 2] <= high) & (beside < GAP))


@dataclass
class Verification:
    """Collects frames until it can tell.

    needed : frames that must agree. points : returns inside the region that are an object. clear : share of the region
    that must have been seen for it to be empty. grid : returns at what the map has occupied anyway do not count.
    widest : m, of a region in which a return can be taken for the object; in a wider one it may be anything, which says
    nothing. appearance : what the object looks like; where something else is seen in its place, it is not found.
    """

    box: RegionBox
    needed: int = 3
    points: int = 3
    clear: float = 0.8
    grid: OccupancyGrid | None = None
    widest: float = 1.5
    appearance: Appearance | None = None
    frames: int = 0
    visible: float = 0.0
    _hits: list[FloatArray] = field(default_factory=list)
    _likeness: list[float] = field(default_factory=list)
    _empty: int = 0

    def __post_init__(self) -> None:
        self.needed = require_count("needed", self.needed)
        self.points = require_count("points", self.points)

    def take(self, frame: Frame) -> str | None:
        """Add a frame; "found", "not_found", "occluded" where it never will, or None while it cannot tell."""
        self.frames += 1
        self.visible = max(self.visible, frame.visible)
        points, colors = frame.points, frame.colors
        if self.grid is not None and len(points):
            free = ~self._mapped(points[:, :2])
            points, colors = points[free], None if colors is None else colors[free]
        if len(points) >= self.points:
            self._hits.append(points)
            self._likeness.append(
                0.0 if self.appearance is None else self.appearance.log_odds(points, colors)
            )
        elif frame.visible >= self.clear:
            self._empty += 1
        if len(self._hits) >= self.needed:
            return self._seen_something()
        return NOT_FOUND if self._empty >= self.needed else None

    def outcome(self) -> str:
        """What is to be said when time is up: nothing, unless most frames agree."""
        if len(self._hits) > self._empty:
            return self._seen_something()
        return OCCLUDED

    def _seen_something(self) -> str:
        if self.box.size[:2].max() > self.widest:
            return OCCLUDED
        return FOUND if float(np.median(self._likeness)) > UNLIKE else NOT_FOUND

    def measurement(self, sigma: float) -> tuple[FloatArray, FloatArray]:
        """Position (3,) of the object and its covariance (3, 3), m and m²; sigma : m, of one look per axis."""
        centres = np.array([points.mean(axis=0) for points in self._hits])
        position = centres.mean(axis=0)
        spread = np.concatenate(self._hits).std(axis=0)
        # The side that is seen is not the middle: half the extent is uncertain along each axis.
        covariance = np.diag(sigma**2 + (0.5 * spread) ** 2)
        covariance[2, 2] = max(covariance[2, 2], (0.25 * self.box.size[2]) ** 2)
        position[2] = self.box.centre[2]
        return position, covariance

    def _mapped(self, points: FloatArray) -> npt.NDArray[np.bool_]:
        """Which points (N, 2) are at what the map has occupied."""
        assert self.grid is not None
        steps = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)]) * MAPPED
        around = points[:, None] + steps[None]
        return np.asarray((self.grid.lookup(around) > 0.6).any(axis=1))

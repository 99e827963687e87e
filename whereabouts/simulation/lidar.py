"""A planar laser scanner in a simulated world: noise, dropouts, maximum range, motion during the sweep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from registration import Scan
from whereabouts.simulation.rays import cast
from whereabouts.simulation.shapes import Array, Shapes


@dataclass(frozen=True)
class SimulatedScan:
    """A scan and the truth about it.

    pose : (3,) x, y, yaw of the sensor in the world at the scan's stamp.
    owners : (N,) of what each beam hit: 0 building, movers from 1, -1 nothing or lost.
    """

    scan: Scan
    pose: Array
    owners: NDArray[np.int64]


@dataclass(frozen=True)
class Lidar:
    """A planar scanner.

    beams : number of beams. opening : radians from first to last beam, centred on straight ahead.
    range_min, range_max : metres. sigma : standard deviation of a range, metres.
    resolution : ranges are rounded to this, metres, 0 for none. dropout : share of the beams that return
    nothing. sweep_time : seconds from first to last beam. mixed : share of the beams at an edge that meet both the
    nearer and the farther side, and return somewhere in between. posts : metres to four posts of the robot that
    carries it, 12 degrees wide and a quarter of a turn apart, 0 for none.
    """

    beams: int = 361
    opening: float = np.pi
    range_min: float = 0.05
    range_max: float = 30.0
    sigma: float = 0.01
    resolution: float = 0.0
    dropout: float = 0.0
    sweep_time: float = 0.0
    mixed: float = 0.0
    posts: float = 0.0

    @property
    def bearings(self) -> Array:
        """(beams,) radians."""
        return -0.5 * self.opening + self.opening / (self.beams - 1) * np.arange(self.beams, dtype=np.float64)

    @property
    def on_posts(self) -> NDArray[np.bool_]:
        """(beams,) whether a beam's way is that of a post."""
        quarter = 0.5 * np.pi
        off = (self.bearings + 0.5 * quarter) % quarter
        return np.minimum(off, quarter - off) < np.deg2rad(6.0)

    def scan(
        self,
        shapes: Shapes,
        pose: ArrayLike | Callable[[float], Array],
        rng: np.random.Generator,
        stamp: float = 0.0,
    ) -> SimulatedScan:
        """One sweep through `shapes`.

        pose : (3,) x, y, yaw of the sensor, or a function of time that gives it; with a function each beam
            is measured from where the sensor is at that beam's time. Movers stand still during a sweep.
        """
        step = self.sweep_time / (self.beams - 1)
        if callable(pose):
            poses = np.array([pose(stamp + step * beam) for beam in range(self.beams)])
        else:
            poses = np.broadcast_to(np.asarray(pose, dtype=np.float64), (self.beams, 3))
        ranges, owners = cast(shapes, poses[:, :2], poses[:, 2] + self.bearings, self.range_max)
        if self.mixed:
            ranges = self._mixed(ranges, rng)
        if self.posts:
            ranges = np.where(self.on_posts, self.posts, ranges)
        ranges = ranges + self.sigma * rng.standard_normal(self.beams)
        if self.resolution:
            ranges = np.round(ranges / self.resolution) * self.resolution
        lost = rng.random(self.beams) < self.dropout
        # A scanner answers with its maximum where nothing comes back.
        gone = lost | ~np.isfinite(ranges) | (ranges < self.range_min) | (ranges >= self.range_max)
        ranges[gone] = self.range_max
        scan = Scan(
            ranges,
            -0.5 * self.opening,
            self.opening / (self.beams - 1),
            self.range_min,
            self.range_max,
            stamp,
            step,
        )
        return SimulatedScan(
            scan, poses[0].copy(), np.where(gone | (self.on_posts & (self.posts > 0.0)), -1, owners)
        )

    def _mixed(self, ranges: Array, rng: np.random.Generator) -> Array:
        """Ranges (N,) m, of which some beside an edge of 0.1 to 2 m lie between its two sides."""
        beside = np.roll(ranges, -1)
        with np.errstate(invalid="ignore"):
            jump = np.abs(beside - ranges)
        # The first and the last beam are no neighbours.
        edge = (jump > 0.1) & (jump < 2.0) & (np.arange(self.beams) < self.beams - 1)
        edge &= rng.random(self.beams) < self.mixed
        share = rng.random(self.beams)
        return ranges + share * (np.where(edge, beside, 0.0) - np.where(edge, ranges, 0.0))

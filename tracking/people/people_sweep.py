"""A scan in the frame of the tracks, each beam from where the scanner was when it was sent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import minimum_filter1d

from estimation.checks import FloatArray
from estimation.geometry.poses import wrap_angle
from registration.laser.scan import Scan
from registration.laser.sweep import beam_shares

BESIDE = 2  # beams to either side
FASTEST = 3.0  # m/s and rad/s; a pose that changes faster has jumped


@dataclass(frozen=True)
class Sweep:
    """Origins (N, 2) m, angles (N,) rad and ranges (N,) m, inf without return, of the beams in the frame of the tracks.

    bearings : (N,) rad, of the beams in the frame of the scanner. clear : (N,) m up to which a beam met nothing, 0
    where it says nothing: its range, or all the scanner's for a return too far away to be measured (that or +inf). One
    of these among returns was lost: it went no farther than they.
    """

    origins: FloatArray
    angles: FloatArray
    ranges: FloatArray
    bearings: FloatArray
    clear: FloatArray

    @classmethod
    def of(cls, scan: Scan, pose: FloatArray, before: FloatArray | None, dt: float) -> Sweep:
        """The sweep of a scanner at `pose` (3,) that was at `before` `dt` seconds ago and goes on like that."""
        share = np.zeros(len(scan))
        motion = np.zeros(3) if before is None else pose - before
        motion[2] = wrap_angle(motion[2])
        if np.hypot(motion[0], motion[1]) < FASTEST * dt and abs(motion[2]) < FASTEST * dt:
            share = beam_shares(scan, dt)
        ranges = np.where(scan.valid, scan.ranges, np.inf)
        beside = minimum_filter1d(ranges, 2 * BESIDE + 1, mode="nearest")
        unmet = np.where(scan.ranges >= scan.range_max, np.minimum(beside, scan.range_max), 0.0)
        return cls(
            pose[:2] + share[:, None] * motion[:2],
            scan.bearings + pose[2] + share * motion[2],
            ranges,
            scan.bearings,
            np.where(scan.valid, scan.ranges, unmet),
        )

    def points(self, beams: npt.NDArray[np.bool_]) -> FloatArray:
        """End points of the beams of a mask (N,), (M, 2) metres."""
        angles = self.angles[beams]
        ends = self.ranges[beams, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        return np.asarray(self.origins[beams] + ends)

    def placed(self, places: FloatArray, beams: npt.NDArray[np.int64]) -> FloatArray:
        """Places (K, 2) of the scanner's frame, seen by beams (K,), in the frame of the tracks."""
        turn = self.angles[beams] - self.bearings[beams]
        c, s = np.cos(turn), np.sin(turn)
        x, y = places[:, 0], places[:, 1]
        return np.asarray(self.origins[beams] + np.column_stack((c * x - s * y, s * x + c * y)))

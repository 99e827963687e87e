"""When the beams of a scan were sent, and how it would look from where its first beam was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from registration.laser.scan import TURN, Scan

BUNCHED, GAP = 0.01, 1.0  # s between two scans within which their motion tells of the motion in a sweep


def beam_shares(scan: Scan, elapsed: float) -> FloatArray:
    """When each beam was sent, (N,), after the scan's stamp, as a share of the `elapsed` s since the scan before.

    Zeros where that cannot be believed: after a gap, between stamps that bunch, and where the sweep would take two
    periods, as with drivers that give the time of a scan for that of a beam.
    """
    whole = abs(scan.time_increment) * len(scan)
    if not BUNCHED < elapsed < GAP or whole >= 2.0 * elapsed:
        return np.zeros(len(scan))
    return scan.time_increment / elapsed * np.arange(len(scan), dtype=np.float64)


def at_first_beam(scan: Scan, motion: FloatArray, elapsed: float) -> Scan:
    """Move what each beam met to where the sensor was at the scan's stamp.

    motion : (3,) x, y, yaw of the sensor, m and rad, over the `elapsed` s before; it is taken to go on like that.

    The result has the bearings of `scan` and one time for all beams; of two returns at one bearing the nearer counts,
    and where none is any more its range is NaN. A scan whose beams have no times of their own is returned as it is.
    """
    return moved_to_first_beam(scan, motion, elapsed)[0]


def moved_to_first_beam(scan: Scan, motion: FloatArray, elapsed: float) -> tuple[Scan, NDArray[np.int64]]:
    """As `at_first_beam`, and (N,) which beam of the result looks where each beam of `scan` did, -1 out of view."""
    share = beam_shares(scan, elapsed)
    if not share.any():
        return scan, np.arange(len(scan))
    bearings = scan.bearings + share * motion[2]
    valid = scan.valid
    ends = scan.ranges[valid, None] * np.column_stack((np.cos(bearings[valid]), np.sin(bearings[valid])))
    ends += share[valid, None] * motion[:2]
    bearings[valid] = np.arctan2(ends[:, 1], ends[:, 0])
    beams = _beams(scan, bearings)
    ranges = np.full(len(scan), np.nan)
    unmet = ~valid & (beams >= 0)
    ranges[beams[unmet]] = scan.ranges[unmet]
    nearest = np.full(len(scan), np.inf)
    inside = beams[valid] >= 0
    np.minimum.at(nearest, beams[valid][inside], np.hypot(*ends.T)[inside])
    seen = replace(scan, ranges=np.where(np.isfinite(nearest), nearest, ranges), time_increment=0.0)
    return seen, beams


def _beams(scan: Scan, bearings: FloatArray) -> NDArray[np.int64]:
    """Numbers of the beams at bearings (N,) rad, -1 out of view."""
    turn = round(TURN / abs(scan.angle_increment))
    beams = np.rint((bearings - scan.angle_min) / scan.angle_increment).astype(np.int64) % turn
    return np.where(beams < len(scan), beams, -1)

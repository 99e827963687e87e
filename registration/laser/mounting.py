"""How a planar scanner sits on the robot: level, upside down or tilted, and what that makes of its scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from registration.laser.scan import Scan
from registration.laser.sweep import beam_shares

Array = NDArray[np.float64]
LEVEL_TOLERANCE = np.radians(2.0)
# Neighbouring returns farther apart than this share of their range belong to different surfaces.
SURFACE_GAP = 0.15


def level_pose(mounting: Array) -> Array | None:
    """Planar pose (3,) x, y, yaw of a scanner in the robot frame, None where it is tilted.

    mounting : (4, 4), takes sensor coordinates to robot coordinates. A scanner mounted upside down is level.
    """
    if abs(mounting[2, 2]) < np.cos(LEVEL_TOLERANCE):
        return None
    return np.array([mounting[0, 3], mounting[1, 3], np.arctan2(mounting[1, 0], mounting[0, 0])])


def upright(scan: Scan, mounting: Array) -> Scan:
    """The scan as a scanner that is not upside down would have taken it from the same place."""
    if mounting[2, 2] > 0.0:
        return scan
    return replace(scan, angle_min=-scan.angle_min, angle_increment=-scan.angle_increment)


def seen_from_robot(*mounted: tuple[Scan, Array], motion: Array | None = None, elapsed: float = 0.0) -> Scan:
    """Scans of any mounting, projected to the ground plane and sampled again at bearings around the robot.

    mounted : scans with their mountings (4, 4); the finest bearing step of them is used and the first one's stamp.
    motion : (3,) of the robot over the `elapsed` s before, taken to go on like that during the sweeps: what comes out
        has one time for all beams.

    Between two returns on one surface the surface is taken to be straight, so that walls stay exact; where
    several surfaces lie on a bearing the nearest counts. Bearings without a return are NaN.
    """
    steps = [abs(scan.angle_increment) for scan, _ in mounted if scan.angle_increment != 0.0]
    count = max(1, round(2.0 * np.pi / min(steps))) if steps else 1
    step = 2.0 * np.pi / count
    centres = np.asarray(-np.pi + step * (np.arange(count) + 0.5), dtype=np.float64)
    ranges = np.full(count, np.inf)
    for scan, mounting in mounted:
        share = np.zeros(len(scan)) if motion is None else beam_shares(scan, elapsed)
        swept = share[:, None] * (np.zeros(3) if motion is None else motion)
        np.minimum(ranges, _resampled(scan, mounting, swept, centres), out=ranges)
    ranges[np.isinf(ranges)] = np.nan
    # Seen from the robot's centre a return may lie a lever arm farther away than from the scanner.
    reach = max(scan.range_max + float(np.hypot(*mounting[:2, 3])) for scan, mounting in mounted)
    return Scan(ranges, float(centres[0]), step, 0.0, reach, mounted[0][0].stamp)


def _resampled(scan: Scan, mounting: Array, swept: Array, centres: Array) -> Array:
    """Ranges (N,) of one scan at bearings around the robot, infinite where nothing was met.

    swept : (B, 3) where the robot was when each beam was sent.
    """
    count, step = len(centres), 2.0 * np.pi / len(centres)
    ranges: Array = np.full(count, np.inf)
    valid = np.flatnonzero(scan.valid)
    bearings, distances = scan.bearings[valid], scan.ranges[valid]
    flat = np.column_stack((distances * np.cos(bearings), distances * np.sin(bearings)))
    points = flat @ mounting[:2, :2].T + mounting[:2, 3]
    (x, y), (dx, dy, turn) = points.T, swept[valid].T
    c, s = np.cos(turn), np.sin(turn)
    points = np.column_stack((c * x - s * y + dx, s * x + c * y + dy))
    index = np.floor((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / step).astype(int) % count
    np.minimum.at(ranges, index, np.hypot(points[:, 0], points[:, 1]))

    neighbours = np.flatnonzero(np.diff(valid) == 1)
    first, second = points[neighbours], points[neighbours + 1]
    crossed = np.floor((np.arctan2(first[:, 1], first[:, 0]) + np.pi) / step).astype(int)
    # A segment between neighbouring beams spans about one bearing; which side of it depends on the direction.
    for shift in (-1, 0, 1):
        _cross(ranges, centres, (crossed + shift) % count, first, second)
    return ranges


def _cross(ranges: Array, centres: Array, index: NDArray[np.intp], first: Array, second: Array) -> None:
    """Replace samples by the exact crossing of their bearing with the segments that cover it, in place."""
    directions = np.column_stack((np.cos(centres[index]), np.sin(centres[index])))
    edges = second - first
    denominator = directions[:, 0] * edges[:, 1] - directions[:, 1] * edges[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (first[:, 0] * edges[:, 1] - first[:, 1] * edges[:, 0]) / denominator
        share = (first[:, 0] * directions[:, 1] - first[:, 1] * directions[:, 0]) / denominator
    reach = np.hypot(first[:, 0], first[:, 1])
    joined = np.hypot(edges[:, 0], edges[:, 1]) < SURFACE_GAP * reach
    good = joined & (share >= 0.0) & (share <= 1.0) & (along > 0.0) & np.isfinite(along)
    # The rough sample is at most one step of bearing off; an exact crossing of the same surface replaces it.
    close = good & (np.abs(along - ranges[index]) < SURFACE_GAP * reach)
    ranges[index[close]] = along[close]
    empty = good & np.isinf(ranges[index])
    ranges[index[empty]] = along[empty]

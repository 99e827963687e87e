"""Scans laid on each other by small_gicp, to judge closures, the reference and odometry by neither of them.

It starts from each of several guesses and keeps what explains more of both scans. Scans that see different walls, or
one corridor only, fix no relative pose: nothing is said of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, wrap_angle
from evaluation.registration.registration_others import extruded
from evaluation.slam.slam_judging import FALSE, Closed, Followed, true_poses
from registration import Scan

Array = NDArray[np.float64]
VOXEL = 0.02  # metres
REACH = 0.5  # metres between points that can be the same
SHARED = 0.5  # of the points of either scan, in the other
DECIDED = 0.05  # information across the best known direction, by that along it
FEWEST = 100  # points


@dataclass(frozen=True)
class Checked:
    """Closures by two judges, in numbers.

    checked : that small_gicp can judge. off : of these, more than 0.5 m or 10 degrees off it. both : off it and off the
    reference. cleared : off the reference only.
    """

    checked: int
    off: int
    both: int
    cleared: int


class Direct:
    """Relative poses of scans by GICP."""

    def __init__(self, scans: Sequence[Scan]) -> None:
        self._scans = scans
        self._known: dict[int, tuple[Any, Any]] = {}

    def relative(self, a: int, b: int, starts: Sequence[Array]) -> Array | None:
        """Pose (3,) of scan `b` in the frame of scan `a`; None where the two do not fix it."""
        import small_gicp

        (still, tree), (moving, _) = self._cloud(a), self._cloud(b)
        if min(still.size(), moving.size()) < FEWEST:
            return None
        tries = [
            small_gicp.align(still, moving, tree, _in_space(start), max_correspondence_distance=REACH)
            for start in starts
        ]
        best = max(tries, key=lambda found: found.num_inliers)
        if best.num_inliers < SHARED * max(still.size(), moving.size()) or not _decided(best.H):
            return None
        T = best.T_target_source
        return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])

    def _cloud(self, number: int) -> tuple[Any, Any]:
        import small_gicp

        if number not in self._known:
            self._known[number] = small_gicp.preprocess_points(extruded(self._scans[number]), VOXEL)
        return self._known[number]


def check(log: Followed, direct: Direct, closures: Sequence[Closed], false: Sequence[int]) -> Checked:
    """Judge closures by direct registration; `false` are those that the reference calls so."""
    if not closures:
        return Checked(0, 0, 0, 0)
    earlier = true_poses(log, [a for a, _, _ in closures])
    later = true_poses(log, [b for _, b, _ in closures])
    expected = between(earlier, later)
    checked, off = set(), set()
    for number, (a, b, relative) in enumerate(closures):
        found = direct.relative(a, b, (relative, expected[number]))
        if found is None:
            continue
        checked.add(number)
        away, turned = _miss(found, relative)
        if away > FALSE[0] or turned > FALSE[1]:
            off.add(number)
    denied = set(false) & checked
    return Checked(len(checked), len(off), len(denied & off), len(denied - off))


def single_errors(log: Followed, direct: Direct) -> Array:
    """Metres and radians (2, 2) by which the worst single pose of the reference, and of odometry, is off.

    A pose is off by itself where the steps to it and from it are denied, and the step past it is not.
    """
    known = np.flatnonzero(np.isfinite(log.truth[:, 0]))
    tracks = (log.truth, log.poses)
    worst = np.zeros((2, 2))
    misses: dict[tuple[int, int], list[tuple[float, float]] | None] = {}

    def missed(a: int, b: int) -> list[tuple[float, float]] | None:
        if (a, b) not in misses:
            steps = [np.asarray(between(track[a], track[b])) for track in tracks]
            found = direct.relative(a, b, steps)
            misses[a, b] = None if found is None else [_miss(found, step) for step in steps]
        return misses[a, b]

    for a, b, c in zip(known[:-2], known[1:-1], known[2:], strict=True):
        to, away, past = missed(a, b), missed(b, c), missed(a, c)
        if to is not None and away is not None and past is not None:
            alone = np.minimum(to, away) - np.array(past)
            worst = np.maximum(worst, alone)
    return worst


def _miss(found: Array, given: Array) -> tuple[float, float]:
    off = between(found, given)
    return float(np.hypot(off[0], off[1])), float(abs(wrap_angle(off[2])))


def _in_space(pose: Array) -> Array:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    T = np.eye(4)
    T[:2, :2], T[:2, 3] = [[c, -s], [s, c]], pose[:2]
    return T


def _decided(H: Array) -> bool:
    """Whether no direction in the plane is known much worse than another; H (6, 6) is of rotation, translation."""
    least, most = np.linalg.eigvalsh(H[3:5, 3:5])
    return bool(least >= DECIDED * most)

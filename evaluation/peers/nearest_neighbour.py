"""A plain nearest-neighbour tracker of people in laser scans: what a student would write, and what ours has to beat.

Clusters as wide as a leg or a trunk, two legs near each other made one, a Kalman filter of constant velocity for each,
one assignment, and two counters. It knows nothing of shape, of surroundings and of who hides whom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from registration.laser.scan import Scan
from tracking.mixture.target import Target

Array = npt.NDArray[np.float64]
JUMP = 0.15  # m between neighbouring returns that ends a cluster
WIDTHS = (0.05, 0.6)  # m, of what may be a person
LEGS = 0.45  # m between two legs of one person
FARTHEST = 10.0  # m
GATE = 0.6  # m from the prediction to the cluster
NOISE, ACCELERATION = 0.1, 1.0  # m, and m/s² over a scan
CONFIRMED, LOST = 5, 8  # scans seen until one is told of, and scans missed until it is dropped


@dataclass
class _Track:
    label: int
    mean: Array
    covariance: Array
    seen: int = 1
    missed: int = 0


class NearestNeighbour:
    """The interface of `PeopleTracker`."""

    def __init__(self) -> None:
        self.tracks: list[_Track] = []
        self._given = 0
        self._stamp: float | None = None

    def step(self, scan: Scan, pose: npt.ArrayLike, stamp: float) -> list[Target]:
        """People after a scan taken from `pose` (3,), m and rad, in the frame of the poses."""
        place = np.asarray(pose, dtype=np.float64)
        dt = 0.1 if self._stamp is None else min(max(stamp - self._stamp, 0.0), 1.0)
        self._stamp = stamp
        c, s = np.cos(place[2]), np.sin(place[2])
        spots = detections(scan) @ np.array([[c, s], [-s, c]]) + place[:2]
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        G = np.vstack([0.5 * dt**2 * np.eye(2), dt * np.eye(2)])
        for track in self.tracks:
            track.mean = F @ track.mean
            track.covariance = F @ track.covariance @ F.T + ACCELERATION**2 * G @ G.T
            track.missed += 1
        means = np.array([track.mean[:2] for track in self.tracks]).reshape(-1, 2)
        gaps = np.linalg.norm(means[:, None] - spots[None], axis=2)
        free = np.ones(len(spots), dtype=bool)
        for t, k in zip(*linear_sum_assignment(np.minimum(gaps, GATE)), strict=True):
            if gaps[t, k] < GATE:
                self._correct(self.tracks[t], spots[k])
                free[k] = False
        for spot in spots[free]:
            self.tracks.append(
                _Track(self._given, np.array([*spot, 0.0, 0.0]), np.diag([NOISE**2, NOISE**2, 1.0, 1.0]))
            )
            self._given += 1
        self.tracks = [
            track for track in self.tracks if track.missed <= (LOST if track.seen >= CONFIRMED else 0)
        ]
        return [
            Target(track.label, track.mean.copy(), track.covariance.copy(), 1.0, 0.01 * np.eye(2), 1.0)
            for track in self.tracks
            if track.seen >= CONFIRMED
        ]

    @staticmethod
    def _correct(track: _Track, spot: Array) -> None:
        P = track.covariance
        K = P[:, :2] @ np.linalg.inv(P[:2, :2] + NOISE**2 * np.eye(2))
        track.mean = track.mean + K @ (spot - track.mean[:2])
        track.covariance = P - K @ P[:2]
        track.seen, track.missed = track.seen + 1, 0


def detections(scan: Scan) -> Array:
    """Middles (K, 2) of what may be people in a scan, m, in the frame of the scanner."""
    use = scan.valid & (scan.ranges < FARTHEST)
    points = np.column_stack((np.cos(scan.bearings), np.sin(scan.bearings))) * scan.ranges[:, None]
    beams = np.flatnonzero(use)
    if not len(beams):
        return np.zeros((0, 2))
    points = points[beams]
    gap = np.linalg.norm(np.diff(points, axis=0), axis=1)
    spacing = 3.0 * abs(scan.angle_increment) * np.minimum(scan.ranges[beams[1:]], scan.ranges[beams[:-1]])
    parts = np.split(points, np.flatnonzero(gap > np.maximum(JUMP, spacing)) + 1)
    found = [
        part.mean(0)
        for part in parts
        if len(part) >= 3 and WIDTHS[0] <= np.linalg.norm(part[-1] - part[0]) <= WIDTHS[1]
    ]
    people: list[Array] = []
    for spot in found:
        near = [k for k, other in enumerate(people) if np.linalg.norm(other - spot) < LEGS]
        if near:
            people[near[0]] = 0.5 * (people[near[0]] + spot)
        else:
            people.append(spot)
    return np.array(people).reshape(-1, 2)

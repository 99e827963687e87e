"""Global nearest neighbour tracking, to compare with: one association per look, the same motion model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]
GATE = 16.27  # χ² with 3 degrees of freedom, 99.9 %
CONFIRM_HITS = 3
DROP_MISSES = 4


@dataclass
class GnnTrack:
    """A constant-velocity Kalman filter with counts of detections and of misses in a row."""

    id: int
    mean: Array
    covariance: Array
    hits: int = 1
    misses: int = 0

    @property
    def confirmed(self) -> bool:
        return self.hits >= CONFIRM_HITS


class GlobalNearestNeighbour:
    """The cheapest assignment of detections to gated tracks; three detections confirm, four misses delete."""

    def __init__(self, accel_sigma: float, sigma: float, speed: float) -> None:
        self.q, self.r, self.speed = accel_sigma**2, sigma**2, speed
        self.tracks: list[GnnTrack] = []
        self._stamp: float | None = None
        self._next = 0

    def step(self, detections: Array, stamp: float) -> list[GnnTrack]:
        """Take detections (M, 3) in; returns confirmed tracks."""
        dt = 0.0 if self._stamp is None else stamp - self._stamp
        self._stamp = stamp
        I = np.eye(3)
        F = np.block([[I, dt * I], [0 * I, I]])
        Q = self.q * np.block([[dt**3 / 3 * I, dt**2 / 2 * I], [dt**2 / 2 * I, dt * I]])
        costs = np.full((len(self.tracks), len(detections)), 1e6)
        for i, track in enumerate(self.tracks):
            track.mean, track.covariance = F @ track.mean, F @ track.covariance @ F.T + Q
            S = track.covariance[:3, :3] + self.r * I
            apart = detections - track.mean[:3]
            d2 = (apart @ np.linalg.inv(S) * apart).sum(1)
            costs[i] = np.where(d2 < GATE, d2 + np.log(np.linalg.det(S)), 1e6)
        rows, columns = linear_sum_assignment(costs)
        taken = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if costs[i, j] < 1e6}
        for i, track in enumerate(self.tracks):
            if i not in taken:
                track.misses += 1
                continue
            S = track.covariance[:3, :3] + self.r * I
            gain = track.covariance[:, :3] @ np.linalg.inv(S)
            track.mean = track.mean + gain @ (detections[taken[i]] - track.mean[:3])
            track.covariance = track.covariance - gain @ track.covariance[:3]
            track.hits, track.misses = track.hits + 1, 0
        limit = [DROP_MISSES if track.confirmed else 1 for track in self.tracks]
        self.tracks = [t for t, most in zip(self.tracks, limit, strict=True) if t.misses < most]
        for j in sorted(set(range(len(detections))) - set(taken.values())):
            P = np.diag([self.r] * 3 + [self.speed**2] * 3)
            self.tracks.append(GnnTrack(self._next, np.array([*detections[j], 0, 0, 0]), P))
            self._next += 1
        return [track for track in self.tracks if track.confirmed]

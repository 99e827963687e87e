"""Figure 6.11: along a simulated drive, the range from which on a detection stops being Gaussian.

The text logged amcl on a robot; here an extended Kalman filter localises a simulated one: a 24 m drive past
five way points through a room of 12 m × 7.5 m, odometry with noise, and corners of the furniture seen within
3 m by range and bearing.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from estimation.checks import FloatArray
from estimation.conversion.polar import condition_ratio
from estimation.geometry.poses import compound, compound_jacobians, wrap_angle
from evaluation.conversion.conversion_limits import K_CRIT

WAY_POINTS = np.array([[1.0, 1.2], [8.6, 1.5], [10.8, 5.4], [5.4, 5.9], [4.9, 3.2], [1.0, 3.9]])
CORNERS = np.array(
    [[2.5, 0.0], [6.7, 2.9], [11.8, 2.5], [10.0, 7.1], [7.6, 7.2], [3.2, 6.6], [0.2, 2.5], [3.2, 4.4]]
)
SPEED, DT, REACH = 0.5, 0.2, 3.0
ODOMETRY = np.array([0.02, 0.01, 0.025])  # standard deviations per √m (x, y: m) and per √rad and m (yaw: rad)
CORNER_NOISE = np.diag([0.08**2, np.radians(4.0) ** 2])
SIGMA_RANGE = 0.02
FARTHEST = 60.0


@dataclass(frozen=True)
class RecordedDrive:
    """Stamps (T,), s; true path (T, 3); pose covariances (T, 3, 3) of the localisation."""

    stamps: FloatArray
    path: FloatArray
    covariances: FloatArray

    @property
    def length(self) -> float:
        """m."""
        return float(np.linalg.norm(np.diff(self.path[:, :2], axis=0), axis=1).sum())


def _motions() -> list[FloatArray]:
    """Turn on the spot, then straight, from way point to way point, in steps of `DT`."""
    steps: list[FloatArray] = []
    heading = 0.0
    for a, b in pairwise(WAY_POINTS):
        target = float(np.arctan2(b[1] - a[1], b[0] - a[0]))
        turn = wrap_angle(target - heading)
        count = max(1, round(abs(turn) / (0.8 * DT)))
        steps += [np.array([0.0, 0.0, turn / count])] * count
        distance = float(np.linalg.norm(b - a))
        count = max(1, round(distance / (SPEED * DT)))
        steps += [np.array([distance / count, 0.0, 0.0])] * count
        heading = target
    return steps


def drive(seed: int) -> RecordedDrive:
    """Simulate and localise."""
    rng = np.random.default_rng(seed)
    true = estimate = np.array([*WAY_POINTS[0], 0.0])
    P = np.diag([0.05**2, 0.05**2, np.radians(1.5) ** 2])
    path, covariances = [true], [P]
    for motion in _motions():
        travelled, turned = abs(motion[0]), abs(motion[2])
        sigma = ODOMETRY * np.sqrt([travelled + 1e-6, travelled + 1e-6, travelled + turned + 1e-6])
        true = compound(true, motion)
        J1, J2 = compound_jacobians(estimate, motion)
        estimate = compound(estimate, motion + sigma * rng.standard_normal(3))
        P = J1 @ P @ J1.T + J2 @ np.diag(sigma**2) @ J2.T
        for corner in CORNERS:
            if np.linalg.norm(corner - true[:2]) <= REACH and rng.uniform() < 0.3:
                estimate, P = _see(true, estimate, P, corner, rng)
        path.append(true)
        covariances.append(P)
    return RecordedDrive(DT * np.arange(len(path), dtype=np.float64), np.array(path), np.array(covariances))


def _see(
    true: FloatArray, estimate: FloatArray, P: FloatArray, corner: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    z = _polar(true, corner) + rng.multivariate_normal(np.zeros(2), CORNER_NOISE)
    offset = corner - estimate[:2]
    r = float(np.linalg.norm(offset))
    H = np.array([[-offset[0] / r, -offset[1] / r, 0.0], [offset[1] / r**2, -offset[0] / r**2, -1.0]])
    innovation = z - _polar(estimate, corner)
    innovation[1] = wrap_angle(float(innovation[1]))
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + CORNER_NOISE)
    updated = (np.eye(3) - gain @ H) @ P
    return estimate + gain @ innovation, 0.5 * (updated + updated.T)


def _polar(pose: FloatArray, point: FloatArray) -> FloatArray:
    offset = point - pose[:2]
    return np.array([np.linalg.norm(offset), np.arctan2(offset[1], offset[0]) - pose[2]])


def critical_range(P: FloatArray, sigma_object: float, with_position: bool) -> float:
    """Range, m, at which K reaches 1.075 under a robot pose covariance (3, 3); inf where it is beyond 60 m."""
    sigma = float(np.sqrt(sigma_object**2 + P[2, 2]))
    # The eigenvalues turn with the bearing; the mean over the directions is what a robot meets.
    position = 0.5 * np.trace(P[:2, :2]) * np.eye(2) if with_position else None

    def excess(r: float) -> float:
        return float(condition_ratio(r, 0.0, SIGMA_RANGE, sigma, position)) - K_CRIT

    # Close by, K rises again where the range noise is large against the range: start beyond that.
    start = max(0.3, min(5 * SIGMA_RANGE / sigma, 2.0))
    if excess(FARTHEST) < 0:
        return float("inf")
    return start if excess(start) > 0 else float(brentq(excess, start, FARTHEST))

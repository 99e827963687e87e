"""Scans of a wall with legs before it."""

from __future__ import annotations

import numpy as np

from registration import Scan
from tracking import PeopleTracker

STEP = np.pi / 360


def scan_of(ranges: np.ndarray, stamp: float = 0.0) -> Scan:
    return Scan(ranges, -0.5 * np.pi, STEP, 0.05, 12.0, stamp)


def wall(distance: float = 6.0) -> np.ndarray:
    return np.full(361, distance)


def with_leg(ranges: np.ndarray, x: float, y: float, radius: float = 0.07) -> np.ndarray:
    """Ranges with a round leg in front of what was there."""
    bearings = -0.5 * np.pi + STEP * np.arange(361)
    along = x * np.cos(bearings) + y * np.sin(bearings)
    square = radius**2 - (x**2 + y**2 - along**2)
    hit = (square > 0.0) & (along > 0.0)
    near = along - np.sqrt(np.where(hit, square, 0.0))
    return np.where(hit, np.minimum(ranges, near), ranges)


def walk(tracker: PeopleTracker, steps: int, first: int = 0, pose: np.ndarray | None = None) -> list:
    """Somebody walks by 2.5 m in front of the scanner, 0.8 m/s to the left; the targets of the last scan."""
    targets: list = []
    for k in range(first, first + steps):
        y = -1.5 + 0.08 * k
        swing = 0.2 * np.sin(1.5 * k)
        ranges = with_leg(with_leg(wall(), 2.4, y + swing), 2.6, y - swing)
        targets = tracker.step(scan_of(ranges, 0.1 * k), np.zeros(3) if pose is None else pose, 0.1 * k)
    return targets

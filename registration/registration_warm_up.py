"""Compiles, or loads from the cache, what registration runs per scan, so that the first scan is as fast as others."""

from __future__ import annotations

import numpy as np

from registration.crf.online import ScanSegmenter
from registration.laser.scan import Scan
from registration.odometry.follower import Odometry, OdometryConfig

LENGTH, WIDTH = 8.0, 6.0


def warm_up(config: OdometryConfig | None = None) -> None:
    """Follow a few scans of an empty room with a throw-away `Odometry`."""
    odometry = Odometry(config)
    for step in range(4):
        guess = np.array([0.3, 0.0, 0.02]) if step else None
        odometry.register(_room_scan(0.3 * step - 1.0), float(step), guess=guess)


def warm_up_segmenter(segmenter: ScanSegmenter) -> None:
    """Label a scan with something in it that moved; the segmenter is as new afterwards."""
    ranges = _room_scan(-1.0).ranges
    for step in range(2):
        seen = ranges.copy()
        seen[100 + 15 * step : 130 + 15 * step] = 1.5
        scan = Scan(seen, -0.5 * np.pi, np.pi / 360.0, 0.05, 30.0)
        segmenter.segment(scan, 0.5 * step, np.zeros(3))
        segmenter.keep(scan, 0.5 * step, np.zeros(3))
    segmenter.reset()


def _room_scan(x: float, beams: int = 361) -> Scan:
    """A half-circle scan from (x, 0.5) in a room of 8 by 6 metres, looking along its length."""
    bearings = np.linspace(-0.5 * np.pi, 0.5 * np.pi, beams)
    across = np.where(bearings > 0.0, 0.5 * WIDTH - 0.5, 0.5 * WIDTH + 0.5)
    ahead = (0.5 * LENGTH - x) / np.maximum(np.cos(bearings), 1e-6)
    ranges = np.minimum(ahead, across / np.maximum(np.abs(np.sin(bearings)), 1e-6))
    return Scan(ranges, float(bearings[0]), float(bearings[1] - bearings[0]), 0.05, 30.0)

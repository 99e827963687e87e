"""Compiles, or loads from the cache, what registration runs per scan, so that the first scan is as fast as others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from registration.laser.scan import Scan
from registration.odometry.follower import Odometry
from registration.odometry.odometry_config import OdometryConfig

if TYPE_CHECKING:
    from registration.crf.online import ScanSegmenter


def warm_up(config: OdometryConfig | None = None) -> None:
    """Follow a few scans of an empty room with a throw-away `Odometry`."""
    odometry = Odometry(config)
    for step in range(4):
        guess = np.array([0.5, 0.0, 0.0]) if step else None
        odometry.register(room_scan(0.5 * step), float(step), guess=guess)


def warm_up_segmenter(segmenter: ScanSegmenter) -> None:
    """Label a scan with something in it that moved; the segmenter is as new afterwards."""
    for step in range(2):
        scan = room_scan(0.0)
        scan.ranges[100 + 15 * step : 130 + 15 * step] = 2.0
        segmenter.segment(scan, float(step), np.zeros(3))
        segmenter.keep(scan, float(step), np.zeros(3))
    segmenter.reset()


def room_scan(x: float) -> Scan:
    """A half-circle scan from (x, 0) in a room of 8 by 6 metres around the origin, looking along its length."""
    bearings = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 361)
    with np.errstate(divide="ignore"):
        ranges = np.minimum((4.0 - x) / np.cos(bearings), 3.0 / np.abs(np.sin(bearings)))
    return Scan(ranges, float(bearings[0]), float(bearings[1] - bearings[0]))

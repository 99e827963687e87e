"""Compiles what the people tracker runs, so that the first scan is not late."""

from __future__ import annotations

import numpy as np

from registration.laser.scan import Scan
from tracking.people.people_config import PeopleConfig
from tracking.people.people_tracker import PERIOD
from tracking.people.scan_filters import tracker_of


def warm_up(config: PeopleConfig | None = None, name: str = "mixture") -> None:
    """Tracks two legs that go together, and one alone, for two seconds of made-up scans with the tracker of a name."""
    tracker = tracker_of(name, config)
    for k in range(25):
        ranges = np.full(181, 4.0)
        for leg in (16, 70, 88):
            ranges[leg + 2 * k :][:5] = 2.0
        tracker.step(Scan(ranges, -1.0, 2.0 / 180, 0, 10, PERIOD * k), np.zeros(3), PERIOD * k)

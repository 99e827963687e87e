"""Errors that all detections of a look share and that change slowly: of the robot's pose, of the sensor's mounting.

What is left after `sensor_bias`: an offset in range (m) and a turn (rad) that go towards zero within some time (an
Ornstein-Uhlenbeck process), and a part that changes with every look. The detections of a look together say which: each
known object explains one of them at most (`sensor_filter`, `revision`).
"""

from __future__ import annotations

import numpy as np

SECONDS = 30.0  # After which what was found is forgotten
SLOW = np.array([0.02, 0.02])  # Standard deviations of the slow part, of range (m) and turn (rad)
QUICK = np.array([0.01, 0.006])  # The same of what changes with every look
JITTER = 0.02  # The same of how old a look's detections are, s
STEPS = np.linspace(-2.0, 2.0, 9)  # Turns that are tried, in standard deviations
RANGES = np.linspace(-1.5, 1.5, 5)  # The same of ranges
UNKNOWN = 25.0  # Squared Mahalanobis distance from which a detection is of nothing that is known

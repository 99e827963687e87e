"""Targets as what trackers are judged by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimation.checks import FloatArray
from tracking.mixture.target import Target


def positions(targets: Sequence[Target]) -> FloatArray:
    """Positions (N, 2) of reported targets."""
    return np.array([target.mean[:2] for target in targets], dtype=np.float64).reshape(-1, 2)

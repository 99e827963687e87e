"""One look in arrays, as the steps of `Anchoring` pass it on."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.checks import FloatArray
from world_model.anchoring.leaves import IntArray


@dataclass
class Look:
    """One look in arrays: M detections, n touched leaves."""

    stamp: float
    lag: float
    positions: FloatArray
    covariances: FloatArray
    likelihood: FloatArray
    log_new: FloatArray
    existence: FloatArray
    born: FloatArray
    gap: FloatArray
    reach: float
    chosen: IntArray
    clear: FloatArray
    matrix: FloatArray
    missing: FloatArray

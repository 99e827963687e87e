"""What a scan is registered against: lines, and a hash of who lies near a spot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from registration.laser.buckets import index
from registration.laser.surface import Surface


@dataclass(frozen=True)
class TargetLines:
    """Lines to register against: points (M, 2) on them, normals, tilt and signed as in `Surface`; their hash."""

    points: FloatArray
    normals: FloatArray
    tilt: FloatArray
    heads: NDArray[np.int32]
    following: NDArray[np.int32]
    signed: bool = True


def target_of(surface: Surface) -> TargetLines:
    """A scan's surface as the target of a registration."""
    heads, following = index(surface.feet, surface.normals)
    return TargetLines(surface.feet, surface.normals, surface.tilt, heads, following, surface.signed)

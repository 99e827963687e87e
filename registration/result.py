"""What a registration yields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray

UNKNOWN = np.diag([1.0, 1.0, 1.0])  # m², rad²: of a motion nothing is known about


@dataclass(frozen=True, eq=False)
class Registration:
    """Motion that lays the source on the target, and how far to trust it.

    transform : pose of the source's sensor in the target's frame, (3,) x, y, yaw in the plane or (4, 4) in space;
        it takes source points to where they lie in the target.
    covariance : (3, 3) of (x, y, yaw), or (6, 6) of (x, y, z, rotation about x, y, z), metres and radians, in the
        target's frame. Large along directions the data leave open: there the guess was kept.
    fitness : 0 to 1, how much of the outline both scans could see agrees.
    converged : True where the transform can be used with its covariance.
    reason : why it did not converge, or what it leaves open; empty where there is nothing to say.
    """

    transform: FloatArray
    covariance: FloatArray
    fitness: float
    converged: bool
    reason: str = ""

"""Systematic errors of a moving sensor, estimated from what it says about resting objects from different places.

A detection of an object at distance d (m) and bearing b (rad, off the sensor's axis) is taken to be off by
`scale d + offset + depth d b² / 2` along the line of sight and by `turn d` across it. depth is -1 where a detector
reports depth for distance; what sees farther to the side than `ASIDE` does not. `sensor_filter` estimates objects and
the four numbers together: only what changes with the place of the sensor says something.
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray

PRIOR = np.array([0.1, 0.05, 1.0, 0.02])
"""Standard deviations of offset (m), scale, depth and turn (rad) before anything is known."""
PARALLAX = 0.5
"""m: a sensor that has not moved farther than this cannot tell its errors from the objects' places."""
ASIDE = 1.2
"""rad: no camera reports depth of what is farther off its axis."""


def depth_share(bearing: FloatArray) -> FloatArray:
    """Change of range per unit of depth and distance, at bearings within half a turn."""
    return np.where(np.abs(bearing) < ASIDE, 0.5 * bearing**2, 0.0)


def basis(positions: FloatArray, pose: FloatArray) -> FloatArray:
    """Displacements (M, 2, 4) per unit of offset, scale, depth and turn of positions (M, 3) seen from a pose (4,)."""
    off = positions[:, :2] - pose[:2]
    distance = np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-6)
    along = off / distance[:, None]
    bearing = np.arctan2(off[:, 1], off[:, 0]) - pose[3]
    bearing -= 2.0 * np.pi * np.round(bearing / (2.0 * np.pi))
    out = np.empty((len(positions), 2, 4))
    out[:, :, 0] = along
    out[:, :, 1] = off
    out[:, :, 2] = depth_share(bearing)[:, None] * off
    out[:, 0, 3], out[:, 1, 3] = -off[:, 1], off[:, 0]
    return out

"""Systematic errors of a moving sensor, estimated from what it says about resting objects from different places.

A detection of an object at distance d (m) and bearing b (rad, off the sensor's axis) is taken to be off by
`scale d + offset + depth d b² / 2 + lean d b` along the line of sight and by `turn d + stretch d b + bend d b²` across
it. depth is -1 where a detector reports depth for distance, lean the angle by which its image plane is turned then;
stretch and bend are of lenses; what sees farther to the side than `ASIDE` has none of these four. `delay` (s) is how
old a detection is at its stamp: it is off by what the sensor moved meanwhile. `sensor_filter` estimates objects and
the eight numbers together: only what changes with the place of the sensor says something.

What is left are an offset in range (m) and a turn (rad) that all detections of a look share (errors of the robot's
pose, of the sensor's mounting). They go towards zero within some time (an Ornstein-Uhlenbeck process), with a part that
changes with every look. The detections of a look together say which: each known object explains one of them at most
(`sensor_worlds`, `revision`).
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.rotations import wrap_angle

NAMES = ("offset", "scale", "depth", "turn", "lean", "stretch", "bend", "delay")
CONSTANT = len(NAMES)
PRIOR = np.array([0.1, 0.05, 1.0, 0.02, 0.03, 0.03, 0.05, 0.05])
"""Standard deviations of offset (m), scale, depth, turn, lean (rad), stretch, bend (1/rad) and delay (s) before
anything is known."""
PARALLAX = 0.5
"""m: a sensor that has not moved farther than this cannot tell its errors from the objects' places."""
ASIDE = 1.2  # rad: no camera reports depth of what is farther off its axis
SOONEST, LATEST = 0.01, 0.6  # s: how fast a sensor moves is known from poses this far apart
QUICKEST = np.array([5.0, 5.0, 6.0])  # m/s and rad/s: what is faster is no motion of a sensor
SECONDS = 30.0  # After which shared errors that were found are forgotten
SLOW = np.array([0.02, 0.02])  # Standard deviations of their slow part, of range (m) and turn (rad)
QUICK = np.array([0.01, 0.006])  # The same of what changes with every look
JITTER = 0.02  # The same of how old a look's detections are, s
STEPS = np.linspace(-2.0, 2.0, 9)  # Turns that are tried, in standard deviations


def rates(poses: FloatArray, before: FloatArray, elapsed: FloatArray) -> FloatArray:
    """Velocity and yaw rate (..., 3) of poses (..., 4) since `before`, `elapsed` (...) s ago; 0 where not known."""
    off = np.stack([*np.moveaxis(poses - before, -1, 0)[:2], wrap_angle(poses[..., 3] - before[..., 3])], -1)
    known = (elapsed > SOONEST) & (elapsed < LATEST)
    out = off / np.where(known, elapsed, 1.0)[..., None]
    known = known & (np.abs(out) < QUICKEST).all(-1)
    return np.where(known[..., None], out, 0.0)


def lines_of_sight(places: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distances and bearings (...) of places (..., 2) from poses (..., 4), and the lines of sight (..., 2)."""
    off = places - poses[..., :2]
    distance = np.maximum(np.hypot(off[..., 0], off[..., 1]), 1e-3)
    bearing = wrap_angle(np.arctan2(off[..., 1], off[..., 0]) - poses[..., 3])
    return distance, bearing, off / distance[..., None]


def constants(distance: FloatArray, bearing: FloatArray, sight: FloatArray, rates: FloatArray) -> FloatArray:
    """Change of range and bearing (..., 2, 8) per unit of each constant error, at distances and bearings (...) along
    lines of sight (..., 2) of a sensor that moves at rates (..., 3)."""
    aside = np.where(np.abs(bearing) < ASIDE, bearing, 0.0)
    out = np.zeros((*distance.shape, 2, CONSTANT))
    out[..., 0, 0] = 1.0
    out[..., 0, 1] = distance
    out[..., 0, 2] = 0.5 * aside**2 * distance
    out[..., 0, 4] = aside * distance
    out[..., 0, 7] = (sight * rates[..., :2]).sum(-1)
    out[..., 1, 3] = 1.0
    out[..., 1, 5] = aside
    out[..., 1, 6] = aside**2
    across = sight[..., 0] * rates[..., 1] - sight[..., 1] * rates[..., 0]
    out[..., 1, 7] = across / distance + rates[..., 2]
    return out


def basis(positions: FloatArray, pose: FloatArray, rate: FloatArray | None = None) -> FloatArray:
    """Displacements (M, 2, 8) per unit of each error of positions (M, 2 or 3) seen from a pose (4,).

    rate (3,) : the sensor's velocity (m/s) and yaw rate (rad/s), world axes; None for one that stands.
    """
    distance, bearing, sight = lines_of_sight(positions[:, :2], pose)
    change = constants(distance, bearing, sight, np.zeros(3) if rate is None else rate)
    across = np.stack([-sight[:, 1], sight[:, 0]], -1) * distance[:, None]
    return sight[:, :, None] * change[:, :1] + across[:, :, None] * change[:, 1:]

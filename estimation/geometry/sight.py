"""Sight: what one planar scan says about a spot in its plane, and how sure a beam can be of that.

A beam that ends where the spot is has seen something there; one that ends farther away went through; one that ends
nearer was stopped, and says nothing. How far apart two distances have to be to tell is a matter of noise: that of the
range, that of where the spot is, and that of the bearing, for which the beams beside count as well. Next to an edge,
on a surface seen at a low angle and between two things at different distances (mixed pixels) neighbouring beams
disagree, and only what is clear of all of them goes through or is hidden.

A laser scanner's readings of unevenly reflecting surfaces scatter by a few centimetres, so `RANGE_SIGMA` is more than
the data sheets' centimetre.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import as_floats, as_number, as_own, as_points
from estimation.errors import InputError

AGREES, THROUGH, HIDDEN, UNSEEN = range(4)
RANGE_SIGMA = 0.03  # metres, of a reading
BEARING_SIGMA = 0.005  # radians, of a beam
SIGMAS = 3.0  # standard deviations that tell two distances apart


@njit(cache=True, inline="always")
def beam_at(x, y, angle_min, step):  # type: ignore[no-untyped-def]
    """Number of the beam that looks at (x, y), sensor frame, of a scanner that may see all around.

    It lies outside the scan, up to a full turn beyond its first beam, where none looks there.
    """
    beam = (math.atan2(y, x) - angle_min) / step
    around = 2.0 * math.pi / abs(step)
    beam -= math.floor((beam + 0.5) / around) * around
    return math.floor(beam + 0.5)


@njit(cache=True)
def look(x, y, doubt, ranges, angle_min, step):  # type: ignore[no-untyped-def]
    """What a scan says about the spot (x, y) metres in its sensor frame.

    doubt : metres, standard deviation of the spot in any direction. ranges : (B,) metres, inf without a return.
    angle_min, step : radians, of the first beam and from beam to beam; `step` may be negative.

    Returns AGREES, THROUGH, HIDDEN or UNSEEN: no beam there, none with a return, or beams that disagree.
    """
    count = len(ranges)
    centre = beam_at(x, y, angle_min, step)
    if centre < 0 or centre >= count or not math.isfinite(ranges[centre]):
        return UNSEEN
    distance = math.hypot(x, y)
    margin = SIGMAS * math.sqrt(RANGE_SIGMA * RANGE_SIGMA + doubt * doubt)
    if abs(distance - ranges[centre]) <= margin:
        return AGREES
    # A beam to either side for its own width, and as many as its bearing may be off by.
    around = round(2.0 * math.pi / abs(step))
    beside = min(1 + int(BEARING_SIGMA / abs(step)), around // 2)
    nearest = farthest = ranges[centre]
    for k in range(centre - beside, centre + beside + 1):
        beam = k % around
        if beam < count and math.isfinite(ranges[beam]):
            nearest, farthest = min(nearest, ranges[beam]), max(farthest, ranges[beam])
    if distance < nearest - margin:
        return THROUGH
    if distance > farthest + margin:
        return HIDDEN
    return UNSEEN


@njit(cache=True)
def _label(points, pose, doubt, ranges, angle_min, step, labels):  # type: ignore[no-untyped-def]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(points)):
        dx, dy = points[k, 0] - pose[0], points[k, 1] - pose[1]
        labels[k] = look(c * dx + s * dy, c * dy - s * dx, doubt, ranges, angle_min, step)


def sight(
    points: NDArray[np.float64],
    pose: NDArray[np.float64],
    doubt: float,
    ranges: NDArray[np.float64],
    angle_min: float,
    step: float,
) -> NDArray[np.int8]:
    """What a scan taken at `pose` (3,) says about `points` (N, 2) metres in the frame of that pose: labels (N,).

    doubt : metres, standard deviation of the points relative to the scan. ranges : (B,) metres, inf without a return.
    angle_min, step : radians. The labels are those of `look`. Raises InputError naming the argument.
    """
    spots, place = as_points("points", points, 2), as_own("pose", pose, (3,))
    seen = np.ascontiguousarray(as_floats("ranges", ranges))
    doubt, first, step = as_number("doubt", doubt), as_number("angle_min", angle_min), as_number("step", step)
    if seen.ndim != 1 or doubt < 0.0 or step == 0.0:
        raise InputError(
            f"ranges (B,), doubt of at least 0 and a step expected, not {seen.shape}, {doubt}, {step}"
        )
    labels: Any = np.empty(len(spots), dtype=np.int8)
    _label(np.ascontiguousarray(spots), place, doubt, seen, first, step, labels)
    return np.asarray(labels)

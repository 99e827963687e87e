"""How a scan sees a spot: on its outline, which runs on between beams; in front of it; behind it; or not at all."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimation.geometry.sight import AGREES, RANGE_SIGMA, UNSEEN, beam_at, look
from estimation.geometry.sight import SIGMAS as TELLING

CLEAR = 4  # beside the labels of `estimation.geometry.sight`: near, and nothing came back from there
# Of what may be noise: how far in front of, or behind, what a beam saw before that says anything.
MARGIN = 2.0
LONGEST = 0.5  # metres of outline taken to run on between two beams
WIDE = 3.0  # of the same: how far a distance off an outline is told
TOUCHING = 1.0001  # likewise, where only the label is asked for


@njit(cache=True, inline="always")
def length(x, y):  # type: ignore[no-untyped-def]
    """As `math.hypot`, which also minds overflow and takes several times as long."""
    return math.sqrt(x * x + y * y)


@njit(cache=True, inline="always")
def _off_segment(x, y, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Distance from (x, y) to the segment a, b."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    share = 0.0
    if square > 0.0:
        share = min(max(((x - ax) * dx + (y - ay) * dy) / square, 0.0), 1.0)
    return length(x - ax - share * dx, y - ay - share * dy)


@njit(cache=True)
def off_outline(x, y, radius, enough, xy, ranges, angle_min, step):  # type: ignore[no-untyped-def]
    """Distance from (x, y) to a scan's outline; `radius` where that is farther.

    enough : the search ends with the first distance that is not more.
    """
    count, centre = len(ranges), beam_at(x, y, angle_min, step)
    stride = abs(step)
    around = round(2.0 * math.pi / stride)
    distance = length(x, y)
    best = radius
    for away in range(around // 2 + 1):
        # Beams outwards from the one that looks there, until none can be nearer than what was found.
        angle = (away - 1.5) * stride
        # Less than by its sine, and cheaper: beams that are looked at in vain change nothing.
        apart = distance if angle >= 0.5 * math.pi else distance * angle * (1.0 - angle * angle / 6.0)
        if apart > best:
            break
        for side in range(2):
            if away == 0 and side == 1:
                continue
            j = centre + away if side == 0 else centre - away
            if j >= around:
                j -= around
            elif j < 0:
                j += around
            if j < 0 or j >= count or not ranges[j] < math.inf or abs(ranges[j] - distance) > best + LONGEST:
                continue
            best = min(best, length(x - xy[j, 0], y - xy[j, 1]))
            after = j + 1
            if after < count and ranges[after] < math.inf:
                long = length(xy[after, 0] - xy[j, 0], xy[after, 1] - xy[j, 1])
                # Only surfaces run on between beams, not jumps from one thing to the next.
                if long < max(0.08, min(6.0 * stride * min(ranges[j], ranges[after]), LONGEST)):
                    best = min(best, _off_segment(x, y, xy[j, 0], xy[j, 1], xy[after, 0], xy[after, 1]))
            if best <= enough:
                return best
    return best


@njit(cache=True, inline="always")
def _label(x, y, off, near, ranges, clear, angle_min, step):  # type: ignore[no-untyped-def]
    """How a scan sees the spot (x, y), which is `off` its outline; see `sight`."""
    if off <= near:
        return AGREES
    centre = beam_at(x, y, angle_min, step)
    if 0 <= centre < len(ranges) and not ranges[centre] < math.inf:
        return CLEAR if length(x, y) < clear[centre] else UNSEEN
    doubt = math.sqrt(max((MARGIN * near / TELLING) ** 2 - RANGE_SIGMA**2, 0.0))
    told = look(x, y, doubt, ranges, angle_min, step)
    return UNSEEN if told == AGREES else told


@njit(cache=True)
def sight(x, y, near, xy, ranges, clear, angle_min, step):  # type: ignore[no-untyped-def]
    """How a scan sees the spot (x, y): as `estimation.geometry.sight.look`, but for what is next to its outline.

    AGREES: on its outline; THROUGH: it saw through there; HIDDEN: behind what it saw; UNSEEN: no beam tells; CLEAR:
    near, and nothing came back from there.
    """
    off = off_outline(x, y, TOUCHING * near, near, xy, ranges, angle_min, step)
    return _label(x, y, off, near, ranges, clear, angle_min, step)


@njit(cache=True)
def sightings(points, near, wanted, pose, xy, ranges, clear, angle_min, step, wide=WIDE):  # type: ignore[no-untyped-def]
    """`sight` of points (n, 2) moved by pose (3,): labels (n,) and distances off the outline (n,).

    wide : the distance is told up to so many times `near`; the label alone needs no more than `TOUCHING`.
    Points that are not `wanted` (n,) are taken to be unseen and far off.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    labels, offs = np.full(len(points), UNSEEN, dtype=np.int64), wide * near
    for k in range(len(points)):
        if not wanted[k]:
            continue
        x = pose[0] + c * points[k, 0] - s * points[k, 1]
        y = pose[1] + s * points[k, 0] + c * points[k, 1]
        enough = near[k] if wide <= TOUCHING else 0.0
        offs[k] = off_outline(x, y, wide * near[k], enough, xy, ranges, angle_min, step)
        labels[k] = _label(x, y, offs[k], near[k], ranges, clear, angle_min, step)
    return labels, offs

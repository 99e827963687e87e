"""Parts of the robot that its own scanner sees, such as posts: near returns that go wherever the scanner goes.

They say of every motion that there was none. A wall alongside seems to come along as well, for as long as the scanner
does not turn. Of what is short, only somebody who keeps pace does; the robot's parts were there before him.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.geometry.poses import between
from registration.laser.scan import Scan

NEAR = 0.9  # m; farther away nothing is a part of the robot
STEADY = 0.03  # m that a reading may change by
TURN = 1.0  # rad after which a steady reading is believed
# m; a thing is short that is no longer, and stands that far before what is beside it. Where the scanner goes on by its
# length, it comes along or is seen elsewhere.
SHORT, GAP = 0.5, 0.15
FREE = 20.0  # turns and lengths, at most, after which as many are asked for of what has come to where nothing was
LEAST, MOST = 0.02, 0.3  # m or rad; less is the noise of the pose, more from scan to scan counts as that
SECTORS = 360  # of a full turn, at most; a sector has 1.5 beams or more, so that none is without


class OwnBody:
    """Learns, direction by direction, what moves with the scanner; scans may have any beams."""

    def __init__(self) -> None:
        self._ranges: FloatArray = np.zeros(0)  # (S,) m, of each sector
        # (S,) it has been steady for, in turns and lengths; negative, for which there was something else.
        self._travel: FloatArray = np.zeros(0)
        self._pose: FloatArray = np.zeros(3)

    def mask(self, scan: Scan, pose: FloatArray) -> npt.NDArray[np.bool_]:
        """Beams (N,) that end on the robot itself; pose : (3,) of the scanner, m, rad."""
        if not len(self._ranges):
            count = max(1, min(SECTORS, int(2.0 * np.pi / (1.5 * abs(scan.angle_increment)))))
            self._ranges, self._travel, self._pose = np.full(count, np.inf), np.zeros(count), pose.copy()
        motion = between(self._pose, pose)
        ahead, turned = min(math.hypot(motion[0], motion[1]), MOST), min(abs(float(motion[2])), MOST)
        if ahead + turned > LEAST:
            self._pose = pose.copy()
        else:
            ahead = turned = 0.0
        near = np.where(scan.valid, scan.ranges, np.inf)
        own = _own(near, scan.angle_min, scan.angle_increment, ahead, turned, self._ranges, self._travel)
        return np.asarray(own)

    def without(self, scan: Scan, pose: FloatArray) -> Scan:
        """A scan without the beams that end on the robot itself."""
        own = self.mask(scan, pose)
        return scan.without(own) if own.any() else scan


@numba.njit(cache=True)
def _own(ranges, first, step, ahead, turned, steady, travel):  # type: ignore[no-untyped-def]
    """Beams (N,) on the robot. `steady`, `travel` (S,) of the sectors are brought up to date."""
    size, count = len(ranges), len(steady)
    sector = np.empty(size, np.int64)
    nearest = np.full(count, np.inf)
    looked = np.zeros(count, np.bool_)
    for n in range(size):
        k = math.floor((first + n * step) * count / (2.0 * math.pi)) % count
        sector[n] = k
        looked[k] = True
        nearest[k] = min(nearest[k], ranges[n])
    same = np.zeros(count, np.bool_)
    for k in range(count):
        same[k] = nearest[k] < NEAR and abs(nearest[k] - steady[k]) < STEADY
    short = _short(nearest, same)
    known = np.zeros(count, np.bool_)
    for k in range(count):
        if same[k]:
            travel[k] = min(travel[k] + turned / TURN + (ahead / SHORT if short[k] else 0.0), 3.0)
            steady[k] += 0.1 * (nearest[k] - steady[k])
            known[k] = travel[k] > 1.0
        elif looked[k]:
            if nearest[k] < np.inf and travel[k] > 0.0:
                travel[k] = max(0.7 * travel[k] - 0.1, 0.0)
            else:
                travel[k] = max(travel[k] - turned / TURN - ahead / SHORT, -FREE)
            if nearest[k] < np.inf and travel[k] < 0.3:
                steady[k] = nearest[k]
    own = np.zeros(size, np.bool_)
    for n in range(size):
        k = sector[n]
        # The edges of a part flicker.
        own[n] = ranges[n] < NEAR and (known[k] or known[k - 1] or known[(k + 1) % count])
    return own


@numba.njit(cache=True)
def _short(nearest, same):  # type: ignore[no-untyped-def]
    """Sectors (S,) of steady things that are short and stand before what is to either side of them."""
    count = len(nearest)
    short = np.zeros(count, np.bool_)
    for begin in range(count):
        if not same[begin] or same[begin - 1]:
            continue
        end, farthest = begin, nearest[begin]
        while same[(end + 1) % count]:
            end += 1
            farthest = max(farthest, nearest[end % count])
        free = min(nearest[begin - 1], nearest[(end + 1) % count]) > farthest + GAP
        if free and (end - begin + 1) * 2.0 * math.pi / count * farthest < SHORT:
            for k in range(begin, end + 1):
                short[k % count] = True
    return short

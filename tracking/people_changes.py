"""What has come and gone within the last half second, seen by looking through places.

What moved stands where the scanner looked through before, and where it was the scanner looks through now. A wall that
slides along an edge, or the next leg of a table that is taken for the last one, does neither: there it was hidden
before, here something still stands. So three scans tell who walks, as soon as he is a part of himself farther on. That
holds as far as the poses do: walls do not move, and how much of them seems to tells how far poses are to be trusted.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from registration.scan import Scan
from tracking.legs import Clusters
from tracking.people_association import Seen
from tracking.people_sweep import Sweep
from tracking.people_tracks import BoolArray, IntArray

OLDEST, NEWEST = 0.45, 0.15  # seconds, age of the scan that is compared with
MARGIN, MARGIN_AWAY = 0.08, 0.01  # metres, and metres per metre away, that are looked through beyond a place
LITTLE, ENOUGH = 0.3, 0.6  # shares of somebody that come and go, together: of noise, and of who surely moved
SLOWEST, SURELY = 0.15, 0.35  # m/s in the slowest part of the way: no walking, and surely
# Share of walkers that move as much, and of things where walls do not seem to, and more of them while the robot drives.
WALKERS, FALSE, FALSE_DRIVING = 0.9, 0.002, 0.005
# Small things seem to move more often than returns of walls. While the robot drives WALLS_DRIVING of those do so as far
# as is known before some LOOKS looks at MOST_WALL of them; FAST as in `people_walking`.
WORSE, WALLS_DRIVING, LOOKS, MOST_WALL = 20.0, 0.02, 1.5, 80
FAST = 0.8
FORGETTING = 0.98  # of a look at walls until the next


@dataclass(frozen=True)
class Past:
    """A scan in the frame of the tracks.

    stamp s; origin (2,) m; first, step : angle of the first beam and to the next, rad; ranges (N,) m; points (N, 2) m;
    returns : of each track by name, (M, 2) m.
    """

    stamp: float
    origin: FloatArray
    first: float
    step: float
    ranges: FloatArray
    points: FloatArray
    returns: dict[int, FloatArray]

    @classmethod
    def of(cls, scan: Scan, sweep: Sweep, pose: FloatArray, stamp: float) -> Past:
        """A scan from `pose` (3,) of which nobody knows yet whose the returns are."""
        away = np.where(np.isfinite(sweep.ranges), sweep.ranges, 0.0)[:, None]
        points = sweep.origins + away * np.column_stack((np.cos(sweep.angles), np.sin(sweep.angles)))
        first, step = pose[2] + scan.angle_min, scan.angle_increment
        return cls(stamp, pose[:2].copy(), first, step, sweep.ranges, points, {})

    def given(self, clusters: Clusters, seen: Seen, whose: IntArray) -> Past:
        """The same scan with the returns of tracks; whose (K,) : name of the one that each of `seen` is of, or -1."""
        returns: dict[int, FloatArray] = {}
        for k in np.flatnonzero(whose >= 0).tolist():
            cluster = seen.index[k]
            beams = slice(int(clusters.first[cluster]), int(clusters.last[cluster]) + 1)
            mine = self.points[beams][clusters.labels[beams] == cluster]
            name = int(whose[k])
            returns[name] = np.concatenate((returns[name], mine)) if name in returns else mine
        return replace(self, returns=returns)

    def through(self, points: FloatArray) -> float:
        """Share of places (M, 2) that this scan looked through."""
        if not len(points):
            return 0.0
        return float(_through(points, self.origin, self.first, self.step, self.ranges).mean())


class Changes:
    """Remembers the scans of the last half second, and whose the returns were, and how far walls seemed to move."""

    def __init__(self) -> None:
        self._past: deque[Past] = deque()
        self._seeming = self._watched = 0.0

    def remember(self, past: Past) -> None:
        """Keep a scan for comparison."""
        self._past.append(past)
        while self._past and self._past[0].stamp < past.stamp - OLDEST:
            self._past.popleft()

    def walking(self, names: IntArray, now: Past, wall: BoolArray, robot: float) -> FloatArray:
        """Log-likelihood ratio of having walked, walkers : things, of the tracks `names` (T,).

        0 of who is not seen `now`.
        wall (N,) : returns of what is too large to walk. robot : m/s and rad/s together.
        """
        found = np.zeros(len(names))
        old = [past for past in self._past if past.stamp <= now.stamp - NEWEST]
        if not old:
            return found
        self._watch(old[0], now.points[wall])
        most = self._likelihood_ratio(robot)
        for t, name in enumerate(names.tolist()):
            found[t] = most * self._walked(name, now)
        return found

    def _walked(self, name: int, now: Past) -> float:
        """How surely what is called `name` has got ahead steadily, and wholly, since one of the scans before."""
        here = now.returns.get(name)
        seen = [past for past in self._past if name in past.returns]
        if here is None or len(seen) < 2 or seen[0].stamp > now.stamp - NEWEST:
            return 0.0
        there = seen[0].returns[name]
        way = np.array([*(past.returns[name].mean(0) for past in seen), here.mean(0)])
        times = np.array([*(past.stamp for past in seen), now.stamp])
        steady = _share(least_speed(way, times), SLOWEST, SURELY)
        if steady == 0.0:
            return 0.0
        return steady * _share(seen[0].through(here) + now.through(there), LITTLE, ENOUGH)

    def _watch(self, past: Past, wall: FloatArray) -> None:
        """How much of the walls (M, 2) seems to have come out of nowhere."""
        wall = wall[:: 1 + len(wall) // MOST_WALL]
        age = FORGETTING
        self._seeming = age * self._seeming + past.through(wall) * len(wall) / MOST_WALL
        self._watched = age * self._watched + len(wall) / MOST_WALL

    def _likelihood_ratio(self, robot: float) -> float:
        """Logarithm of how much more walkers than things move wholly."""
        unknown = WALLS_DRIVING * min(1.0, robot / FAST) * math.exp(-self._watched / LOOKS)
        walls = self._seeming / max(self._watched, 1.0) + unknown
        false = FALSE + FALSE_DRIVING * min(1.0, robot / FAST) + WORSE * walls
        return max(math.log(WALKERS / false), 0.0)


def least_speed(way: FloatArray, times: FloatArray) -> float:
    """Progress along the whole of a way (K, 2) in the slowest half or, where there are more steps, third of it, m/s."""
    whole = way[-1] - way[0]
    length = math.hypot(whole[0], whole[1])
    if length == 0.0:
        return 0.0
    marks = np.linspace(times[0], times[-1], min(len(way), 4))
    along = np.interp(marks, times, (way - way[0]) @ whole / length)
    return float(np.min(np.diff(along)) / (marks[1] - marks[0]))


def _share(value: float, low: float, high: float) -> float:
    """0 up to `low`, 1 from `high` on."""
    return min(max((value - low) / (high - low), 0.0), 1.0)


@njit(cache=True)
def _through(points, origin, first, step, ranges):  # type: ignore[no-untyped-def]
    """Whether a scan looked through each of some points (M, 2): the beam to it and its neighbours ended beyond."""
    found = np.zeros(len(points), dtype=np.bool_)
    around = max(1, round(2.0 * math.pi / abs(step)))
    for k in range(len(points)):
        dx, dy = points[k, 0] - origin[0], points[k, 1] - origin[1]
        away = math.hypot(dx, dy)
        turn = (math.atan2(dy, dx) - first) * (1.0 if step > 0.0 else -1.0)
        middle = round((turn % (2.0 * math.pi)) / abs(step))
        margin = MARGIN + MARGIN_AWAY * away
        clear = True
        for beam in range(middle - 1, middle + 2):
            b = beam % around
            if b >= len(ranges) or not ranges[b] > away + margin:
                clear = False
                break
        found[k] = clear
    return found

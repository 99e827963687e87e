"""Who walks steadily: the quickest evidence of being a person.

Furniture does not walk. What seems to move as the robot drives is one end of a wall that slides, or the next leg of a
table: it goes in jerks. Somebody who got ahead in each third of the last half second walks; while the robot stands
hardly anything else does so.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from estimation.poses import between
from tracking.people_tracks import TRAIL, Tracks

APART = 0.095  # seconds between the places that are remembered, at least
WINDOW = 0.65  # seconds looked back
LEAST = 0.25  # seconds that somebody must have been seen for
SLOWEST, SURELY = 0.15, 0.35  # m/s in the slowest third: below it is no walking, above it surely is
FREE = 0.15  # metres in front of the surroundings at both ends: what is seen is not cut off by anything
# Share of tracks of things that seem to walk: those in the open, added by being cut off, and by the robot's own motion.
FALSE_FREE, FALSE_CUT, FALSE_CROWD, FALSE_DRIVING = 0.0005, 0.0025, 0.03, 0.9
WALKERS = 0.9  # share of people who walk that show it
FAST = 0.8  # m/s and rad/s together: as fast as the robots at which FALSE_DRIVING was measured
STOOD_A_LITTLE = 0.2  # oldness of a thing that may have stood there all the time
STOOD, MOVING = 0.5, 0.25  # oldness of what surely is a thing, and m/s at which it seems to walk
MEMORY, FEW = 10.0, 100.0  # seconds for which that counts, and looks at things before it tells much
WORSE = 3.0  # how much more what is seen for the first time seems to move
LEAST_WAY, WHOLE_WAY = (
    0.1,
    0.25,
)  # metres: up to the first an estimate moves by itself, the second is a way walked
PROVEN, FORGETTING = 1.0, 2.0  # seconds of walking that prove it for good, and for which less is believed
LONGER, LITTLE = (
    0.6,
    2.0,
)  # what going on walking adds to half a second of it, where that tells more than a little
MANY = 20  # things in view: as many as where it was measured; jerks need neighbours to jerk to


class Walking:
    """Remembers where everybody was lately, and how fast the robot was."""

    def __init__(self) -> None:
        self.times = np.full(TRAIL, np.nan)
        self._since = math.inf
        self._robot = 0.0
        self._known = True
        self._moving = self._things = 0.0

    def drive(self, pose: FloatArray, before: FloatArray | None, dt: float, known: bool = True) -> None:
        """The robot got from `before` to `pose`, (3,) each, in `dt` seconds, if that is `known`."""
        self._known = known
        if before is not None and dt > 0.0:
            step = between(before, pose)
            rate = min(float(np.hypot(step[0], step[1]) + abs(step[2])) / dt, 5.0)
            self._robot += (1.0 - math.exp(-dt / 0.3)) * (rate - self._robot)

    def due(self, dt: float) -> bool:
        """Whether `learn`, `dt` seconds after it was last called, looks at anybody."""
        return self._since + dt >= APART

    @property
    def robot(self) -> float:
        """Speed of the robot, m/s and rad/s together; infinite while nobody knows."""
        return self._robot if self._known else math.inf

    def learn(
        self,
        tracks: Tracks,
        free: FloatArray,
        old: FloatArray,
        around: int,
        stamp: float,
        dt: float,
        moved: FloatArray | float = 0.0,
    ) -> None:
        """Evidence of walking for those seen now.

        free (T,) : metres by which the clusters of each stand in front of the surroundings, the lesser of both ends;
        nan of who is not seen. old (T,) : share of them where something stood. around : clusters in view.
        moved (T,) : log-likelihood ratio of having come and gone (`people_changes`).
        """
        self._since += dt
        if self._since < APART:
            return
        since, self._since = self._since, 0.0
        self.times = np.append(self.times[1:], stamp)
        tracks.trails = np.concatenate((tracks.trails[:, 1:], tracks.means[:, None, :2]), axis=1)
        looking = np.flatnonzero(np.isfinite(free) & (tracks.existence > 2.0))
        speeds = np.zeros(len(tracks))
        speeds[looking] = steady_speeds(tracks.trails[looking], self.times)
        things = looking[~tracks.shown[looking] & (old[looking] > STOOD) & (tracks.age[looking] > 1.0)]
        self._count(int(np.sum(speeds[things] > MOVING)), len(things), min(since, 1.0))
        tracks.walking *= math.exp(-min(since, 1.0) / FORGETTING)
        shares = np.clip((speeds - SLOWEST) / (SURELY - SLOWEST), 0.0, 1.0) * (1.0 - old)
        seen = np.zeros(len(tracks))
        seen[looking] = 1.0
        moved = moved * seen * np.maximum(1.0 - np.maximum(old, tracks.oldness) / STOOD_A_LITTLE, 0.0)
        for t in np.flatnonzero((shares > 0.0) | (moved > 0.0)).tolist():
            ratio = max(shares[t] * self._likelihood_ratio(float(free[t]), around), moved[t])
            tracks.walking[t] = max(tracks.walking[t], ratio)
            # What walked but for a moment is forgotten, who walked for longer never.
            earned = tracks.motion[t] + ratio * min(since, 1.0) / PROVEN
            tracks.motion[t] = max(tracks.motion[t], min(earned, ratio + LONGER * max(ratio - LITTLE, 0.0)))

    def _count(self, moving: int, things: int, since: float) -> None:
        """How many of the things that stand there seem to move."""
        keep = math.exp(-since / MEMORY)
        self._moving, self._things = keep * self._moving + moving, keep * self._things + things

    def _likelihood_ratio(self, free: float, around: int) -> float:
        """Logarithm of how much more people than things walk steadily."""
        if not self._known:
            return 0.0
        false = FALSE_FREE + (FALSE_CUT if free < FREE else 0.0)
        crowd = min(1.0, around / MANY) ** 3
        false += (FALSE_CROWD + FALSE_DRIVING * min(1.0, self._robot / FAST) ** 2) * crowd
        false += WORSE * self._moving / (FEW + self._things)
        return max(math.log(WALKERS / false), 0.0)


@njit(cache=True)
def steady_speeds(trails, times):  # type: ignore[no-untyped-def]
    """Progress along the whole way in the slowest third of it, m/s (T,); 0 for those seen too shortly.

    trails (T, H, 2) : places, m, nan before somebody was there. times (H,) : seconds, nan for none.
    """
    # Places are estimates: they settle without anything having moved.
    count, most = trails.shape[0], trails.shape[1]
    speeds = np.zeros(count)
    marks = np.zeros((4, 2))
    for t in range(count):
        first = most - 1
        while first > 0 and times[first - 1] >= times[-1] - WINDOW and math.isfinite(trails[t, first - 1, 0]):
            first -= 1
        span = times[-1] - times[first]
        if most - first < 3 or not span >= LEAST:
            continue
        for k in range(4):
            time = times[first] + span * k / 3.0
            i = first
            while i < most - 2 and times[i + 1] < time:
                i += 1
            share = min(max((time - times[i]) / (times[i + 1] - times[i]), 0.0), 1.0)
            marks[k] = (1.0 - share) * trails[t, i] + share * trails[t, i + 1]
        way = marks[3] - marks[0]
        length = math.hypot(way[0], way[1])
        if length < 1e-6:
            continue
        least = math.inf
        for k in range(3):
            step = marks[k + 1] - marks[k]
            least = min(least, step[0] * way[0] + step[1] * way[1])
        settled = min(max((length - LEAST_WAY) / (WHOLE_WAY - LEAST_WAY), 0.0), 1.0)
        speeds[t] = settled * least / length * 3.0 / span
    return speeds

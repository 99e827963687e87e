"""Where in a finished map: tracking from a known pose, and finding it again without one; scans and clouds alike.

What was seen over the last metres is laid on what the map shows (`loop_closure.maps.map_search`). While the
place is known, only its surroundings are searched; lost, every part of the map is, and a place is believed
once several keyframes along the path agree on it and no other place has as much for itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_own, require_kind, require_positive
from estimation.errors import InputError
from loop_closure.graph.uncertainty import FOUND
from loop_closure.keyframes import AROUND, MOST, Keyframes
from loop_closure.maps.map_search import Placed, PlanarMap, SpatialMap
from loop_closure.motions import as_pose, compose, invert, length, motion, planar, positions, turns
from registration.laser.own_body import OwnBody
from registration.laser.scan import Scan
from registration.laser.sweep import at_first_beam

AGREE = (0.4, 0.1)  # metres and radians between placements that say the same
VOTES = 3  # keyframes that have to agree before a lost robot believes it
# Metres of path over which they have to: local maps of neighbouring keyframes are nearly the same, and one place that
# looks like another does so again 0.3 m on. Half of what they show is new then.
SPAN = 0.5 * AROUND
LONG = 4.0  # s between scans from which on all is due, as where scans have no stamps
MEMORY = 60  # keyframes for which a vote counts
LOST_AFTER = 8.0  # metres of standard deviation beyond which the place is given up
# Metres of path after which a pose that was said, and never seen to be true, is given up. One that was found is sooner:
# a part of the building that the map has not may look like one that it has, but not for long. It is given up once more
# of the path since then went without confirmation than with, until it was confirmed over as many metres.
UNPROVEN = 10.0
# Parts of the map a lost robot is laid on: half a processor's time, as one takes 10 to 50 ms.
PER_SECOND = 10.0
SAID, FOLLOWED = (
    (1.0, 0.35),
    (0.05, 0.02),
)  # m and rad by which a pose may be off that was said, and that was followed
DRIFT = (0.03, 0.01)  # metres and radians that odometry is taken to be off per metre


@dataclass(frozen=True, eq=False)
class Located:
    """One scan or cloud against the map.

    pose : (3,) or (4, 4) in the map, None while lost. sure : it was confirmed by this scan.
    """

    pose: FloatArray | None
    sure: bool


@dataclass(frozen=True, eq=False)
class _Vote:
    """One placement of a lost robot's keyframe: the odometry frame in the map, metres of outline, keyframe, path."""

    correction: FloatArray
    merit: float
    serial: int
    path: float


class Localizer:
    """Follows a range sensor in a map of keyframes that is not changed.

    places : keyframes of the map; poses (N, 3) or (N, 4, 4) of them in the map. initial : as for `place`.
    """

    def __init__(self, places: Keyframes, poses: FloatArray, initial: FloatArray | None = None) -> None:
        require_kind("places", places, Keyframes)
        self._poses = as_own("poses", poses, (len(places), 3), (len(places), 4, 4))
        self._map: PlanarMap | SpatialMap
        self._map = (PlanarMap if planar(self._poses) else SpatialMap)(places, self._poses)
        self._recent, self._own = Keyframes(), OwnBody()
        self.correction: FloatArray | None = None  # the odometry frame in the map
        self._sigma, self._turn = SAID
        self._unproven = 0.0  # metres travelled without confirmation by the map, over those with it
        self._credit = 0.0  # and how many of them it takes to give the pose up
        self._votes: list[_Vote] = []
        self._serial, self._path = 0, 0.0
        # Placements of the newest keyframe that are still to be looked for, its odometry, and of how many now.
        self._looking: Iterator[Placed] | None = None
        self._key, self._due = np.zeros(3), 0.0
        self._pending: FloatArray | None = None
        self._before: tuple[FloatArray, float] | None = None  # odometry and stamp of the last scan
        if initial is not None:
            self.place(initial)

    def __getstate__(self) -> dict[str, Any]:
        """For copies: a search that is under way begins anew with the next keyframe."""
        return self.__dict__ | {"_looking": None}

    def place(self, pose: npt.ArrayLike, sigma: float = SAID[0], turn: float = SAID[1]) -> None:
        """The sensor is said to be at `pose` in the map, give or take `sigma` m and `turn` rad.

        pose : (3,), in a map of clouds on the ground that the map has there; or there (4, 4). What the map does not
        confirm within 10 m of path is given up.

        Raises
        ------
        InputError : another shape, or numbers that are not finite.
        """
        said, sigma, turn = (
            as_pose("pose", pose),
            require_positive("sigma", sigma),
            require_positive("turn", turn),
        )
        if planar(self._poses) and not planar(said):
            raise InputError("pose: (3,) expected in a map of scans, got (4, 4)")
        self._pending = self._map.on_the_ground(said)
        self._sigma, self._turn = sigma, turn
        self._votes.clear()

    def process(self, scan: Scan | npt.ArrayLike, odometry: npt.ArrayLike) -> Located:
        """Take the next scan, or cloud (N, 3), with the pose (3,) or (4, 4) of the sensor by odometry.

        Raises
        ------
        InputError : wrong shapes, numbers that are not finite, a scan in a map of clouds or a cloud in one of scans.
        """
        here = as_pose("odometry", odometry)
        if isinstance(scan, Scan) != planar(self._poses) or planar(here) != planar(self._poses):
            kind = "a Scan and (3,)" if planar(self._poses) else "a cloud and (4, 4)"
            raise InputError(f"scan: {kind} expected in this map")
        if isinstance(scan, Scan):
            scan = self._own.without(scan, here)
        if self._pending is not None:
            self.correction = compose(self._pending, invert(here))
            self._pending = None
            self._recent, self._unproven, self._credit, self._looking = Keyframes(), 0.0, UNPROVEN, None
        before, self._before = self._before, (here, scan.stamp if isinstance(scan, Scan) else 0.0)
        self._due = self._due if self._looking else 0.0
        if before is not None:
            elapsed = self._before[1] - before[1]
            self._due += PER_SECOND * elapsed if 0.0 < elapsed < LONG else np.inf
        if not self._recent.wanted(here, *self._map.step):
            return self._said(here, self._look())
        if isinstance(scan, Scan) and before is not None:
            scan = at_first_beam(scan, motion(before[0], here), scan.stamp - before[1])
        travelled = length(motion(self._recent[-1].odometry, here)) if len(self._recent) else 0.0
        self._map.remember(self._recent, scan, here)
        if len(self._recent) > 4 * MOST:
            # What no local map reaches back to any more would grow for as long as the robot drives.
            self._recent.take_out(np.maximum(np.arange(len(self._recent)) - 3 * MOST, -1))
        self._serial, self._path = self._serial + 1, self._path + travelled
        self._sigma, self._turn = self._sigma + DRIFT[0] * travelled, self._turn + DRIFT[1] * travelled
        if self._sigma >= LOST_AFTER:
            self.correction = None
        sure = self.correction is not None and self._follow(here)
        self._unproven = max(self._unproven + (-travelled if sure else travelled), 0.0)
        if sure:
            self._credit = self._credit + travelled if self._credit < UNPROVEN else np.inf
        if self._unproven > self._credit:
            self.correction = None
        if self._looking is not None:
            sure = self._decide() or sure
        # Where more of the path goes without confirmation than with, the robot may have been carried away.
        if self.correction is None or self._unproven > UNPROVEN:
            self._looking = self._map.search(self._recent, self.correction is None)
            self._key = here
            sure = self._look() or sure
        return self._said(here, sure)

    def _said(self, here: FloatArray, sure: bool) -> Located:
        return Located(None if self.correction is None else compose(self.correction, here), sure)

    def _follow(self, here: FloatArray) -> bool:
        """Lay what was seen on the map around where it should be; whether that worked."""
        assert self.correction is not None
        found = self._map.track(self._recent, compose(self.correction, here), self._sigma, self._turn)
        if found is None:
            return False
        self.correction = compose(found, invert(here))
        self._sigma, self._turn = FOLLOWED
        return True

    def _look(self) -> bool:
        """Try as many parts of the map as are due, in turn; whether with the last of them a place has won."""
        while self._looking is not None and self._due >= 1.0:
            self._due -= 1.0
            placed = next(self._looking, None)
            if placed is None:
                return self._decide()
            for pose, merit in placed:
                self._votes.append(_Vote(compose(pose, invert(self._key)), merit, self._serial, self._path))
        return False

    def _decide(self) -> bool:
        """Let the placements vote; whether a place has won, and the newest keyframe is found there."""
        self._looking, here = None, self._recent[-1].odometry
        self._votes = [vote for vote in self._votes if self._serial - vote.serial < MEMORY]
        if not self._votes:
            return False
        # Compared where the robot is now: odometry may have begun far away, where the least turn moves everything.
        placed = compose(np.array([vote.correction for vote in self._votes]), here)
        agree = np.array([same(pose, placed) for pose in placed])
        groups = [self._group(row) for row in agree]
        best = max(range(len(groups)), key=lambda n: groups[n][0])
        merit, count, span = groups[best]
        rivals = [groups[n][0] for n in np.flatnonzero(~agree[best])]
        if count < VOTES or span < SPAN or max(rivals, default=0.0) >= 0.7 * merit:
            return False
        before = self.correction, self._sigma, self._turn
        self.correction = self._votes[best].correction
        self._sigma, self._turn = FOUND
        if not self._follow(here):
            self.correction, self._sigma, self._turn = before
            return False
        self._unproven = self._credit = 0.0
        self._votes.clear()
        return True

    def _group(self, agree: npt.NDArray[np.bool_]) -> tuple[float, int, float]:
        """What speaks for a pose: merit of the votes that say the same, (V,) bool, the best of each keyframe; of how
        many; over what path, m."""
        alike = [self._votes[n] for n in np.flatnonzero(agree)]
        best: dict[int, float] = {}
        for vote in alike:
            best[vote.serial] = max(best.get(vote.serial, 0.0), vote.merit)
        return sum(best.values()), len(best), alike[-1].path - alike[0].path


def same(a: FloatArray, b: FloatArray) -> npt.NDArray[np.bool_]:
    """Which placements b, (N, 3) or (N, 4, 4), say the same as a, (3,) or (4, 4); (N,)."""
    off = motion(a, b)
    return np.asarray((np.linalg.norm(positions(off), axis=-1) < AGREE[0]) & (turns(off) < AGREE[1]))

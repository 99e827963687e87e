"""Where in a finished map: tracking from a known pose, and finding it again without one.

The scans of the last metres become a local map that is laid on those of the map. While the place is known, only its
surroundings are searched; lost, every part of the map is, and a place is believed once several keyframes along the
path agree on it and no other place has as much for itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from estimation.poses import wrap_angle
from loop_closure.keyframes import Keyframes
from loop_closure.motions import compose, invert, length, motion
from registration.align_submaps import Placement, align_submaps, ambiguous
from registration.scan import Scan

BACK, AROUND = 4.0, 4.0  # metres of path in the local maps of the robot and of the map
SPACING = 3.0  # metres between places of the map that are tried when lost
MOST_TRIED = 40  # of them per keyframe
NEAR = 4.0  # metres from a place at which its local map shows the robot's surroundings
AGREE = (0.4, 0.1)  # metres and radians between corrections that say the same
VOTES = 3  # keyframes that have to agree before a lost robot believes it
LOST_AFTER = 8.0  # metres of standard deviation beyond which the place is given up
STEP = (0.3, 0.3)  # metres and radians between keyframes


@dataclass(frozen=True, eq=False)
class Located:
    """One scan against the map. pose : (3,) in the map, None while lost. sure : it was confirmed by this scan."""

    pose: FloatArray | None
    sure: bool


class Localizer:
    """Follows a planar sensor in a map of keyframes that is not changed.

    places : keyframes of the map; poses (N, 3) of them in the map.
    """

    def __init__(self, places: Keyframes, poses: FloatArray, initial: FloatArray | None = None) -> None:
        self._places, self._poses = places, np.asarray(poses, dtype=np.float64)
        self._recent = Keyframes()
        self.correction: FloatArray | None = None  # the odometry frame in the map
        self._pending = initial
        self._sigma, self._turn = 1.0, 0.35
        self._votes: list[tuple[FloatArray, float, int]] = []
        self._next = 0

    def place(self, pose: FloatArray, sigma: float = 1.0, turn: float = 0.35) -> None:
        """The robot is said to be at `pose` (3,) in the map, give or take `sigma` m and `turn` rad."""
        self._pending, self._sigma, self._turn = np.asarray(pose, dtype=np.float64), sigma, turn
        self._votes.clear()

    def process(self, scan: Scan, odometry: FloatArray) -> Located:
        """Take the next scan, with the pose (3,) of the sensor by odometry."""
        if self._pending is not None:
            self.correction = compose(self._pending, invert(odometry))
            self._pending = None
            self._recent = Keyframes()
        if not self._recent.wanted(odometry, *STEP):
            return self._said(odometry, False)
        travelled = 0.0
        if len(self._recent):
            travelled = length(motion(self._recent[len(self._recent) - 1].odometry, odometry))
        self._recent.add_scan(scan, odometry, 25.0)
        self._sigma, self._turn = self._sigma + 0.03 * travelled, self._turn + 0.01 * travelled
        source = self._recent.local_map(len(self._recent) - 1, BACK, 0.0)
        if self.correction is not None and self._sigma < LOST_AFTER:
            found = self._track(source, odometry)
            if found is not None:
                self.correction = compose(found, invert(odometry))
                self._sigma, self._turn = 0.05, 0.02
            return self._said(odometry, found is not None)
        self.correction = None
        self._search(source, odometry)
        return self._said(odometry, self.correction is not None)

    def _said(self, odometry: FloatArray, sure: bool) -> Located:
        return Located(None if self.correction is None else compose(self.correction, odometry), sure)

    def _track(self, source, odometry: FloatArray) -> FloatArray | None:  # type: ignore[no-untyped-def]
        assert self.correction is not None
        expected = compose(self.correction, odometry)
        away = np.hypot(*(self._poses[:, :2] - expected[:2]).T)
        best: tuple[Placement, int] | None = None
        tried: list[int] = []
        for j in np.argsort(away).tolist():
            if away[j] > NEAR + 2.0 * self._sigma or len(tried) == 3:
                break
            if any(np.hypot(*(self._poses[j, :2] - self._poses[o, :2])) < 0.5 * SPACING for o in tried):
                continue
            tried.append(j)
            target = self._places.local_map(j, AROUND, AROUND)
            guess = motion(self._poses[j], expected)
            fits = align_submaps(source, target, guess, 2.5 * self._sigma + 0.3, 2.5 * self._turn + 0.1)
            if not fits or not fits[0].sure or ambiguous(fits):
                continue
            if best is None or fits[0].merit > best[0].merit:
                best = fits[0], j
        return None if best is None else compose(self._poses[best[1]], best[0].pose)

    def _search(self, source, odometry: FloatArray) -> None:  # type: ignore[no-untyped-def]
        """Try parts of the map, in turn, and let them vote."""
        places = self._spread_places()
        count = min(MOST_TRIED, len(places))
        turns = [places[(self._next + n) % len(places)] for n in range(count)]
        self._next = (self._next + count) % max(len(places), 1)
        serial = len(self._recent)
        for j in turns:
            target = self._places.local_map(j, AROUND, AROUND)
            for fit in align_submaps(source, target, np.zeros(3), NEAR, np.pi):
                if fit.sure:
                    pose = compose(self._poses[j], fit.pose)
                    self._votes.append((compose(pose, invert(odometry)), fit.merit, serial))
        self._votes = [vote for vote in self._votes if serial - vote[2] < 60]
        self._elect()

    def _elect(self) -> None:
        groups: list[tuple[float, int, FloatArray]] = []
        for correction, _, _ in self._votes:
            best: dict[int, float] = {}
            for other, merit, serial in self._votes:
                if same(correction, other):
                    best[serial] = max(best.get(serial, 0.0), merit)
            groups.append((sum(best.values()), len(best), correction))
        if not groups:
            return
        merit, votes, correction = max(groups, key=lambda group: group[0])
        rival = max((g[0] for g in groups if not same(g[2], correction)), default=0.0)
        if votes >= VOTES and rival < 0.7 * merit:
            self.correction = correction
            self._sigma, self._turn = 0.2, 0.05
            self._votes.clear()

    def _spread_places(self) -> list[int]:
        chosen: list[int] = []
        for j in range(len(self._poses)):
            away = self._poses[chosen, :2] - self._poses[j, :2] if chosen else np.full((1, 2), np.inf)
            if np.hypot(*away.T).min() >= SPACING:
                chosen.append(j)
        return chosen


def same(a: FloatArray, b: FloatArray) -> bool:
    """Whether two corrections (3,) say the same."""
    return bool(
        np.hypot(*(a[:2] - b[:2])) < AGREE[0] + 0.0 and abs(wrap_angle(float(a[2] - b[2]))) < AGREE[1]
    )

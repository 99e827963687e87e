"""A finished map as a `Localizer` searches it: what was seen over the last metres, laid on what the map shows.

Scans: local map on local map by correlation, everywhere. Clouds: the classifier says which places look alike, KISS-
Matcher lays the last metres' cloud on theirs and GICP settles it; believed is what agrees both ways, also in what
stands upright: flat ground fits on all flat ground.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from loop_closure.graph.uncertainty import window
from loop_closure.keyframes import AROUND, Keyframes
from loop_closure.motions import compose, length, motion, planar, turn
from loop_closure.places.context import PREDECESSORS, context_features
from loop_closure.places.features import features_3d
from loop_closure.places.place_model import TRAINED_RANGE, shipped_model
from loop_closure.slam.closing import COMMON
from loop_closure.slam.cloud_closing import LEAF, anywhere, as_cloud, local_cloud, nearby, thinned
from registration.laser.scan import Scan
from registration.laser.submap import FAR, Submap
from registration.placement.align_submaps import Placement, align_submaps, ambiguous

Placed = list[tuple[FloatArray, float]]
"""Placements, (3,) or (4, 4) in the map, with metres of outline, or how much else, that speak for each."""

EDGE = 0.9  # of the window around where the robot should be; farther out it is not believed to be
# Places that a scan is laid on per keyframe when lost, and while a pose is known: as many then as to follow it.
MOST_TRIED, TRIED = 40, 3
# Agreeing share of what both saw that is asked where nothing predicts the place: more than rooms reach that only look
# alike, less than the right one does after furniture was moved. Set on simulated floors, with and without people and
# changes, and on fr079; 0.94 and 0.96 do about the same.
LEAST_FITNESS = 0.95
ALIKE, IN_TURN = 2, 1  # places that a cloud is laid on per keyframe when lost: those that look alike, and any
GROUND = 3.0  # metres around a pose that was said in which the map knows the ground


class PlanarMap:
    """Keyframes of scans, and poses (N, 3) of them."""

    step = (0.3, 0.3)  # metres and radians between the robot's keyframes

    def __init__(self, places: Keyframes, poses: FloatArray) -> None:
        self._places, self._poses = places, poses
        self._parts = spread(poses[:, :2])
        self._next = 0

    def on_the_ground(self, pose: FloatArray) -> FloatArray:
        """`pose` as it was said."""
        return pose

    def remember(self, recent: Keyframes, scan: Scan | npt.ArrayLike, odometry: FloatArray) -> None:
        """Keep a scan among the robot's keyframes."""
        assert isinstance(scan, Scan)
        recent.add_scan(scan, odometry, FAR)

    def track(self, recent: Keyframes, expected: FloatArray, sigma: float, turn: float) -> FloatArray | None:
        """Pose (3,) of the robot's newest keyframe, `sigma` m and `turn` rad around where it is expected."""
        source = self._seen(recent)
        away = np.hypot(*(self._poses[:, :2] - expected[:2]).T)
        best: tuple[Placement, int] | None = None
        tried: list[int] = []
        for j in np.argsort(away).tolist():
            if away[j] > AROUND + 2.0 * sigma or len(tried) == TRIED:
                break
            if any(np.hypot(*(self._poses[j, :2] - self._poses[o, :2])) < 0.5 * COMMON for o in tried):
                continue
            tried.append(j)
            target = self._places.local_map(j, AROUND, AROUND)
            guess, (reach, about) = motion(self._poses[j], expected), window(sigma, turn)
            fits = align_submaps(source, target, guess, reach, about)
            if not fits or not fits[0].sure or ambiguous(fits):
                continue
            # Where the map has changed, something at the edge may fit better than where the robot is.
            if np.abs(fits[0].pose[:2] - guess[:2]).max() > EDGE * reach:
                continue
            if best is None or fits[0].merit > best[0].merit:
                best = fits[0], j
        return None if best is None else compose(self._poses[best[1]], best[0].pose)

    def search(self, recent: Keyframes, lost: bool) -> Iterator[Placed]:
        """Placements of the robot's newest keyframe on one part of the map after the other.

        lost : whether nothing is known of where it is; only a few parts in turn are tried otherwise.
        """
        source = self._seen(recent)
        for _ in range(min(MOST_TRIED if lost else TRIED, len(self._parts))):
            j = self._parts[self._next]
            self._next = (self._next + 1) % len(self._parts)
            target = self._places.local_map(j, AROUND, AROUND)
            fits = align_submaps(source, target, np.zeros(3), AROUND, np.pi)
            yield [
                (compose(self._poses[j], fit.pose), fit.merit)
                for fit in fits
                if fit.sure and fit.fitness >= LEAST_FITNESS
            ]

    def _seen(self, recent: Keyframes) -> Submap:
        return recent.local_map(len(recent) - 1, AROUND, 0.0)


class SpatialMap:
    """Keyframes of clouds, and poses (N, 4, 4) of them."""

    step = (0.5, 0.5)

    def __init__(self, places: Keyframes, poses: FloatArray) -> None:
        self._places, self._poses = places, poses
        self._parts = spread(poses[:, :3, 3])
        self._next = 0
        # Loaded and filled when the robot is lost for the first time.
        self._looks: _Looks | None = None

    def on_the_ground(self, pose: FloatArray) -> FloatArray:
        """A planar pose (3,) at the height and with the tilt that the map has there; (4, 4) is taken as it is."""
        if not planar(pose):
            return pose
        away = np.hypot(*(self._poses[:, :2, 3] - pose[:2]).T)
        near = np.flatnonzero(away <= max(GROUND, float(away.min())))
        # Of several storeys the one nearest to height 0, which is what a planar pose says.
        ground = self._poses[near[np.argmin(np.abs(self._poses[near, 2, 3]))]] if len(near) else np.eye(4)
        up = ground[:3, 2]
        across = np.array([np.cos(pose[2]), np.sin(pose[2])])
        # Along the ground, and from above in the direction that was said.
        ahead = np.array([*across, -(across @ up[:2]) / max(up[2], 0.1)])
        ahead /= np.linalg.norm(ahead)
        out = np.eye(4)
        out[:3, :3] = np.column_stack((ahead, np.cross(up, ahead), up))
        out[:3, 3] = pose[0], pose[1], ground[2, 3]
        return out

    def remember(self, recent: Keyframes, scan: Scan | npt.ArrayLike, odometry: FloatArray) -> None:
        """Keep a cloud among the robot's keyframes."""
        assert not isinstance(scan, Scan)
        recent.add_cloud(thinned(as_cloud(scan), 0.5 * LEAF), 0.0, odometry)

    def track(self, recent: Keyframes, expected: FloatArray, sigma: float, turn_: float) -> FloatArray | None:
        """Pose (4, 4) of the robot's newest keyframe, `sigma` m and `turn_` rad around where it is expected."""
        away = np.linalg.norm(self._poses[:, :3, 3] - expected[:3, 3], axis=1)
        j = int(np.argmin(away))
        if away[j] > AROUND + 2.0 * sigma:
            return None
        source, target = self._seen(recent), local_cloud(self._places, j, AROUND, AROUND)
        guess = motion(self._poses[j], expected)
        laid = nearby(source, target, guess)
        if (laid is None or not _within(guess, laid[0], sigma, turn_)) and sigma > 0.5:
            laid = anywhere(source, target)
        if laid is None or not _within(guess, laid[0], sigma, turn_):
            return None
        return compose(self._poses[j], laid[0])

    def search(self, recent: Keyframes, lost: bool) -> Iterator[Placed]:
        """Placements of the robot's newest keyframe on one part of the map after the other.

        lost : as of `PlanarMap`; clouds are laid on few places in any case.
        """
        source = self._seen(recent)
        for j in self._turns(recent):
            laid = anywhere(source, local_cloud(self._places, j, AROUND, AROUND))
            yield [] if laid is None else [(compose(self._poses[j], laid[0]), laid[1])]

    def _seen(self, recent: Keyframes) -> FloatArray:
        return local_cloud(recent, len(recent) - 1, AROUND, 0.0)

    def _turns(self, recent: Keyframes) -> list[int]:
        """Places that look like the robot's, and the next of all, so that none is left out for ever."""
        if self._looks is None:
            self._looks = _Looks(self._places)
        points = recent[len(recent) - 1].points
        assert points is not None
        turns: list[int] = []
        for j in self._looks.alike(points):
            if all(length(motion(self._poses[j], self._poses[o])) >= COMMON for o in turns):
                turns.append(j)
            if len(turns) == ALIKE:
                break
        for _ in range(min(IN_TURN, len(self._parts))):
            turns.append(self._parts[self._next % len(self._parts)])
            self._next += 1
        return list(dict.fromkeys(turns))


class _Looks:
    """The map's clouds as the classifier knows them."""

    def __init__(self, places: Keyframes) -> None:
        self._model = shipped_model("best_3d")
        clouds = [places[k].points for k in range(len(places))]
        self._database = self._model.database(
            [features_3d(cloud, TRAINED_RANGE) for cloud in clouds if cloud is not None]
        )
        self._rows: deque[FloatArray] = deque(maxlen=PREDECESSORS + 1)

    def alike(self, points: FloatArray) -> list[int]:
        """All places of the map, the most alike to a cloud (N, 3) first; clouds are asked about in order of path."""
        if not len(points):
            return []
        self._rows.appendleft(self._model.odds(features_3d(points, TRAINED_RANGE), self._database))
        assert self._model.context is not None
        likelihood = self._model.context.score(context_features(list(self._rows)))
        return [int(j) for j in np.argsort(-likelihood, kind="stable")]


def spread(where: FloatArray) -> list[int]:
    """Places (N, 2 | 3) of which none are nearer to each other than COMMON, and all others to one of them."""
    chosen: list[int] = []
    for j in range(len(where)):
        away = where[chosen] - where[j] if chosen else np.full((1, where.shape[1]), np.inf)
        if np.linalg.norm(away, axis=1).min() >= COMMON:
            chosen.append(j)
    return chosen


def _within(guess: FloatArray, found: FloatArray, sigma: float, turn_: float) -> bool:
    off = motion(guess, found)
    reach, angle = window(sigma, turn_)
    return length(off) <= reach and turn(off) <= angle

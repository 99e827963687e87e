"""Which keyframes a map can do without: those of places that a keyframe near by shows as well.

A keyframe is looked at when the path has gone on far enough, and again if something waited for it or its place was not
known. If an older one lies so close that the newer would not have been kept right after it, their relative pose is
known, and the older one's surroundings explain what the newer one saw, then the newer one goes: the map stays where it
is. If the place has changed, the older one goes: the map shows what is there now. Either way there is one less, and the
map grows with the place and not with the time spent in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from loop_closure.keyframes import AROUND, Keyframes
from loop_closure.motions import invert, length, motion, planar, positions, turn
from loop_closure.slam.closing import Gate
from loop_closure.slam.closure_hypotheses import MEMORY
from loop_closure.slam.cloud_closing import CLOSE, LEAST_POINTS, local_cloud
from registration.clouds.cloud_registration import overlap
from registration.laser.submap import Submap, fuse
from registration.placement.align_submaps import place
from registration.placement.consistency import judge

BEHIND = MEMORY + 10.0  # metres of path after which a keyframe is looked at
BATCH = 20  # keyframes that are taken out at once
KNOWN = 0.15  # metres of standard deviation up to which a relative pose is known; and of a placement off it
SHARE = 0.75  # of the newer one's outline that the older one's surroundings have to explain
CHANGED = 0.4  # metres of outline that is new, or gone
SAME_CLOUD, HALF_CLOUD = 0.9, 0.5  # share of a cloud explained: nothing new; the same place
MOST = 4  # keyframes at one place; more are never kept, whatever they show
TRIED = 3  # older keyframes a new one is judged with


@dataclass(frozen=True)
class KeyframeSight:
    """What a newer keyframe shows of an older one's surroundings. same : the place; changed : it looks different."""

    same: bool
    changed: bool


class Thinning:
    """Decides, keyframe by keyframe, which are not needed; `gone` maps their numbers to those that stand for them."""

    def __init__(self, distance: float, angle: float, first: int = 0) -> None:
        """`distance`, `angle` : within which a scan is not worth keeping. `first` : keyframe to begin with."""
        self._distance, self._angle = distance, angle
        self._next = first
        self._later: list[int] = []  # to be looked at again: waited for, or not known where
        self.gone: dict[int, int] = {}

    def next(self, paths: FloatArray) -> list[int]:
        """Keyframes whose turn it is: one the path has left behind by now, and one that could not be told before."""
        turn = []
        if self._later:
            turn.append(self._later.pop(0))
        if self._next < len(paths) and paths[self._next] <= paths[-1] - BEHIND:
            turn.append(self._next)
            self._next += 1
        return [k for k in turn if k not in self.gone]

    @property
    def due(self) -> bool:
        """Whether enough are gone to take them out."""
        return len(self.gone) >= BATCH

    def examine(self, k: int, keyframes: Keyframes, poses: FloatArray, gate: Gate, needed: set[int]) -> None:
        """Compare keyframe `k` with older ones. needed : keyframes that must stay, in any case."""
        near = self._near(k, poses)
        if k in needed or (near and gate.sigma[near[:TRIED]].min() > KNOWN):
            self._later.append(k)
            return
        sights = {j: sight(j, k, keyframes, poses) for j in near[:TRIED] if gate.sigma[j] <= KNOWN}
        stands = next((j for j, seen in sights.items() if seen.same and not seen.changed), None)
        if stands is not None:
            self.gone[k] = stands
            return
        outdated = [j for j, seen in sights.items() if seen.same and seen.changed]
        if len(near) >= MOST:
            outdated.append(min(near))
        # The first node holds the map in its place.
        for j in outdated:
            if j not in needed and j > 0:
                self.gone.setdefault(j, k)

    def _near(self, k: int, poses: FloatArray) -> list[int]:
        """Older keyframes at the place of `k`, nearest first."""
        away = np.linalg.norm(positions(poses[:k]) - positions(poses[k]), axis=1)
        close = [int(j) for j in np.argsort(away, kind="stable") if away[j] <= self._distance]
        return [j for j in close if j not in self.gone and turn(motion(poses[j], poses[k])) <= self._angle]

    def stands_for(self, k: int) -> int:
        """The keyframe that stays in the place of `k`."""
        while k in self.gone:
            k = self.gone[k]
        return k

    def taken_out(self, number: FloatArray) -> None:
        """The keyframes in `gone` are no more; `number` (N,) are the new numbers of the others."""
        self.gone.clear()
        self._later = [int(number[k]) for k in self._later if number[k] >= 0]
        self._next = int((number[: self._next] >= 0).sum())


def sight(j: int, k: int, keyframes: Keyframes, poses: FloatArray) -> KeyframeSight:
    """Compare what keyframe `k` saw with the surroundings of the older keyframe `j`."""
    relative = motion(poses[j], poses[k])
    if not planar(poses):
        return _cloud_sight(j, k, keyframes, relative)
    newer, older = single(keyframes, k), single(keyframes, j)
    surroundings = keyframes.local_map(j, AROUND, AROUND)
    if len(newer) < 20 or len(surroundings) < 20:
        return KeyframeSight(False, False)
    found = place(newer, surroundings, relative, KNOWN)
    off = motion(relative, found.pose)
    if length(off) <= KNOWN and turn(off) <= 0.5 * KNOWN:
        relative = found.pose
    forth, back = judge(newer, surroundings, relative), judge(older, newer, invert(relative))
    outline = forth.agreeing + forth.standing + forth.unknown
    same = forth.agreeing >= SHARE * (outline - forth.standing) and forth.agreeing > forth.standing
    return KeyframeSight(same, max(forth.standing, back.standing) > CHANGED)


def single(keyframes: Keyframes, k: int) -> Submap:
    """The outline of one keyframe's scan."""
    prepared = keyframes[k].prepared
    assert prepared is not None
    return fuse([prepared], np.zeros((1, 3)))


def _cloud_sight(j: int, k: int, keyframes: Keyframes, relative: FloatArray) -> KeyframeSight:
    points = keyframes[k].points
    assert points is not None
    surroundings = local_cloud(keyframes, j, AROUND, AROUND)
    if min(len(points), len(surroundings)) < LEAST_POINTS:
        return KeyframeSight(False, False)
    share = overlap(points, surroundings, relative, CLOSE)
    return KeyframeSight(share >= HALF_CLOUD, share < SAME_CLOUD)

"""Every scan of a run, hung on a keyframe: where it was taken, by the estimate of the moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimation.checks import FloatArray
from loop_closure.keyframes import Keyframes
from loop_closure.motions import blend, compose, identity, length, motion, row, turn


@dataclass(frozen=True, eq=False)
class ScanVisit:
    """One processed scan, `step` from its keyframe.

    own : it is the keyframe. hung : the keyframe it was taken after, or the next, was taken out.
    """

    stamp: float
    keyframe: int
    step: FloatArray
    odometry: FloatArray
    own: bool = False
    hung: bool = False


class Visits:
    """Processed scans in order. every : False keeps those that became keyframes, and the last."""

    def __init__(self, every: bool = True) -> None:
        self._every = every
        self._all: list[ScanVisit] = []
        self._passing = False  # whether the last became no keyframe

    def __len__(self) -> int:
        return len(self._all)

    @property
    def last(self) -> ScanVisit:
        """The newest."""
        return self._all[-1]

    def add(self, stamp: float, keyframe: int, step: FloatArray, odometry: FloatArray, kept: bool) -> None:
        """A scan that became a keyframe (`kept`), or lies `step` from one."""
        if self._passing and not self._every:
            self._all.pop()
        self._all.append(ScanVisit(stamp, keyframe, step, odometry, kept))
        self._passing = not kept

    def restore(self, keyframes: Keyframes) -> None:
        """Those of a saved map: its keyframes."""
        frames = [keyframes[k] for k in range(len(keyframes))]
        self._all = [
            ScanVisit(f.stamp, k, identity(f.odometry), f.odometry, True) for k, f in enumerate(frames)
        ]
        self._passing = False

    def first(self) -> dict[int, int]:
        """Number of the scan that each keyframe is."""
        first: dict[int, int] = {}
        for number, visit in enumerate(self._all):
            if visit.own:
                first.setdefault(visit.keyframe, number)
        return first

    def poses(self, nodes: FloatArray, keyframes: Keyframes) -> list[FloatArray]:
        """Pose of every scan, the keyframes being at `nodes`; between keyframes corrections are blended."""
        placed = []
        for visit in self._all:
            k = visit.keyframe
            pose = nodes[k].copy() if visit.own else compose(nodes[k], visit.step)
            if k + 1 < len(nodes) and not visit.own and not visit.hung:
                whole = motion(visit.odometry, keyframes[k + 1].odometry)
                following = compose(nodes[k + 1], motion(keyframes[k + 1].odometry, visit.odometry))
                before, after = length(visit.step) + turn(visit.step), length(whole) + turn(whole)
                pose = blend(pose, following, before / max(before + after, 1e-9))
            placed.append(pose)
        return placed

    def rows(self, nodes: FloatArray, keyframes: Keyframes) -> FloatArray:
        """(N, 4) or (N, 7) stamp and pose of every scan."""
        poses = self.poses(nodes, keyframes)
        rows = [[visit.stamp, *row(pose)] for visit, pose in zip(self._all, poses, strict=True)]
        return np.array(rows) if rows else np.zeros((0, 4))

    def take_out(
        self, nodes: FloatArray, keyframes: Keyframes, number: FloatArray, stands_for: Callable[[int], int]
    ) -> None:
        """Hang what hung on keyframes that go on those that stand for them, where it is now.

        nodes, keyframes : before they go. number (N,) : new numbers of keyframes, -1 of those that go.
        """
        poses = self.poses(nodes, keyframes)
        made = []
        for n, (visit, pose) in enumerate(zip(self._all, poses, strict=True)):
            k = visit.keyframe
            leaves = number[k] < 0
            if leaves and not self._every and n < len(self._all) - 1:
                continue
            followed = visit.own or visit.hung or k + 1 == len(number) or number[k + 1] >= 0
            if not leaves and followed:
                made.append(replace(visit, keyframe=int(number[k])))
                continue
            anchor = stands_for(k) if leaves else k
            step = motion(nodes[anchor], pose)
            made.append(replace(visit, keyframe=int(number[anchor]), step=step, own=False, hung=True))
        self._all = made

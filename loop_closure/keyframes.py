"""Scans worth keeping, a step of path apart, and local maps of the path around them."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from loop_closure.growing_array import GrowingArray
from loop_closure.motions import length, motion, turn
from registration.laser.local_map import LineMap
from registration.laser.prepared import PreparedScan, prepare_scan
from registration.laser.scan import Scan
from registration.laser.submap import RADIUS, Submap, fuse

MOST = 24  # scans in one direction from the anchor: a robot that turns on the spot keeps many
AROUND = 4.0  # metres of path to either side that a local map shows
CACHED = 100  # local maps kept for the next who asks; few are asked for again later than that


@dataclass(frozen=True, eq=False)
class Keyframe:
    """One kept scan or cloud.

    stamp : seconds. odometry : pose (3,) or (4, 4) in the odometry frame. path : metres travelled until here.
    scan, prepared : None of a cloud. points : of a cloud (N, 3) metres, None of a scan. number : counted since the
    map was begun or read, whatever was taken out since.
    """

    stamp: float
    odometry: FloatArray
    path: float
    prepared: PreparedScan | None
    points: FloatArray | None = None
    scan: Scan | None = None
    number: int = 0

    @property
    def measured(self) -> Scan | FloatArray:
        """The scan or cloud."""
        kept = self.points if self.scan is None else self.scan
        assert kept is not None
        return kept


class Keyframes:
    """Kept scans in order, and local maps around them."""

    def __init__(self) -> None:
        self._frames: list[Keyframe] = []
        self._paths, self._numbers = GrowingArray(), GrowingArray((), np.int64)
        self._gap = 0.0
        self._count = 0
        # Keyframes the step to which was guessed, and its standard deviation in metres.
        self.breaks: dict[int, float] = {}
        self._workspace = LineMap(RADIUS, np.inf)
        self._cache: OrderedDict[tuple[int, ...], Submap] = OrderedDict()

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, k: int) -> Keyframe:
        return self._frames[k]

    @property
    def paths(self) -> FloatArray:
        """Metres travelled until each, (N,)."""
        return self._paths.rows

    @property
    def numbers(self) -> npt.NDArray[np.int64]:
        """`Keyframe.number` of each, (N,)."""
        return self._numbers.rows

    def wanted(self, odometry: FloatArray, distance: float, angle: float) -> bool:
        """Whether a scan at `odometry` is far enough from the last one kept."""
        if not self._frames:
            return True
        step = motion(self._frames[-1].odometry, odometry)
        return length(step) >= distance or turn(step) >= angle

    def add_scan(
        self, scan: Scan, odometry: FloatArray, max_range: float, path: float | None = None
    ) -> Keyframe:
        """Keep a scan; `path` is given where it is known better than from the odometry."""
        return self._add(Keyframe(scan.stamp, odometry, 0.0, prepare_scan(scan, max_range), None, scan), path)

    def add_cloud(
        self, points: FloatArray, stamp: float, odometry: FloatArray, path: float | None = None
    ) -> Keyframe:
        """Keep a cloud (N, 3), already thinned."""
        return self._add(Keyframe(stamp, odometry, 0.0, None, points), path)

    def gap(self, metres: float) -> None:
        """The next keyframe is from another run: no local map reaches across."""
        self._gap = metres

    def break_off(self, sigma: float) -> None:
        """The step to the last keyframe was guessed, give or take `sigma` metres: no local map reaches across it."""
        self.breaks[len(self) - 1] = sigma

    def slack(self, i: int, others: npt.ArrayLike) -> FloatArray:
        """Standard deviation in metres that guessed steps between keyframe `i` and others add to their distances."""
        steps = np.zeros(len(self) + 1)
        for k, sigma in self.breaks.items():
            steps[k] = sigma**2
        summed = np.cumsum(steps)
        return np.asarray(np.sqrt(np.abs(summed[i] - summed[np.asarray(others)])))

    def parts(self, slack: float) -> npt.NDArray[np.int64]:
        """Number of the part of the path each keyframe is in, (N,); steps guessed to more than `slack` m part it."""
        parted = np.zeros(len(self), dtype=np.int64)
        parted[[k for k, sigma in self.breaks.items() if sigma > slack]] = 1
        return np.cumsum(parted)

    def _add(self, frame: Keyframe, path: float | None) -> Keyframe:
        if path is None:
            path = 0.0
            if self._frames:
                last, gap, self._gap = self._frames[-1], self._gap, 0.0
                path = last.path + gap + length(motion(last.odometry, frame.odometry))
        frame = replace(frame, path=path, number=self._count)
        self._count += 1
        self._put(frame)
        return frame

    def _put(self, frame: Keyframe) -> None:
        self._frames.append(frame)
        self._paths.append(frame.path)
        self._numbers.append(frame.number)

    def take_out(self, number: FloatArray) -> None:
        """Keep those with a new number, in order; `number` (N,) is -1 of the others."""
        stay = np.flatnonzero(number >= 0)
        breaks: dict[int, float] = {}
        for k, sigma in self.breaks.items():
            # A guessed step to what goes is part of the way to what stays after it.
            later = stay[stay >= k]
            if len(later):
                at = int(number[later[0]])
                breaks[at] = float(np.hypot(breaks.get(at, 0.0), sigma))
        self.breaks = breaks
        frames, self._frames = self._frames, []
        self._paths, self._numbers = GrowingArray(), GrowingArray((), np.int64)
        for k in stay.tolist():
            self._put(frames[k])

    def window(self, k: int, back: float, fore: float) -> tuple[int, int]:
        """First and last keyframe within `back` metres of path before `k` and `fore` after it."""
        first = last = k
        paths = self.paths
        here = paths[k]
        while first > 0 and here - paths[first - 1] <= back and k - first < MOST:
            if first in self.breaks:
                break
            first -= 1
        while last < len(self) - 1 and paths[last + 1] - here <= fore and last - k < MOST:
            if last + 1 in self.breaks:
                break
            last += 1
        return first, last

    def local_map(self, k: int, back: float, fore: float) -> Submap:
        """Fused outline of the scans around keyframe `k`, in its frame."""
        first, last = self.window(k, back, fore)
        frames = self._frames[first : last + 1]
        key = (self._frames[k].number, *(frame.number for frame in frames))
        if key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        anchor = self._frames[k].odometry
        scans = [frame.prepared for frame in frames if frame.prepared is not None]
        poses = np.array([motion(anchor, frame.odometry) for frame in frames])
        made = fuse(scans, poses, self._workspace)
        self._cache[key] = made
        if len(self._cache) > CACHED:
            self._cache.popitem(last=False)
        return made

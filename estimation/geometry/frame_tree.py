"""A tree of coordinate frames, as tf tells of it: who stands how in whom, for good or by stamp."""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import WhereaboutsError
from estimation.geometry.history import StampedHistory
from estimation.geometry.rotations import rotation_rows

SECOND = 1_000_000_000
HISTORY = 10 * SECOND
JUMP = 2 * SECOND
# Poses in the history of a frame that comes often; one that comes seldom may leap.
FREQUENT = 5


class TransformError(WhereaboutsError):
    """A transform is not to be had. `later` tells whether it may still arrive."""

    def __init__(self, message: str, later: bool) -> None:
        super().__init__(message)
        self.later = later


class NotYetError(TransformError):
    """The frames are there, but were not placed yet as late as asked for."""

    def __init__(self, message: str) -> None:
        super().__init__(message, later=True)


class MovingFrame:
    """Stamped poses of one frame in its parent over the last ten seconds, interpolated in between.

    One whose stamp lies far from the others is kept apart from them: it may be wrong, or the first of another time, and
    is only found at its own stamp. Once a second one confirms it, the history goes on from there.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self.history: StampedHistory[FloatArray] = StampedHistory(HISTORY)
        self._apart: StampedHistory[FloatArray] = StampedHistory(HISTORY)

    def insert(self, stamp: int, pose: FloatArray) -> None:
        """Add (7,) position and quaternion (x, y, z, w)."""
        if self._continues(stamp):
            self.history.insert(stamp, pose)
            self._apart.clear()
            return
        confirmed = self._apart.newest is not None and stamp >= self._apart.newest
        if not confirmed:
            self._apart.clear()
        self._apart.insert(stamp, pose)
        if confirmed:
            self._go_on()

    def _continues(self, stamp: int) -> bool:
        if self.history.newest is None:
            return True
        ahead = JUMP if len(self.history) >= FREQUENT else HISTORY
        return -JUMP <= stamp - self.history.newest <= ahead

    def _go_on(self) -> None:
        """Time is where the others were kept apart; over a short gap ahead it is the same history."""
        before, self.history = self.history, self._apart
        self._apart = StampedHistory(HISTORY)
        if (
            before.newest is not None
            and self.history.oldest is not None
            and before.newest < self.history.oldest
        ):
            for stamp, pose in before.latest(len(before)):
                self.history.insert(stamp, pose)

    def forget_after(self, stamp: int) -> None:
        """Drop what is newer than `stamp`."""
        self.history.forget_after(stamp)
        self._apart.forget_after(stamp)
        if not len(self.history):
            self.history, self._apart = self._apart, self.history

    def at(self, stamp: int) -> FloatArray:
        """The pose at a stamp in nanoseconds, (4, 4). Raises TransformError."""
        found = self.history.around(stamp) or self._apart.around(stamp)
        if found is None:
            raise self._out_of_range(stamp)
        return pose_matrix(interpolated(*found))

    def _out_of_range(self, stamp: int) -> TransformError:
        oldest, newest = self.history.oldest, self.history.newest
        assert oldest is not None
        assert newest is not None
        if stamp > newest:
            late = (stamp - newest) / SECOND
            return NotYetError(f"{self._name}: {late:.3f} s newer than the newest transform")
        return TransformError(
            f"{self._name}: {(oldest - stamp) / SECOND:.3f} s older than the oldest transform", later=False
        )


class FrameTree:
    """Frames by the names of those they stand in. A frame that is given another parent moves there."""

    def __init__(self) -> None:
        self.parents: dict[str, str] = {}
        self.moving: dict[str, MovingFrame] = {}
        self._fixed: dict[str, FloatArray] = {}

    def fix(self, child: str, parent: str, pose: FloatArray) -> None:
        """A frame stands still in its parent: pose (4, 4)."""
        self.moving.pop(child, None)
        self.parents[child], self._fixed[child] = parent, pose

    def move(self, child: str, parent: str, stamp: int, pose: FloatArray) -> None:
        """A frame was somewhere in its parent at a stamp, ns: (7,) position and quaternion (x, y, z, w)."""
        if child not in self.moving or self.parents[child] != parent:
            self._fixed.pop(child, None)
            self.parents[child] = parent
            self.moving[child] = MovingFrame(f"{child} in {parent}")
        self.moving[child].insert(stamp, pose)

    def forget_after(self, stamp: int) -> None:
        """Drop what moving frames did after a stamp, and those of which nothing is left."""
        for child, frame in list(self.moving.items()):
            frame.forget_after(stamp)
            if not len(frame.history):
                del self.parents[child], self.moving[child]

    def chain(self, frame: str) -> list[str]:
        """A frame, its parent, and so on up to the root."""
        chain = [frame]
        while chain[-1] in self.parents and self.parents[chain[-1]] not in chain:
            chain.append(self.parents[chain[-1]])
        return chain

    def knows(self, frame: str) -> bool:
        """Whether a frame stands in another, or another in it."""
        return frame in self.parents or frame in self.parents.values()

    def lookup(self, target: str, source: str, stamp: int = 0) -> FloatArray:
        """Takes coordinates in `source` to coordinates in `target` at a stamp, (4, 4).

        Raises TransformError: a frame is unknown, the two are not connected, or the stamp is out of range.
        """
        for frame in (source, target):
            if not self.knows(frame):
                raise TransformError(f"frame '{frame}' is unknown to tf", later=True)
        below, above = self.chain(source), self.chain(target)
        common = next((frame for frame in below if frame in above), None)
        if common is None:
            raise TransformError(f"frames '{source}' and '{target}' are not connected in tf", later=True)
        up = self._in(common, below, stamp)
        if common == target:
            return up
        down = self._in(common, above, stamp)
        turn = down[:3, :3].T
        back = np.eye(4)
        back[:3, :3], back[:3, 3] = turn, -turn @ down[:3, 3]
        return back @ up

    def _in(self, ancestor: str, chain: list[str], stamp: int) -> FloatArray:
        """Pose (4, 4) of the first frame of a chain in one that is farther up."""
        pose = np.eye(4)
        for frame in chain[: chain.index(ancestor)]:
            pose = (self.moving[frame].at(stamp) if frame in self.moving else self._fixed[frame]) @ pose
        return pose


def pose_matrix(pose: FloatArray) -> FloatArray:
    """(4, 4) of (7,) position and unit quaternion (x, y, z, w)."""
    x, y, z, *quaternion = pose.tolist()
    rows = rotation_rows(*quaternion)
    return np.array([[*rows[0], x], [*rows[1], y], [*rows[2], z], [0.0, 0.0, 0.0, 1.0]])


def interpolated(before: FloatArray, after: FloatArray, share: float) -> FloatArray:
    """Between two poses (7,): position on the line, rotation on the shorter great circle (slerp)."""
    if share == 0.0:
        return before
    a, b = before[3:], after[3:]
    cosine = float(a @ b)
    if cosine < 0.0:
        b, cosine = -b, -cosine
    angle = np.arccos(min(cosine, 1.0))
    weights = (1.0 - share, share) if angle < 1e-6 else np.sin([(1.0 - share) * angle, share * angle])
    turn = weights[0] * a + weights[1] * b
    turn /= np.linalg.norm(turn)
    return np.concatenate(((1.0 - share) * before[:3] + share * after[:3], turn))

"""tf without tf2_ros: a buffer over pytransform3d's graph, a listener and broadcasters."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray
from pytransform3d.rotations import quaternion_slerp
from pytransform3d.transform_manager import StaticTransform, TemporalTransformManager, TimeVaryingTransform
from pytransform3d.transformations import transform_from_pq

from estimation.errors import InputError, WhereaboutsError
from estimation.geometry.history import StampedHistory
from whereabouts.nodes.messages.envelopes import FRAME, POSITION, envelope
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message

Matrix = NDArray[np.float64]
HISTORY = 10 * NANOSECONDS
JUMP = 2 * NANOSECONDS
# Transforms in the history of a pair that comes often; one that comes seldom may leap.
FREQUENT = 5
KEPT = 64
FRAMES = 5000
# s that a second parent of a frame is remembered after it was heard last.
CONTRADICTED = 10.0


class TransformError(WhereaboutsError):
    """A transform is not to be had. `later` tells whether it may still arrive."""

    def __init__(self, message: str, later: bool) -> None:
        super().__init__(message)
        self.later = later


class MovingTransform(TimeVaryingTransform):
    """Stamped transforms of one frame pair over the last ten seconds, interpolated in between.

    One whose stamp lies far from the others is kept apart from them: it may be wrong, or the first of another time, and
    is only found at its own stamp. Once a second one confirms it, the history goes on from there.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self.history: StampedHistory[Matrix] = StampedHistory(HISTORY)
        self._apart: StampedHistory[Matrix] = StampedHistory(HISTORY)

    def insert(self, stamp: int, pose: Matrix) -> None:
        """Add (7,) position and quaternion (w, x, y, z)."""
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

    def as_matrix(self, query_time: Any) -> Matrix:
        """The transform at a stamp in nanoseconds, (4, 4)."""
        found = self.history.around(query_time) or self._apart.around(query_time)
        if found is None:
            raise self._out_of_range(query_time)
        before, after, share = found
        position = (1.0 - share) * before[:3] + share * after[:3]
        rotation = quaternion_slerp(before[3:], after[3:], share, shortest_path=True) if share else before[3:]
        return np.asarray(transform_from_pq(np.concatenate((position, rotation))))

    def _out_of_range(self, stamp: int) -> TransformError:
        oldest, newest = self.history.oldest, self.history.newest
        assert oldest is not None
        assert newest is not None
        if stamp > newest:
            ahead = (stamp - newest) / NANOSECONDS
            return TransformError(f"{self._name}: {ahead:.3f} s newer than the newest transform", later=True)
        behind = (oldest - stamp) / NANOSECONDS
        return TransformError(f"{self._name}: {behind:.3f} s older than the oldest transform", later=False)

    def check_transforms(self) -> MovingTransform:
        return self


class TransformBuffer:
    """Transforms between frames, by stamp. Never blocks: what is not there is an error that says so."""

    def __init__(self) -> None:
        self._graph = TemporalTransformManager(check=False)
        self._parents: dict[str, str] = {}
        self._fixed: dict[str, str] = {}  # parents that tf_static has named
        self._rivals: dict[
            str, tuple[frozenset[str], float]
        ] = {}  # two parents of a frame, and when heard last, s
        self._moving: dict[str, MovingTransform] = {}
        # What was looked up since the last transform came: whether a message can be handled, and then by its handler.
        self._found: dict[tuple[str, str, int], Matrix] = {}

    def insert(self, message: TransformStamped, static: bool = False) -> None:
        """Add one transform of a tf or tf_static message.

        Raises
        ------
        InputError : frames empty or equal, numbers outside of the envelope, or the quaternion is not of unit length.
        """
        parent, child = frame_name(message.header.frame_id), frame_name(message.child_frame_id)
        if not parent or not child or parent == child:
            raise InputError(f"transform from '{child}' to '{parent}': two different frames expected")
        try:
            envelope(TransformStamped).check(message)
            pose = pose_of(message.transform.translation, message.transform.rotation)
        except InputError as error:
            raise InputError(f"transform from '{child:.{FRAME}}' to '{parent:.{FRAME}}': {error}") from None
        self._found.clear()
        known = self._parents.get(child)
        if known is None and len(self._parents) >= FRAMES:
            raise InputError(f"transform from '{child}' to '{parent}': {FRAMES} frames are known already")
        if known is not None and known != parent:
            self._graph.remove_transform(child, known)
            self._moving.pop(child, None)
        self._note_parents(child, parent, known, static)
        self._parents[child] = parent
        if static:
            self._moving.pop(child, None)
            self._graph.add_transform(child, parent, StaticTransform(transform_from_pq(pose)))
            return
        if child not in self._moving:
            self._moving[child] = MovingTransform(f"{child} in {parent}")
            self._graph.add_transform(child, parent, self._moving[child])
        self._moving[child].insert(nanoseconds(message.header.stamp), pose)

    def _note_parents(self, child: str, parent: str, known: str | None, static: bool) -> None:
        """Remember two different parents of one frame. tf_static says its own only once."""
        other = known if known not in (None, parent) else self._fixed.get(child, parent)
        if other is not None and other != parent:
            self._rivals[child] = frozenset((parent, other)), time.monotonic()
        if static:
            self._fixed[child] = parent

    def parent(self, child: str) -> str | None:
        """Parent of a frame, as last heard; that of tf_static where there are two."""
        name = frame_name(child)
        return self._fixed.get(name, self._parents.get(name))

    def contradictions(self) -> list[str]:
        """A sentence for each frame that was given two parents within the last seconds."""
        now = time.monotonic()
        return [
            f"frame '{child}' has two parents: {' and '.join(repr(name) for name in sorted(parents))}"
            for child, (parents, heard) in sorted(self._rivals.items())
            if now - heard < CONTRADICTED
        ]

    def lookup(self, target: str, source: str, stamp: int) -> Matrix:
        """Transform that takes coordinates in `source` to coordinates in `target` at `stamp`, (4, 4).

        Raises
        ------
        TransformError : a frame is unknown, the two are not connected, or the stamp is out of range.
        """
        target, source = frame_name(target), frame_name(source)
        if target == source:
            return np.eye(4)
        found = self._found.get((target, source, stamp))
        if found is None:
            if len(self._found) >= KEPT:
                self._found.clear()
            found = self._found[target, source, stamp] = self._compose(target, source, stamp)
        return found.copy()

    def _compose(self, target: str, source: str, stamp: int) -> Matrix:
        for frame in (source, target):
            if not self._graph.has_frame(frame):
                raise TransformError(f"frame '{frame}' is unknown to tf", later=True)
        try:
            found = np.asarray(self._graph.get_transform_at_time(source, target, stamp))
        except KeyError:
            message = f"frames '{source}' and '{target}' are not connected in tf"
            raise TransformError(message, later=True) from None
        if not np.abs(found[:3, 3]).max() <= POSITION:
            raise TransformError(f"'{source}' is farther than {POSITION:g} m from '{target}'", later=False)
        return found

    def newest(self, target: str, source: str) -> int | None:
        """Newest stamp at which `source` is known in `target`, ns; 0 where nothing moves, None if not connected."""
        above, below = self._chain(frame_name(target)), self._chain(frame_name(source))
        if above[-1] != below[-1] or not all(self._graph.has_frame(chain[0]) for chain in (above, below)):
            return None
        between = set(above).symmetric_difference(below)
        stamps = [self._moving[child].history.newest for child in between if child in self._moving]
        return min((stamp for stamp in stamps if stamp is not None), default=0)

    def _chain(self, frame: str) -> list[str]:
        """A frame, its parent, and so on up to the root."""
        chain = [frame]
        while chain[-1] in self._parents and self._parents[chain[-1]] not in chain:
            chain.append(self._parents[chain[-1]])
        return chain

    def back_to(self, stamp: int) -> None:
        """Time jumped back to `stamp`: drop moving transforms of the time after it. Static ones stay."""
        self._found.clear()
        for child, transform in list(self._moving.items()):
            transform.forget_after(stamp + JUMP)
            if not len(transform.history):
                self._graph.remove_transform(child, self._parents.pop(child))
                del self._moving[child]


def frame_name(name: str) -> str:
    """A frame without the leading slash that old drivers and bags put there."""
    return name.lstrip("/")


def pose_of(t: Any, r: Any) -> Matrix:
    """Position and quaternion (w, x, y, z) of a message's position and orientation, checked, (7,)."""
    pose = [t.x, t.y, t.z, r.w, r.x, r.y, r.z]
    length = math.hypot(*pose[3:])
    if abs(length - 1.0) > 0.01:
        raise InputError(f"quaternion of length 1 expected, got length {length:.3g}")
    return np.array([*pose[:3], *(part / length for part in pose[3:])])


def transform_message(parent: str, child: str, stamp: int, pose: Iterable[float]) -> TransformStamped:
    """Transform of `child` in `parent` from (7,) x, y, z and quaternion x, y, z, w."""
    message = TransformStamped()
    message.header.stamp = time_message(stamp)
    message.header.frame_id = parent
    message.child_frame_id = child
    x, y, z, qx, qy, qz, qw = (float(value) for value in pose)
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = x, y, z
    rotation.x, rotation.y, rotation.z, rotation.w = qx, qy, qz, qw
    return message

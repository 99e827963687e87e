"""tf without tf2_ros: a buffer of what was heard, checked, messages to send, and who says where a frame is."""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Iterable
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.frame_tree import JUMP, FrameTree, NotYetError, TransformError, pose_matrix
from whereabouts.nodes.messages.envelopes import FRAME, POSITION, envelope
from whereabouts.nodes.messages.stamps import nanoseconds, time_message

Pairs = tuple[tuple[str, str], ...]  # (target, source)
KEPT = 64
FRAMES = 5000
# s that a second parent of a frame is remembered after it was heard last.
CONTRADICTED = 10.0


class TransformBuffer:
    """Transforms between frames, by stamp. Never blocks: what is not there is an error that says so."""

    def __init__(self) -> None:
        self._tree = FrameTree()
        self._fixed: dict[str, str] = {}  # parents that tf_static has named
        # Two parents of a frame, and when they were heard last, s.
        self._rivals: dict[str, tuple[frozenset[str], float]] = {}
        # What was looked up since the last transform came: whether a message can be handled, and then by its handler.
        self._found: dict[tuple[str, str, int], Array] = {}

    def insert(self, message: TransformStamped, static: bool = False) -> None:
        """Add one transform of a tf or tf_static message.

        Raises InputError: frames empty or equal, numbers outside of the envelope, or the quaternion is not of unit
        length.
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
        known = self._tree.parents.get(child)
        if known is None and len(self._tree.parents) >= FRAMES:
            raise InputError(f"transform from '{child}' to '{parent}': {FRAMES} frames are known already")
        self._note_parents(child, parent, known, static)
        if static:
            self._tree.fix(child, parent, pose_matrix(pose))
        else:
            self._tree.move(child, parent, nanoseconds(message.header.stamp), pose)

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
        return self._fixed.get(name, self._tree.parents.get(name))

    def contradictions(self) -> list[str]:
        """A sentence for each frame that was given two parents within the last seconds."""
        now = time.monotonic()
        return [
            f"frame '{child}' has two parents: {' and '.join(repr(name) for name in sorted(parents))}"
            for child, (parents, heard) in sorted(self._rivals.items())
            if now - heard < CONTRADICTED
        ]

    def lookup(self, target: str, source: str, stamp: int) -> Array:
        """Transform that takes coordinates in `source` to coordinates in `target` at `stamp`, (4, 4).

        Raises TransformError: a frame is unknown, the two are not connected, or the stamp is out of range.
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

    def are_ready(self, needed: Pairs, stamp: int) -> bool:
        """Whether all of `needed` are there; True also where waiting would not help: a look-up then says why."""
        try:
            for target, source in needed:
                self.lookup(target, source, stamp)
        except TransformError as error:
            return not error.later
        except Exception:
            return True
        return True

    def missing(self, needed: Pairs, stamp: int) -> str:
        """A sentence on the first of `needed` that is not there."""
        for target, source in needed:
            try:
                self.lookup(target, source, stamp)
            except TransformError as error:
                late = isinstance(error, NotYetError)
                advice = (
                    "tf is late, see transform_timeout, or clocks differ"
                    if late
                    else "is it on tf or tf_static?"
                )
                return f"no transform from '{source}' to '{target}': {error}; {advice}"
        return "transform arrived too late"

    def _compose(self, target: str, source: str, stamp: int) -> Array:
        found = self._tree.lookup(target, source, stamp)
        if not np.abs(found[:3, 3]).max() <= POSITION:
            raise TransformError(f"'{source}' is farther than {POSITION:g} m from '{target}'", later=False)
        return found

    def newest(self, target: str, source: str) -> int | None:
        """Newest stamp at which `source` is known in `target`, ns; 0 where nothing moves, None if not connected."""
        tree = self._tree
        above, below = tree.chain(frame_name(target)), tree.chain(frame_name(source))
        if above[-1] != below[-1] or not all(tree.knows(chain[0]) for chain in (above, below)):
            return None
        between = set(above).symmetric_difference(below)
        stamps = [tree.moving[child].history.newest for child in between if child in tree.moving]
        return min((stamp for stamp in stamps if stamp is not None), default=0)

    def back_to(self, stamp: int) -> None:
        """Time jumped back to `stamp`: drop moving transforms of the time after it. Static ones stay."""
        self._found.clear()
        self._tree.forget_after(stamp + JUMP)


def frame_name(name: str) -> str:
    """A frame without the leading slash that old drivers and bags put there."""
    return name.lstrip("/")


def check_frame(what: str, frame: str, map_frame: str) -> None:
    """Raises InputError where something that has to be in the frame of the map is in another."""
    if frame_name(frame) != frame_name(map_frame):
        raise InputError(f"{what} is in frame '{frame}', expected '{map_frame}' (map_frame)")


def pose_of(t: Any, r: Any) -> Array:
    """Position and quaternion (x, y, z, w) of a message's position and orientation, checked, (7,)."""
    pose = [t.x, t.y, t.z, r.x, r.y, r.z, r.w]
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


# Of a node's own transforms, to know them when they come back.
REMEMBERED = 500
# Foreign transforms from which on somebody else is sure to publish them: one may be left over from before a restart.
SURE = 3


class FrameOwner:
    """Decides whether a node may publish `parent` -> `child`.

    withheld : why it may not, as a sentence; empty while it may.
    """

    def __init__(self, parent: str, child: str) -> None:
        self._parent, self._child = frame_name(parent), frame_name(child)
        self._own: OrderedDict[int, None] = OrderedDict()
        self._foreign = 0
        self.withheld = ""

    def hear(self, message: TFMessage) -> None:
        """Look at what comes on tf, for the same transform by somebody else."""
        for item in message.transforms:
            if frame_name(item.child_frame_id) != self._child:
                continue
            same = frame_name(item.header.frame_id) == self._parent
            if same and nanoseconds(item.header.stamp) not in self._own:
                self._foreign += 1

    def takes(self, stamp: int, transforms: TransformBuffer) -> bool:
        """Whether the node may publish its transform of `stamp`, ns; it is taken to do so then."""
        link = f"'{self._parent}' -> '{self._child}'"
        parent = transforms.parent(self._child)
        if parent not in (None, self._parent):
            chain = [parent]
            while (above := transforms.parent(chain[-1])) and above not in (self._parent, *chain):
                chain.append(above)
            self.withheld = (
                f"the transform {link} is withheld: '{self._child}' has the parent '{parent}' already. Set base_frame: "
                f"{chain[-1]} for all nodes, or publish_tf: false for this one"
            )
        elif self._foreign >= SURE:
            self.withheld = (
                f"the transform {link} is withheld: somebody else publishes it. Set publish_tf: false, or switch "
                "it off there"
            )
        if self.withheld:
            return False
        self._own[stamp] = None
        while len(self._own) > REMEMBERED:
            self._own.popitem(last=False)
        return True

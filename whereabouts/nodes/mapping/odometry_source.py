"""Where the robot is by odometry: what messages say, or the transform from the odometry frame.

A base that publishes its own transform keeps it. Scan registration beside it then only sends messages, in a frame that
begins elsewhere and drifts otherwise. A map is made along the messages, and `shift` takes it back to the frame of tf.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from nav_msgs.msg import Odometry

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.frame_tree import MovingFrame, TransformError
from loop_closure.motions import invert
from whereabouts.nodes.messages.transforms import TransformBuffer, frame_name, pose_of

Source = Literal["auto", "tf", "messages"]


class OdometrySource:
    """One pose per scan, without a jump where one source takes over from the other.

    source : "auto" takes messages where they are to be had, else tf. base_frame : of the robot.

    Attributes
    ----------
    shift : (4, 4), the odometry frame of tf in the frame of the poses; None where both are the same.
    kind : where the last pose came from, "messages" or "tf".
    """

    def __init__(self, source: Source, base_frame: str) -> None:
        self._source, self._base = source, frame_name(base_frame)
        self.clear()

    def clear(self) -> None:
        self._heard = MovingFrame("odometry")
        self._child = self._base
        self._offset: Array | None = None
        self._last: tuple[Array, Array] | None = None
        self.shift: Array | None = None
        self.kind = ""

    def take(self, message: Odometry, stamp: int) -> None:
        """A message. Raises InputError where its pose is none."""
        if self._source == "tf":
            return
        self._heard.insert(stamp, pose_of(message.pose.pose.position, message.pose.pose.orientation))
        self._child = frame_name(message.child_frame_id) or self._base

    def pose(self, stamp: int, by_tf: Array, transforms: TransformBuffer) -> Array:
        """Pose (4, 4) of the robot at `stamp`. by_tf : the same by tf.

        Raises
        ------
        InputError : messages are the only source, and there is none at that time.
        """
        raw, kind = self._by_messages(stamp, transforms), "messages"
        if raw is None:
            if self._source == "messages":
                raise InputError("no message on odometry at its stamp, and odometry_source is 'messages'")
            raw, kind = by_tf, "tf"
        if self._last is not None and kind != self.kind:
            used, before = self._last
            self._offset = used @ invert(before) @ by_tf @ invert(raw)
        self.kind = kind
        pose = raw if self._offset is None else self._offset @ raw
        self._last = pose, by_tf
        self.shift = None if np.array_equal(pose, by_tf) else pose @ invert(by_tf)
        return pose

    def _by_messages(self, stamp: int, transforms: TransformBuffer) -> Array | None:
        if not len(self._heard.history):
            return None
        try:
            found = self._heard.at(stamp)
            if self._child == self._base:
                return found
            return np.asarray(found @ transforms.lookup(self._child, self._base, stamp))
        except TransformError:
            return None

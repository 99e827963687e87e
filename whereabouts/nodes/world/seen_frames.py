"""From the frame in which something was seen to the world, with how uncertain the robot's pose in it was."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from whereabouts.nodes.messages.conversions import PLANAR, pose_from_message, stated_covariance
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.messages.transforms import check_frame, frame_name
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.recorded.evidence_messages import SeenFrame

# A robot pose older than this says nothing about now.
POSE_AGE = 5 * NANOSECONDS


class SeenFrames:
    """Frames of a node's messages, by tf and `robot_pose`.

    pose : stamp and covariance (3, 3) over x, y, yaw of the last one heard.
    """

    def __init__(self, node: SuiteNode, map_frame: str) -> None:
        self._node, self._map = node, map_frame
        self.pose: tuple[int, Array] | None = None
        # An old pose is no jump of time: localisation says it again when somebody asks.
        node.add_input(PoseWithCovarianceStamped, "robot_pose", self._take_pose, sensor=False)

    def wanted(self, message: Any) -> list[tuple[str, str]]:
        """What tf must know about a message."""
        frame = frame_name(message.header.frame_id)
        return [(self._map, frame)] if frame else []

    def lookup(self, message: Any, stamp: int) -> Array:
        """(4, 4) from the message's frame to the world. Raises InputError where it names none."""
        return self._node.transforms.lookup(self._map, _frame(message), stamp)

    def of(self, message: Any, stamp: int) -> SeenFrame:
        """From the message's frame to the world, with what is uncertain about it."""
        frame = _frame(message)
        return SeenFrame() if frame == self._map else self.at(frame, stamp)

    def at(self, frame: str, stamp: int) -> SeenFrame:
        """From a frame to the world, with what is uncertain about it."""
        frames = self._map, self._node.settings.base_frame
        return SeenFrame.placed(self._node.transforms, frames, frame, stamp, self._pose_covariance(stamp))

    def _pose_covariance(self, stamp: int) -> Array:
        """Of the robot in the map over x, y, yaw: the one it was given with its pose, else the configured one."""
        if self.pose is not None and abs(stamp - self.pose[0]) <= POSE_AGE:
            return self.pose[1]
        settings = self._node.settings
        return np.diag([settings.position_sigma**2, settings.position_sigma**2, settings.heading_sigma**2])

    def _take_pose(self, message: PoseWithCovarianceStamped, stamp: int) -> None:
        check_frame("robot_pose", message.header.frame_id, self._map)
        pose_from_message(message.pose.pose)
        covariance = stated_covariance(message.pose.covariance, PLANAR)
        self.pose = None if covariance is None else (stamp, covariance)


def _frame(message: Any) -> str:
    frame = frame_name(message.header.frame_id)
    if not frame:
        raise InputError("header.frame_id is empty")
    return frame

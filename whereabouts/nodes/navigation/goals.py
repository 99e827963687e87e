"""Goals that somebody else drives to: whether they get nearer, and nav2's word on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.task import Future

from estimation.checks import FloatArray as Array
from estimation.errors import InputError

# A goal that the robot has not come NEARER to, m, for PATIENCE s is not reached; goals closer than SAME m are one.
NEARER, PATIENCE, SAME = 0.1, 20.0, 0.5
AGAIN = 1  # times that a goal which nav2 could not reach is sent once more
ACTION = "navigate_to_pose"


class Approach:
    """Tells whether a robot still comes nearer to where it was sent."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self._goal: Array | None = None
        self._nearest, self._since = math.inf, 0.0

    def stuck(self, goal: Array, away: float, stamp: float) -> bool:
        """Whether the robot, `away` metres from a goal (2,) at a stamp, s, has not come nearer to it for long."""
        same = self._goal is not None and float(np.hypot(*(self._goal - goal))) < SAME
        if not same or away < self._nearest - NEARER:
            self._goal, self._nearest, self._since = np.array(goal), away, stamp
            return False
        if stamp - self._since < PATIENCE:
            return False
        self.forget()
        return True


@dataclass(eq=False)
class _Drive:
    """Where the robot is sent; `failed` is called where it cannot get there. again : tries left. sent : to nav2."""

    pose: PoseStamped
    failed: Callable[[], None]
    again: int = AGAIN
    sent: bool = False
    handle: Any = None


class Navigator:
    """Goals for nav2's `navigate_to_pose`, one at a time. wanted : false where somebody else drives to goals.

    remaining : metres that nav2 says are left, None before it says so. recoveries : how often it had to free itself on
    the way to the goal. reason : why the last goal was not reached, in words.
    Raises InputError: nav2_msgs is not installed.
    """

    def __init__(self, node: Node, wanted: bool = True) -> None:
        self._kind = navigate_type() if wanted else None
        self._client = ActionClient(node, self._kind, ACTION) if wanted else None
        self._drive: _Drive | None = None
        self.reason = ""
        self._begin()

    def _begin(self) -> None:
        self.remaining: float | None = None
        self.recoveries = 0

    @property
    def ready(self) -> bool:
        return self._client is not None and bool(self._client.server_is_ready())

    @property
    def figures(self) -> dict[str, object]:
        if self._client is None:
            return {}
        told: dict[str, object] = {"nav2 recoveries": self.recoveries}
        if self.remaining is not None:
            told["nav2 metres left"] = round(self.remaining, 2)
        return told | ({"nav2 last failure": self.reason} if self.reason else {})

    def go(self, pose: PoseStamped, failed: Callable[[], None] = lambda: None) -> bool:
        """Send the robot; `failed` is called where nav2 refuses or cannot reach the goal. False where nav2 is not up:
        `serve` sends the goal once it is.

        A goal that nav2 gives up with an error is sent once more: people step aside. One that it drops without an
        error has made way for somebody else's.
        """
        if self._client is None:
            return True
        self.stop()
        self._drive = _Drive(pose, failed)
        if not self.ready:
            self.reason = "no node offers navigate_to_pose"
        self.serve()
        return self._drive.sent

    def serve(self) -> None:
        """Send the goal that nav2 was not there for, if it is by now."""
        if self._drive is not None and not self._drive.sent and self.ready:
            self._send(self._drive)

    def stop(self) -> None:
        self._begin()
        drive, self._drive = self._drive, None
        if drive is not None and drive.handle is not None:
            drive.handle.cancel_goal_async()

    def close(self) -> None:
        self.stop()
        if self._client is not None:
            self._client.destroy()

    def _send(self, drive: _Drive) -> None:
        assert self._client is not None
        assert self._kind is not None
        drive.sent = True
        goal = self._kind.Goal(pose=drive.pose)
        sent = self._client.send_goal_async(goal, feedback_callback=partial(self._heard, drive))
        sent.add_done_callback(partial(self._answered, drive))

    def _heard(self, drive: _Drive, message: Any) -> None:
        if drive is self._drive:
            self.remaining = float(message.feedback.distance_remaining)
            self.recoveries = int(message.feedback.number_of_recoveries)

    def _answered(self, drive: _Drive, done: Future) -> None:
        handle = done.result()
        accepted = handle is not None and handle.accepted
        if drive is not self._drive:
            if accepted:
                handle.cancel_goal_async()
        elif accepted:
            drive.handle = handle
            handle.get_result_async().add_done_callback(partial(self._ended, drive))
        else:
            self.reason = "nav2 refuses the goal"
            drive.failed()

    def _ended(self, drive: _Drive, done: Future) -> None:
        drive.handle, answer = None, done.result()
        if drive is not self._drive or answer.status != GoalStatus.STATUS_ABORTED:
            return
        code = int(getattr(answer.result, "error_code", 0))
        if not code:
            self.reason = "nav2 gives up, or another goal took its place"
            drive.failed()
            return
        said = getattr(answer.result, "error_msg", "")
        self.reason = f"nav2 gives up, error {code}{f': {said}' if said else ''}"
        if drive.again:
            drive.again -= 1
            self._send(drive)
        else:
            drive.failed()


def navigate_type() -> Any:
    """nav2's action. Raises InputError where it is not installed: nothing else of the suite needs it."""
    try:
        return import_module("nav2_msgs.action").NavigateToPose
    except ImportError as error:
        raise InputError(f"navigate: nav2_msgs is not installed ({error})") from error

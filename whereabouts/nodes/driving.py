"""Goals that somebody else drives to: whether they get nearer, and nav2's word on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from numpy.typing import NDArray

from estimation.errors import InputError

Array = NDArray[np.float64]
# A goal that the robot has not come NEARER to, m, for PATIENCE s is not reached; goals closer than SAME m are one.
NEARER, PATIENCE, SAME = 0.1, 20.0, 0.5


class Approach:
    """Tells whether a robot still comes nearer to where it was sent."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """The next goal is a new one."""
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


class Navigator:
    """Goals for nav2's `navigate_to_pose`, one at a time.

    client : an ActionClient of it. goal_of : makes its goal from a PoseStamped.
    """

    def __init__(self, client: Any, goal_of: Callable[[Any], Any]) -> None:
        self._client, self._goal_of = client, goal_of
        self._handle: Any = None
        self._serial = 0

    def go(self, pose: Any, failed: Callable[[], None]) -> bool:
        """Send the robot; `failed` is called where nav2 refuses or cannot reach the goal. False where there is none."""
        self.stop()
        if not self._client.server_is_ready():
            return False
        serial = self._serial
        sent = self._client.send_goal_async(self._goal_of(pose))
        sent.add_done_callback(lambda done: self._accepted(serial, done.result(), failed))
        return True

    def stop(self) -> None:
        """Nobody wants the robot there any more."""
        self._serial += 1
        handle, self._handle = self._handle, None
        if handle is not None:
            handle.cancel_goal_async()

    def _accepted(self, serial: int, handle: Any, failed: Callable[[], None]) -> None:
        accepted = handle is not None and handle.accepted
        if serial != self._serial:
            if accepted:
                handle.cancel_goal_async()
            return
        if not accepted:
            failed()
            return
        self._handle = handle
        handle.get_result_async().add_done_callback(
            lambda done: self._ended(serial, done.result().status, failed)
        )

    def _ended(self, serial: int, status: int, failed: Callable[[], None]) -> None:
        if serial != self._serial:
            return
        self._handle = None
        if status == GoalStatus.STATUS_ABORTED:
            failed()


def navigate_type() -> Any:
    """nav2's action. Raises InputError where it is not installed: nothing else of the suite needs it."""
    try:
        return import_module("nav2_msgs.action").NavigateToPose
    except ImportError as error:
        raise InputError(f"navigate: nav2_msgs is not installed ({error})") from error

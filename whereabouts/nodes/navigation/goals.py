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
AGAIN = 1  # times that a goal which nav2 could not reach is sent once more


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

    Attributes
    ----------
    remaining : metres that nav2 says are left, None before it says so. recoveries : how often it had to free itself on
    the way to the goal. reason : why the last goal was not reached, in words.
    """

    def __init__(self, client: Any, goal_of: Callable[[Any], Any]) -> None:
        self._client, self._goal_of = client, goal_of
        self._handle: Any = None
        self._serial = 0
        self.reason = ""
        self._begin()

    def _begin(self) -> None:
        self.remaining: float | None = None
        self.recoveries = 0

    def go(self, pose: Any, failed: Callable[[], None]) -> bool:
        """Send the robot; `failed` is called where nav2 refuses or cannot reach the goal. False where there is none.

        A goal that nav2 gives up with an error is sent once more: people step aside. One that it drops without an
        error has made way for somebody else's.
        """
        self.stop()
        if not self._client.server_is_ready():
            self.reason = "no node offers navigate_to_pose"
            return False
        self._send(pose, failed, AGAIN)
        return True

    def stop(self) -> None:
        """Nobody wants the robot there any more."""
        self._serial += 1
        self._begin()
        handle, self._handle = self._handle, None
        if handle is not None:
            handle.cancel_goal_async()

    def _send(self, pose: Any, failed: Callable[[], None], again: int) -> None:
        serial = self._serial

        def ended(answer: Any) -> None:
            self._ended(serial, answer, pose, failed, again)

        sent = self._client.send_goal_async(
            self._goal_of(pose), feedback_callback=lambda message: self._heard(serial, message.feedback)
        )
        sent.add_done_callback(lambda done: self._accepted(serial, done.result(), failed, ended))

    def _heard(self, serial: int, feedback: Any) -> None:
        if serial == self._serial:
            self.remaining = float(feedback.distance_remaining)
            self.recoveries = int(feedback.number_of_recoveries)

    def _accepted(
        self, serial: int, handle: Any, failed: Callable[[], None], ended: Callable[[Any], None]
    ) -> None:
        accepted = handle is not None and handle.accepted
        if serial != self._serial:
            if accepted:
                handle.cancel_goal_async()
            return
        if not accepted:
            self.reason = "nav2 refuses the goal"
            failed()
            return
        self._handle = handle
        handle.get_result_async().add_done_callback(lambda done: ended(done.result()))

    def _ended(self, serial: int, answer: Any, pose: Any, failed: Callable[[], None], again: int) -> None:
        if serial != self._serial:
            return
        self._handle = None
        if answer.status != GoalStatus.STATUS_ABORTED:
            return
        code = int(getattr(answer.result, "error_code", 0))
        said = getattr(answer.result, "error_msg", "")
        self.reason = f"nav2 gives up, error {code}{f': {said}' if said else ''}"
        if not code:
            self.reason = "nav2 gives up, or another goal took its place"
        if code and again:
            self._send(pose, failed, again - 1)
            return
        failed()


def navigate_type() -> Any:
    """nav2's action. Raises InputError where it is not installed: nothing else of the suite needs it."""
    try:
        return import_module("nav2_msgs.action").NavigateToPose
    except ImportError as error:
        raise InputError(f"navigate: nav2_msgs is not installed ({error})") from error

"""Goals that somebody else drives to: what is made of nav2's answers, and when a goal counts as out of reach."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

from whereabouts.nodes.navigation import goals
from whereabouts.nodes.navigation.goals import Approach, Navigator


class Later:
    """A future that is answered when the test says so."""

    def __init__(self) -> None:
        self._done: list[Any] = []

    def add_done_callback(self, callback: Any) -> None:
        self._done.append(callback)

    def answer(self, value: Any) -> None:
        for callback in self._done:
            callback(SimpleNamespace(result=lambda: value))


class DrivingServer:
    """Takes goals, and ends them as it is told."""

    def __init__(self, ready: bool = True) -> None:
        self.ready = ready
        self.goals: list[Any] = []
        self.sent: list[Later] = []
        self.results: list[Later] = []
        self.cancelled: list[int] = []
        self.feedback: list[Any] = []

    def server_is_ready(self) -> bool:
        return self.ready

    def send_goal_async(self, goal: Any, feedback_callback: Any) -> Later:
        self.goals.append(goal)
        self.feedback.append(feedback_callback)
        self.sent.append(Later())
        return self.sent[-1]

    def take(self, index: int, accepted: bool = True) -> None:
        self.results.append(Later())
        result = self.results[-1]
        self.sent[index].answer(
            SimpleNamespace(
                accepted=accepted,
                get_result_async=lambda: result,
                cancel_goal_async=lambda: self.cancelled.append(index),
            )
        )

    def end(self, index: int, status: int, code: int = 0) -> None:
        self.results[index].answer(SimpleNamespace(status=status, result=SimpleNamespace(error_code=code)))


Driver = Callable[[DrivingServer], Navigator]


@pytest.fixture
def driver_of(monkeypatch: pytest.MonkeyPatch) -> Driver:
    """Makes what drives by a server; a goal is its pose."""

    def driver(nav2: DrivingServer) -> Navigator:
        monkeypatch.setattr(goals, "navigate_type", lambda: SimpleNamespace(Goal=lambda pose: pose))
        monkeypatch.setattr(goals, "ActionClient", lambda *_: nav2)
        return Navigator(None)  # type: ignore[arg-type]

    return driver


def test_what_nav2_cannot_reach_or_refuses_is_told_and_what_it_reaches_is_not(driver_of: Driver) -> None:
    nav2 = DrivingServer()
    failures: list[int] = []
    navigator = driver_of(nav2)
    statuses = (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED)
    for index, status in enumerate(statuses):
        assert navigator.go(index, partial(failures.append, index))
        nav2.take(index)
        nav2.end(index, status)
    assert nav2.goals == [0, 1, 2]
    assert failures == [1]
    navigator.go(3, lambda: failures.append(3))
    nav2.take(3, accepted=False)
    assert failures == [1, 3]
    assert not driver_of(DrivingServer(ready=False)).go(0, lambda: failures.append(0))
    assert nav2.cancelled == []


def test_a_driver_that_nobody_wants_leaves_goals_to_others() -> None:
    navigator = Navigator(None, wanted=False)  # type: ignore[arg-type]
    assert navigator.go(0, lambda: pytest.fail("nothing was tried"))
    navigator.stop()
    navigator.close()
    assert (navigator.ready, navigator.figures) == (False, {})


def test_goals_that_nobody_wants_any_more_are_cancelled_whenever_nav2_answers(driver_of: Driver) -> None:
    nav2 = DrivingServer()
    failures: list[int] = []
    navigator = driver_of(nav2)
    navigator.go(0, lambda: failures.append(0))
    navigator.stop()
    nav2.take(0)
    assert nav2.cancelled == [0]
    navigator.go(1, lambda: failures.append(1))
    nav2.take(1)
    navigator.go(2, lambda: failures.append(2))
    assert nav2.cancelled == [0, 1]
    nav2.end(1, GoalStatus.STATUS_ABORTED)
    assert failures == []


def test_a_goal_that_nav2_gives_up_is_tried_once_more_and_another_ones_goal_is_left_alone(
    driver_of: Driver,
) -> None:
    nav2 = DrivingServer()
    failures: list[str] = []
    navigator = driver_of(nav2)
    navigator.go("door", lambda: failures.append(navigator.reason))
    nav2.take(0)
    nav2.feedback[0](
        SimpleNamespace(feedback=SimpleNamespace(distance_remaining=2.5, number_of_recoveries=1))
    )
    assert (navigator.remaining, navigator.recoveries) == (2.5, 1)
    nav2.end(0, GoalStatus.STATUS_ABORTED, code=207)
    assert (nav2.goals, failures) == (["door", "door"], [])
    nav2.take(1)
    nav2.end(1, GoalStatus.STATUS_ABORTED, code=207)
    assert (nav2.goals, failures) == (["door", "door"], ["nav2 gives up, error 207"])
    # No error: another client has sent the robot elsewhere. Sending it back would be a quarrel.
    navigator.go("desk", lambda: failures.append(navigator.reason))
    assert navigator.remaining is None
    nav2.take(2)
    nav2.end(2, GoalStatus.STATUS_ABORTED)
    assert nav2.goals[2:] == ["desk"]
    assert failures[1:] == ["nav2 gives up, or another goal took its place"]
    # What it says about a goal that nobody wants any more says nothing about the next one.
    nav2.feedback[1](
        SimpleNamespace(feedback=SimpleNamespace(distance_remaining=9.0, number_of_recoveries=9))
    )
    assert (navigator.remaining, navigator.recoveries) == (None, 0)


def test_a_goal_is_out_of_reach_once_the_robot_has_not_come_nearer_for_long() -> None:
    approach, goal = Approach(), np.array([5.0, 0.0])
    # It comes nearer, slowly: never stuck.
    assert not any(approach.stuck(goal, 5.0 - 0.02 * k, float(k)) for k in range(200))
    # It stands still.
    approach.forget()
    answers = [approach.stuck(goal, 1.0, 300.0 + k) for k in range(40)]
    assert answers.index(True) == 20
    # Another goal has a patience of its own; the same one, a little aside, has not.
    assert not approach.stuck(np.array([9.0, 0.0]), 4.0, 400.0)
    assert not approach.stuck(np.array([9.2, 0.0]), 4.0, 410.0)
    assert approach.stuck(np.array([9.0, 0.1]), 4.0, 421.0)
    approach.forget()
    assert not approach.stuck(np.array([9.0, 0.1]), 4.0, 500.0)

"""What a person would do while the demo runs: have an object verified, have it looked for."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Bool

from whereabouts.logs import RawMessage
from whereabouts.nodes.live.searching import ACTION, RunningSearch, Searches
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.ros.executor import private_node
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts.nodes.ros.turns import goals_name, mark_of, results_name
from whereabouts_msgs.action import FindObject
from whereabouts_msgs.srv import TriggerVerification

PATIENCE = 30.0


@dataclass(frozen=True)
class DirectedStep:
    """One step of a search as it was told: seconds of the bag, kind, the object it is about, reason, goal (x, y)."""

    stamp: float
    kind: str
    object: str
    reason: str
    goal: tuple[float, float]
    probability: float


@dataclass
class Account:
    """What was asked and what was answered. Stamps are seconds of the bag.

    verification : answer to the request. search : kind of thing. started, ended : None where that did not happen.
    """

    verification: str = ""
    verified_at: float | None = None
    search: str = ""
    steps: list[DirectedStep] = field(default_factory=list)
    started: float | None = None
    ended: float | None = None
    found: bool = False
    outcome: str = ""
    object_id: str = ""
    place: tuple[float, float] | None = None
    distance: float = 0.0


class Director:
    """Acts at given moments of a replay; a context manager.

    wanted : class of the thing. verify_at, search_at : seconds of the bag. The base is said to be taken all the time,
    as the robot drives where it drove: maintenance then looks only at what is in view. note : called with the name of
    what is about to be sent. is_over : whether a result is on its way, by its name; in lock-step, else None.
    """

    def __init__(self, wanted: str, verify_at: float, search_at: float) -> None:
        self.account = Account(search=wanted)
        self._verify_at, self._search_at = verify_at, search_at
        self._now = 0.0
        self._base_taken = False
        self._running: RunningSearch | None = None
        self.note: Callable[[str], None] = lambda name: None
        self.is_over: Callable[[str], bool] | None = None

    def __enter__(self) -> Director:
        self._node, self._executor = private_node("whereabouts_demo")
        self._base = self._node.create_publisher(Bool, "base_available", LATCHED)
        self._trigger = self._node.create_client(TriggerVerification, "world_maintenance/trigger")
        self._searches = Searches(self._node)
        self._action, self._me = (
            self._node.resolve_topic_name(ACTION),
            self._node.get_fully_qualified_name(),
        )
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._running is not None and self._running.result is not None:
            self._end(self._running)
        self._node.context.try_shutdown()
        self._thread.join()
        self._node.destroy_node()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            while self._node.context.ok():
                self._executor.spin_once(timeout_sec=0.1)

    def look(self, message: RawMessage) -> None:
        """Called after each replayed message; the replay goes on when it returns."""
        self._now = message.log_time / NANOSECONDS
        if not self._base_taken:
            self._base_taken = True
            self._take_base()
        running = self._running
        if running is not None and (running.result is not None or self._is_over()):
            self._end(running)
        if self.account.verified_at is None and self._now >= self._verify_at:
            self._verify()
        if self.account.started is None and self._now >= self._search_at:
            self._search()

    def _verify(self) -> None:
        self.account.verified_at = self._now
        request = TriggerVerification.Request(
            class_name=self.account.search, requester="the demo, before fetching it"
        )
        answer = self._call(self._trigger, request)
        self.account.verification = "nobody answered" if answer is None else answer.message

    def _search(self) -> None:
        self.account.started = self._now
        if not _until(lambda: self._searches.ready):
            self.account.outcome = "no node offers the action find_object"
            return
        goal = FindObject.Goal(class_name=self.account.search)
        self.note(goals_name(self._action))
        search = self._searches.ask(goal, self._told)
        if not _until(search.answered.done) or not search.answered.result().accepted:
            self.account.outcome = "the search was refused"
            return
        self._running = search
        # The bag goes on when the search has said what it is about to do, or that it knows already. In lock-step it
        # begins when its node has its turn.
        if self.is_over is None:
            _until(lambda: bool(self.account.steps) or search.result is not None)

    def _told(self, said: FindObject.Feedback) -> None:
        at = said.goal.pose.position
        self.account.steps.append(
            DirectedStep(self._now, said.kind, said.object_id, said.reason, (at.x, at.y), said.probability)
        )

    def _is_over(self) -> bool:
        return self.is_over is not None and self.is_over(results_name(self._action, mark_of(self._me)))

    def _end(self, search: RunningSearch) -> None:
        self._running = None
        if not _until(lambda: search.result is not None):
            return
        account, result = self.account, search.result
        assert result is not None
        account.ended, account.outcome = self._now, result.message
        account.found, account.distance = result.code == result.FOUND, result.distance
        if account.found:
            account.object_id = result.object[0].id
            account.place = (result.pose.pose.position.x, result.pose.pose.position.y)
        # The search gave the base back, but it is still the recording that drives.
        self._take_base()

    def _take_base(self) -> None:
        self.note(self._base.topic_name)
        self._base.publish(Bool(data=False))

    def _call(self, client: Any, request: Any) -> Any:
        """Answer of a service, None where there is none in time."""
        if not client.wait_for_service(PATIENCE):
            return None
        future = client.call_async(request)
        return future.result() if _until(future.done) else None


def _until(done: Callable[[], bool]) -> bool:
    """Wait, but not for ever; whether it is done."""
    deadline = time.monotonic() + PATIENCE
    while not done() and time.monotonic() < deadline:
        time.sleep(0.002)
    return done()

"""Searches that are asked of the action `find_object`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action.client import ActionClient
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.task import Future

from whereabouts.nodes.ros.turns import goal_id
from whereabouts_msgs.action import FindObject

ACTION = "find_object"
GONE = 5
"""s after which a node that searched, and is not there any more, is not waited for."""


class RunningSearch:
    """One search. answered : done once it is known whether it is accepted. result : None until it has ended."""

    def __init__(self, answered: Future, ended: Callable[[FindObject.Result], None]) -> None:
        self.answered = answered
        self.result: FindObject.Result | None = None
        self._ended = ended
        answered.add_done_callback(self._take_answer)

    def cancel(self) -> Future:
        """Have an accepted one ended; done when that is on its way."""
        return self.answered.result().cancel_goal_async()

    def ask_again(self) -> None:
        """Ask for the result once more: a node that was started anew says that it knows nothing of the search."""
        if self.answered.done():
            self._take_answer(self.answered)

    def give_up(self, code: int, message: str) -> None:
        """End it without a word of the node that searches."""
        self._end(FindObject.Result(code=code, message=message))

    def _take_answer(self, answered: Future) -> None:
        handle = answered.result()
        if handle is None or not handle.accepted:
            self.give_up(FindObject.Result.REFUSED, "The search was not accepted.")
        else:
            handle.get_result_async().add_done_callback(self._take_result)

    def _take_result(self, done: Future) -> None:
        said = done.result()
        if said.result.code == FindObject.Result.FOUND and said.status != GoalStatus.STATUS_SUCCEEDED:
            # What a server sends that failed: a result in which nothing was filled in.
            failed = FindObject.Result.GAVE_UP
            said.result = FindObject.Result(code=failed, message="The search failed; its log says why.")
        self._end(said.result)

    def _end(self, result: FindObject.Result) -> None:
        if self.result is None:
            self.result = result
            self._ended(result)


class Searches:
    """A node's way to have things searched for."""

    def __init__(self, node: Node) -> None:
        self._client = ActionClient(node, FindObject, ACTION)
        self._me = node.get_fully_qualified_name()
        self._running: list[RunningSearch] = []
        self._gone = 0
        self._node = node
        self._timer = node.create_timer(1.0, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def ready(self) -> bool:
        """Whether anybody searches."""
        return bool(self._client.server_is_ready())

    def ask(
        self,
        goal: FindObject.Goal,
        told: Callable[[FindObject.Feedback], None] = lambda step: None,
        ended: Callable[[FindObject.Result], None] = lambda result: None,
    ) -> RunningSearch:
        """Have it searched for. told : called with each step. ended : with the result, also where it is refused."""

        def hear(message: Any) -> None:
            told(message.feedback)

        search = RunningSearch(self._client.send_goal_async(goal, hear, goal_id(self._me)), ended)
        self._running = [each for each in self._running if each.result is None] + [search]
        return search

    def _look(self) -> None:
        """Who searches may end, or be started anew, without a word."""
        before, self._gone = self._gone, 0 if self.ready else self._gone + 1
        for search in self._running:
            if self._gone >= GONE:
                search.give_up(
                    FindObject.Result.GAVE_UP,
                    "The node object_search has ended during the search; its log says why.",
                )
            elif before and not self._gone and search.result is None:
                search.ask_again()

    def destroy(self) -> None:
        self._node.destroy_timer(self._timer)
        self._client.destroy()

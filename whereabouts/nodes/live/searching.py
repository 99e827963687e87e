"""Searches that are asked of the action `find_object`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.task import Future

from whereabouts.nodes.ros.turns import goal_id
from whereabouts_msgs.action import FindObject

ACTION = "find_object"


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

    def _take_answer(self, answered: Future) -> None:
        handle = answered.result()
        if handle is None or not handle.accepted:
            refused = FindObject.Result.REFUSED
            self._end(FindObject.Result(code=refused, message="The search was not accepted."))
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
        self.result = result
        self._ended(result)


class Searches:
    """A node's way to have things searched for."""

    def __init__(self, node: Node) -> None:
        self._client = ActionClient(node, FindObject, ACTION)
        self._me = node.get_fully_qualified_name()

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

        return RunningSearch(self._client.send_goal_async(goal, hear, goal_id(self._me)), ended)

    def destroy(self) -> None:
        self._client.destroy()

"""What stands between a node's services and actions and whoever calls them: checked requests, refusals, defects."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Any

from rclpy.action.server import ActionServer, CancelResponse, GoalResponse

from estimation.errors import InputError, WhereaboutsError
from whereabouts.nodes.messages.envelopes import envelope

if TYPE_CHECKING:
    from whereabouts.nodes.ros.base import SuiteNode


def guarded_action(
    node: SuiteNode, action_type: Any, name: str, execute: Callable[[Any], Coroutine[Any, Any, Any]]
) -> ActionServer:
    """An action server of the node; see `SuiteNode.add_action`."""
    inside = envelope(action_type.Goal)
    full_name = node.resolve_topic_name(name)
    node.turns.serves(full_name)

    def judge(goal: Any) -> GoalResponse:
        try:
            inside.check(goal)
        except InputError as error:
            node.complain(f"action {name}: goal refused: {error}", key=(name, "refused"))
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT if node.active else GoalResponse.REJECT

    async def run(handle: Any) -> Any:
        try:
            await node.turns.begin(full_name)
            return await execute(handle)
        except WhereaboutsError as error:
            handle.abort()
            return action_type.Result(code=action_type.Result.REFUSED, message=str(error))
        except Exception as error:
            node.report_defect(f"action {name}", error)
            handle.abort()
            return action_type.Result(message=f"{type(error).__name__}: {error}")
        finally:
            node.turns.ended(full_name, handle)

    return ActionServer(
        node, action_type, name, run, goal_callback=judge, cancel_callback=lambda _: CancelResponse.ACCEPT
    )


def guarded_answer(
    node: SuiteNode, service_type: Any, name: str, callback: Callable[[Any, Any], str | None]
) -> Callable[[Any, Any], Any]:
    """The callback of a service, which always answers; see `SuiteNode.add_service`."""
    inside = envelope(service_type.Request)

    def answer(request: Any, response: Any) -> Any:
        try:
            inside.check(request)
            done = callback(request, response)
            if done is not None:
                _say(response, "SUCCESS", done)
        except WhereaboutsError as error:
            if not _say(response, "REFUSED", str(error)):
                node.complain(f"service {name}: {error}", key=(name, str(error)))
        except OSError as error:
            node.complain(f"service {name}: {error}", key=(name, "failed"))
            _say(response, "FAILED", str(error)[:1000])
        except Exception as error:
            node.report_defect(f"service {name}", error)
            _say(response, "FAILED", f"{type(error).__name__}: {error}")
        return response

    return answer


def _say(response: Any, code: str, sentence: str) -> bool:
    """Write into a response what was done, or why nothing was; whether it has a place for that.

    The suite's own services have a code and a message, those of std_srvs success and a message, others neither. An
    answer of nav2's that says nothing would say success.
    """
    if hasattr(response, "RESULT_UNDEFINED_FAILURE"):
        response.result = response.RESULT_UNDEFINED_FAILURE
        return False
    if hasattr(response, "code"):
        response.code, response.message = getattr(response, code), sentence
        return True
    if hasattr(response, "success"):
        response.success, response.message = code == "SUCCESS", sentence
        return True
    return False

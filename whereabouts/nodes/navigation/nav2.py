"""The one driver of all nodes that send the robot somewhere: nav2's action, where it is wanted and installed."""

from __future__ import annotations

from rclpy.action.client import ActionClient

from whereabouts.nodes.navigation.goals import Navigator, navigate_type
from whereabouts.nodes.ros.base import SuiteNode

ACTION = "navigate_to_pose"


def navigator_of(node: SuiteNode, wanted: bool) -> Navigator | None:
    """A driver that goes with the node, None where it is not wanted.

    Raises
    ------
    InputError : nav2_msgs is not installed.
    """
    if not wanted:
        return None
    kind = navigate_type()
    client = ActionClient(node, kind, ACTION)
    navigator = Navigator(client, lambda pose: kind.Goal(pose=pose))

    def end() -> None:
        navigator.stop()
        client.destroy()

    node.goes_with(end)
    return navigator


def figures_of(navigator: Navigator | None) -> dict[str, object]:
    """What a node says in its diagnostics about where it drives."""
    if navigator is None:
        return {}
    told: dict[str, object] = {"nav2 recoveries": navigator.recoveries}
    if navigator.remaining is not None:
        told["nav2 metres left"] = round(navigator.remaining, 2)
    return told | ({"nav2 last failure": navigator.reason} if navigator.reason else {})

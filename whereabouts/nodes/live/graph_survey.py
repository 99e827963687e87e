"""A survey of the running robot: who publishes what, how often and with which QoS, and what nodes complain about."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile

from whereabouts.logs import Qos
from whereabouts.messages.type_names import COMPRESSED, IMAGE, OBSERVED
from whereabouts.nodes.live.listener import listen
from whereabouts.nodes.ros.inputs import EARLY
from whereabouts.nodes.runtime.audience import full_name
from whereabouts.robot.bags import look_at_message
from whereabouts.robot.survey import SeenTopic, Survey

HEARD = (*OBSERVED, "diagnostic_msgs/msg/DiagnosticArray")


def survey_graph(seconds: float) -> Survey:
    """Listen to everything of use for a while."""
    survey = Survey("the running robot", live=True, seconds=seconds)
    suite: dict[str, Any] = {}

    def take(type_name: str, topic: str, message: Any, arrival: int) -> None:
        if isinstance(message, DiagnosticArray):
            suite.update({item.name: item for item in message.status if item.hardware_id == "whereabouts"})
            return
        seen = survey.topics.setdefault(topic, SeenTopic(topic, type_name))
        look_at_message(survey, seen, message, 1e-9 * arrival)

    def look(node: Node, _: list[str]) -> None:
        for name, kinds in node.get_topic_names_and_types():
            infos = node.get_publishers_info_by_topic(name)
            if infos:
                seen = survey.topics.setdefault(name, SeenTopic(name, kinds[0]))
                seen.publishers = tuple(sorted(map(full_name, infos)))
                seen.qos = tuple(_offer(info.qos_profile) for info in infos)

    listen("whereabouts_doctor", HEARD, take, seconds=seconds, on_look=look, brief=(IMAGE, COMPRESSED))
    survey.suite = frozenset(f"/{name}" for name in suite)
    # What the suite says itself is none of the robot's sensors.
    survey.topics = {
        name: seen
        for name, seen in survey.topics.items()
        if not seen.publishers or not survey.suite.issuperset(seen.publishers)
    }
    survey.troubles += _troubles(suite)
    return survey


def _troubles(suite: dict[str, Any]) -> list[str]:
    troubles = []
    if suite:
        names = ", ".join(f"/{name}" for name in sorted(suite))
        troubles.append(
            f"nodes of the suite are running: {names}. Their transforms are taken for the robot's own: "
            "stop them before `whereabouts setup`"
        )
    for name, said in sorted(suite.items()):
        drops = [
            f"{item.key}: {item.value}"
            for item in said.values
            if " dropped, " in item.key and not item.key.endswith(EARLY)
        ]
        if said.level != DiagnosticStatus.OK or drops:
            troubles.append(f"{name}: {'; '.join([said.message, *drops])}")
    return troubles


def _offer(profile: QoSProfile) -> Qos:
    return Qos(
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
    )

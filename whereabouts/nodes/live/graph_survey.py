"""A survey of the running robot: who publishes what, how often and with which QoS, and what nodes complain about."""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from whereabouts.logs import Qos
from whereabouts.nodes.messages.message_types import message_class
from whereabouts.nodes.ros.executor import leave, private_node
from whereabouts.nodes.ros.qos import TF_STATIC_QOS, best_effort
from whereabouts.nodes.runtime.dead_ends import full_name
from whereabouts.robot.bags import look_at_message
from whereabouts.robot.survey import CLOUD, IMU, ODOMETRY, SCAN, TF, Seen, Survey

HEARD = (SCAN, CLOUD, ODOMETRY, IMU, TF)
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
LOOK_AGAIN = 0.5  # s
DEPTH = 50
NAMES = {
    ReliabilityPolicy.BEST_EFFORT: "best_effort", ReliabilityPolicy.RELIABLE: "reliable",
    DurabilityPolicy.VOLATILE: "volatile", DurabilityPolicy.TRANSIENT_LOCAL: "transient_local",
}  # fmt: skip


def survey_graph(seconds: float) -> Survey:
    """Listen to everything of use for a while."""
    node, executor = private_node("whereabouts_doctor")
    try:
        listener = _Listener(node)
        begun = looked = time.monotonic()
        listener.look()
        while (now := time.monotonic()) < begun + seconds:
            executor.spin_once(timeout_sec=0.1)
            if now > looked + LOOK_AGAIN:
                looked = now
                listener.look()
        listener.look()
        listener.survey.seconds = seconds
        return listener.done()
    finally:
        leave(node)


class _Listener:
    """Subscribes what comes up, and notes what it says."""

    def __init__(self, node: Node) -> None:
        self.survey = Survey("the running robot", live=True)
        self._node = node
        self._subscribed: set[str] = set()
        self._suite: dict[str, Any] = {}

    def look(self) -> None:
        """Look for topics that are new, and for who publishes the known ones."""
        for name, kinds in self._node.get_topic_names_and_types():
            infos = self._node.get_publishers_info_by_topic(name)
            if not infos:
                continue
            seen = self.survey.topics.setdefault(name, Seen(name, kinds[0]))
            seen.publishers = tuple(sorted(map(full_name, infos)))
            seen.qos = tuple(_offer(info.qos_profile) for info in infos)
            if name not in self._subscribed and kinds[0] in (*HEARD, DIAGNOSTICS):
                self._subscribed.add(name)
                self._subscribe(seen)

    def _subscribe(self, seen: Seen) -> None:
        def take(message: Any) -> None:
            if isinstance(message, DiagnosticArray):
                suite = (item for item in message.status if item.hardware_id == "whereabouts")
                self._suite |= {item.name: item for item in suite}
                return
            look_at_message(self.survey, seen, message, time.time())

        qos = TF_STATIC_QOS if seen.name.endswith("tf_static") else best_effort(DEPTH)
        self._node.create_subscription(message_class(seen.kind), seen.name, take, qos)

    def done(self) -> Survey:
        """The survey with what running nodes of the suite complain about."""
        troubles = self.survey.troubles
        if self._suite:
            names = ", ".join(f"/{name}" for name in sorted(self._suite))
            troubles.append(
                f"nodes of the suite are running: {names}. Their transforms are taken for the robot's own: "
                "stop them before `whereabouts setup`"
            )
        for name, said in sorted(self._suite.items()):
            drops = [f"{item.key}: {item.value}" for item in said.values if " dropped, " in item.key]
            if said.level != DiagnosticStatus.OK or drops:
                troubles.append(f"{name}: {'; '.join([said.message, *drops])}")
        return self.survey


def _offer(profile: QoSProfile) -> Qos:
    return Qos(
        depth=profile.depth,
        reliability=NAMES.get(profile.reliability, "unknown"),
        durability=NAMES.get(profile.durability, "unknown"),
    )

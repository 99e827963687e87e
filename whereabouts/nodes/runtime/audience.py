"""Which of the nodes that a replay waits for listen to what, by their own word and by the graph."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy

from whereabouts.nodes.runtime.dead_ends import DeadEnds, full_name
from whereabouts_msgs.msg import Connections

# Inputs of every node, and those that a person writes to.
NOT_DATA = ("/tf", "/tf_static", "/turn", "/initialpose", "/clicked_point")


class Audience:
    """Watched nodes, by full name. inputs : topics that each listens to, once it has said so.

    take_counts : told who has received and sent how many messages, by topic.
    """

    def __init__(
        self,
        node: Node,
        watched: Sequence[str],
        take_counts: Callable[[str, Mapping[str, int], Mapping[str, int]], None],
    ) -> None:
        self._node, self._watched, self._take_counts = node, watched, take_counts
        self.inputs: dict[str, frozenset[str]] = {}
        self._on_demand: dict[str, frozenset[str]] = {}
        self._connections: dict[str, Connections] = {}
        self._listeners: dict[str, list[str]] = {}
        self._reported: dict[str, int] = {}
        self._dead = DeadEnds(node)
        self._died: dict[str, int] = {}
        self._born: dict[str, float] = {}
        self._subscriptions = [self._listen(name) for name in watched]

    def close(self) -> None:
        """Listen no more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def is_of_the_dead(self, watched: str, info: dict[str, Any]) -> bool:
        """What a node said before it died may still be on its way."""
        return int(info["source_timestamp"]) <= self._died.get(watched, 0)

    def _listen(self, watched: str) -> Any:
        def keep(message: Connections, info: dict[str, Any]) -> None:
            if self.is_of_the_dead(watched, info):
                return
            self._connections[watched] = message
            inputs, on_demand = frozenset(message.inputs), frozenset(message.on_demand)
            if inputs != self.inputs.get(watched) or on_demand != self._on_demand.get(watched):
                self.inputs[watched], self._on_demand[watched] = inputs, on_demand
                self._listeners.clear()
            self._reported[watched] = int(info["source_timestamp"])
            received = dict(zip(message.inputs, message.received, strict=True))
            published = dict(zip(message.outputs, message.sent, strict=True))
            self._take_counts(watched, received, published)

        return self._node.create_subscription(
            Connections,
            f"{watched}/connections",
            keep,  # type: ignore[arg-type]  # rclpy also passes the message info where it is taken
            1,
        )

    def listeners(self, name: str) -> list[str]:
        """Watched nodes that listen to a topic, by their own word, both by full name."""
        found = self._listeners.get(name)
        if found is None:
            found = [node for node in self._watched if name in self.inputs.get(node, ())]
            self._listeners[name] = found
        return found

    def lazy(self, node: str) -> frozenset[str]:
        """Topics on which messages to a node may lie about."""
        return self._on_demand.get(node, frozenset())

    def _is_subscribed(self, node: str, name: str) -> bool:
        """Whether the graph knows a node as a subscriber of a topic."""
        ends = self._node.get_subscriptions_info_by_topic(name)
        return any(full_name(end) == node and tuple(end.endpoint_gid) not in self._dead for end in ends)

    def _is_kept_for(self, name: str, topic: str) -> bool:
        """Whether a node that came late is given the latched message; one that asks for a volatile topic is not."""
        return any(
            full_name(end) == name and end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            for end in self._node.get_subscriptions_info_by_topic(topic)
        )

    def deaf(self, sent: Callable[[str], int]) -> dict[str, list[str]]:
        """Nodes to which nothing was sent but tf, and what they listen to. sent : messages there were on a topic."""
        found = {}
        for watched in self._watched:
            inputs = {name for name in self.inputs.get(watched, ()) if not name.endswith(NOT_DATA)}
            if inputs and not any(map(sent, inputs)):
                found[watched] = sorted(inputs)
        return found

    def unconnected(self, recorded: Collection[str], played: set[str], latched: set[str]) -> list[str]:
        """See `Replayer.unconnected`. played : topics of the bag; latched : those on which something is kept."""
        silent = [
            f"{name} has not reported its connections"
            for name in self._watched
            if name not in self._connections
        ]
        if silent:
            return silent
        listeners = Counter(topic for report in self._connections.values() for topic in report.inputs)
        listeners.update(recorded)
        missing = [
            f"{name} is not yet a known subscriber of {topic}"
            for name, report in self._connections.items()
            for topic in played.intersection(report.inputs)
            if not self._is_subscribed(name, topic)
        ]
        missing += [
            f"{name} has not received the last message on {topic}"
            for name, report in self._connections.items()
            for topic, received in zip(report.inputs, report.received, strict=True)
            if topic in latched and not received and self._is_kept_for(name, topic)
        ]
        for name, report in self._connections.items():
            for topic, found in zip(report.outputs, report.subscribers, strict=True):
                alive = found - self._dead.known(topic, self._born.get(name, 0.0))
                if alive < listeners[topic]:
                    missing.append(f"{name} has found {alive} of {listeners[topic]} subscribers of {topic}")
        return missing

    def bury(self, node: str) -> None:
        """A watched node died: the graph shows its inputs for a while yet, as if they were those of its successor."""
        self._connections.pop(node, None)
        self.inputs.pop(node, None)
        self._listeners.clear()
        self._died[node] = time.time_ns()
        self._dead.bury(node)
        self._born[node] = time.monotonic()

    def silent_since(self, moment: int) -> list[str]:
        """Watched nodes that have not said since a moment (ns of the system's clock) how much went through them."""
        return [name for name in self._watched if self._reported.get(name, 0) <= moment]

"""Which of the nodes that a replay waits for listen to what, by their own word and by the graph, dead ones too."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy

from whereabouts_msgs.msg import Connections

# Inputs of every node, and those that a person writes to.
NOT_DATA = ("/tf", "/tf_static", "/turn", "/initialpose", "/clicked_point")


# s that participants may differ in when they give up on the same silent one.
MARGIN = 3.0


def full_name(end: Any) -> str:
    """Of the node that a publisher or subscription belongs to, as the graph has it."""
    return f"{end.node_namespace.rstrip('/')}/{end.node_name}"


@dataclass
class _DeadEnd:
    topic: str
    died: float
    seen: float


class DeadEnds:
    """Subscriptions that nobody stands behind any more, as the graph still shows them.

    A node that has been killed says no farewell. Until its lease is over, some 20 s, whoever publishes to it takes it
    for a listener, and so seems to have found its successor before it has.
    """

    def __init__(self, node: Node, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self._ends: dict[tuple[int, ...], _DeadEnd] = {}

    def bury(self, name: str) -> None:
        """A node has died, by its full name, and its successor has not been started yet."""
        namespace, _, base = name.rpartition("/")
        now = self._clock()
        try:
            topics = self._node.get_subscriber_names_and_types_by_node(base, namespace or "/")
        except RuntimeError:
            return  # It said farewell, or was never found.
        for topic, _ in topics:
            for end in self._node.get_subscriptions_info_by_topic(topic):
                if full_name(end) == name:
                    self._ends.setdefault(tuple(end.endpoint_gid), _DeadEnd(topic, now, now))

    def __contains__(self, gid: object) -> bool:
        return gid in self._ends

    def known(self, topic: str, since: float) -> int:
        """How many of a topic a node may still count that has been there since `since` (s of the clock)."""
        now = self._clock()
        mine = {gid: end for gid, end in self._ends.items() if end.topic == topic}
        if not mine:
            return 0
        for found in self._node.get_subscriptions_info_by_topic(topic):
            end = mine.get(tuple(found.endpoint_gid))
            if end is not None:
                end.seen = now
        return sum(end.died >= since and now - end.seen <= MARGIN for end in mine.values())


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

"""Records topics of the running graph to MCAP, as bytes: what is recorded is what was sent."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message

from whereabouts.logs import McapWriter, Topic
from whereabouts.nodes.messages.message_types import definition, message_class
from whereabouts.nodes.ros.qos import reliable

DEPTH = 1000


class Recorder:
    """Writes what arrives on some topics to an `McapWriter`.

    Log time is the time of arrival by the clock of `now`, which a replay sets to message time.
    """

    def __init__(self, node: Node, writer: McapWriter, topics: Iterable[tuple[str, str]]) -> None:
        self._writer = writer
        self.now = time.time_ns
        self.counts: Counter[str] = Counter()
        # When each node's diagnostics came last, s of the monotonic clock.
        self.told: dict[str, float] = {}
        self.last_arrival = time.monotonic()
        self._subscriptions = [self._subscribe(node, name, type_name) for name, type_name in topics]

    @property
    def topics(self) -> list[str]:
        """Full names of what is recorded."""
        return [subscription.topic_name for subscription in self._subscriptions]

    def _subscribe(self, node: Node, name: str, type_name: str) -> Any:
        topic = Topic(node.resolve_topic_name(name), type_name, definition(type_name))
        kind = message_class(type_name)

        def keep(data: bytes) -> None:
            self.counts[topic.name] += 1
            # Diagnostics never end.
            if name.endswith("diagnostics"):
                for status in deserialize_message(bytes(data), kind).status:
                    self.told[status.name] = time.monotonic()
            else:
                self.last_arrival = time.monotonic()
            self._writer.write_raw(topic, bytes(data), max(0, self.now()))

        # A latched publisher's last message is wanted too; a volatile one is compatible only with volatile.
        latched = name.rsplit("/", 1)[-1] in ("tf_static", "map", "trajectory")
        return node.create_subscription(kind, name, keep, reliable(DEPTH, latched), raw=True)

"""Listens to whatever of some message types is published in the running graph."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy

from whereabouts.nodes.messages.message_types import UnknownTypeError, message_class
from whereabouts.nodes.ros.executor import leave, private_node
from whereabouts.nodes.ros.qos import LOOKED_AT, best_effort, reliable
from whereabouts.system.interrupts import interrupts_kept

LOOK_PERIOD = 0.5  # s
Take = Callable[[str, str, Any, int], None]


@dataclass
class Listener:
    """Subscribes topics as they appear.

    types : message types that are of interest.
    take : called with type, topic without the namespace, message, and time of arrival in ns.
    namespace : "" or "/robot1"; topics outside it are not listened to.
    brief : types of which a message or two tell all: such a topic is left at the next look.
    """

    node: Node
    types: Collection[str]
    take: Take
    namespace: str = ""
    brief: Collection[str] = ()
    topics: dict[str, Any] = field(default_factory=dict)
    _enough: set[str] = field(default_factory=set, init=False)

    def look(self) -> list[str]:
        """Subscribe what has appeared since the last look; returns the new topics."""
        found, prefix = [], self.namespace.rstrip("/")
        for topic in self._enough:
            self.node.destroy_subscription(self.topics[topic])
            self.topics[topic] = None
        self._enough.clear()
        for topic, kinds in self.node.get_topic_names_and_types():
            wanted = [kind for kind in kinds if kind in self.types]
            offers = self.node.get_publishers_info_by_topic(topic) if wanted else []
            if topic in self.topics or not topic.startswith(f"{prefix}/") or not offers:
                continue
            with suppress(UnknownTypeError):
                self._subscribe(topic, wanted[0], offers)
                found.append(topic)
        return found

    def _subscribe(self, topic: str, type_name: str, offers: list[Any]) -> None:
        # Best effort hears everybody; what is kept for latecomers is only sent to those who ask for it.
        latched = all(o.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offers)
        qos = reliable(LOOKED_AT, latched=True) if latched else best_effort()
        name = topic.removeprefix(self.namespace.rstrip("/"))

        def keep(message: Any) -> None:
            self.take(type_name, name, message, self.node.get_clock().now().nanoseconds)
            if type_name in self.brief:
                self._enough.add(topic)

        self.topics[topic] = self.node.create_subscription(message_class(type_name), topic, keep, qos)


def listen(
    name: str,
    types: Collection[str],
    take: Take,
    namespace: str = "",
    seconds: float | None = None,
    on_look: Callable[[Node, list[str]], None] = lambda node, new: None,
    brief: Collection[str] = (),
) -> None:
    """Listen as a node of a name until Ctrl-C, or for so many seconds.

    on_look : called with the node and the new topics, now and then and at the end. brief : as of `Listener`.
    """
    node, executor = private_node(name)
    listener = Listener(node, types, take, namespace, brief)
    start, looked = time.monotonic(), -LOOK_PERIOD
    try:
        while seconds is None or time.monotonic() - start < seconds:
            if time.monotonic() - looked >= LOOK_PERIOD:
                looked = time.monotonic()
                on_look(node, listener.look())
            with interrupts_kept():
                executor.spin_once(timeout_sec=0.1)
        on_look(node, listener.look())
    except KeyboardInterrupt:
        pass
    finally:
        leave(node)

"""Listeners of nodes that were killed: the others count them as found until their lease runs out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

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

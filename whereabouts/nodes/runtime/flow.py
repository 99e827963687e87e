"""What has been published between the nodes of a suite and what of it has been taken in.

Lock-step replay sends the next message when nothing is under way any more: neither its own, nor what one node sent
another because of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping


class Flow:
    """Messages between watched nodes.

    subscribers : watched nodes that listen to a topic, both by full name.
    sent : messages that the replay itself has sent on a topic.
    """

    def __init__(self, subscribers: Callable[[str], list[str]], sent: Callable[[str], int]) -> None:
        self._subscribers = subscribers
        self._sent = sent
        self._published: Counter[str] = Counter()  # by topic
        self._received: Counter[tuple[str, str]] = Counter()  # by node and topic, with what was forgiven
        # The last word of each node on what it has published or received.
        self._told: dict[tuple[str, str, str], int] = {}

    def note(self, node: str, received: Mapping[str, int], published: Mapping[str, int]) -> None:
        """Take in what a node reports: messages it has received and published, by topic."""
        for topic, count in received.items():
            self._received[node, topic] += self._growth((node, "received", topic), count)
        for topic, count in published.items():
            self._published[topic] += self._growth((node, "published", topic), count)

    def _growth(self, what: tuple[str, str, str], count: int) -> int:
        """How many are new. Reports overtake each other, so a smaller figure is an older one."""
        before = self._told.get(what, 0)
        self._told[what] = max(before, count)
        return self._told[what] - before

    def died(self, node: str) -> None:
        """A node has ended; its successor counts from nought."""
        self._told = {what: count for what, count in self._told.items() if what[0] != node}

    def published(self, topic: str) -> int:
        """Messages of a topic that watched nodes have sent."""
        return self._published[topic]

    def behind(self) -> list[str]:
        """Nodes that have yet to take in what other nodes sent them."""
        return [node for (node, _), lag in self._lags().items() if lag > 0]

    def forgive(self) -> None:
        """Begin anew from where all are: a node died or joined late.

        What was said to it meanwhile is lost, and what is latched has come to it once more.
        """
        self._received.update(self._lags())

    def _lags(self) -> dict[tuple[str, str], int]:
        return {
            (node, topic): self._sent(topic) + count - self._received[node, topic]
            for topic, count in self._published.items()
            for node in self._subscribers(topic)
        }

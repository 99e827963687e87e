"""What has been published between the nodes of a suite and what of it has been taken in.

Lock-step replay sends the next message when nothing is under way any more: neither its own, nor what one node sent
another because of it.
"""

from __future__ import annotations

from collections.abc import Callable

from whereabouts_msgs.msg import Processed


class Tally:
    """A counter that a restarted node begins anew and that still never falls."""

    def __init__(self) -> None:
        self._before = 0
        self._current = 0

    def set(self, count: int) -> None:
        """Take the node's own figure."""
        if count < self._current:
            self._before += self._current
        self._current = count

    @property
    def total(self) -> int:
        return self._before + self._current


class Flow:
    """Messages between watched nodes.

    Parameters
    ----------
    subscribers : watched nodes that listen to a topic, both by full name.
    sent : messages that the replay itself has sent on a topic.
    """

    def __init__(self, subscribers: Callable[[str], list[str]], sent: Callable[[str], int]) -> None:
        self._subscribers = subscribers
        self._sent = sent
        self._published: dict[str, dict[str, Tally]] = {}
        self._received: dict[tuple[str, str], Tally] = {}
        self._forgiven: dict[tuple[str, str], int] = {}

    def note(self, node: str, message: Processed) -> None:
        """Take in what a node reports."""
        self._received.setdefault((node, message.topic), Tally()).set(int(message.received))
        for topic, count in zip(message.output_topics, message.output_counts, strict=True):
            self._published.setdefault(topic, {}).setdefault(node, Tally()).set(int(count))

    def published(self, topic: str) -> int:
        """Messages of a topic that watched nodes have sent."""
        return sum(tally.total for tally in self._published.get(topic, {}).values())

    def behind(self) -> list[str]:
        """Nodes that have yet to take in what other nodes sent them."""
        return [node for (node, _), lag in self._lags().items() if lag > 0]

    def forgive(self) -> None:
        """Take what is under way as lost: a node died or joined late."""
        for pair, lag in self._lags().items():
            if lag > 0:
                self._forgiven[pair] = self._forgiven.get(pair, 0) + lag

    def _lags(self) -> dict[tuple[str, str], int]:
        lags: dict[tuple[str, str], int] = {}
        for topic in self._published:
            expected = self._sent(topic) + self.published(topic)
            for node in self._subscribers(topic):
                received = self._received.get((node, topic))
                total = 0 if received is None else received.total
                lags[node, topic] = expected - total - self._forgiven.get((node, topic), 0)
        return lags

"""What has been published between the nodes of a suite and what of it has been taken in.

Lock-step replay sends the next message when nothing is under way any more: neither its own, nor what one node sent
another because of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping


class Tally:
    """A counter that a restarted node begins anew and that still never falls."""

    def __init__(self) -> None:
        self._before = 0
        self._current = 0

    def set(self, count: int) -> None:
        """Take the node's own figure; reports overtake each other, so a smaller one is an older one."""
        self._current = max(self._current, count)

    def begin_anew(self) -> None:
        """The node has ended; its successor counts from nought."""
        self._before += self._current
        self._current = 0

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
        # Sums of the above, as they are asked for with every message: published, and received or forgiven.
        self._total: dict[str, int] = {}
        self._taken: dict[tuple[str, str], int] = {}

    def note(self, node: str, received: Mapping[str, int], published: Mapping[str, int]) -> None:
        """Take in what a node reports: messages it has received and published, by topic."""
        for topic, count in received.items():
            self._received.setdefault((node, topic), Tally()).set(count)
            self._sum_up(node, topic)
        for topic, count in published.items():
            tallies = self._published.setdefault(topic, {})
            tallies.setdefault(node, Tally()).set(count)
            self._total[topic] = sum(tally.total for tally in tallies.values())

    def _sum_up(self, node: str, topic: str) -> None:
        received, forgiven = self._received.get((node, topic)), self._forgiven.get((node, topic), 0)
        self._taken[node, topic] = forgiven + (0 if received is None else received.total)

    def died(self, node: str) -> None:
        """A node has ended; what it reports from now on begins anew."""
        ended = [tally for (name, _), tally in self._received.items() if name == node]
        ended += [tallies[node] for tallies in self._published.values() if node in tallies]
        for tally in ended:
            tally.begin_anew()

    def published(self, topic: str) -> int:
        """Messages of a topic that watched nodes have sent."""
        return self._total.get(topic, 0)

    def behind(self) -> list[str]:
        """Nodes that have yet to take in what other nodes sent them."""
        return [node for (node, _), lag in self._lags().items() if lag > 0]

    def forgive(self) -> None:
        """Begin anew from where all are: a node died or joined late.

        What was said to it meanwhile is lost, and what is latched has come to it once more.
        """
        for pair, lag in self._lags().items():
            self._forgiven[pair] = self._forgiven.get(pair, 0) + lag
            self._sum_up(*pair)

    def _lags(self) -> dict[tuple[str, str], int]:
        lags: dict[tuple[str, str], int] = {}
        for topic, total in self._total.items():
            expected = self._sent(topic) + total
            for node in self._subscribers(topic):
                lags[node, topic] = expected - self._taken.get((node, topic), 0)
        return lags

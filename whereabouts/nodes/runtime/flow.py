"""What has been sent to the nodes of a suite, and what of it each has been told to take in.

Lock-step replay gives a node a turn when something was sent that it listens to, by the replay or by another node.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping

# Messages that nobody waits for which may lie about: of transforms a hundred are kept.
MOST_LEFT = 40


class Flow:
    """Messages to and from watched nodes. listeners : who listens to a topic, by full names."""

    def __init__(self, listeners: Callable[[str], Collection[str]]) -> None:
        self._listeners = listeners
        self._total: Counter[str] = Counter()  # by topic
        self._published: Counter[str] = Counter()  # of these, by watched nodes
        # The last word of each node on what it has published, and on what it has received.
        self._told: dict[str, Counter[str]] = defaultdict(Counter)
        self._received: dict[str, Counter[str]] = defaultdict(Counter)
        # By node and topic: what came since its last turn; what it is to have received by the end of that; and how much
        # more it had received than there was when it was begun with.
        self._came: dict[str, Counter[str]] = defaultdict(Counter)
        self._asked: dict[str, dict[str, int]] = {}
        self._ahead: dict[str, Counter[str]] = defaultdict(Counter)

    def send(self, topic: str, count: int = 1) -> None:
        self._total[topic] += count
        for node in self._listeners(topic):
            self._came[node][topic] += count

    def note(self, node: str, received: Mapping[str, int], published: Mapping[str, int]) -> None:
        """Take in what a node reports: messages it has received and published, by topic."""
        mine, told = self._received[node], self._told[node]
        for topic, count in received.items():
            # Reports overtake each other, so a smaller figure is an older one.
            mine[topic] = max(mine[topic], count)
        for topic, count in published.items():
            new = count - told[topic]
            if new > 0:
                told[topic] = count
                self._published[topic] += new
                self.send(topic, new)

    def died(self, node: str) -> None:
        """A node has ended; its successor counts from nought."""
        self._told.pop(node, None)
        self._received.pop(node, None)

    def published(self, topic: str) -> int:
        """Messages of a topic that watched nodes have sent."""
        return self._published[topic]

    def total(self, topic: str) -> int:
        return self._total[topic]

    def received(self, node: str) -> Counter[str]:
        return self._received[node]

    def begin(self, node: str) -> None:
        """A node is done with all that was sent so far: it is new, or did not answer."""
        received = self._received[node]
        self._came[node].clear()
        self._asked.pop(node, None)
        self._ahead[node] = Counter(
            {topic: received[topic] - self._total[topic] for topic in (*self._total, *received)}
        )

    def due(self, node: str, lazy: Collection[str]) -> bool:
        """Whether something was sent to a node since its last turn. lazy : topics on which that may wait a while."""
        return any(count > (MOST_LEFT if topic in lazy else 0) for topic, count in self._came[node].items())

    def give(self, node: str) -> dict[str, int]:
        """A node has a turn: how many messages of each topic it is to have received at its end."""
        ahead, came = self._ahead[node], self._came[node]
        asked = self._asked[node] = {topic: self._total[topic] + ahead[topic] for topic in came}
        came.clear()
        return asked

    def taken(self, node: str) -> None:
        self.note(node, self._asked.get(node, {}), {})

    def behind(self, node: str) -> bool:
        """Whether a node has yet to take in something, by its own account."""
        ahead, received = self._ahead[node], self._received[node]
        return any(
            received[topic] < count + ahead[topic]
            for topic, count in self._total.items()
            if node in self._listeners(topic)
        )

"""Gives the nodes of a lock-step replay their turns; see `whereabouts.nodes.ros.turns`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from rclpy.node import Node
from std_msgs.msg import Empty

from whereabouts.nodes.ros.turns import RANKS, kept_name, turn_topic

DEPTH = 10


class TurnGiver:
    """Knows who has something kept. watched : full names of the nodes."""

    def __init__(self, node: Node, watched: Sequence[str]) -> None:
        self._publishers = {name: node.create_publisher(Empty, turn_topic(name), DEPTH) for name in watched}
        self._given: Counter[str] = Counter()
        self._kept: Counter[str] = Counter()
        self._done: Counter[str] = Counter()

    def close(self, destroy: Callable[..., object]) -> None:
        """Give publishers back."""
        for publisher in self._publishers.values():
            destroy(publisher)

    def note(self, name: str, published: Mapping[str, int]) -> None:
        """Take in what a node says of itself."""
        self._kept[name] = max(self._kept[name], published.get(kept_name(name), 0))

    def died(self, name: str) -> None:
        """A node has ended, and what it had kept with it."""
        del self._kept[name], self._done[name]

    def due(self) -> list[str]:
        """Whose turn it is: of those who have something kept, all of the lowest rank."""
        waiting = [name for name in self._publishers if self._kept[name] > self._done[name]]
        lowest = min(map(_rank, waiting), default=0)
        return [name for name in waiting if _rank(name) == lowest]

    def give(self, name: str) -> None:
        """Tell a node that it is its turn."""
        self._done[name] = self._kept[name]
        self._given[name] += 1
        self._publishers[name].publish(Empty())

    def given(self, name: str) -> int:
        """How many turns it was given."""
        return self._given[name]


def _rank(name: str) -> int:
    return RANKS.get(name.rpartition("/")[2], 0)

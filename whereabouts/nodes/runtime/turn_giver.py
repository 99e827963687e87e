"""Gives the nodes of a lock-step replay their turns; see `whereabouts.nodes.ros.turns`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence

from rclpy.node import Node

from whereabouts.nodes.ros.turns import RANKS, free_topic, kept_name, turn_topic, waits_name
from whereabouts.nodes.runtime.flow import Flow
from whereabouts_msgs.msg import Connections, Processed

DEPTH = 10


class TurnGiver:
    """Knows who has something to do.

    watched : full names of the nodes. flow : what was sent to them. lazy : topics on which messages may wait, by node.
    busy : who has his turn. holding : of these, who keeps others waiting.
    """

    def __init__(
        self, node: Node, watched: Sequence[str], flow: Flow, lazy: Callable[[str], Collection[str]]
    ) -> None:
        self._publishers = {
            name: node.create_publisher(Connections, turn_topic(name), DEPTH) for name in watched
        }
        self._flow, self._lazy = flow, lazy
        self.busy: set[str] = set()
        self.holding: set[str] = set()
        self._given: Counter[str] = Counter()
        self._kept: Counter[str] = Counter()
        self._done: Counter[str] = Counter()
        self._waits: Counter[str] = Counter()

    def close(self, destroy: Callable[..., object]) -> None:
        for publisher in self._publishers.values():
            destroy(publisher)

    def note(self, name: str, published: Mapping[str, int]) -> None:
        """Take in what a node says of itself."""
        self._kept[name] = max(self._kept[name], published.get(kept_name(name), 0))

    def answered(self, name: str, answer: Processed, published: Mapping[str, int]) -> None:
        """Take in what a node says of its turn."""
        if answer.sequence != self._given[name] or name not in self.busy:
            return
        if answer.topic == free_topic(name):
            self.holding.discard(name)
        elif answer.topic == turn_topic(name):
            self._waits[name] = published.get(waits_name(name), 0)
            self._flow.taken(name)
            self._end(name)

    def give_up(self, name: str) -> None:
        """A node does not answer: nobody waits for it any longer."""
        self._flow.begin(name)
        self._end(name)

    def _end(self, name: str) -> None:
        self.busy.discard(name)
        self.holding.discard(name)

    def died(self, name: str) -> None:
        """A node has ended, and what it had kept with it."""
        del self._kept[name], self._done[name], self._waits[name]
        self._end(name)

    def due(self, last: bool = False) -> list[str]:
        """Whose turn it is: of those who have something to do, all of the lowest rank. last : lazy is nothing."""
        waiting = [name for name in self._publishers if name not in self.busy and self._is_due(name, last)]
        lowest = min(map(rank, waiting), default=0)
        return [name for name in waiting if rank(name) == lowest]

    def _is_due(self, name: str, last: bool) -> bool:
        kept = self._kept[name] > self._done[name]
        return kept or self._flow.due(name, () if last or self._waits[name] else self._lazy(name))

    def give(self, name: str) -> None:
        self._done[name] = self._kept[name]
        self._given[name] += 1
        self.busy.add(name)
        self.holding.add(name)
        wanted = self._flow.give(name)
        self._publishers[name].publish(Connections(inputs=[*wanted], received=[*wanted.values()]))


def rank(name: str) -> int:
    """When a node, by its full name, has its turn: who has a lower one comes before it."""
    return RANKS.get(name.rpartition("/")[2], 0)

"""The publishers of a node, and how much went through them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.event_handler import PublisherEventCallbacks

from whereabouts_msgs.msg import Connections, Processed

if TYPE_CHECKING:
    from whereabouts.nodes.ros.base import SuiteNode

# Every event that is waited for is looked at whenever the node wakes up. That the quality of service does not match,
# the other end says as well.
QUIET = PublisherEventCallbacks(use_default_callbacks=False)


class Output:
    """A lifecycle publisher that counts: lock-step replay waits until what was sent has been taken in downstream."""

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher
        self.topic: str = publisher.topic_name
        self.count = 0

    @property
    def subscribers(self) -> int:
        return int(self._publisher.get_subscription_count())

    @property
    def wanted(self) -> bool:
        """Whether anybody listens, so that costly messages need not be made for nobody."""
        return self.subscribers > 0

    def publish(self, message: Any) -> None:
        if self._publisher.is_activated:
            self.count += 1
            self._publisher.publish(message)


class OutputAccount:
    """Says what a node is done with and what it has sent: who replays or tests waits for it."""

    def __init__(self, node: SuiteNode) -> None:
        self._node = node
        self._processed = node.create_publisher(Processed, "~/processed", 100, event_callbacks=QUIET)
        self._connections = node.create_publisher(Connections, "~/connections", 1, event_callbacks=QUIET)

    @property
    def sent(self) -> dict[str, int]:
        """What was sent, by topic; in a replay also what else others or the replay have to know of."""
        node = self._node
        sent = {output.topic: output.count for output in node.outputs}
        return sent | node.turns.counts if node.replayed else sent

    def acknowledge(self, message: Processed) -> None:
        """Say that something is done with, and what was sent because of it."""
        sent = self.sent
        message.output_topics, message.output_counts = [*sent], [*sent.values()]
        self._processed.publish(message)

    def report_connections(self) -> None:
        """Say who is connected and what went through."""
        node = self._node
        if not node.settings.report_processed:
            return
        subscribers = [output.subscribers for output in node.outputs]
        came = {item.topic: item.counts.received for item in node.inputs}
        if node.replayed:
            subscribers += map(node.turns.listeners, node.turns.counts)
            came |= node.turns.received
        sent = self.sent
        message = Connections(
            inputs=[*came],
            received=[*came.values()],
            on_demand=[
                item.topic for item in node.inputs if (item.lazy if node.replayed else item.on_demand)
            ],
            outputs=[*sent],
            sent=[*sent.values()],
            subscribers=subscribers,
        )
        self._connections.publish(message)

"""One publisher of a node, and how much went through it."""

from __future__ import annotations

from typing import Any

from rclpy.event_handler import PublisherEventCallbacks

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
        """How many listeners it has found."""
        return int(self._publisher.get_subscription_count())

    @property
    def wanted(self) -> bool:
        """Whether anybody listens, so that costly messages need not be made for nobody."""
        return self.subscribers > 0

    def publish(self, message: Any) -> None:
        """Send, unless the node is inactive."""
        if self._publisher.is_activated:
            self.count += 1
            self._publisher.publish(message)

"""The executor of a node: rclpy's, without waking itself up after each callback."""

from __future__ import annotations

from typing import Any

from rclpy.executors import SingleThreadedExecutor


class _NobodyWaits:
    """Stands for the guard condition that ends a wait."""

    def trigger(self) -> None:
        """There is one thread, and it is not waiting."""


_NOBODY_WAITS = _NobodyWaits()


class NodeExecutor(SingleThreadedExecutor):
    """Single-threaded executor that waits once per callback.

    rclpy wakes its executor before and after every callback, for the sake of other threads that may be waiting. Here
    there are none, and each wait looks at every service, event and timer of the node anew. Tasks, futures and other
    threads go on waking it as ever. With an rclpy that is built otherwise it is the plain executor.
    """

    def _make_handler(self, *arguments: Any, **named: Any) -> Any:
        guard = getattr(self, "_guard", None)
        if guard is None:
            return super()._make_handler(*arguments, **named)
        self._guard = _NOBODY_WAITS  # type: ignore[assignment]
        try:
            return super()._make_handler(*arguments, **named)
        finally:
            self._guard = guard

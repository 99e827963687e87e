"""The executor of a node: rclpy's, with less work for each message."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation

from whereabouts.nodes.stamps import NANOSECONDS

Take = Callable[[Any], Any]
Work = tuple[Take, Any]
FOREVER = -1
NEEDED = (
    "_guard",
    "_sigint_gc",
    "_tasks",
    "_tasks_lock",
    "_take_subscription",
    "_take_timer",
    "_take_waitable",
)


class NodeExecutor(SingleThreadedExecutor):
    """Single-threaded executor of one node, and of callbacks in the order in which rclpy would call them.

    rclpy's own makes for every callback a new wait set and a task, takes the use of every handle, and wakes itself up
    before and after, for the sake of threads that may be waiting or destroying things meanwhile. Here there is one
    thread: the wait set is kept, and a callback is called. Only what awaits something becomes a task, and does not keep
    others of its callback group waiting. With an rclpy that is built otherwise it is the plain executor.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._sizes: tuple[int, ...] = ()
        self._wait_set: Any = None
        self._fits = all(hasattr(self, name) for name in NEEDED)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for work, no longer than `timeout_sec` (None: as long as it takes), and do all there is of it."""
        nodes = self.get_nodes()
        if len(nodes) != 1 or not self._fits:
            super().spin_once(timeout_sec)
            return
        self._continue_tasks()
        try:
            ready = self._wait(nodes[0], FOREVER if timeout_sec is None else int(timeout_sec * NANOSECONDS))
        except ShutdownException:
            return
        for take, entity in ready:
            self._call(take, entity)

    def _continue_tasks(self) -> None:
        """Go on with what awaits something, in rclpy's order."""
        if not self._tasks:
            return
        for task, _, _ in reversed(list(self._tasks)):
            if not task.executing() and not task.done():
                task()
                error = task.exception()
                if error is not None:
                    raise error
        with self._tasks_lock:
            self._tasks = [item for item in self._tasks if not item[0].done() and not item[0].cancelled()]

    def _wait(self, node: Any, timeout: int) -> list[Work]:
        """Entities that are ready after at most `timeout` ns, each with what takes its work."""
        subscriptions, timers = list(node.subscriptions), list(node.timers)
        clients, services = list(node.clients), list(node.services)
        guards, waitables = list(node.guards), list(node.waitables)
        wait_set = self._empty_wait_set(
            [len(subscriptions), len(guards) + 2, len(timers), len(clients), len(services), 0], waitables
        )
        for item in subscriptions:
            wait_set.add_subscription(item.handle)
        for item in clients:
            wait_set.add_client(item.handle)
        for item in services:
            wait_set.add_service(item.handle)
        for item in timers:
            wait_set.add_timer(item.handle)
        for item in (*guards, self._guard, self._sigint_gc):
            wait_set.add_guard_condition(item.handle)
        for item in waitables:
            item.add_to_wait_set(wait_set)
        wait_set.wait(timeout)
        if self._is_shutdown:
            raise ShutdownException
        if not self._context.ok():
            raise ExternalShutdownException

        def ready(kind: str, items: list[Any], take: Take) -> list[Work]:
            pointers = wait_set.get_ready_entities(kind) if items else ()
            return [(take, item) for item in items if item.handle.pointer in pointers] if pointers else []

        return [
            *((self._take_waitable, item) for item in waitables if item.is_ready(wait_set)),
            *ready("timer", timers, self._take_timer),
            *ready("subscription", subscriptions, self._take_subscription),
            *ready("guard_condition", guards, self._take_guard_condition),
            *ready("client", clients, self._take_client),
            *ready("service", services, self._take_service),
        ]

    def _empty_wait_set(self, sizes: list[int], waitables: list[Any]) -> Any:
        """The wait set of the last time, where it has room for just what is waited for."""
        for item in waitables:
            needed = item.get_num_entities()
            for place, name in enumerate(
                ("subscriptions", "guard_conditions", "timers", "clients", "services", "events")
            ):
                sizes[place] += getattr(needed, f"num_{name}")
        if tuple(sizes) != self._sizes:
            self._wait_set = rclpy_implementation.WaitSet(*sizes, self._context.handle)
            self._sizes = tuple(sizes)
        self._wait_set.clear_entities()
        return self._wait_set

    def _call(self, take: Take, entity: Any) -> None:
        """Take the work of an entity and do it; it may have been destroyed or cancelled since the wait."""
        try:
            if take == self._take_timer and not entity.handle.is_timer_ready():
                return
            work = take(entity)
        except InvalidHandle:
            return
        if work is None:
            return
        coroutine = work()
        try:
            coroutine.send(None)
        except StopIteration:
            return
        self.create_task(coroutine)

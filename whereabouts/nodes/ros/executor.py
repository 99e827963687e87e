"""The executor of a node: rclpy's, with less work for each message; and a node of its own that it spins."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.ros.qos import BURST
from whereabouts.system.interrupts import raise_if_interrupt

Take = Callable[[Any], Any]
Work = tuple[Take, Any]
FOREVER = -1
# s between looks at what the middleware counts, such as lost messages: it keeps, and each costs time in every wait.
EVENT_PERIOD = 1.0
# Wait sets kept, by size: with and without events, and while something is being created or destroyed.
KEPT = 4
# What a wait set has room for, in this order.
ENTITIES = ("subscription", "guard_condition", "timer", "client", "service", "event")
NEEDED = (
    "_guard", "_sigint_gc", "_tasks", "_tasks_lock", "_take_subscription", "_take_timer", "_take_waitable",
)  # fmt: skip


class _Kind:
    """Entities of one kind that a node has, and their handles as long as they are the same."""

    def __init__(self, name: str, attribute: str, take: Take) -> None:
        self.name = name
        self.handles: list[Any] = []
        self._attribute = attribute
        self._take = take
        self._items: list[Any] = []
        self._by_pointer: dict[int, Any] = {}

    def look(self, node: Any, resting: Sequence[Any] = ()) -> None:
        """See what the node has now, but for what rests."""
        items = [item for item in getattr(node, self._attribute) if item not in resting]
        if items != self._items:
            self._items = items
            self.handles = [item.handle for item in items]
            self._by_pointer = {item.handle.pointer: item for item in items}

    def ready(self, wait_set: Any) -> list[Work]:
        """Those that are ready, in the node's order."""
        if not self._items:
            return []
        pointers = wait_set.get_ready_entities(self.name)
        return [
            (self._take, self._by_pointer[pointer]) for pointer in pointers if pointer in self._by_pointer
        ]


class NodeExecutor(SingleThreadedExecutor):
    """Single-threaded executor of one node, and of callbacks in the order in which rclpy would call them.

    rclpy's own makes for every callback a new wait set and a task, takes the use of every handle, and wakes itself up
    before and after, for the sake of threads that may be waiting or destroying things meanwhile. Here there is one
    thread: wait sets are kept, and a callback is called. Only what awaits something becomes a task, and does not keep
    others of its callback group waiting. Events of the middleware are looked at once a second. Subscriptions that the
    node names in `resting` wake nobody up: what they have is taken before anything else is done, but for what the node
    itself takes in, its `own`. With an rclpy that is built otherwise it is the plain executor. What a callback raises
    goes to the node's `report_defect`, where it has one, and no further.

    rclpy's events executor takes less for a message (`bench/bench_executors.py`), but calls no timer while nothing else
    happens, and a coroutine that waits keeps it busy.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._wait_sets: dict[tuple[int, ...], Any] = {}
        self._events_due = 0.0
        self._fits = all(hasattr(self, name) for name in NEEDED)
        if self._fits:
            # In the order in which rclpy serves them.
            self._kinds = [
                _Kind("timer", "timers", self._take_timer),
                _Kind("subscription", "subscriptions", self._take_subscription),
                _Kind("guard_condition", "guards", self._take_guard_condition),
                _Kind("client", "clients", self._take_client),
                _Kind("service", "services", self._take_service),
            ]

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for work, no longer than `timeout_sec` (None: as long as it takes), and do all there is of it.

        It also returns when events of the middleware are to be looked at again.
        """
        nodes = self.get_nodes()
        if len(nodes) != 1 or not self._fits:
            try:
                super().spin_once(timeout_sec)
            except Exception as error:
                self._survive(nodes[0] if nodes else None, self, error)
            return
        self._continue_tasks(nodes[0])
        try:
            ready = self._wait(nodes[0], FOREVER if timeout_sec is None else int(timeout_sec * NANOSECONDS))
        except ShutdownException:
            return
        if ready:
            self._catch_up(nodes[0])
        for take, entity in ready:
            self._call(nodes[0], take, entity)

    def _survive(self, node: Any, where: Any, error: Exception) -> None:
        """Tell the node what one of its callbacks has raised, if it wants to know; otherwise it goes on its way."""
        report = getattr(node, "report_defect", None)
        if report is None or isinstance(error, ExternalShutdownException | ShutdownException):
            raise error
        raise_if_interrupt(error)
        report(type(where).__name__.lower(), error)

    def _catch_up(self, node: Any) -> None:
        """Take in what lies about in subscriptions that rest."""
        own = getattr(node, "own", ())
        for subscription in getattr(node, "resting", ()):
            # As many as a queue holds.
            for _ in range(0 if subscription in own else BURST):
                if not self._call(node, self._take_subscription, subscription):
                    break

    def go_on(self, node: Any) -> None:
        """Go on at once with what awaits something, from within a callback."""
        if self._fits:
            self._continue_tasks(node)

    def _continue_tasks(self, node: Any) -> None:
        """Go on with what awaits something, in rclpy's order."""
        if not self._tasks:
            return
        for task, _, _ in reversed(list(self._tasks)):
            if not task.executing() and not task.done():
                task()
                error = task.exception()
                if error is not None:
                    self._survive(node, task, error)
        with self._tasks_lock:
            self._tasks = [item for item in self._tasks if not item[0].done() and not item[0].cancelled()]

    def _wait(self, node: Any, timeout: int) -> list[Work]:
        """Entities that are ready after at most `timeout` ns, each with what takes its work."""
        waitables = list(node.waitables)
        left = self._events_due - time.monotonic()
        if left <= 0.0:
            self._events_due += EVENT_PERIOD - left
        elif any(isinstance(item, EventHandler) for item in waitables):
            waitables = [item for item in waitables if not isinstance(item, EventHandler)]
            cut = int(left * NANOSECONDS)
            timeout = cut if timeout == FOREVER else min(timeout, cut)
        resting = getattr(node, "resting", ())
        for kind in self._kinds:
            kind.look(node, resting if kind.name == "subscription" else ())
        wait_set = self._empty_wait_set(waitables)
        for kind in self._kinds:
            add = getattr(wait_set, f"add_{kind.name}")
            for handle in kind.handles:
                add(handle)
        for own in (self._guard, self._sigint_gc):
            wait_set.add_guard_condition(own.handle)
        for item in waitables:
            item.add_to_wait_set(wait_set)
        wait_set.wait(timeout)
        if self._is_shutdown:
            raise ShutdownException
        if not self._context.ok():
            raise ExternalShutdownException
        ready: list[Work] = [(self._take_waitable, item) for item in waitables if item.is_ready(wait_set)]
        for kind in self._kinds:
            ready += kind.ready(wait_set)
        return ready

    def _empty_wait_set(self, waitables: list[Any]) -> Any:
        """The wait set of an earlier time that has room for just what is waited for."""
        room = {kind.name: len(kind.handles) for kind in self._kinds}
        sizes = [room.get(name, 0) for name in ENTITIES]
        sizes[ENTITIES.index("guard_condition")] += 2
        for item in waitables:
            needed = item.get_num_entities()
            for place, name in enumerate(ENTITIES):
                sizes[place] += getattr(needed, f"num_{name}s")
        wait_set = self._wait_sets.get(tuple(sizes))
        if wait_set is None:
            if len(self._wait_sets) == KEPT:
                self._wait_sets.clear()
            wait_set = rclpy_implementation.WaitSet(*sizes, self._context.handle)
            self._wait_sets[tuple(sizes)] = wait_set
        wait_set.clear_entities()
        return wait_set

    def _call(self, node: Any, take: Take, entity: Any) -> bool:
        """Take the work of an entity and do it, if any: it may have been destroyed or cancelled since the wait."""
        try:
            return self._do(take, entity)
        except Exception as error:
            self._survive(node, entity, error)
            return False

    def _do(self, take: Take, entity: Any) -> bool:
        try:
            if take == self._take_timer and not entity.handle.is_timer_ready():
                return False
            work = take(entity)
        except InvalidHandle:
            return False
        if work is None:
            return False
        coroutine = work()
        try:
            coroutine.send(None)
        except StopIteration:
            return True
        self.create_task(coroutine)
        return True


def private_node(name: str, namespace: str = "") -> tuple[Node, NodeExecutor]:
    """A node that is no part of the suite but talks to it, in a context of its own, and what spins it."""
    context = Context()
    rclpy.init(context=context)
    node = Node(name, context=context, namespace=namespace or None)
    executor = NodeExecutor(context)
    executor.add_node(node)
    return node, executor


def leave(node: Node) -> None:
    node.destroy_node()
    node.context.try_shutdown()

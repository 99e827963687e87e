"""The executor of nodes serves everything that rclpy's own does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Int32

from whereabouts.nodes.ros.executor import NodeExecutor
from whereabouts_msgs.srv import Reset

PATIENCE = 60.0


def unfamiliar(context: Context) -> NodeExecutor:
    """Ours, where rclpy is not built as it expects."""
    executor = NodeExecutor(context)
    executor._fits = False
    return executor


def plain(context: Context) -> SingleThreadedExecutor:
    return SingleThreadedExecutor(context=context)


@pytest.fixture(params=[NodeExecutor, unfamiliar, plain])
def spinning(request: Any, domain: int) -> Iterator[tuple[Node, Any]]:
    """A node and its executor: ours, and rclpy's to hold it against."""
    context = Context()
    rclpy.init(context=context)
    node = Node("served", context=context)
    executor = request.param(context)
    executor.add_node(node)
    yield node, executor
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()


def spin_until(executor: Any, condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        executor.spin_once(timeout_sec=0.1)


def test_topics_services_timers_and_guards_are_served(spinning: tuple[Node, Any]) -> None:
    node, executor = spinning
    heard: list[int] = []
    ticks: list[int] = []
    woken: list[int] = []

    def hear(message: Int32) -> None:
        heard.append(message.data)

    node.create_subscription(Int32, "numbers", hear, 100)
    publisher = node.create_publisher(Int32, "numbers", 100)
    node.create_timer(0.01, lambda: ticks.append(1))
    guard = node.create_guard_condition(lambda: woken.append(1))

    def answer(request: Reset.Request, response: Reset.Response) -> Reset.Response:
        response.message = request.reason
        return response

    node.create_service(Reset, "answer", answer)
    client = node.create_client(Reset, "answer")
    spin_until(executor, lambda: publisher.get_subscription_count() and client.service_is_ready())
    for number in range(50):
        publisher.publish(Int32(data=number))
    guard.trigger()
    future = client.call_async(Reset.Request(reason="why"))
    spin_until(executor, lambda: len(heard) == 50 and future.done() and len(ticks) > 2 and woken)
    assert heard == list(range(50))
    assert future.result().message == "why"
    assert woken == [1]


def test_events_of_the_middleware_are_told(spinning: tuple[Node, Any]) -> None:
    node, executor = spinning
    found: list[int] = []

    def match(event: Any) -> None:
        found.append(event.current_count)

    callbacks = SubscriptionEventCallbacks(matched=match, use_default_callbacks=False)
    node.create_subscription(Int32, "numbers", lambda message: None, 10, event_callbacks=callbacks)
    executor.spin_once(timeout_sec=0.0)
    publisher = node.create_publisher(Int32, "numbers", 10)
    spin_until(executor, lambda: found)
    node.destroy_publisher(publisher)
    spin_until(executor, lambda: found[-1] == 0)
    assert found[0] == 1


def test_a_service_may_await_what_a_timer_brings(spinning: tuple[Node, Any]) -> None:
    node, executor = spinning
    arrived: Future = Future()
    begun: list[int] = []

    async def answer(request: Reset.Request, response: Reset.Response) -> Reset.Response:
        begun.append(1)
        response.message = await arrived
        return response

    node.create_service(Reset, "answer", answer)
    client = node.create_client(Reset, "answer")
    spin_until(executor, client.service_is_ready)
    future = client.call_async(Reset.Request())
    spin_until(executor, lambda: begun)
    arrived.set_result("here")
    spin_until(executor, future.done)
    assert future.result().message == "here"


def test_what_one_callback_destroys_is_not_called_any_more(spinning: tuple[Node, Any]) -> None:
    node, executor = spinning
    heard: list[str] = []
    subscriptions: dict[str, Any] = {}

    def take(mine: str, other: str, message: Int32) -> None:
        heard.append(mine)
        if other in subscriptions:
            node.destroy_subscription(subscriptions.pop(other))

    for mine, other in (("a", "b"), ("b", "a")):
        subscriptions[mine] = node.create_subscription(Int32, mine, partial(take, mine, other), 10)
    publishers = [node.create_publisher(Int32, name, 10) for name in ("a", "b")]
    spin_until(executor, lambda: all(item.get_subscription_count() for item in publishers))
    for item in publishers:
        item.publish(Int32())
    spin_until(executor, lambda: heard)
    for _ in range(5):
        executor.spin_once(timeout_sec=0.02)
    assert len(heard) == 1


def test_an_exception_in_a_callback_reaches_who_spins(spinning: tuple[Node, Any]) -> None:
    node, executor = spinning

    def fail() -> None:
        raise ZeroDivisionError

    node.create_timer(0.001, fail)
    with pytest.raises(ZeroDivisionError):
        spin_until(executor, lambda: False)


def test_a_timeout_ends_the_wait_and_a_shutdown_the_spinning(spinning: tuple[Node, Any]) -> None:
    node, executor = spinning
    begun = time.monotonic()
    executor.spin_once(timeout_sec=0.05)
    executor.spin_once(timeout_sec=0.05)
    assert time.monotonic() - begun < PATIENCE
    node.context.try_shutdown()
    executor.spin()


def test_what_rests_wakes_nobody_and_is_taken_before_what_does(domain: int) -> None:
    context = Context()
    rclpy.init(context=context)
    node: Any = Node("served", context=context)
    executor = NodeExecutor(context)
    executor.add_node(node)
    heard: list[tuple[str, int]] = []
    publishers = {}
    for name in ("awake", "resting"):
        subscription = node.create_subscription(
            Int32, name, lambda message, name=name: heard.append((name, message.data)), 10
        )
        publishers[name] = node.create_publisher(Int32, name, 10)
        if name == "resting":
            node.resting = [subscription]
    spin_until(executor, lambda: all(item.get_subscription_count() for item in publishers.values()))
    for number in range(3):
        publishers["resting"].publish(Int32(data=number))
    executor.spin_once(timeout_sec=0.0)
    assert heard == []
    publishers["awake"].publish(Int32(data=7))
    spin_until(executor, lambda: ("awake", 7) in heard)
    assert heard == [*(("resting", number) for number in range(3)), ("awake", 7)]
    node.resting = []
    publishers["resting"].publish(Int32(data=3))
    spin_until(executor, lambda: heard[-1] == ("resting", 3))
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()

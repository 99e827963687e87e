"""A killed node's subscriptions are no listeners, although the graph shows them for a while yet."""

from __future__ import annotations

import signal
import time

from harness import Graph
from sensor_msgs.msg import LaserScan

from whereabouts.nodes.runtime.audience import DeadEnds


def test_subscriptions_of_a_killed_node_are_counted_for_those_who_knew_it(graph: Graph) -> None:
    ends = DeadEnds(graph.node)
    publisher = graph.node.create_publisher(LaserScan, "scan", 10)
    spec = graph.start("verifier")
    graph.until(lambda: publisher.get_subscription_count() == 1, "the node is found")

    def listeners() -> list[str]:
        return [end.node_name for end in graph.node.get_subscriptions_info_by_topic("/scan")]

    # A subscription may be known before the name of who has it.
    graph.until(lambda: listeners() == [spec.executable], "the graph knows who listens")
    graph.kill(spec)
    ends.bury(spec.full_name)
    assert ends.known("/scan", since=0.0) == 1
    assert ends.known("/scan", since=time.monotonic()) == 0  # one that began later never knew it
    assert ends.known("/nothing", since=0.0) == 0
    assert publisher.get_subscription_count() == 1
    graph.start("verifier")
    graph.until(
        lambda: publisher.get_subscription_count() - ends.known("/scan", since=0.0) == 1,
        "its successor is the one who listens",
    )
    ends.bury("/nobody")


def test_a_node_that_says_farewell_leaves_none(graph: Graph) -> None:
    ends = DeadEnds(graph.node)
    spec = graph.start("verifier")
    graph.until(
        lambda: graph.node.count_subscribers("/scan"),
        "the node is found",
    )
    process = graph.supervisor.nodes[spec.full_name].process
    process.send_signal(signal.SIGTERM)
    process.wait()
    graph.until(lambda: not graph.node.count_subscribers("/scan"), "its farewell has come")
    ends.bury(spec.full_name)
    assert ends.known("/scan", since=0.0) == 0

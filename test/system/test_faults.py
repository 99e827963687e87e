"""Nodes broken on purpose: nonsense on every input, and a flood. `test_replay.py` kills them."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fuzz import Fuzzer
from harness import START, Graph, room, scan_message
from lifecycle_msgs.msg import State
from tf2_msgs.msg import TFMessage

from whereabouts.cli.run import NODES
from whereabouts.nodes.base import TF_STATIC_QOS
from whereabouts.nodes.interfaces import message_class
from whereabouts.nodes.stamps import NANOSECONDS, time_message
from whereabouts.nodes.transforms import transform_message
from whereabouts.simulation import Lidar
from whereabouts_msgs.msg import Processed

ROUNDS = 30
FLOOD = 2000
HERE = (0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0)


def figures(node: str, diagnostics: list[Any]) -> dict[str, str]:
    """A node's latest diagnostics."""
    mine = [status for message in diagnostics for status in message.status if status.name == node]
    return {item.key: item.value for item in mine[-1].values} if mine else {}


@pytest.mark.parametrize("node", NODES)
def test_nonsense_on_every_input_is_survived(graph: Graph, node: str) -> None:
    diagnostics = graph.collect(DiagnosticArray, "diagnostics")
    answers = graph.collect(Processed, f"{node}/processed", 1000)
    spec = graph.start(node)
    # Whom the node itself moves, it is not told.
    links = {"scan_registration": [], "loop_closure": [("odom", "base_link")]}
    frames = [*links.get(node, [("map", "odom"), ("odom", "base_link")]), ("base_link", "laser")]
    tree = TFMessage(transforms=[transform_message(parent, child, START, HERE) for parent, child in frames])
    types = {topic: message_class(graph.type_of(topic)) for topic in graph.inputs(spec)}
    fuzzer = Fuzzer(seed=7)
    for round_ in range(ROUNDS):
        if round_ == 0 and "/tf_static" in types:
            graph.publish("/tf_static", tree, TF_STATIC_QOS)
        for topic, kind in types.items():
            # Transforms last: once frames mean nothing, little else gets anywhere.
            if topic.startswith("/tf") and round_ < ROUNDS // 2:
                continue
            before = len(answers)
            # Durable, as some listen only to what is kept for those who come late.
            graph.publish(topic, fuzzer.message(kind), TF_STATIC_QOS)
            graph.until(
                lambda topic=topic, before=before: any(a.topic == topic for a in answers[before:]),
                f"{topic}, round {round_}, is processed",
            )
    assert graph.state(spec) == State.PRIMARY_STATE_ACTIVE
    # One more may have been under way since before the last message.
    reported = len(diagnostics)
    graph.until(lambda: len(diagnostics) >= reported + 2, "fresh diagnostics")
    last = figures(node, diagnostics)
    assert last["internal errors"] == "0", graph.log(spec)[-3000:]


def test_a_flood_of_scans_is_survived_and_accounted_for(graph: Graph) -> None:
    everything = graph.collect(Processed, "scan_registration/processed", 5000)
    diagnostics = graph.collect(DiagnosticArray, "diagnostics")
    graph.start("scan_registration", input_reliability="best_effort", segment_scans=False)
    graph.mount()
    lidar, rng, here = Lidar(), np.random.default_rng(3), np.array([-3.0, -1.5, 0.0])
    message = scan_message(lidar.scan(room(), here, rng, 0.0).scan)
    sent = 0

    def send() -> None:
        nonlocal sent
        sent += 1
        message.header.stamp = time_message(START + sent * NANOSECONDS // 1000)
        graph.publish("scan", message)

    def newest() -> int:
        """Number of the latest scan that was processed."""
        return max((answer.sequence for answer in everything if answer.topic == "/scan"), default=0)

    send()
    graph.until(newest, "the first scan is processed")
    for _ in range(FLOOD):
        send()

    tried = time.monotonic()

    def last_arrived() -> bool:
        """Best effort: the last one may be lost as well; then another follows once the node has had its time."""
        nonlocal tried
        if newest() < sent and time.monotonic() - tried > 3.0:
            tried = time.monotonic()
            send()
        return newest() == sent

    graph.until(last_arrived, "the node has caught up")

    def accounted() -> bool:
        counts = figures("scan_registration", diagnostics)
        return bool(counts) and int(counts["/scan received"]) + int(counts["/scan lost"]) == sent

    graph.until(accounted, "every scan is either received or counted as lost")
    assert figures("scan_registration", diagnostics)["internal errors"] == "0"

"""The whole suite broken on purpose: nonsense on every input, floods, full disks, nodes that die."""

from __future__ import annotations

from typing import Any

import pytest
from fuzz import Fuzzer
from harness import START, Graph
from lifecycle_msgs.msg import State
from tf2_msgs.msg import TFMessage

from whereabouts.cli.run import NODES
from whereabouts.nodes.base import TF_STATIC_QOS
from whereabouts.nodes.interfaces import message_class
from whereabouts.nodes.transforms import transform_message
from whereabouts_msgs.msg import Processed

ROUNDS = 30
HERE = (0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0)


def figures(node: str, diagnostics: list[Any]) -> dict[str, str]:
    """A node's latest diagnostics."""
    mine = [status for message in diagnostics for status in message.status if status.name == node]
    return {item.key: item.value for item in mine[-1].values} if mine else {}


@pytest.mark.parametrize("node", NODES)
def test_nonsense_on_every_input_is_survived(graph: Graph, node: str) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

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
    diagnostics.clear()
    last = graph.until(lambda: figures(node, diagnostics), "fresh diagnostics")
    assert last["internal errors"] == "0", graph.log(spec)[-3000:]

"""Nodes broken on purpose: nonsense on every input, and a flood. `test_replay.py` kills them."""

from __future__ import annotations

import resource
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import START, Graph, Robot, mounting, room, scan_message
from lifecycle_msgs.msg import State
from test_world_model import ON_COUNTER, ON_DESK, ON_TABLE, World, evidence, seen
from tf2_msgs.msg import TFMessage

from evaluation.chaos.generator import Fuzzer
from whereabouts.cli.run import NODES
from whereabouts.nodes.messages.message_types import message_class
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.ros.qos import TF_STATIC_QOS
from whereabouts.simulation import Drive, Lidar
from whereabouts_msgs.msg import Processed

ROUNDS = 30
FLOOD = 2000
CROWD = 10_000
HERE = (0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0)


def figures(node: str, diagnostics: list[Any]) -> dict[str, str]:
    """A node's latest diagnostics."""
    mine = [status for message in diagnostics for status in message.status if status.name == node]
    return {item.key: item.value for item in mine[-1].values} if mine else {}


@pytest.mark.parametrize("node", NODES)
def test_nonsense_on_every_input_is_survived(graph: Graph, node: str) -> None:
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    answers = graph.collect(Processed, f"{node}/processed", 1000)
    spec = graph.start(node)
    # Whom the node itself moves, it is not told.
    links = {"scan_registration": [], "loop_closure": [("odom", "base_link")]}
    frames = [*links.get(node, [("map", "odom"), ("odom", "base_link")]), ("base_link", "laser")]
    tree = TFMessage(transforms=[transform_message(parent, child, START, HERE) for parent, child in frames])
    types = {topic: message_class(graph.type_of(topic)) for topic in graph.inputs(spec)}
    fuzzer, sent, sometime = Fuzzer(seed=7), Counter[str](), graph.on_demand(spec)
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
            sent[topic] += 1
            if topic in sometime:
                continue
            graph.until(
                lambda topic=topic, before=before: any(a.topic == topic for a in answers[before:]),
                f"{topic}, round {round_}, is processed",
            )
    graph.until(
        lambda: all(count >= sent[topic] for topic, count in graph.on_demand(spec).items()),
        "what is taken in on demand has been",
    )
    assert graph.state(spec) == State.PRIMARY_STATE_ACTIVE
    # One more may have been under way since before the last message.
    reported = len(diagnostics)
    graph.until(lambda: len(diagnostics) >= reported + 2, "fresh diagnostics")
    last = figures(node, diagnostics)
    assert last["internal errors"] == "0", graph.log(spec)[-3000:]


def test_a_flood_of_scans_is_survived_and_accounted_for(graph: Graph) -> None:
    everything = graph.collect(Processed, "scan_registration/processed", 5000)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
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


def test_ten_thousand_detections_in_one_message_are_survived(graph: Graph) -> None:
    answers = graph.collect(Processed, "world_model/processed")
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    spec = graph.start(
        "world_model", classes=["cup", "bowl"], region=[-500.0, 500.0, -500.0, 500.0, -0.5, 2.5]
    )
    places = np.random.default_rng(3).uniform(-400.0, 400.0, (CROWD, 2))
    graph.publish("evidence", evidence(0.0, *(seen((x, y, 0.5), "cup", "red") for x, y in places)))
    graph.publish("evidence", evidence(0.1, seen(ON_TABLE, "bowl", "green")))
    graph.until(
        lambda: any(a.topic == "/evidence" and a.received == 2 for a in answers), "both are processed"
    )
    graph.until(lambda: figures("world_model", diagnostics).get("/evidence used") == "2", "both are used")
    last = figures("world_model", diagnostics)
    assert int(last["objects"]) > 0
    assert last["internal errors"] == "0", graph.log(spec)[-3000:]
    assert graph.state(spec) == State.PRIMARY_STATE_ACTIVE


def test_a_full_disk_stops_neither_the_node_nor_what_is_stored(graph: Graph, tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    world = World(graph, store_path=str(path))
    cup, bowl, shoe = (
        seen(ON_TABLE, "cup", "red"),
        seen(ON_COUNTER, "bowl", "green"),
        seen(ON_DESK, "shoe", "blue"),
    )
    now = world.look(0.0, 12, cup)
    # To the process it is as if the disk had room for nothing more.
    process = graph.supervisor.nodes[world.spec.full_name].process.pid
    unlimited = resource.prlimit(process, resource.RLIMIT_FSIZE, (1024, resource.RLIM_INFINITY))
    now = world.look(now, 12, cup, bowl)
    graph.until(
        lambda: "not written" in str(world.diagnostics[-1].status), "diagnostics say that nothing is written"
    )
    assert [item.id for item in world.at(round(now - 0.1, 3)).objects] == ["bowl-1", "cup-1"]
    resource.prlimit(process, resource.RLIMIT_FSIZE, unlimited)
    now = world.look(now, 12, cup, bowl, shoe)
    graph.until(
        lambda: "not written" not in str(world.diagnostics[-1].status), "diagnostics say that all is well"
    )
    graph.kill(world.spec)
    world.states.clear()
    world.start()
    restored = graph.until(lambda: world.states, "the remembered world, before anything is seen")[0]
    assert [item.id for item in restored.objects] == ["bowl-1", "cup-1", "shoe-1"]


def test_two_robots_in_one_domain_do_not_hear_each_other(graph: Graph) -> None:
    nodes = ("scan_registration", "loop_closure", "target_tracker", "world_model")
    robots = [Robot(graph, f"/robot{number}/") for number in (1, 2)]
    robots[1].drive = Drive([(3.0, 1.5), (-3.0, 1.5), (-3.0, -1.5)], speed=0.4)
    specs = [
        graph.start(name, wait=False, namespace=f"/robot{number}") for name in nodes for number in (1, 2)
    ]
    for spec in specs:
        graph.await_active(spec)
    for robot in robots:
        mount = TFMessage(transforms=[mounting("laser", HERE)])
        graph.publish(f"{robot.prefix}tf_static", mount, TF_STATIC_QOS)
    for k in range(25):
        for robot in robots[: 1 if k % 5 == 4 else 2]:
            robot.send(scan_message(robot.scan(0.1 * k)))
    for robot, scans in zip(robots, (25, 20), strict=True):
        assert len(robot.poses()) == scans
        for moment, pose in robot.poses().items():
            np.testing.assert_allclose(pose[:2], robot.truth(moment)[:2], atol=0.03)
        for name in nodes[:3]:
            figure = f"{robot.prefix}scan received"
            graph.until(
                lambda robot=robot, name=name, figure=figure, scans=scans: (
                    figures(f"{robot.prefix}{name}".strip("/"), robot.diagnostics).get(figure) == str(scans)
                ),
                f"{robot.prefix}{name} has its own {scans} scans and no others",
            )

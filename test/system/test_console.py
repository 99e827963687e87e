"""The console beside a running graph, and in a real browser where one is installed."""

from __future__ import annotations

import json
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, PoseStamped, TransformStamped, Vector3
from harness import Graph
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.serialization import serialize_message
from serving import served
from tf2_msgs.msg import TFMessage

from evaluation.browser import CHROMIUM, Browser
from whereabouts.console.console_server import Console
from whereabouts.console.heard import TOPICS, Heard
from whereabouts.console.sources import ConsoleError
from whereabouts.nodes.live.console_source import LiveSource, reader_of
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts_msgs.msg import (
    Attribute,
    DiscreteDistribution,
    PredictedPath,
    PredictedPathArray,
    PredictedPoint,
    TargetArray,
    VerificationTask,
    WorldState,
)
from whereabouts_msgs.msg import Target as TargetMessage
from whereabouts_msgs.msg import WorldObject as ObjectMessage

TOKEN = "secret"
EVIL = "<img src=x onerror='window.broken=1'></script><script>window.broken=1</script>"


def cup(x: float) -> WorldState:
    item = ObjectMessage(id="cup-1", existence_probability=0.9)
    item.class_distribution = DiscreteDistribution(values=["cup"], probabilities=[1.0])
    item.pose.pose.position.x = x
    message = WorldState(objects=[item])
    message.header.frame_id = "map"
    message.header.stamp.sec = 5
    return message


def person(label: int) -> TargetArray:
    message = TargetArray(targets=[TargetMessage(label=label)])
    message.header.frame_id = "odom"
    message.header.stamp.sec = 5
    return message


def grid() -> OccupancyGrid:
    message = OccupancyGrid(data=[0, 100, -1, 0])
    message.info.width = message.info.height = 2
    message.info.resolution = 1.0
    message.header.frame_id = "map"
    return message


class Suite:
    """What the nodes would publish."""

    def __init__(self, graph: Graph) -> None:
        node = graph.node
        self.world = node.create_publisher(WorldState, "world_state", LATCHED)
        self.targets = node.create_publisher(TargetArray, "targets", 10)
        self.map = node.create_publisher(OccupancyGrid, "map", LATCHED)
        self.tf = node.create_publisher(TFMessage, "tf", 10)
        # Latched: the console hears these however late it comes.
        self.world.publish(cup(1.0))
        self.map.publish(grid())

    def tell(self, label: int) -> None:
        moved = TransformStamped()
        moved.header.frame_id, moved.child_frame_id = "map", "odom"
        moved.transform.translation.x = 2.0
        self.tf.publish(TFMessage(transforms=[moved]))
        self.targets.publish(person(label))


def test_what_the_suite_says_is_shown_and_what_cannot_be_done_is_said(graph: Graph) -> None:
    suite = Suite(graph)
    labels = count()
    with LiveSource() as source:

        def heard() -> bool:
            suite.tell(next(labels))
            world = source.world()
            return bool(
                world["things"] and world["map"] and world["people"] and world["people"][0]["x"] == 2.0
            )

        graph.until(heard, "the console has heard of everything")
        world = source.world()
        assert (world["things"][0]["id"], world["things"][0]["x"]) == ("cup-1", 1.0)
        assert world["map"]["box"] == [0.0, 2.0, 0.0, 2.0]
        before = source.version
        suite.world.publish(cup(3.0))
        graph.until(lambda: source.world()["things"][0]["x"] == 3.0, "the cup has moved")
        assert source.version > before
        for action, sentence in (("find", "search does not run"), ("save_map", "no map to save")):
            with pytest.raises(ConsoleError, match=sentence):
                source.act(action, {"name": "cup-1"})
        with pytest.raises(ConsoleError, match="--store"):
            source.ask("where is the cup?")


def test_the_search_asked_for_last_is_shown_and_cancelled(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph.start("object_search")
    found, ended = LiveSource._found, []

    def heard(*told: Any) -> None:
        found(*told)
        ended.append(told)

    monkeypatch.setattr(LiveSource, "_found", heard)
    with LiveSource() as source:

        def asked(name: str) -> bool:
            with suppress(ConsoleError):
                return bool(source.act("find", {"name": name}))
            return False

        graph.until(lambda: asked("cup"), "the search takes the first goal")
        source.act("find", {"name": "book"})
        graph.until(lambda: ended, "the console has heard that the first search has ended")
        source.act("cancel", {})
        graph.until(lambda: source.world()["search"]["done"], "the second search has ended")
        search = source.world()["search"]
        assert (search["name"], search["text"]) == ("book", "cancelled")


def test_messages_are_read_as_ros_reads_them() -> None:
    world = cup(1.5)
    [item] = world.objects
    item.lost, item.place, item.place_probability = True, "counter", 0.25
    item.last_seen.sec, item.last_seen.nanosec = 4, 500_000_000
    item.pose.covariance[7] = 0.04
    item.properties = [
        Attribute(name="color", discrete=DiscreteDistribution(values=["réd"], probabilities=[0.9]))
    ]
    people = person(7)
    [target] = people.targets
    target.position, target.velocity, target.occluded = Point(x=1.0, y=2.0), Vector3(x=0.5), True
    path = PredictedPath(
        label=7,
        goals=[Point(x=3.0)],
        goal_probabilities=[0.75],
        points=[PredictedPoint(position=Point(y=-1.0))],
    )
    paths = PredictedPathArray(paths=[path], header=people.header)
    moved = TransformStamped(child_frame_id="odom", header=world.header)
    moved.transform.translation.x, moved.transform.rotation.w = 2.0, 1.0
    status = DiagnosticStatus(
        name="/tracker", hardware_id="whereabouts", level=DiagnosticStatus.WARN, message="late"
    )
    task = VerificationTask(header=world.header, object_id="cup-1", reason="not seen for long")
    told = [
        ("tf", TFMessage(transforms=[moved])), ("map", grid()), ("world_state", world), ("targets", people),
        ("predicted_paths", paths), ("verification_tasks", task),
        ("odometry", Odometry(header=people.header, child_frame_id="base_link")),
        ("search_goal", PoseStamped(header=world.header)), ("/diagnostics", DiagnosticArray(status=[status])),
    ]  # fmt: skip
    ours, theirs = Heard(), Heard()
    for topic, message in told:
        theirs.take(topic, message)
        ours.take(topic, reader_of(TOPICS[topic])(serialize_message(message)))
    shown = ours.world()
    assert shown["health"][0]["level"] == "warning"
    assert shown["people"][0]["goals"] == [[5.0, 0.0, 0.75]]
    assert json.dumps(shown) == json.dumps(theirs.world())
    assert ours.picture == theirs.picture


@pytest.mark.skipif(CHROMIUM is None, reason="no browser here: install Debian's chromium")
def test_a_browser_shows_it_and_comes_back_after_a_lost_connection(graph: Graph, tmp_path: Path) -> None:
    suite = Suite(graph)
    labels = count()
    with LiveSource() as source, Browser(tmp_path / "browser") as browser:

        def text() -> str:
            return browser.run("document.body.innerText") or ""

        def shown() -> bool:
            suite.tell(next(labels))
            return "cup (cup-1)" in text() and "person" in text()

        with served(Console(source, TOKEN)) as port:
            browser.open(f"http://127.0.0.1:{port}/#token={TOKEN}")
            graph.until(shown, "the page shows the cup and the person")
            assert browser.run("document.querySelector('#find').disabled") is True
            browser.run("document.querySelector('#things button').click()")
            assert browser.run("document.querySelector('#find').disabled") is False
            browser.run("document.querySelector('#find').click()")
            graph.until(lambda: "search does not run" in text(), "the refusal is shown")
            browser.run("document.querySelector('#question').value = 'where?'")
            browser.run("document.querySelector('#ask').requestSubmit()")
            graph.until(lambda: "--store" in text(), "the answer is shown")
            named = cup(1.0)
            named.objects = [*named.objects, ObjectMessage(id=EVIL, existence_probability=0.9)]
            suite.world.publish(named)
            graph.until(lambda: EVIL in text(), "a name is only a name")
            browser.run("document.querySelector('#things button:last-child').click()")
            assert browser.run("typeof window.broken") == "undefined"
            # The token is not left in the address, which people send to each other.
            assert TOKEN not in browser.run("location.href")
        graph.until(lambda: browser.run("!document.querySelector('#banner').hidden"), "it says it is cut off")
        with served(Console(source, TOKEN), port):
            graph.until(lambda: browser.run("document.querySelector('#banner').hidden"), "it is back")

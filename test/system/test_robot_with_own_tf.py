"""A base that places itself in tf: it keeps its frames, and the map is made along scan registration all the same."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import START, Graph, Robot, scan_message
from tf2_msgs.msg import TFMessage
from typer.testing import CliRunner

from estimation.geometry.poses import between, compound, pose_from_matrix
from evaluation.scenes.small_robot import record
from whereabouts.cli.main import app
from whereabouts.logs import TransformRecord, open_log
from whereabouts.nodes.messages.conversions import fill_pose, spatial
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.ros.qos import TF_STATIC_QOS

PLANAR = [0, 1, 5]


class FrameParents:
    """Transforms of a bag and of what was recorded while it was replayed."""

    def __init__(self, *paths: Path) -> None:
        self.parents: dict[str, set[str]] = {}
        self._moving: dict[str, dict[float, np.ndarray]] = {"odom": {}, "map": {}}
        for path in paths:
            with open_log(path) as log:
                for item in log:
                    if isinstance(item, TransformRecord):
                        self.parents.setdefault(item.child_frame_id, set()).add(item.frame_id)
                        if item.frame_id in self._moving:
                            self._moving[item.frame_id][item.stamp] = item.transform

    def in_map(self, stamp: float) -> np.ndarray:
        """Pose (3,) of the base, by the transforms nearest to a stamp."""
        parts = []
        for parent in ("map", "odom"):
            known = self._moving[parent]
            parts.append(known[min(known, key=lambda other: abs(other - stamp))])
        return np.asarray(pose_from_matrix(parts[0] @ parts[1])[PLANAR])


def run(bag: Path, out: Path, *options: str) -> FrameParents:
    command = [
        "run",
        "scan_registration",
        "loop_closure",
        "--bag",
        str(bag),
        "--lock-step",
        "--out",
        str(out),
    ]
    command += ["--record", "tf:tf2_msgs/msg/TFMessage", "--logs", str(out.parent / "logs"), *options]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, f"{result.output}{result.exception}"
    return FrameParents(bag, out)


def miss(tree: FrameParents, truth: np.ndarray) -> float:
    """Error of the last pose since the first second, m."""
    first, last = truth[5], truth[-1]
    error = between(between(first[1:], last[1:]), between(tree.in_map(first[0]), tree.in_map(last[0])))
    return float(np.hypot(*error[:2]))


ONE_TREE = {
    "base_scan": {"base_link"}, "base_link": {"base_footprint"}, "base_footprint": {"odom"}, "odom": {"map"}
}  # fmt: skip


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """Through the door into the second room: the wheels are 0.3 m off by then."""
    path = tmp_path_factory.mktemp("bag") / "tb3.mcap"
    return path, record(path, duration=30.0)


def test_set_up_and_run_without_a_parameter_by_hand(driven: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    bag, truth = driven
    settings = tmp_path / "robot.yaml"
    assert CliRunner().invoke(app, ["setup", str(bag), "--out", str(settings)]).exit_code == 0
    tree = run(bag, tmp_path / "out.mcap", "--config", str(settings))
    assert tree.parents == ONE_TREE
    assert miss(tree, truth) < 0.05
    # The wheels alone are far worse, so it is scan registration that helps, by its messages.
    wheels = (tmp_path / "wheels.yaml").absolute()
    written = yaml.safe_load(settings.read_text())
    assert written["/**/loop_closure"]["ros__parameters"]["odometry_source"] == "auto"
    written["/**/loop_closure"]["ros__parameters"]["odometry_source"] = "tf"
    wheels.write_text(yaml.safe_dump(written))
    assert miss(run(bag, tmp_path / "wheels.mcap", "--config", str(wheels)), truth) > 0.05


def test_as_shipped_no_frame_gets_a_second_parent(driven: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    bag, truth = driven
    tree = run(bag, tmp_path / "out.mcap")
    assert tree.parents == ONE_TREE
    assert miss(tree, truth) < 0.05


@pytest.mark.parametrize("message_first", [True, False])
def test_messages_and_scans_may_come_in_any_order(graph: Graph, message_first: bool) -> None:
    """What the messages say of the motion counts, and not what the base says on tf."""
    robot = Robot(graph)
    transforms: list[TFMessage] = graph.collect(TFMessage, "tf")
    graph.start("loop_closure", tf_period=5.0)
    graph.mount()
    by_wheels, offset = np.array([2.0, -1.0, 0.4]), np.array([0.5, 0.2, -0.3])

    def base(time: float) -> np.ndarray:
        # Wheels that slip: they say a tenth less than is driven.
        return compound(by_wheels, robot.truth(time) * 0.9)

    def place(time: float) -> None:
        stamp = START + round(time * NANOSECONDS)
        pose = spatial(base(time))
        quaternion = (0.0, 0.0, np.sin(pose[5] / 2.0), np.cos(pose[5] / 2.0))
        graph.publish(
            "tf",
            TFMessage(transforms=[transform_message("odom", "base_link", stamp, (*pose[:3], *quaternion))]),
        )

    def tell(time: float) -> None:
        from nav_msgs.msg import Odometry

        message = Odometry()
        message.header.stamp = time_message(START + round(time * NANOSECONDS))
        message.header.frame_id, message.child_frame_id = "odom", "base_link"
        fill_pose(message.pose.pose, spatial(compound(offset, robot.truth(time))))
        graph.publish("odometry", message)

    def corrected(time: float) -> Any:
        stamp = START + round((time + 0.1) * NANOSECONDS)
        found = [t for m in transforms for t in m.transforms if t.child_frame_id == "odom"]
        return next((t for t in found if nanoseconds(t.header.stamp) == stamp), None)

    times = [0.2 * k for k in range(12)]
    for number, time in enumerate(times):
        place(time)
        steps = [lambda: tell(time), lambda: graph.publish("scan", scan_message(robot.scan(time)))]  # noqa: B023
        # The first message makes the node know that there are any.
        for step in steps if message_first or number == 0 else steps[::-1]:
            step()
        graph.until(lambda: corrected(time), f"the correction at {time:.1f} s")  # noqa: B023
    last = corrected(times[-1]).transform
    yaw = 2.0 * np.arctan2(last.rotation.z, last.rotation.w)
    correction = np.array([last.translation.x, last.translation.y, yaw])
    pose = compound(correction, base(times[-1]))
    expected = compound(offset, robot.truth(times[-1]))
    assert np.abs(between(expected, pose)).max() < 0.01


def test_a_second_parent_is_an_error_in_diagnostics(graph: Graph) -> None:
    said: list[DiagnosticArray] = graph.collect(DiagnosticArray, "/diagnostics")
    graph.start("loop_closure")
    graph.mount()
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    graph.publish("tf", TFMessage(transforms=[transform_message("odom", "base_link", START, still)]))
    graph.until(lambda: len(said) > 2, "diagnostics arrive")
    assert all(status.level != DiagnosticStatus.ERROR for array in said for status in array.status)
    static = transform_message("base_footprint", "base_link", 0, still)
    graph.publish("tf_static", TFMessage(transforms=[static]), TF_STATIC_QOS)

    def error() -> Any:
        return [s for array in said for s in array.status if s.level == DiagnosticStatus.ERROR]

    found = graph.until(error, "an error in diagnostics")
    assert found[0].message == "frame 'base_link' has two parents: 'base_footprint' and 'odom'"


def test_a_running_robot_is_looked_at(graph: Graph, tmp_path: Path) -> None:
    """Its publishers are named, two of one topic are refused, and what a node of the suite drops is said."""
    from sensor_msgs.msg import LaserScan

    robot = Robot(graph)
    graph.start("scan_registration", transform_timeout=0.0)
    graph.mount()
    robot.send(scan_message(robot.scan(0.0)))
    robot.send(scan_message(robot.scan(0.1), frame=""))
    # A scan waits for its transform by the time of messages, so that later ones end the wait.
    robot.go(0.2, 6.2, 0.5)
    graph.until(
        lambda: "/scan dropped, no transform" in robot.figures(), "the node says that it drops something"
    )
    figures = tmp_path / "found.json"

    def examine(*command: str) -> list[tuple[str, str]]:
        process = subprocess.Popen(
            [sys.executable, "-m", "whereabouts.cli.main", *command, "--json", str(figures)]
        )
        number = 1

        def ended() -> bool:
            nonlocal number
            number += 1
            graph.publish("scan", scan_message(robot.scan(0.1 * number)))
            return process.poll() is not None

        graph.until(ended, "the command ends")
        return [(item["level"], item["text"]) for item in json.loads(figures.read_text())["findings"]]

    said = examine("setup", "--out", str(tmp_path / "robot.yaml"), "--seconds", "3")
    assert any("following /scan" in text for _, text in said)
    assert any(text.startswith("nodes of the suite are running: /scan_registration.") for _, text in said)
    assert not any("static_points" in text for _, text in said), "it is the suite's own"
    assert any("scan_registration" in text and "/scan dropped, no transform: 1" in text for _, text in said)
    second = graph.node.create_publisher(LaserScan, "scan", 1)
    said = examine("doctor", "--seconds", "3")
    assert ("error", "/scan has two publishers: /tester, /tester") in said
    graph.node.destroy_publisher(second)


def test_what_comes_before_the_first_transform_is_counted_and_no_trouble(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start("target_tracker")
    graph.mount()
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    graph.publish("tf", TFMessage(transforms=[transform_message("odom", "base_link", START, still)]))
    graph.publish("scan", scan_message(robot.scan(-0.1)))
    told = graph.until(
        lambda: (
            robot.figures().get("/scan dropped, before the first transform") == "1" and robot.diagnostics[-1]
        ),
        "the scan is counted",
    )
    assert all(status.level == DiagnosticStatus.OK for array in robot.diagnostics for status in array.status)
    assert told.status[0].name == "target_tracker"

"""Bags replayed through supervised nodes."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from harness import START, Graph, room
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from evaluation.repeats import compare, differences, said
from whereabouts.cli.run import NODES
from whereabouts.logs import (
    McapWriter,
    OdometryRecord,
    RawMessage,
    ScanRecord,
    TransformRecord,
    open_log,
    open_raw,
)
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.runtime.replayer import Replayer
from whereabouts.nodes.runtime.suite_run import SuiteRun, replay_spec, run_suite
from whereabouts.simulation import Drive, Lidar
from whereabouts_msgs.msg import Connections

ODOMETRY = [("odometry", "nav_msgs/msg/Odometry")]
SCANS = 60


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive, recorded."""
    path = tmp_path_factory.mktemp("bag") / "drive.mcap"
    drive, lidar, rng = (
        Drive([(-3.0, -1.5), (2.5, -1.5), (2.5, 1.5)], speed=0.5),
        Lidar(),
        np.random.default_rng(5),
    )
    start = START / NANOSECONDS
    with McapWriter(path) as writer:
        mount = np.eye(4)
        writer.write_transforms([TransformRecord(mount, start, "base_link", "laser", "tf_static")])
        for k in range(SCANS):
            pose = drive(0.1 * k)
            scan = lidar.scan(room(), pose, rng, start + 0.1 * k).scan
            writer.write_odometry(OdometryRecord(pose, start + 0.1 * k))
            writer.write_scan(ScanRecord(scan, scan.stamp))
    return path


def suite_run(bag: Path, folder: Path, **changes: object) -> SuiteRun:
    settings = {"record": ODOMETRY, "output": folder / "out.mcap", **changes}
    return SuiteRun(bag, [replay_spec("scan_registration")], folder / "logs", **settings)  # type: ignore[arg-type]


def odometry_bytes(path: Path) -> list[bytes]:
    with open_raw(path, ["odometry"]) as log:
        return [bytes(message.data) for message in log]


def test_lock_step_answers_every_message_and_repeats_exactly(bag: Path, tmp_path: Path) -> None:
    outputs = []
    for name in ("first", "second"):
        folder = tmp_path / name
        folder.mkdir()
        account = run_suite(suite_run(bag, folder))
        assert account.published == {"/tf_static": 1, "/wheel_odom": SCANS, "/scan": SCANS}
        assert account.unanswered.total() == 0
        assert account.total_lost == 0
        outputs.append(odometry_bytes(folder / "out.mcap"))
    assert len(outputs[0]) == SCANS
    assert outputs[0] == outputs[1]


def test_the_demo_through_all_nodes_repeats_exactly_on_a_busy_machine(tmp_path: Path) -> None:
    found, count = compare(tmp_path, 8.0, 2)
    assert found == []
    assert count > 300
    everything = said(tmp_path / "alone" / "recording.mcap")
    assert {"/targets", "/predicted_paths", "/world_state", "/trajectory", "/map"} <= set(everything)
    # A difference would be seen.
    others = said(tmp_path / "busy" / "recording.mcap")
    at, (state, *_) = others["/world_state"][-1]
    changed = [(name, 2 if name == "epoch" else value) for name, value in state]
    others["/world_state"][-1] = (at, [tuple(changed)])
    (text,) = differences(everything, others)
    assert text.endswith(".epoch: 0 and 2")


def test_replay_at_a_rate_loses_nothing(bag: Path, tmp_path: Path) -> None:
    account = run_suite(suite_run(bag, tmp_path, rate=4.0))
    assert account.total_lost == 0
    assert account.bag_seconds == pytest.approx(0.1 * (SCANS - 1), abs=0.01)
    # Never ahead of the recorded pace; how far behind depends on the machine.
    assert account.wall_seconds >= account.bag_seconds / 4.0
    assert len(odometry_bytes(tmp_path / "out.mcap")) == SCANS


def test_node_killed_in_mid_replay_is_brought_back_and_the_replay_goes_on(bag: Path, tmp_path: Path) -> None:
    events: list[str] = []
    run = suite_run(bag, tmp_path, on_event=events.append)
    sent = 0

    def kill_once(message: RawMessage) -> None:
        nonlocal sent
        sent += message.name == "/scan"
        if sent == 20 and not events and run.supervisor is not None:
            node = run.supervisor.nodes["/scan_registration"]
            if node.running and node.restarts == 0:
                node.process.send_signal(signal.SIGKILL)
                node.process.wait()

    run.on_message = kill_once
    account = run_suite(run)
    assert events == ["/scan_registration ended with SIGKILL and was started again"]
    assert account.published["/scan"] == SCANS
    assert account.unanswered.total() == 0
    with open_log(tmp_path / "out.mcap") as log:
        stamps = [record.stamp for record in log if isinstance(record, OdometryRecord)]
    assert len(stamps) == SCANS


def test_every_node_in_turn_is_killed_and_comes_back(bag: Path, tmp_path: Path) -> None:
    events: list[str] = []
    specs = [replay_spec(name) for name in NODES]
    run = SuiteRun(
        bag, specs, tmp_path / "logs", record=ODOMETRY, output=tmp_path / "out.mcap", on_event=events.append
    )
    due = {10 + 6 * k: spec.full_name for k, spec in enumerate(specs)}
    sent = 0

    def kill_in_turn(message: RawMessage) -> None:
        nonlocal sent
        sent += message.name == "/scan"
        name = due.pop(sent, None) if message.name == "/scan" else None
        if name is not None and run.supervisor is not None:
            process = run.supervisor.nodes[name].process
            process.send_signal(signal.SIGKILL)
            process.wait()

    run.on_message = kill_in_turn
    account = run_suite(run)
    assert [event for event in events if "SIGKILL" in event] == [
        f"{spec.full_name} ended with SIGKILL and was started again" for spec in specs
    ]
    assert account.published["/scan"] == SCANS
    assert account.unanswered.total() == 0
    assert account.total_lost == 0
    assert len(odometry_bytes(tmp_path / "out.mcap")) == SCANS


def test_message_in_the_hands_of_a_killed_node_is_counted(bag: Path, tmp_path: Path) -> None:
    run = suite_run(bag, tmp_path)
    killed = False

    def stop_then_kill(message: RawMessage) -> None:
        nonlocal killed
        assert run.supervisor is not None
        process = run.supervisor.nodes["/scan_registration"].process
        if message.name == "/wheel_odom" and not killed:
            killed = True
            # Stopped, it takes the next message and never answers; it dies while the replayer waits.
            process.send_signal(signal.SIGSTOP)
            subprocess.Popen(["sh", "-c", f"sleep 1; kill -KILL {process.pid}"])

    run.on_message = stop_then_kill
    account = run_suite(run)
    assert account.unanswered["/scan_registration"] == 1
    assert account.published["/scan"] == SCANS


def test_somebody_else_who_speaks_on_a_topic_of_the_bag_stops_nobody(
    graph: Graph, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("whereabouts.nodes.runtime.replayer.SILENCE", 3.0)
    other = graph.node.create_publisher(Odometry, "/wheel_odom", 10)
    run = suite_run(bag, tmp_path)
    spoken = 0

    def speak(message: RawMessage) -> None:
        nonlocal spoken
        if message.name == "/wheel_odom" and spoken < 2 and other.get_subscription_count():
            assert run.replayer is not None
            spoken += 1
            run.replayer.note("/wheel_odom")
            other.publish(bytes(message.data))

    run.on_message = speak
    account = run_suite(run)
    assert spoken == 2
    assert account.unanswered.total() == 0
    assert account.published["/scan"] == SCANS


def test_bag_with_unknown_types_and_a_clock_is_replayed_without_them(bag: Path, tmp_path: Path) -> None:
    from whereabouts.logs import Topic

    source = tmp_path / "mixed.mcap"
    with McapWriter(source) as writer, open_raw(bag) as log:
        strange = Topic("/strange", "no_msgs/msg/Nothing", "int32 value\n")
        # A simulator's clock that begins at 0, recorded by the wall clock: the replay's own goes by the latter.
        clock = Topic("/clock", "rosgraph_msgs/msg/Clock")
        for number, message in enumerate(log):
            writer.write_raw(message.topic, bytes(message.data), message.log_time)
            writer.write_raw(strange, b"\x00\x01\x00\x00\x05\x00\x00\x00", message.log_time)
            writer.write_raw(clock, struct.pack("<IiI", 0x0100, number, 0), message.log_time)
    account = run_suite(suite_run(source, tmp_path))
    assert set(account.skipped) == {"/strange", "/clock"}
    assert account.unanswered.total() == 0
    assert account.published["/scan"] == SCANS


def test_what_is_latched_is_waited_for_only_where_it_is_kept(graph: Graph, tmp_path: Path) -> None:
    bag = tmp_path / "latched.mcap"
    with McapWriter(bag) as writer:
        writer.write_transforms([TransformRecord(np.eye(4), 1.0, "base_link", "laser", "tf_static")])
    node = graph.node
    replayer = Replayer(node, graph.executor, bag, watched=["/tester"])
    replayer.run()
    said = node.create_publisher(Connections, "tester/connections", 1)
    graph.until(lambda: said.get_subscription_count() == 1, "the replay listens")

    def unconnected(durability: DurabilityPolicy) -> list[str]:
        """What it says of a node that came late, says that it has got nothing, and asks for the topic like this."""
        qos = QoSProfile(depth=10, durability=durability)
        subscription = node.create_subscription(TFMessage, "tf_static", lambda _: None, qos)
        graph.until(
            lambda: len(node.get_subscriptions_info_by_topic("/tf_static")) == 1, "it is in the graph"
        )
        said.publish(Connections(inputs=["/tf_static"], received=[0]))
        graph.until(
            lambda: "has not reported" not in "".join(replayer.unconnected()), "the replay has heard it"
        )
        missing = replayer.unconnected()
        node.destroy_subscription(subscription)
        graph.until(lambda: not node.get_subscriptions_info_by_topic("/tf_static"), "it is gone")
        return missing

    assert unconnected(DurabilityPolicy.TRANSIENT_LOCAL) == [
        "/tester has not received the last message on /tf_static"
    ]
    assert unconnected(DurabilityPolicy.VOLATILE) == []
    replayer.close()


def test_namespaced_replay(bag: Path, tmp_path: Path) -> None:
    from whereabouts.nodes.runtime.suite_run import REPLAY_PARAMETERS
    from whereabouts.nodes.runtime.supervisor import NodeSpec

    spec = NodeSpec("scan_registration", "/robot1", dict(REPLAY_PARAMETERS))
    run = SuiteRun(
        bag, [spec], tmp_path / "logs", namespace="/robot1", record=ODOMETRY, output=tmp_path / "out.mcap"
    )
    account = run_suite(run)
    assert account.unanswered.total() == 0
    with open_raw(tmp_path / "out.mcap") as log:
        assert {message.name for message in log} == {"/robot1/odometry"}


def test_a_bag_of_a_robot_with_a_namespace_is_replayed_in_it_and_silence_is_told(
    tmp_path: Path,
) -> None:
    from typer.testing import CliRunner

    from evaluation.scenes.small_robot import Naming, record
    from whereabouts.cli.main import app

    plain, bag, out = tmp_path / "plain.mcap", tmp_path / "robot1.mcap", tmp_path / "out.mcap"
    record(plain, Naming(), duration=2.0)
    with open_raw(plain) as log, McapWriter(bag) as writer:
        for message in log:
            writer.write_raw(
                replace(message.topic, name=f"/robot1{message.name}"), message.data, message.log_time
            )
    settings = tmp_path / "robot.yaml"
    runner = CliRunner()
    assert runner.invoke(app, ["setup", str(bag), "--out", str(settings)]).exit_code == 0
    command = [
        "run",
        "scan_registration",
        "--config",
        str(settings),
        "--bag",
        str(bag),
        "--lock-step",
    ]
    command += [
        "--logs",
        str(tmp_path / "logs"),
        "--out",
        str(out),
        "--record",
        "odometry:nav_msgs/msg/Odometry",
    ]
    told = runner.invoke(app, [*command, "--namespace", "/robot1"])
    assert told.exit_code == 0, told.output
    assert "nothing came" not in told.output
    with open_raw(out) as log:
        assert len([message for message in log if message.name == "/robot1/odometry"]) > 5
    # Without the namespace there is no tf: said as it happens. Elsewhere nothing comes at all.
    told = runner.invoke(app, command)
    assert "no transform from 'base_scan' to 'base_footprint'" in told.stderr
    elsewhere = tmp_path / "elsewhere.yaml"
    elsewhere.write_text(settings.read_text().replace("/robot1/", "/robot2/"))
    told = runner.invoke(app, [*command[:3], str(elsewhere), *command[4:]])
    assert "scan_registration: nothing came on " in told.stderr


def test_what_is_no_bag_is_not_said_to_be_replayed(tmp_path: Path) -> None:
    bag = tmp_path / "notes.mcap"
    bag.write_text("no bag")
    command = [sys.executable, "-m", "whereabouts.cli.main", "run", "verifier", "--bag", str(bag)]
    answer = subprocess.run(command, capture_output=True, text=True)
    assert (answer.returncode, answer.stdout) == (1, "")
    assert "is no bag" in answer.stderr


def test_interrupted_run_ends_its_nodes_and_leaves_no_half_recording(bag: Path, tmp_path: Path) -> None:
    command = [
        *(sys.executable, "-m", "whereabouts.cli.main", "run", "scan_registration", "--bag", str(bag)),
        *("--rate", "0.2", "--record", "odometry:nav_msgs/msg/Odometry", "--out", str(tmp_path / "out.mcap")),
        *("--logs", str(tmp_path / "logs")),
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60.0
    while not (nodes := children(process.pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert nodes
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60)
    assert process.returncode != 0, said
    assert not any(Path(f"/proc/{pid}").exists() for pid in nodes)
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == []


def test_node_ends_when_its_supervisor_is_killed(bag: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "whereabouts.cli.main", "run", "scan_registration"]
    command += ["--logs", str(tmp_path / "logs")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60.0
    while not (nodes := children(process.pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert nodes
    process.kill()
    process.wait()
    while any(alive(pid) for pid in nodes) and time.monotonic() < deadline + 60.0:
        time.sleep(0.1)
    assert not any(alive(pid) for pid in nodes)


def children(pid: int) -> list[int]:
    """Processes whose parent is `pid`."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.append(int(path.parent.name))
    return found


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()

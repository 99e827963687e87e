"""Nodes forked from one host: processes like any other, with their memory shared, and what happens without the host."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from whereabouts.nodes.ros import host as module
from whereabouts.nodes.runtime import supervisor as supervising
from whereabouts.nodes.runtime.supervisor import NodeSpec, SuiteError, Supervisor

NAMES = ("verifier", "object_search", "world_maintenance")


def watch(supervisor: Supervisor, enough: Callable[[], bool]) -> None:
    while not enough():
        supervisor.check()
        time.sleep(0.01)


def private(pid: int) -> float:
    """MiB that no other process shares."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return sum(int(size) for size in re.findall(r"^Private_\w+:\s+(\d+) kB", text, re.MULTILINE)) / 1024


def test_nodes_of_one_host_share_memory_die_alone_and_end_with_the_supervisor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # How long a node takes to end is the machine's.
    monkeypatch.setattr(supervising, "GRACE", 60.0)
    events: list[str] = []
    with Supervisor(tmp_path, on_event=events.append, hosted=True) as supervisor:
        nodes = [supervisor.start(NodeSpec(name)) for name in NAMES]
        watch(supervisor, lambda: all(node.was_active for node in nodes))
        first = nodes[0]
        with Supervisor(tmp_path / "alone") as other:
            alone = other.start(NodeSpec("verifier", "/alone"))
            watch(other, lambda: alone.was_active)
            assert private(first.process.pid) < 0.6 * private(alone.process.pid)
        assert os.getpgid(first.process.pid) == first.process.pid
        before = first.process.pid
        os.kill(before, signal.SIGKILL)
        watch(supervisor, lambda: first.restarts == 1)
        assert [node.restarts for node in nodes] == [1, 0, 0]
        assert first.process.pid != before
        pids = [node.process.pid for node in nodes]
    assert events == ["/verifier ended with SIGKILL and was started again"]
    # The first was hardly up again.
    assert [node.process.returncode for node in nodes[1:]] == [0, 0]
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


LOADS = """
import sys
from whereabouts.nodes.ros import host

host.is_compiled = lambda root: True
host._load()
before = set(sys.modules)
import rclpy
from whereabouts.nodes.{name}_node import {kind}

rclpy.init()
node = {kind}()
node.trigger_configure()
node.destroy_node()
print(*(item.split(".")[0] for item in set(sys.modules) - before))
"""


@pytest.mark.parametrize(
    ("name", "kind"), [("verifier", "VerifierNode"), ("loop_closure", "LoopClosureNode")]
)
def test_the_host_has_imported_what_a_node_imports(name: str, kind: str) -> None:
    """Also what messages bring along when the first of their package is used: each node would have it for itself."""
    command = [sys.executable, "-c", LOADS.replace("{name}", name).replace("{kind}", kind)]
    answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[-1]
    # nav2's are used where they are there, and asked for then.
    assert set(answer.split()) <= {"nav2_msgs", "type_description_interfaces"}


def test_an_interrupt_while_the_host_loads_ends_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module.Host, "wait", lambda host: signal.raise_signal(signal.SIGINT))
    # Tests that run in the background have it ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with Supervisor(tmp_path, hosted=True) as supervisor, pytest.raises(KeyboardInterrupt):
            supervisor.start(NodeSpec("verifier"))
    finally:
        signal.signal(signal.SIGINT, before)
    assert not supervisor.nodes


def test_a_host_whose_asker_is_gone_ends_without_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_load", lambda: None)
    monkeypatch.setattr(module, "settle", lambda: None)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs, ThreadPoolExecutor(1) as pool:
        served = pool.submit(module.serve, theirs)
        # What nobody has read makes the end a reset.
        assert ours.recv(64, socket.MSG_PEEK) == b"loaded"
        ours.close()
        served.result(30.0)


def test_without_the_host_nodes_start_alone(tmp_path: Path) -> None:
    events: list[str] = []
    with Supervisor(tmp_path, on_event=events.append, hosted=True) as supervisor:
        first = supervisor.start(NodeSpec("verifier"))
        watch(supervisor, lambda: first.was_active)
        assert supervisor.host_pid is not None
        os.kill(supervisor.host_pid, signal.SIGKILL)
        second = supervisor.start(NodeSpec("object_search"))
        watch(supervisor, lambda: second.was_active)
        assert first.running
    assert "one by one" in events[0]


def test_where_children_of_children_cannot_be_adopted_nodes_start_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PR_SET_CHILD_SUBREAPER", -1)
    events: list[str] = []
    with Supervisor(tmp_path, on_event=events.append, hosted=True) as supervisor:
        node = supervisor.start(NodeSpec("verifier"))
        watch(supervisor, lambda: node.was_active)
    assert "cannot be adopted" in events[0]


ADOPTED = """
import ctypes, os, time
from whereabouts.nodes.ros.host import PR_SET_CHILD_SUBREAPER, _wait_for_parent
ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
supervisor = os.getpid()
if os.fork() == 0:
    if os.fork() == 0:
        before = os.getppid()
        _wait_for_parent(supervisor)
        print(before == supervisor, os.getppid() == supervisor)
    else:
        time.sleep(0.5)
    os._exit(0)
else:
    os.wait(), os.wait()
"""


def test_a_node_begins_only_once_its_supervisor_is_its_parent() -> None:
    answer = subprocess.run([sys.executable, "-u", "-c", ADOPTED], capture_output=True, text=True, check=True)
    assert answer.stdout == "False True\n"


def test_wrong_parameters_are_told_as_by_a_process_of_its_own(tmp_path: Path) -> None:
    with Supervisor(tmp_path, hosted=True) as supervisor:
        supervisor.start(NodeSpec("verifier", parameters={"diagnostics_period": -3.0}))
        with pytest.raises(SuiteError, match=r"(?s)could not start.*diagnostics_period"):
            watch(supervisor, lambda: False)


def test_what_a_node_has_made_for_itself_ends_with_it_and_leaves_nothing_behind(tmp_path: Path) -> None:
    # Another child has ended, too, and whoever started it has not asked yet.
    with Supervisor(tmp_path, hosted=True) as supervisor, subprocess.Popen("true"):
        node = supervisor.start(NodeSpec("loop_closure"))
        watch(supervisor, lambda: node.was_active)
        pid = node.process.pid
        (smoother,) = map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
        os.kill(pid, signal.SIGKILL)
        watch(supervisor, lambda: node.restarts == 1 and not Path(f"/proc/{smoother}").exists())
        watch(supervisor, lambda: node.running)

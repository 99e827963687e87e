"""A node on another machine, played by a network namespace: it goes out of reach in mid run, and comes back.

Making one takes the right to, and changes the machine's network for a while: it is done only where it is asked for,
with `WHEREABOUTS_TEST_NETWORK=1 pytest test/system/test_network.py` as root.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from harness import Graph, Robot, scan_message

from whereabouts.nodes.runtime.supervisor import NodeSpec

NAMESPACE, HERE, THERE = "whereabouts_test", "whereabouts0", "whereabouts1"

pytestmark = pytest.mark.skipif(
    "WHEREABOUTS_TEST_NETWORK" not in os.environ,
    reason="set WHEREABOUTS_TEST_NETWORK=1 to make a network namespace",
)


@dataclass(frozen=True)
class Away(NodeSpec):
    """A node in the other network."""

    def command(self) -> list[str]:
        return ["ip", "netns", "exec", NAMESPACE, *super().command()]


def ip(command: str) -> None:
    subprocess.run(["ip", *command.split()], check=True, capture_output=True, text=True)


@pytest.fixture
def network() -> Iterator[None]:
    """Two networks with a cable between them."""
    ip(f"netns add {NAMESPACE}")
    try:
        ip(f"link add {HERE} type veth peer name {THERE} netns {NAMESPACE}")
        ip(f"addr add 10.213.0.1/24 dev {HERE}")
        ip(f"link set {HERE} up")
        for command in (f"addr add 10.213.0.2/24 dev {THERE}", f"link set {THERE} up", "link set lo up"):
            ip(f"-n {NAMESPACE} {command}")
        yield
    finally:
        ip(f"netns delete {NAMESPACE}")


def test_a_node_out_of_reach_takes_in_what_was_said_once_it_is_back(
    network: None, domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    graph = Graph(tmp_path / "logs")
    try:
        graph.start("scan_registration", kind=Away)
        robot = Robot(graph)
        graph.mount()
        robot.go(0.0, 1.0)
        ip(f"link set {HERE} down")
        unheard = np.arange(1.0, 3.0, 0.1)
        for time in unheard:
            graph.publish("scan", scan_message(robot.scan(float(time))))
        known = set(robot.poses())
        ip(f"link set {HERE} up")
        robot.go(3.0, 4.0)
        graph.until(
            lambda: all(any(abs(stamp - time) < 0.01 for stamp in robot.poses()) for time in unheard),
            "every scan that was sent meanwhile has its pose",
        )
        assert all(abs(stamp - time) > 0.01 for stamp in known for time in unheard)
        for stamp, pose in robot.poses().items():
            assert np.hypot(*(pose[:2] - robot.truth(stamp)[:2])) < 0.05
        assert robot.figures()["/scan lost"] == "0"
    finally:
        graph.close()

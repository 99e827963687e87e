"""Real nodes over DDS: broken bytes on every input while they are killed; what was known must be there again."""

from __future__ import annotations

import os
import resource
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message

from evaluation.chaos.generator import START, Fuzzer
from whereabouts.interfaces import NODE_INTERFACES
from whereabouts.node_names import NODES
from whereabouts.nodes.base import LATCHED
from whereabouts.nodes.executor import NodeExecutor
from whereabouts.nodes.interfaces import message_class
from whereabouts.nodes.stamps import NANOSECONDS, time_message
from whereabouts.nodes.supervisor import NodeSpec, SuiteError, Supervisor
from whereabouts_msgs.msg import Attribute, DiscreteDistribution, ObjectEvidence, WorldEvidence, WorldState

PATIENCE = 300.0
LOOKS = 15  # at each object, until it is believed in
BURST = 20  # broken messages for each input between two looks
# s of a full disk; what is seen meanwhile is written afterwards.
FULL = 2.0
STATE_QOS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass
class Faults:
    """inputs : sent. facts : said by the world model before it was killed. lost : of these, not there afterwards."""

    inputs: int = 0
    facts: int = 0
    lost: int = 0
    kills: int = 0
    deaths: int = 0
    recoveries: list[float] = field(default_factory=list)
    stalled: list[str] = field(default_factory=list)
    """What the world model said of itself when it took nothing in, or did not come back."""

    def __str__(self) -> str:
        longest = (
            f"{max(self.recoveries):.1f} s at most to recover" if self.recoveries else "nothing recovered"
        )
        said = f"{self.inputs} inputs, {self.kills} kills, {self.facts} facts, {self.lost} lost, {longest}"
        return "\n".join([said, *(f"stalled: {text}" for text in self.stalled)])


class Laboratory:
    """The world model and one other node at a time, a publisher for each of their inputs, and what the first says."""

    def __init__(self, seed: int, folder: Path, context: Context) -> None:
        self.node = Node("chaos", context=context)
        self.executor = NodeExecutor(context)
        self.executor.add_node(self.node)
        self.supervisor = Supervisor(folder / "nodes", patient=True)
        self.found = Faults()
        self._fuzzer = Fuzzer(seed)
        self._known: set[str] = set()
        self._heard = 0
        self._now = START
        self._evidence = self.node.create_publisher(WorldEvidence, "evidence", 100)
        self.node.create_subscription(WorldState, "world_state", self._hear, STATE_QOS)
        self.node.create_subscription(DiagnosticArray, "diagnostics", self._note, 10)
        self._said = "no diagnostics"
        self._publishers: dict[tuple[str, str], Any] = {}
        store = {
            "store_path": str(folder / "world.sqlite"),
            "region": [-30.0, 30.0, -30.0, 30.0, -0.5, 2.5],
            "classes": ["kettle"],
            "input_reliability": "reliable",
        }
        self.world = NodeSpec("world_model", parameters=store)

    def _hear(self, message: WorldState) -> None:
        self._known = {item.id for item in message.objects if item.id.startswith("kettle")}
        self._heard += 1

    def _note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self.world.executable:
                figures = ", ".join(f"{item.key} {item.value}" for item in status.values if item.value != "0")
                self._said = f"{status.message}; {figures}"

    def stall(self) -> None:
        """Note that it goes no further."""
        self.found.stalled.append(f"{sorted(self._known)} known, {self._heard} heard; {self._said}")

    def spin(self, seconds: float) -> None:
        """Let things happen."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
            self.supervisor.check()

    def await_facts(self, count: int, heard: int) -> bool:
        """Until the world model has said that so many are there, once more than `heard` times."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if len(self._known) >= count and self._heard > heard:
                return True
            self.spin(0.05)
        return False

    def show(self, index: int) -> None:
        """Look at one more kettle."""
        for _ in range(LOOKS):
            self._now += NANOSECONDS // 10
            kettle = ObjectEvidence(existence_probability=0.95)
            kettle.pose.pose.position.x = 2.0 * (index % 20) - 20.0
            kettle.pose.pose.position.y = 2.0 * (index // 20) - 20.0
            kettle.pose.pose.orientation.w = 1.0
            kettle.pose.covariance = (1e-4 * np.eye(6)).ravel()
            kettle.attributes = [
                Attribute(name="class", discrete=DiscreteDistribution(values=["kettle"], probabilities=[1.0]))
            ]
            message = WorldEvidence(objects=[kettle])
            message.header.frame_id, message.header.stamp = "map", time_message(self._now)
            self._evidence.publish(message)
            self.spin(0.02)

    def shake(self, spec: NodeSpec) -> None:
        """Broken messages on every input of a node. The world model gets only what is no message at all any more."""
        for item in NODE_INTERFACES[spec.executable]:
            if item.kind != "in":
                continue
            kind = message_class(item.type.replace("/", "/msg/"))
            topic = f"{spec.namespace}/{item.name}"
            key = (topic, item.type)
            if key not in self._publishers:
                qos = LATCHED if "latched" in item.way else 100
                self._publishers[key] = self.node.create_publisher(kind, topic, qos)
            for _ in range(BURST):
                data = self._fuzzer.bytes(kind)
                if spec is self.world and _readable(data, kind):
                    continue
                self._publishers[key].publish(data)
                self.found.inputs += 1
            self.spin(0.01)

    def kill(self, spec: NodeSpec) -> None:
        """At once, if it was active already; the supervisor starts it again."""
        node = self.supervisor.nodes[spec.full_name]
        if node.was_active and node.running:
            node.process.send_signal(signal.SIGKILL)
            node.process.wait()
            self.found.kills += 1

    def fill_disk(self) -> None:
        """To the world model it is as if the disk were full for a while."""
        process = self.supervisor.nodes[self.world.full_name].process.pid
        before = resource.prlimit(process, resource.RLIMIT_FSIZE, (1024, resource.RLIM_INFINITY))
        self.spin(FULL)
        resource.prlimit(process, resource.RLIMIT_FSIZE, before)


def _readable(data: bytes, kind: Any) -> bool:
    try:
        deserialize_message(data, kind)
    except Exception:
        return False
    return True


@contextmanager
def _quiet() -> Iterator[None]:
    """The middleware says of each broken message that it is one."""
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


def faults(seconds: float, seed: int, folder: Path) -> Faults:
    """Shake and kill real nodes until the time is over."""
    with _quiet():
        return _faults(seconds, seed, folder)


def _faults(seconds: float, seed: int, folder: Path) -> Faults:
    context = Context()
    rclpy.init(context=context)
    laboratory = Laboratory(seed, folder, context)
    found, end, others = (
        laboratory.found,
        time.monotonic() + seconds,
        [n for n in NODES if n != "world_model"],
    )
    with laboratory.supervisor as supervisor:
        supervisor.start(laboratory.world)
        turn = 0
        try:
            while not turn or time.monotonic() < end:
                _round(laboratory, others[turn % len(others)], turn)
                turn += 1
        except SuiteError as error:
            found.deaths += 1
            print(error)
        found.deaths += sum(len(node.deaths) for node in supervisor.nodes.values()) - found.kills
    laboratory.node.destroy_node()
    context.try_shutdown()
    return found


def _round(laboratory: Laboratory, other: str, turn: int) -> None:
    """One more fact while another node is shaken, and then both are killed."""
    found, supervisor = laboratory.found, laboratory.supervisor
    # What it makes of nonsense is nothing that the world model should hear.
    spec = NodeSpec(other, namespace="/shaken")
    if spec.full_name not in supervisor.nodes:
        supervisor.start(spec)
    asked = time.monotonic()
    while len(laboratory._known) <= turn:
        laboratory.show(turn)
        if time.monotonic() - asked > PATIENCE:
            laboratory.stall()
            return
    found.facts += 1
    for shaken in (spec, laboratory.world):
        laboratory.shake(shaken)
    if turn % 3 == 2:
        laboratory.fill_disk()
    heard = laboratory._heard
    laboratory._known.clear()
    laboratory.kill(laboratory.world)
    laboratory.kill(spec)
    begun = time.monotonic()
    if laboratory.await_facts(turn + 1, heard):
        found.recoveries.append(time.monotonic() - begun)
    else:
        found.lost += turn + 1 - len(laboratory._known)
        laboratory.stall()

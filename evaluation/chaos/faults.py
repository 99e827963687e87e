"""Real nodes over DDS: what a laboratory can do to them, and what it has found."""

from __future__ import annotations

import re
import resource
import signal
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message

from evaluation.chaos.generator import START, Fuzzer
from evaluation.chaos.network import Link
from whereabouts.node_interfaces import NODE_INTERFACES
from whereabouts.nodes.messages.message_types import message_class
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.ros.executor import private_node
from whereabouts.nodes.ros.qos import HEARD_LATCHED, LATCHED
from whereabouts.nodes.runtime.supervisor import NodeSpec, Supervisor
from whereabouts_msgs.msg import Attribute, DiscreteDistribution, ObjectEvidence, WorldEvidence, WorldState

PATIENCE = 300.0
BURST = 20  # broken messages for each input between two looks
# m by which what is known may be elsewhere and is still the same; columns of things on the floor, and m between them.
SAME, COLUMNS, APART = 0.3, 20, 2.0
Spot = tuple[float, float]


@dataclass
class Faults:
    """What was done to the nodes and what came of it.

    inputs : sent. facts : said by the world model before it was killed. lost : of these, not there afterwards, or
    elsewhere. runs : new ones that the world model began; nothing that is done here is a reason for any.
    hours : that have gone by on the stamps. growth : MiB per such hour of the world model, of each of its lives that
    was long enough.
    """

    inputs: int = 0
    facts: int = 0
    lost: int = 0
    kills: int = 0
    deaths: int = 0
    runs: int = 0
    hours: int = 0
    recoveries: list[float] = field(default_factory=list)
    growth: list[float] = field(default_factory=list)
    stalled: list[str] = field(default_factory=list)
    """What the world model said of itself when it took nothing in, or did not come back."""

    @property
    def well(self) -> bool:
        """Whether nothing was lost, nobody died by himself, and all went on."""
        return not (self.lost or self.stalled or self.deaths or self.runs)

    def __str__(self) -> str:
        longest = (
            f"{max(self.recoveries):.1f} s at most to recover" if self.recoveries else "nothing recovered"
        )
        growth = (
            f"memory grew by {max(self.growth):.2f} MiB per hour at most"
            if self.growth
            else "no life was long enough to tell growth of memory"
        )
        said = (
            f"{self.hours} h of stamps, {self.inputs} inputs, {self.kills} kills, {self.facts} facts, "
            f"{self.lost} lost, {longest}, {self.runs} new runs, {growth}"
        )
        return "\n".join([said, *(f"stalled: {text}" for text in self.stalled)])


class Laboratory:
    """The world model and one other node at a time, a publisher for each of their inputs, and what the first says.

    now : stamp of the next look, ns. known : places of the things that the world model knows.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        self.node, self.executor = private_node("chaos")
        self.supervisor = Supervisor(folder / "nodes", patient=True)
        self.found = Faults()
        self.known: dict[str, Spot] = {}
        self.heard = 0
        self.now = START
        self._fuzzer = Fuzzer(seed)
        self._evidence = self.node.create_publisher(WorldEvidence, "evidence", 100)
        self.node.create_subscription(WorldState, "world_state", self._hear, HEARD_LATCHED)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._note, 10)
        self._said, self._runs = "no diagnostics", 0
        self._publishers: dict[tuple[str, str], Any] = {}
        store = {
            "store_path": str(folder / "world.sqlite"),
            "region": [-30.0, 30.0, -30.0, 30.0, -0.5, 2.5],
            "classes": ["kettle"],
            "input_reliability": "reliable",
            "diagnostics_period": 0.2,
        }
        self.world = NodeSpec("world_model", parameters=store)

    def _hear(self, message: WorldState) -> None:
        self.known = {
            item.id: (item.pose.pose.position.x, item.pose.pose.position.y)
            for item in message.objects
            if item.id.startswith("kettle")
        }
        self.heard += 1

    def _note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self.world.executable:
                figures = {item.key: item.value for item in status.values if item.value != "0"}
                told = ", ".join(f"{name} {value}" for name, value in figures.items())
                self._said, self._runs = f"{status.message}; {told}", int(figures.get("new runs", 0))

    def stall(self, what: str) -> None:
        """Note that it goes no further."""
        self.found.stalled.append(f"{what}: {len(self.known)} known, {self.heard} heard; {self._said}")

    def spin(self, seconds: float) -> None:
        """Let things happen."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
            self.supervisor.check()

    def await_facts(self, facts: dict[str, Spot], heard: int) -> bool:
        """Until the world model has said all these again, after more than `heard` words."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if self.heard > heard and not self.missing(facts):
                return True
            self.spin(0.05)
        return False

    def missing(self, facts: dict[str, Spot]) -> list[str]:
        """What of these is not known, or is elsewhere."""
        return [name for name, spot in facts.items() if not near(spot, self.known.get(name))]

    def at(self, spot: Spot) -> str:
        """What is known at a place; empty if nothing is."""
        return next((name for name, place in self.known.items() if near(spot, place)), "")

    def look(
        self, spot: Spot, name: str = "", off: float = 0.0, link: Link[WorldEvidence] | None = None
    ) -> None:
        """One look at a kettle. name : the one that it is. off : s by which the stamp is wrong."""
        self.now += NANOSECONDS // 10
        kettle = ObjectEvidence(object_id=name, existence_probability=0.95)
        kettle.pose.pose.position.x, kettle.pose.pose.position.y = spot
        kettle.pose.pose.orientation.w = 1.0
        kettle.pose.covariance = (1e-4 * np.eye(6)).ravel()
        kettle.attributes = [
            Attribute(name="class", discrete=DiscreteDistribution(values=["kettle"], probabilities=[1.0]))
        ]
        message = WorldEvidence(objects=[kettle])
        stamp = self.now + round(off * NANOSECONDS)
        message.header.frame_id, message.header.stamp = "map", time_message(stamp)
        for arriving in [message] if link is None else link.send(message):
            self._evidence.publish(arriving)
            self.found.inputs += 1
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
                # Not all that is broken can even be sent.
                with suppress(rclpy_implementation.RCLError):
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

    def count_runs(self) -> None:
        """Add the new runs of the world model's life that ends."""
        self.found.runs += self._runs
        self._runs = 0

    def limit_disk(self, full: bool) -> None:
        """To the world model it is as if the disk were full, or not any more."""
        unlimited = resource.RLIM_INFINITY
        resource.prlimit(self._pid, resource.RLIMIT_FSIZE, (1024 if full else unlimited, unlimited))

    @property
    def memory(self) -> float:
        """MiB that the world model has written."""
        text = Path(f"/proc/{self._pid}/smaps_rollup").read_text()
        return int(re.findall(r"^Anonymous:\s+(\d+) kB", text, re.MULTILINE)[0]) / 1024.0

    @property
    def _pid(self) -> int:
        return self.supervisor.nodes[self.world.full_name].process.pid


def near(spot: Spot, other: Spot | None) -> bool:
    """Whether two places are one."""
    return other is not None and float(np.hypot(spot[0] - other[0], spot[1] - other[1])) < SAME


def floor(index: int) -> Spot:
    """Where the thing of a number stands."""
    return APART * (index % COLUMNS) - APART * COLUMNS / 2, APART * (index // COLUMNS) - APART * COLUMNS / 2


def _readable(data: bytes, kind: Any) -> bool:
    try:
        deserialize_message(data, kind)
    except Exception:
        return False
    return True

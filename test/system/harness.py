"""A graph of real nodes on a DDS domain of its own, driven by conditions, never by time."""

from __future__ import annotations

import math
import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from registration import Scan
from whereabouts.nodes.messages.conversions import array_of, fill_pose, spatial
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.ros.executor import NodeExecutor
from whereabouts.nodes.ros.qos import TF_STATIC_QOS
from whereabouts.nodes.runtime.audience import DeadEnds
from whereabouts.nodes.runtime.supervisor import NodeSpec, Supervisor
from whereabouts.simulation import Drive, Lidar, Shapes, box, joined
from whereabouts_msgs.msg import Connections, Processed
from whereabouts_msgs.srv import Reset

# Long enough for a machine that is busy with other things; conditions usually hold within a second.
PATIENCE = 90.0
AGAIN = 10.0  # s after which a scan that nobody answered is sent again: sensors are best effort, and machines busy
START = 1_000 * NANOSECONDS


class Graph:
    """Nodes under test as processes, and a node of the test's own that talks to them."""

    def __init__(self, logs: Path, namespace: str = "") -> None:
        self.namespace = namespace
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node("tester", context=self.context, namespace=namespace or None)
        self.executor = NodeExecutor(self.context)
        self.executor.add_node(self.node)
        self.events: list[str] = []
        self.supervisor = Supervisor(logs, restart=False, on_event=self.events.append, hosted=True)
        self._publishers: dict[str, Any] = {}
        self._connections: dict[str, Connections] = {}
        self._collected: Counter[str] = Counter()
        self._latched: set[str] = set()
        self._reporting: set[str] = set()
        self._started: dict[str, int] = {}
        self._dead = DeadEnds(self.node, clock=time.time)
        self._found = 0

    def close(self) -> None:
        self.supervisor.stop()
        self.node.destroy_node()
        self.context.try_shutdown()

    def start(
        self,
        executable: str,
        wait: bool = True,
        namespace: str = "",
        kind: type[NodeSpec] = NodeSpec,
        **parameters: Any,
    ) -> NodeSpec:
        """Start a node, as its `kind` says, and wait until it is active."""
        defaults = {"input_reliability": "reliable", "report_processed": True, "diagnostics_period": 0.2}
        # The stamps of further messages say when a transform is given up, and tests send these faster than the
        # middleware sends a lost one again.
        defaults["transform_timeout"] = 10.0
        spec = kind(executable, namespace or self.namespace, {**defaults, **parameters})
        self._connections.pop(spec.full_name, None)
        self._started[spec.full_name] = time.time_ns()
        self.supervisor.start(spec)
        self._listen_to_connections(spec.full_name)
        self._reporting.discard(spec.full_name)
        if wait:
            self.await_active(spec)
        return spec

    def await_active(self, spec: NodeSpec) -> None:
        self.until(lambda: self.state(spec) == State.PRIMARY_STATE_ACTIVE, f"{spec.full_name} is active")
        if spec.parameters["report_processed"]:
            self._reporting.add(spec.full_name)

    def _listen_to_connections(self, name: str) -> None:
        def keep(message: Connections, info: dict[str, Any]) -> None:
            # What one of the same name said before it was killed may still be on its way.
            if int(info["source_timestamp"]) > self._started[name]:
                self._connections[name] = message

        self.node.create_subscription(Connections, f"{name}/connections", keep, 1)
        self._found = 0

    def _all_found(self) -> bool:
        """Whether what the nodes say reaches each other and the test, so that none of it gets lost."""
        running = {name for name, node in self.supervisor.nodes.items() if node.running}
        if not self._reporting & running <= self._connections.keys():
            return False
        listeners = Counter(self._collected)
        reports = [self._connections[name] for name in running & self._connections.keys()]
        for report in reports:
            listeners.update(report.inputs)
            # What a restarted node is told anew takes its time, and without it the rest is of no use.
            for topic, received in zip(report.inputs, report.received, strict=True):
                if topic in self._latched and not received:
                    return False
        return all(
            found - self._dead.known(topic, self._started[name] / NANOSECONDS) >= listeners[topic]
            for name in running & self._connections.keys()
            for topic, found in zip(
                self._connections[name].outputs, self._connections[name].subscribers, strict=True
            )
        )

    def inputs(self, spec: NodeSpec) -> list[str]:
        """Full names of the topics a node listens to."""
        report = self.until(
            lambda: self._connections.get(spec.full_name), f"{spec.full_name} says what it hears"
        )
        return sorted(set(report.inputs))

    def on_demand(self, spec: NodeSpec) -> dict[str, int]:
        """Messages received so far on the topics that a node takes in on demand and does not acknowledge."""
        report = self._connections[spec.full_name]
        counts = dict(zip(report.inputs, report.received, strict=True))
        return {topic: counts[topic] for topic in report.on_demand}

    def type_of(self, topic: str) -> str:
        """Type of a topic, as the graph knows it."""

        def known() -> list[str]:
            return [
                t for name, kinds in self.node.get_topic_names_and_types() if name == topic for t in kinds
            ]

        return str(self.until(known, f"{topic} has a type")[0])

    def log(self, spec: NodeSpec) -> str:
        """What a node has written so far, nothing before it is there."""
        path = self.supervisor.nodes[spec.full_name].log
        return path.read_text() if path.exists() else ""

    def kill(self, spec: NodeSpec) -> None:
        process = self.supervisor.nodes[spec.full_name].process
        process.send_signal(signal.SIGKILL)
        process.wait()
        self._dead.bury(spec.full_name)

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Spin until a condition holds and return its value; fail with the nodes' logs if it never does."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            value = condition()
            if value:
                return value
            self.executor.spin_once(timeout_sec=0.05)
        logs = "\n".join(
            f"{name}, {'running' if node.running else f'ended with {node.process.returncode}'}:\n{node.log_tail(30)}"
            for name, node in self.supervisor.nodes.items()
        )
        pytest.fail(f"never happened: {what}\n{logs}")

    def call(self, service_type: Any, name: str, request: Any) -> Any:
        """Call a service and return its answer."""
        client = self.node.create_client(service_type, name)
        self.until(client.service_is_ready, f"service {name} is there")
        future = client.call_async(request)
        self.until(future.done, f"service {name} answers")
        self.node.destroy_client(client)
        return future.result()

    def change(self, spec: NodeSpec, *transitions: int) -> None:
        """Take a node through lifecycle transitions; what it makes anew is to be found anew."""
        name = spec.full_name
        for transition in transitions:
            self._reporting.discard(name)
            self._connections.pop(name, None)
            self._started[name] = time.time_ns()
            request = ChangeState.Request(transition=Transition(id=transition))
            assert self.call(ChangeState, f"{name}/change_state", request).success
            if transition == Transition.TRANSITION_ACTIVATE:
                self._reporting.add(name)
        self._found = 0

    def state(self, spec: NodeSpec) -> int:
        client = self.node.create_client(GetState, f"{spec.full_name}/get_state")
        try:
            if not client.wait_for_service(0.2):
                return State.PRIMARY_STATE_UNKNOWN
            future = client.call_async(GetState.Request())
            self.executor.spin_until_future_complete(future, timeout_sec=1.0)
            return int(future.result().current_state.id) if future.done() else State.PRIMARY_STATE_UNKNOWN
        finally:
            self.node.destroy_client(client)

    def collect(self, message_type: Any, topic: str, qos: Any = 100) -> list[Any]:
        """A list that fills with the messages of a topic."""
        received: list[Any] = []
        subscription = self.node.create_subscription(message_type, topic, received.append, qos)
        self._collected[subscription.topic_name] += 1
        return received

    def publish(self, topic: str, message: Any, qos: Any = 100, kind: Any = None) -> None:
        """Publish once somebody listens, and the test and the nodes are known to those they listen to.

        kind : of a message that is given as bytes.
        """
        kind = kind or type(message)
        key = f"{topic} {kind.__name__}"
        if key not in self._publishers:
            self._publishers[key] = self.node.create_publisher(kind, topic, qos)
            self.until(lambda: self._publishers[key].get_subscription_count(), f"somebody listens to {topic}")
        entities = len(self._connections) + sum(self._collected.values())
        if entities > self._found:
            self.until(self._all_found, "the nodes have found those who listen to them")
            self._found = entities
        self._publishers[key].publish(message)
        if isinstance(qos, QoSProfile) and qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            self._latched.add(self._publishers[key].topic_name)
            self._found = 0

    def heard(self, spec: NodeSpec, topic: str) -> int:
        """How many messages of a topic a node says it has received."""
        said = self._connections.get(spec.full_name)
        return 0 if said is None else dict(zip(said.inputs, said.received, strict=True)).get(topic, 0)

    def introduce(self, scan: LaserScan, heard: Callable[[], Any], *nodes: str) -> None:
        """Let nodes find each other: one scan again and again until what follows from it arrives, then a fresh start.

        A node that is active may still be unknown to those it is to listen to, and misses what they say first.
        """
        acknowledged = {name: self.collect(Processed, f"{name}/processed") for name in nodes}
        sent = 0

        def again() -> Any:
            nonlocal sent
            if all(len(_stamps(answers)) + 5 > sent for answers in acknowledged.values()):
                scan.header.stamp = time_message(START - 100 * NANOSECONDS + sent * NANOSECONDS // 10)
                self.publish("scan", scan)
                sent += 1
            return heard()

        self.until(again, f"{', '.join(nodes)} have found each other")
        for name, answers in acknowledged.items():
            self.until(
                lambda answers=answers: len(_stamps(answers)) >= sent,  # type: ignore[misc]
                f"{name} is done with what was sent first",
            )
            assert self.call(Reset, f"{name}/reset", Reset.Request()).code == Reset.Response.SUCCESS

    def mount(
        self, frame: str = "laser", pose: tuple[float, ...] = (0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0)
    ) -> None:
        """Say on tf_static how a sensor is mounted: x, y, z and quaternion x, y, z, w."""
        self.publish("tf_static", TFMessage(transforms=[mounting(frame, pose)]), TF_STATIC_QOS)


def _stamps(answers: list[Processed]) -> set[int]:
    """Stamps of the scans a node has reported on."""
    return {nanoseconds(answer.stamp) for answer in answers if answer.topic.endswith("scan")}


def mounting(frame: str, pose: tuple[float, ...]) -> TransformStamped:
    return transform_message("base_link", frame, 0, pose)


class Robot:
    """A robot driving through a furnished room, and what the node under test says about it."""

    def __init__(self, graph: Graph, prefix: str = "") -> None:
        self.graph = graph
        self.prefix = prefix
        self.world = room()
        self.drive = Drive([(-3.0, -1.5), (2.5, -1.5), (2.5, 1.5), (-3.0, 1.5)], speed=0.5)
        self.lidar = Lidar(beams=361, opening=np.pi, range_max=25.0)
        self.rng = np.random.default_rng(7)
        self.odometry: list[Odometry] = graph.collect(Odometry, f"{prefix}odometry")
        self.processed: list[Processed] = graph.collect(Processed, f"{prefix}scan_registration/processed")
        self.diagnostics: list[DiagnosticArray] = graph.collect(DiagnosticArray, "/diagnostics")

    def truth(self, time: float) -> np.ndarray:
        """Pose of the robot in the frame of its start."""
        from estimation.geometry.poses import between

        return np.asarray(between(self.drive(0.0), self.drive(time)))

    def scan(self, time: float, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Scan:
        from estimation.geometry.poses import compound

        return self.lidar.scan(self.world, compound(self.drive(time), np.array(mount)), self.rng, time).scan

    def send(self, message: LaserScan, topic: str = "scan") -> None:
        """Publish a scan and wait until the node is done with it, one way or another."""
        before, sent = len(self.processed), -math.inf

        def answered() -> bool:
            nonlocal sent
            if time.monotonic() - sent > AGAIN:
                self.graph.publish(f"{self.prefix}{topic}", message)
                sent = time.monotonic()
            return any(
                a.topic.endswith(topic) and a.stamp == message.header.stamp for a in self.processed[before:]
            )

        self.graph.until(answered, f"{topic} at {message.header.stamp.sec} is processed")

    def go(self, start: float, end: float, step: float = 0.1) -> None:
        """Drive from one moment to another, scanning."""
        for time_ in np.arange(start, end, step):
            self.send(scan_message(self.scan(float(time_))))

    def poses(self) -> dict[float, np.ndarray]:
        """Published poses (3,) by seconds since the start."""
        return {
            (nanoseconds(m.header.stamp) - START) / NANOSECONDS: planar(m.pose.pose) for m in self.odometry
        }

    def figures(self) -> dict[str, str]:
        """The latest diagnostics of a node of this robot's: those of all robots come on one topic."""
        own = self.prefix.lstrip("/")
        for message in reversed(self.diagnostics):
            if message.status[0].name.startswith(own):
                return {item.key: item.value for item in message.status[0].values}
        return {}


def room() -> Shapes:
    """A room of 10 by 7 metres with furniture, no two places alike."""
    furniture = [
        box(1.2, 0.6, (-4.0, 2.8, 0.2)),
        box(0.8, 0.8, (1.0, 3.0, 0.5)),
        box(2.0, 0.4, (4.2, -2.6, 0.0)),
        box(0.5, 0.5, (-0.5, 0.1, 0.7)),
        box(0.6, 1.4, (4.5, 1.0, 0.1)),
    ]
    return joined([box(10.0, 7.0), *furniture])


def scan_message(scan: Scan, frame: str = "laser") -> LaserScan:
    message = LaserScan()
    message.header.stamp = time_message(START + round(scan.stamp * NANOSECONDS))
    message.header.frame_id = frame
    message.angle_min = scan.angle_min
    message.angle_increment = scan.angle_increment
    message.angle_max = scan.angle_min + scan.angle_increment * (len(scan) - 1)
    message.range_min, message.range_max = scan.range_min, scan.range_max
    message.ranges = array_of("f", scan.ranges.astype(np.float32))
    return message


def wheel_message(pose: np.ndarray, time_: float) -> Odometry:
    message = Odometry()
    message.header.stamp = time_message(START + round(time_ * NANOSECONDS))
    message.header.frame_id, message.child_frame_id = "odom", "base_link"
    fill_pose(message.pose.pose, spatial(pose))
    return message


def planar(pose: Any) -> np.ndarray:
    q = pose.orientation
    yaw = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return np.array([pose.position.x, pose.position.y, yaw])

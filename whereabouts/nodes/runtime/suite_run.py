"""A bag through a set of nodes: start them, replay, record as bytes what was sent, end them."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lifecycle_msgs.msg import State
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from whereabouts.logs import McapWriter, RawMessage, Topic
from whereabouts.nodes.messages.message_types import definition, message_class
from whereabouts.nodes.ros.executor import leave, private_node
from whereabouts.nodes.ros.footprint import PROFILES
from whereabouts.nodes.ros.host import Host
from whereabouts.nodes.ros.qos import reliable
from whereabouts.nodes.ros.timekeeping import SILENCE
from whereabouts.nodes.runtime.bring_up import COMPILING, LifecycleClient
from whereabouts.nodes.runtime.domain import free_domain
from whereabouts.nodes.runtime.replayer import MessageLog, ReplayAccount, Replayer
from whereabouts.nodes.runtime.supervisor import NodeSpec, SuiteError, Supervisor
from whereabouts.system.resources import config_file

# Nodes find each other within moments; a mismatch of reliability or durability is the usual reason why they do not.
CONNECT_TIMEOUT = 60.0
QUIET = 0.5
# s that a recording waits for what nodes say that they have sent.
RECORDER_PATIENCE = 2.0
# What a node is told when a bag is replayed to it: nothing may be lost, and everything is accounted for.
REPLAY_PARAMETERS = {"input_reliability": "reliable", "report_processed": True, "use_sim_time": True}


DEPTH = 1000


class Recorder:
    """Writes what arrives on some topics to an `McapWriter`.

    Log time is the time of arrival by the clock of `now`, which a replay sets to message time.
    """

    def __init__(self, node: Node, writer: McapWriter, topics: Iterable[tuple[str, str]]) -> None:
        self._writer = writer
        self.now = time.time_ns
        self.counts: Counter[str] = Counter()
        # When each node's diagnostics came last, s of the monotonic clock.
        self.told: dict[str, float] = {}
        self.last_arrival = time.monotonic()
        self._subscriptions = [self._subscribe(node, name, type_name) for name, type_name in topics]

    @property
    def topics(self) -> list[str]:
        """Full names of what is recorded."""
        return [subscription.topic_name for subscription in self._subscriptions]

    def _subscribe(self, node: Node, name: str, type_name: str) -> Any:
        topic = Topic(node.resolve_topic_name(name), type_name, definition(type_name))
        kind = message_class(type_name)

        def keep(data: bytes) -> None:
            self.counts[topic.name] += 1
            # Diagnostics never end.
            if name.endswith("diagnostics"):
                for status in deserialize_message(bytes(data), kind).status:
                    self.told[status.name] = time.monotonic()
            else:
                self.last_arrival = time.monotonic()
            self._writer.write_raw(topic, bytes(data), max(0, self.now()))

        # A latched publisher's last message is wanted too; a volatile one is compatible only with volatile.
        latched = name.rsplit("/", 1)[-1] in ("tf_static", "map", "trajectory")
        return node.create_subscription(kind, name, keep, reliable(DEPTH, latched), raw=True)


@dataclass
class SuiteRun:
    """What to run.

    bag : as of `Replayer`. rate : multiple of the recorded speed, None for lock-step.
    record : (topic, type) to record to `output`.
    clock_period : as of `Replayer`, s. host : as of `Supervisor`.
    on_event : called with a sentence about a node that died, came back or was killed.
    on_progress : called with the share of the bag that has been sent.
    """

    bag: Path | MessageLog
    nodes: Sequence[NodeSpec]
    log_directory: Path
    rate: float | None = None
    namespace: str = ""
    clock_period: float = 0.005
    record: Sequence[tuple[str, str]] = ()
    output: Path | None = None
    host: Host | None = None
    on_event: Callable[[str], None] = lambda text: None
    on_progress: Callable[[float], None] = lambda share: None
    on_message: Callable[[RawMessage], None] = lambda message: None
    supervisor: Supervisor | None = field(default=None, init=False)
    replayer: Replayer | None = field(default=None, init=False)


def replay_spec(executable: str, namespace: str = "", **parameters: Any) -> NodeSpec:
    return NodeSpec(executable, namespace, {**REPLAY_PARAMETERS, **parameters})


def prepare_environment(private: bool = False) -> None:
    """Environment of this process and its nodes; call it before anything of ROS is created.

    private : stay on this machine and on a domain of one's own, unless the user has chosen one.
    """
    os.environ.setdefault(PROFILES, str(config_file("fastdds.xml")))
    if private:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        if "ROS_DOMAIN_ID" not in os.environ:
            os.environ["ROS_DOMAIN_ID"] = str(free_domain())


def run_suite(run: SuiteRun) -> ReplayAccount:
    """Replay a bag through nodes.

    Raises SuiteError: a node could not be started or kept running; LogError: the bag cannot be read.
    """
    with ExitStack() as stack:
        node, executor = private_node("whereabouts_replay", run.namespace)
        stack.callback(leave, node)
        supervisor = stack.enter_context(
            Supervisor(run.log_directory, on_event=run.on_event, hosted=len(run.nodes) > 1, host=run.host)
        )
        run.supervisor = supervisor
        replayer = Replayer(
            node,
            executor,
            run.bag,
            run.rate,
            watched=[spec.full_name for spec in run.nodes],
            namespace=run.namespace,
            is_running=lambda name: supervisor.nodes[name].running,
            clock_period=run.clock_period,
        )
        stack.callback(replayer.close)
        supervisor.on_death = replayer.bury
        run.replayer = replayer
        recorder = None
        if run.output is not None:
            writer = stack.enter_context(McapWriter(run.output))
            recorder = Recorder(node, writer, run.record)
            recorder.now = lambda: replayer.now
            if run.rate is None:
                replayer.on_settled = _CatchUp(executor, recorder, replayer)
        for spec in run.nodes:
            supervisor.start(spec)
        clients = [LifecycleClient(node, executor, spec.full_name) for spec in run.nodes]
        recorded = recorder.topics if recorder else []
        watch = _Watch(executor, supervisor, replayer, clients, recorded, run.on_event)
        watch.wait_until_ready()

        def between_messages(message: RawMessage) -> None:
            run.on_message(message)
            run.on_progress(replayer.progress)
            watch.look()

        account = replayer.run(between_messages)
        if recorder is not None:
            _let_recorder_finish(executor, recorder, replayer)
        return account


@dataclass
class _Watch:
    """Looks after the nodes between messages, and pauses the replay while one comes back."""

    executor: Any
    supervisor: Supervisor
    replayer: Replayer
    clients: Sequence[LifecycleClient]
    recorded: Sequence[str]
    on_event: Callable[[str], None]
    deaths: int = 0

    def look(self) -> None:
        """Notice a node that died; the supervisor starts it again, so wait for it."""
        self.supervisor.check()
        deaths = sum(len(managed.deaths) for managed in self.supervisor.nodes.values())
        if deaths > self.deaths:
            self.wait_until_ready()
            self.deaths = deaths

    def wait_until_ready(self) -> None:
        """Until every node is active, all have found each other, and what went through them so far is known.

        Raises SuiteError: one is not active in time, or has ended.
        """
        deadline = time.monotonic() + COMPILING
        for client in self.clients:
            while client.state() != State.PRIMARY_STATE_ACTIVE:
                self.supervisor.check()
                if time.monotonic() > deadline:
                    tail = self.supervisor.nodes[client.name].log_tail()
                    raise SuiteError(
                        f"{client.name} is not active after {COMPILING:.0f} s; its last lines:\n{tail}"
                    )
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while missing := self.replayer.unconnected(self.recorded):
            self.supervisor.check()
            if time.monotonic() > deadline:
                self.on_event(f"continuing, although {'; '.join(missing)}")
                break
            self.executor.spin_once(timeout_sec=0.05)
        self.replayer.begin_turns()
        connected = time.time_ns()
        while self.replayer.audience.silent_since(connected) and time.monotonic() < deadline:
            self.supervisor.check()
            self.executor.spin_once(timeout_sec=0.05)
        self.replayer.nodes_changed()


@dataclass
class _CatchUp:
    """Lets the recorder take in what the nodes have sent because of a message, so that it is of that moment."""

    executor: Any
    recorder: Recorder
    replayer: Replayer
    forgiven: Counter[str] = field(default_factory=Counter)

    def __call__(self) -> None:
        deadline = time.monotonic() + RECORDER_PATIENCE
        while behind := self._behind():
            if time.monotonic() > deadline:
                # A node that died has not sent all that it had counted.
                self.forgiven.update(behind)
                return
            self.executor.spin_once(timeout_sec=0.05)

    def _behind(self) -> dict[str, int]:
        lacks = {
            topic: self.replayer.flow.total(topic) - self.recorder.counts[topic] - self.forgiven[topic]
            for topic in self.recorder.topics
            if not topic.endswith("diagnostics")
        }
        return {topic: count for topic, count in lacks.items() if count > 0}


def _let_recorder_finish(executor: Any, recorder: Recorder, replayer: Replayer) -> None:
    """The nodes are done; what they have sent last is still on its way."""
    begun = time.monotonic()
    while time.monotonic() < begun + SILENCE:
        # The last word of every node is of the end.
        told = all(recorder.told.get(name.lstrip("/"), begun) >= begun for name in replayer.watched)
        came = all(recorder.counts[topic] >= replayer.flow.published(topic) for topic in recorder.topics)
        if told and came and time.monotonic() >= recorder.last_arrival + QUIET:
            return
        executor.spin_once(timeout_sec=QUIET / 5)

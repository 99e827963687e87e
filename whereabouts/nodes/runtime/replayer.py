"""Publishes a bag into the graph: at a rate, or in lock-step as fast as the nodes keep up."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from rclpy.executors import Executor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from whereabouts.logs import RawMessage, Topic, open_raw
from whereabouts.nodes.messages.message_types import UnknownTypeError, message_class
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.ros.qos import BURST, reliable
from whereabouts.nodes.ros.timekeeping import SILENCE
from whereabouts.nodes.ros.turns import turn_topic
from whereabouts.nodes.runtime.audience import Audience
from whereabouts.nodes.runtime.flow import Flow
from whereabouts.nodes.runtime.turn_giver import TurnGiver, rank
from whereabouts_msgs.msg import Processed

# s after which a turn is given again that nobody has answered: the node was not yet found.
AGAIN = 0.5
# s between two looks whether those that are waited for still run.
CARE_PERIOD = 0.1


class MessageLog(Protocol):
    """Messages by log time; `RawLog` is one."""

    @property
    def topics(self) -> list[Topic]:
        """All that there will be."""

    @property
    def progress(self) -> float:
        """Share of the messages that have been read."""

    def __iter__(self) -> Iterator[RawMessage]: ...

    def close(self) -> None:
        """Release files."""


CLOCK_TYPE = "rosgraph_msgs/msg/Clock"


@dataclass
class ReplayAccount:
    """What was sent and what became of it.

    published : messages per topic. skipped : topics that could not be published, and why.
    unanswered : messages per node that it did not report as processed in time (lock-step only).
    processed : messages per node that it reported as processed.
    lost : messages per node and topic that were sent and, by the node's count, did not arrive.
    deaf : nodes that nothing was sent to, and the topics they listen to.
    """

    published: Counter[str] = field(default_factory=Counter)
    skipped: dict[str, str] = field(default_factory=dict)
    unanswered: Counter[str] = field(default_factory=Counter)
    processed: Counter[str] = field(default_factory=Counter)
    lost: dict[str, int] = field(default_factory=dict)
    deaf: dict[str, list[str]] = field(default_factory=dict)
    bag_seconds: float = 0.0
    wall_seconds: float = 0.0

    @property
    def total_lost(self) -> int:
        return sum(self.lost.values())

    def count(self, answers: Mapping[tuple[str, str], Processed]) -> None:
        """Take in the last answers of all nodes, by node and topic."""
        for (node, topic), answer in answers.items():
            if answer.lost:
                self.lost[f"{node} {topic}"] = int(answer.lost)


class Replayer:
    """Replays one bag.

    bag : a file, or messages that are made as they are sent: what they tell may then depend on what the nodes said.
    node, executor : a node of the caller's to publish with, and what spins it.
    rate : multiple of the recorded speed; None for lock-step, in which the messages of the next moment are sent when
        every watched node that listens to those before has had its turn with them, and then those that listen to what
        these have said; see `Turns`.
    watched : full names of the nodes to wait for.
    namespace : put before the recorded topic names that have it not.
    is_running : whether a watched node's process is alive, so that nobody waits for a dead one.
    clock_period : s of the bag between two messages on /clock, at least; each wakes every node up.
    flow, audience : what was sent to and by the watched nodes, and who listens to what.
    """

    def __init__(
        self,
        node: Node,
        executor: Executor,
        bag: Path | MessageLog,
        rate: float | None = None,
        watched: Sequence[str] = (),
        namespace: str = "",
        is_running: Callable[[str], bool] = lambda name: True,
        clock_period: float = 0.005,
    ) -> None:
        self._node = node
        self._executor = executor
        self._rate = rate
        self.watched = list(watched)
        self._namespace = namespace.rstrip("/")
        self._is_running = is_running
        self._log: MessageLog = open_raw(bag) if isinstance(bag, Path) else bag
        # What is made as it is sent may depend on what follows from the message before.
        self._together = rate is None and isinstance(bag, Path)
        self._publishers: dict[str, Any] = {}
        self._latched: set[str] = set()
        self._answers: dict[tuple[str, str], Processed] = {}
        self.audience = Audience(node, self.watched, self._take_counts)
        self.flow = Flow(self.audience.listeners)
        self.account = ReplayAccount()
        self.now = 0
        self._clock = node.create_publisher(Clock, "/clock", 10)
        self._clock_sent = 0
        self._clock_period = round(clock_period * NANOSECONDS)
        self._turns = TurnGiver(node, self.watched if rate is None else (), self.flow, self.audience.lazy)
        # Whether somebody else has sent something that the nodes have to be done with. Called after each message.
        self._noted = False
        self.on_settled: Callable[[], None] = lambda: None
        self._subscriptions = [self._listen(name) for name in self.watched]
        for topic in self._log.topics:
            self._advertise(topic)

    @property
    def progress(self) -> float:
        return self._log.progress

    def close(self) -> None:
        self._log.close()
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._node.destroy_publisher(self._clock)
        self.audience.close()
        self._turns.close(self._node.destroy_publisher)

    def _listen(self, watched: str) -> Any:
        def keep(message: Processed, info: dict[str, Any]) -> None:
            if self.audience.is_of_the_dead(watched, info):
                return
            self._answers[watched, message.topic] = message
            published = dict(zip(message.output_topics, message.output_counts, strict=True))
            self._take_counts(watched, {message.topic: message.received}, published)
            self._turns.answered(watched, message, published)

        return self._node.create_subscription(
            Processed,
            f"{watched}/processed",
            keep,  # type: ignore[arg-type]  # rclpy also passes the message info where it is taken
            BURST,
        )

    def _take_counts(self, watched: str, received: Mapping[str, int], published: Mapping[str, int]) -> None:
        self._turns.note(watched, published)
        self.flow.note(watched, received, published)

    def _name(self, recorded: str) -> str:
        name = f"/{recorded.lstrip('/')}"
        return name if name.startswith(f"{self._namespace}/") else f"{self._namespace}{name}"

    def _advertise(self, topic: Topic) -> None:
        if topic.type_name == CLOCK_TYPE:
            # A simulator's, as `ros2 bag record -a` has it: with two clocks time would leap with every message.
            self.account.skipped[topic.name] = "the replay has a clock of its own"
            return
        latched = any(offer.durability == "transient_local" for offer in topic.qos)
        # Old recordings do not tell; who listens to these asks for it.
        latched = latched or topic.name.rsplit("/", 1)[-1] in ("tf_static", "world_state")
        try:
            kind = message_class(topic.type_name)
        except UnknownTypeError as error:
            self.account.skipped[topic.name] = str(error)
            return
        self._publishers[topic.name] = self._node.create_publisher(
            kind, self._name(topic.name), reliable(BURST, latched)
        )
        if latched:
            self._latched.add(self._name(topic.name))

    def run(self, on_message: Callable[[RawMessage], None] | None = None) -> ReplayAccount:
        """Send everything; returns when the watched nodes are done with it."""
        started = time.monotonic()
        first: int | None = None
        for moment in self._moments():
            self.now = moment[0].log_time
            first = self.now if first is None else first
            self._wait_until_due(started, self.now - first)
            for message in moment:
                self._send(message)
            self._give_turns()
            if on_message is not None:
                for message in moment:
                    on_message(message)
            if self._noted:
                self._noted = False
                self._give_turns()
            self.on_settled()
        self._settle()
        self.account.bag_seconds = (self.now - (first or 0)) / NANOSECONDS
        self.account.wall_seconds = time.monotonic() - started
        self.account.count(self._answers)
        self.account.processed.update({name: self.flow.received(name).total() for name in self.watched})
        self.account.deaf = self.audience.deaf(self.flow.total)
        return self.account

    def _moments(self) -> Iterator[list[RawMessage]]:
        """Messages one by one; in lock-step those of a recording that belong together, together: they are of the same
        moment, of different topics, and the same nodes are the first to have a turn because of them."""
        moment: list[RawMessage] = []
        for message in self._log:
            if message.name not in self._publishers:
                continue
            if moment and not (self._together and self._belongs(message, moment)):
                yield moment
                moment = []
            moment.append(message)
            if not self._together:
                yield moment
                moment = []
        if moment:
            yield moment

    def _belongs(self, message: RawMessage, moment: list[RawMessage]) -> bool:
        names = [other.name for other in moment]
        ranks = {
            min(map(rank, nodes))
            for name in (*names, message.name)
            if (nodes := self.audience.listeners(self._name(name)))
        }
        return message.log_time == moment[0].log_time and message.name not in names and len(ranks) < 2

    def _wait_until_due(self, started: float, offset: int) -> None:
        if self._rate is None:
            return
        due = started + offset / NANOSECONDS / self._rate
        while (left := due - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def _send(self, message: RawMessage) -> None:
        if message.log_time - self._clock_sent >= self._clock_period or message.log_time < self._clock_sent:
            self._clock.publish(Clock(clock=time_message(message.log_time)))
            self._clock_sent = message.log_time
        self._publishers[message.name].publish(bytes(message.data))
        self.flow.send(self._name(message.name))
        self.account.published[message.name] += 1

    def note(self, name: str) -> None:
        """Somebody else is about to send a message or a goal (by its name) that the nodes have to be done with."""
        self.flow.send(name)
        self._noted = True

    def _give_turns(self, last: bool = False) -> None:
        """In lock-step let nodes do what there is to do. last : nothing may lie about any longer."""
        turns = self._turns
        while (due := turns.due(last)) or turns.busy:
            for name in due:
                turns.give(name)
            self._wait_while(turns.holding if due else turns.busy)

    def begin_turns(self) -> None:
        """Tell all nodes that there are turns, and wait until they know and have taken in all they have so far."""
        self.nodes_changed()
        takers = {name for name in self.watched if turn_topic(name) in self.audience.inputs.get(name, ())}
        deadline, again = time.monotonic() + SILENCE, 0.0
        waiting = takers if self._rate is None else set()
        while waiting and time.monotonic() < deadline:
            if time.monotonic() >= again:
                for name in waiting:
                    self._turns.give(name)
                again = time.monotonic() + AGAIN
            self._executor.spin_once(timeout_sec=0.05)
            waiting &= self._turns.busy

    def _wait_while(self, waiting: Set[str]) -> None:
        now = time.monotonic()
        deadline, care = now + SILENCE, now + CARE_PERIOD
        while waiting and now < deadline:
            self._executor.spin_once(timeout_sec=CARE_PERIOD)
            now = time.monotonic()
            if waiting and now >= care:
                care = now + CARE_PERIOD
                if not all(map(self._is_running, waiting)):
                    break
        # One died or hangs: the message counts as unanswered.
        self.account.unanswered.update(waiting)
        for name in tuple(waiting):
            self._turns.give_up(name)

    def unconnected(self, recorded: Collection[str] = ()) -> list[str]:
        """What has yet to be found before nothing can get lost, as sentences; empty once all is connected.

        A node that is active may be unknown for a while to those it listens to, and what they say meanwhile never
        reaches it.

        recorded : topics that the caller listens to.
        """
        latched = {topic for topic in self._latched if self.flow.total(topic) > self.flow.published(topic)}
        played = {self._name(topic) for topic in self._publishers}
        return self.audience.unconnected(recorded, played, latched)

    def bury(self, node: str) -> None:
        """A watched node died: the graph shows its inputs for a while yet, as if they were those of its successor."""
        self.audience.bury(node)
        self._turns.died(node)
        self.flow.died(node)

    def nodes_changed(self) -> None:
        """A watched node came or went: count from here."""
        for name in self.watched:
            self.flow.begin(name)

    def _settle(self) -> None:
        """Let the nodes finish: until all answers are in, or no more come."""
        if self._rate is None:
            self._give_turns(last=True)
            return
        deadline, before = time.monotonic() + SILENCE, 0
        while time.monotonic() < deadline and any(map(self.flow.behind, self.watched)):
            self._executor.spin_once(timeout_sec=0.2)
            received = sum(self.flow.received(name).total() for name in self.watched)
            if received > before:
                deadline, before = time.monotonic() + SILENCE, received

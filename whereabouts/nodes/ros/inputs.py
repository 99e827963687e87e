"""One subscription of a node: order, transforms that are still to come, and an account of every message."""

from __future__ import annotations

import bisect
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from tf2_msgs.msg import TFMessage

from estimation.errors import InputError
from estimation.geometry.frame_tree import TransformError
from whereabouts.nodes.messages.envelopes import type_name
from whereabouts.nodes.messages.packed import MessageOpener
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import Pairs
from whereabouts.nodes.ros.input_counts import BUDGETS, DEFAULT, InputCounts, MessageGaps, Purse
from whereabouts.nodes.ros.qos import sensor_qos
from whereabouts.system.clocks import MOST_HELD, SourceClock
from whereabouts.system.counting import counted
from whereabouts_msgs.msg import Processed

if TYPE_CHECKING:
    from whereabouts.nodes.ros.base import SuiteNode

LATENCY_WINDOW = 2000
# A reason for dropping the first messages that is no trouble: tf was still to begin. More of them are told of.
EARLY, EARLY_ONES = "before the first transform", 5
# The stamps that a message can carry.
EARLIEST, LATEST = -(2**31) * NANOSECONDS, (2**31 - 1) * NANOSECONDS

Handler = Callable[[Any, int], None]
Frames = Callable[[Any], Sequence[tuple[str, str]]]


@dataclass(eq=False)
class Waiting:
    """A message on its way to the handler. needed : transforms that it waits for."""

    message: Any
    stamp: int
    arrived: float
    needed: Pairs = ()


class Input:
    """Messages of one topic on their way to a handler.

    handler : called with the message and its stamp in nanoseconds; an `InputError` it raises is a refused
        message, counted and reported, any other exception a defect that is reported with its trace.
    frames : pairs (target, source) that must be in tf at the stamp before the handler is called. Until then
        the message waits, and newer ones that need the same frames with it, so that order is kept among these.
    sensor : whether it is a sensor's own topic: its stamps then tell the node's time (`whereabouts.system.clocks`), and
        jumps in the publisher's numbers and in stamps are losses. Several nodes publish tf: its numbers say nothing.
    on_demand : whether messages may lie about until something else wakes the node up: for what is only looked at now
        and then. They are not acknowledged one by one, what the queue had no room for is not lost, and their latency
        counts from when they are taken in. In a replay by turns everything lies about until the node's; see `Turns`.
    lazy : whether what comes on it gives the node no turn of its own: what is on demand, and transforms.
    companions : inputs that tell more about a message of theirs with the same stamp: in a replay it waits for that.
    awaited : whether others wait for it also on a live robot, as its messages say where theirs were taken.
    packed : whether the handler is given a `Packed` message instead of the message itself.
    sequence : the publisher's number of the last message.
    """

    def __init__(
        self,
        node: SuiteNode,
        message_type: type,
        topic: str,
        handler: Handler,
        *,
        frames: Frames | None = None,
        qos: QoSProfile | None = None,
        sensor: bool = True,
        on_demand: bool = False,
        packed: bool = False,
        companions: Sequence[Input] = (),
        awaited: bool = False,
    ) -> None:
        self._node = node
        self.awaited = awaited
        self._companions = [item for item in companions if node.replayed or item.awaited]
        self._expected: bool | None = None
        self.opener = MessageOpener(message_type, packed)
        self._purse = Purse(BUDGETS.get(type_name(message_type), DEFAULT))
        self._shed: Waiting | None = None
        self._handler = handler
        self._frames = frames
        self.tells_time = sensor and self.opener.stamped
        self._sensor = sensor
        self.on_demand = on_demand and not node.replayed
        self.is_transforms = message_type is TFMessage
        self._latched = qos is not None and qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self.lazy = on_demand or (self.is_transforms and not self._latched)
        self.sequence = self._told_lost = 0
        self._waiting: list[Waiting] = []  # oldest stamp first
        self._time: SourceClock[None] = SourceClock()
        self._admitted = 0.0  # when the last message was let in
        self.counts = InputCounts()
        self.gaps = MessageGaps(self.counts)
        self.arrived = 0.0  # when the message being handled reached the process, s of `time.perf_counter`
        self.latencies: deque[float] = deque(maxlen=LATENCY_WINDOW)
        self.subscription = node.create_subscription(
            message_type,
            topic,
            self._receive,  # type: ignore[arg-type]  # rclpy also passes the message info where it is taken
            qos or sensor_qos(node.settings.input_reliability),
            callback_group=node.default_callback_group,
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=self._on_lost,
                incompatible_qos=self._on_incompatible,
                use_default_callbacks=False,
            ),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            raw=packed,
        )
        self.topic = self.subscription.topic_name

    def _receive(self, message: Any, info: dict[str, Any]) -> None:
        arrived = self._node.time.heard_at = time.perf_counter()
        self.counts.received += 1
        self.sequence = sequence = int(info.get("publication_sequence_number") or 0)
        if self._sensor and not self.on_demand:
            if self.gaps.one_publisher is None:
                self.watch_publishers()
            if lost := self.gaps.check_sequence(sequence):
                self._node.complain(
                    f"{self.topic}: {counted(lost, 'message')} lost on the way", key=(self.topic, "lost")
                )
        try:
            message = self.opener.open(message)
        except InputError as error:
            self.drop("refused", str(error))
            self._done(min(max(self.opener.stamp_of(message), EARLIEST), LATEST))
            return
        stamp = self.opener.stamp_of(message)
        # What is latched is said once: a node that ignored it while inactive would never have it.
        if not self._node.active and not self._latched:
            self.counts.inactive += 1
        else:
            # Not every middleware tells when it received a message.
            received = 0 if self.on_demand else int(info.get("received_timestamp") or 0)
            queued = max(0, time.time_ns() - received) / NANOSECONDS if received else 0.0
            self._within_budget(Waiting(message, stamp, arrived - queued))
        self._done(stamp)

    def take(self) -> bool:
        """Take in a message that lies about; whether there was one."""
        subscription: Any = self.subscription
        with subscription.handle:
            found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if found is not None:
            self._receive(*found)
        return found is not None

    def _within_budget(self, waiting: Waiting) -> None:
        """Go on with a message, or keep it back instead of the one before. In lock-step there is all the time."""
        if self._node.settings.report_processed:
            self._guarded(waiting)
            return
        over = self._purse.over(time.perf_counter())
        if self._shed is not None:
            self.drop("over budget", over or "a newer one has come")
            self._shed = None
        if over:
            self._shed = waiting
            return
        begun = time.perf_counter()
        self._guarded(waiting)
        self._purse.spend(self.opener.size(waiting.message), time.perf_counter() - begun)

    def serve_shed(self) -> None:
        """Handle what was kept back, once there is budget for it again."""
        if self._shed is not None and not self._purse.over(time.perf_counter()):
            kept, self._shed = self._shed, None
            self._within_budget(kept)

    def _guarded(self, waiting: Waiting) -> None:
        try:
            if self.tells_time:
                self._node.time.follow(self, waiting)
            else:
                self.admit(waiting)
        except Exception as error:
            self._defect(error)

    def _defect(self, error: Exception) -> None:
        trace = traceback.format_exc(limit=-4)
        self.drop("internal error", f"{type(error).__name__}: {error}\n{trace}", defect=True)

    def silence(self, arrived: float) -> int:
        """Time since the last message that was let in, ns."""
        return round((arrived - self._admitted) * NANOSECONDS) if self._admitted else 0

    def behind(self, stamp: int) -> int:
        """How far a stamp is behind what more than one message speaks for, ns; negative for one ahead."""
        return (stamp if self._time.confirmed is None else self._time.confirmed) - stamp

    def admit(self, waiting: Waiting, late: bool = False) -> None:
        """Handle a message of the node's time, as soon as its transforms are there."""
        self._admitted = waiting.arrived
        self.counts.late += late
        if self.tells_time:
            self.gaps.check_period(waiting.stamp)
            if self.gaps.stamps_stand:
                self._node.complain(
                    f"{self.topic}: its stamps stand still at {waiting.stamp / NANOSECONDS:.3f}: who sends it has to "
                    "set header.stamp to the time of the measurement",
                    key=(self.topic, "stamps stand"),
                )
        self._time.take(waiting.stamp, None)
        if self._frames is not None:
            waiting.needed = tuple(self._frames(waiting.message))
        in_line = any(item.needed == waiting.needed for item in self._waiting)
        if not in_line and self._complete(waiting):
            self._handle(waiting)
        else:
            if len(self._waiting) >= MOST_HELD:
                self._make_room()
            bisect.insort(self._waiting, waiting, key=lambda item: item.stamp)
        self.serve_waiting(reported=True)
        if self._node.replayed:
            self._node.serve_waiting(reported=True)
        elif self.awaited:
            self._node.serve_waiting()

    def _make_room(self) -> None:
        """Give up the oldest message of those that wait for what most of them wait for."""
        ((needed, _),) = Counter(item.needed for item in self._waiting).most_common(1)
        self._waiting.remove(next(item for item in self._waiting if item.needed == needed))
        self.drop("waiting queue full", f"more than {MOST_HELD} messages wait for transforms")

    def _complete(self, waiting: Waiting, over: bool = False) -> bool:
        """Whether all is there that belongs to a message; over : companions are not waited for any more."""
        told = over or all(item.has_told(waiting.stamp) for item in self._companions)
        return told and self._node.transforms.are_ready(waiting.needed, waiting.stamp)

    def has_told(self, stamp: int) -> bool:
        """Whether messages up to a stamp have come, if anybody sends any."""
        if self._expected is None:
            self._expected = self._node.count_publishers(self.topic) > 0
        return not self._expected or (self._time.newest is not None and self._time.newest >= stamp)

    def _handle(self, waiting: Waiting) -> None:
        self.arrived = waiting.arrived
        try:
            self._handler(waiting.message, waiting.stamp)
        except (InputError, TransformError) as error:
            too_old = isinstance(error, TransformError) and not error.later
            if too_old and not self.counts.used and self.counts.drops[EARLY] < EARLY_ONES:
                self.counts.drops[EARLY] += 1
                return
            self.drop("refused", str(error))
            return
        except Exception as error:
            self._defect(error)
            return
        self.counts.used += 1
        self.latencies.append(time.perf_counter() - waiting.arrived)

    @property
    def waiting(self) -> int:
        """How many messages wait for their transforms."""
        return len(self._waiting)

    def serve_waiting(self, reported: bool = False, give_up: bool = False) -> None:
        """Handle messages whose transforms have come, and drop those that time has left behind.

        Time is that of the topic's own further messages, not that of a machine that may be busy.

        reported : whether the caller is about to say what the node has published. give_up : nothing more will come.
        """
        if not self._waiting:
            return
        timeout = round(self._node.settings.transform_timeout * NANOSECONDS)
        missing: set[Pairs] = set()
        for item in tuple(self._waiting):
            # The handler of one before may have begun a new run.
            if item.needed in missing or item not in self._waiting:
                continue
            over = give_up or (self._time.confirmed or 0) > item.stamp + timeout
            if self._complete(item, over):
                self._waiting.remove(item)
                self._handle(item)
                if not reported:
                    # Said again, as there may be more output now.
                    self._done(item.stamp)
            elif over:
                self._waiting.remove(item)
                self.drop("no transform", self._node.transforms.missing(item.needed, item.stamp))
            else:
                missing.add(item.needed)

    def refuse(self, detail: str) -> None:
        """Take back that a message was of use: its handler found out later that it makes no sense."""
        self.counts.used -= 1
        self.drop("refused", detail)

    def drop(self, reason: str, detail: str, defect: bool = False) -> None:
        """Count a message that is given up on, and say so."""
        self.counts.drops[reason] += 1
        self._node.complain(f"{self.topic}: {reason}: {detail}", key=(self.topic, reason), defect=defect)

    def new_run(self) -> None:
        if self._waiting:
            self.counts.drops["run ended while waiting"] += len(self._waiting)
            self._waiting.clear()
        self._time.forget()
        self._admitted = 0.0
        self._shed = None
        self.gaps.new_run()

    def watch_publishers(self) -> None:
        """Look anew who sends; called now and then, as asking costs time."""
        self.gaps.watch_publishers(self._node.count_publishers(self.topic))
        # One that has died keeps nobody waiting.
        self._expected = None

    def _on_lost(self, event: Any) -> None:
        # Of what is latched a newer message takes the place of the one before: that is not a loss.
        if not (self._latched or self.on_demand):
            self.counts.reported_lost = int(event.total_count)

    def _on_incompatible(self, event: Any) -> None:
        self._node.complain(f"{self.topic}: {_unheard(self.topic, event)}", key=(self.topic, "qos"))

    def _done(self, stamp: int) -> None:
        """What came last is done with; where there are turns, that is said once for all inputs."""
        if self._node.turns.on:
            self._node.turns.go_on()
        elif not self.on_demand and self._node.settings.report_processed:
            self.acknowledge(stamp)

    def acknowledge(self, stamp: int) -> None:
        self._told_lost = self.counts.missing
        message = Processed(
            stamp=time_message(stamp),
            topic=self.topic,
            sequence=self.sequence,
            received=self.counts.received,
            dropped=self.counts.dropped,
            lost=self._told_lost,
        )
        self._node.account.acknowledge(message)

    def tell_loss(self) -> None:
        """Say how many messages were lost, if more were than was said before."""
        if self.counts.missing > self._told_lost:
            self.acknowledge(self._time.newest or 0)


def _unheard(topic: str, event: Any) -> str:
    """Why a publisher is not heard, and what to do about it."""
    policy = str(event.last_policy_kind).rpartition(".")[2].lower().removeprefix("rmw_qos_policy_")
    return (
        f"a publisher offers less than is asked for ({policy}) and is not heard. Change it, or set "
        f"qos_overrides.{topic}.subscription.{policy} for this node"
    )

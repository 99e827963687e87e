"""What a node leaves alone until it is its turn, so that a lock-step replay repeats to the last digit, and soon.

Messages lie about. A turn tells how many of each topic, by their publishers' word, the node is to have taken in, and
wakes it up once for all of them. The replay gives turns in the order of `RANKS`, those who are listened to first. What
several nodes of a rank say reaches a further one in any order: it takes its inputs in the order in which it has made
them. Goals and results of actions, and coroutines that rest, are kept until all messages are there. Kept things, goals
and results are counted like messages, under names that no topic has.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.action.client import ActionClient
from rclpy.qos import QoSProfile
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts_msgs.msg import Connections, Processed

if TYPE_CHECKING:
    from whereabouts.nodes.ros.base import SuiteNode
    from whereabouts.nodes.ros.inputs import Input

# Who is listened to has its turn first.
RANKS = {
    "target_tracker": 1, "loop_closure": 1, "motion_predictor": 2, "verifier": 2, "world_model": 2,
    "world_maintenance": 3, "object_search": 3,
}  # fmt: skip
# What is kept is done in this order.
GOALS, RESULTS, RESTS = range(3)
MARK = 8  # bytes of a goal's id that tell who sent it
# Listeners that an output has at least that no topic stands for.
ENOUGH = 1 << 16


def turn_topic(node: str) -> str:
    """Where a node, by its full name, is told that it is its turn."""
    return f"{node}/turn"


def kept_name(node: str) -> str:
    """Under which a node counts what it has kept."""
    return f"{node}/kept"


def waits_name(node: str) -> str:
    """Under which a node says how much waits for transforms or for time to go on."""
    return f"{node}/waits"


def free_topic(node: str) -> str:
    """Under which a node says in its turn that others need not wait for the end of it."""
    return f"{node}/free"


def goals_name(action: str) -> str:
    """Under which goals of an action are counted."""
    return f"{action}/goals"


def results_name(action: str, mark: bytes) -> str:
    """Under which results are counted that go to whom the mark is of."""
    return f"{action}/results_{mark.hex()}"


def mark_of(client: str) -> bytes:
    """What the ids of a node's goals begin with."""
    return hashlib.blake2b(client.encode(), digest_size=MARK).digest()


def goal_id(client: str) -> UUID:
    """A new goal's id that tells whose it is."""
    return UUID(uuid=list(mark_of(client) + uuid.uuid4().bytes[MARK:]))


@dataclass
class _Rest:
    since: int | None
    seconds: float
    over: Future

    def is_over(self, now: int) -> bool:
        """By message time; also where that went back."""
        return self.since is None or not self.since <= now < self.since + self.seconds * NANOSECONDS


class Turns:
    """What one node keeps.

    on : whether there is a replay that gives turns. received, sent : goals and results, by name. own, resting :
    subscriptions of the node's inputs; those that wake nobody up.
    """

    def __init__(self, node: SuiteNode) -> None:
        self._node = node
        self.clear()

    def clear(self) -> None:
        self.on = False
        self.received: dict[str, int] = {}
        self.sent: dict[str, int] = {}
        self._listeners: dict[str, Callable[[], int]] = {}
        self._kept: list[tuple[int, int, Callable[[], None]]] = []
        self._number = self._count = 0
        self._rests: list[_Rest] = []
        self._wanted: dict[str, int] | None = None
        self._missing: Input | None = None
        self._around = False
        self.own: list[Any] = []
        self.resting: list[Any] = []
        self._busy = False

    def listen(self) -> None:
        topic = turn_topic(self._node.get_fully_qualified_name())
        self._input = self._node.add_input(
            Connections, topic, self.take, sensor=False, qos=QoSProfile(depth=10)
        )

    @property
    def counts(self) -> dict[str, int]:
        """What the node has put out besides messages, and how much waits."""
        name = self._node.get_fully_qualified_name()
        waiting = len(self._rests) + sum(item.waiting for item in self._node.inputs)
        return {kept_name(name): self._count, waits_name(name): waiting, **self.sent}

    def _rest(self, missing: Input | None) -> None:
        """Wait for the next turn, or for what is missing of this one."""
        self._missing = missing
        awake = [item.subscription for item in (self._input, missing) if item is not None]
        self.own = [item.subscription for item in self._node.inputs]
        self.resting = [item for item in self._node.subscriptions if item not in awake]

    def listeners(self, name: str) -> int:
        """How many have been found that take what is put out under a name."""
        return self._listeners[name]() if name in self._listeners else ENOUGH

    def keep(self, rank: int, work: Callable[[], None]) -> None:
        """Do this when it is the node's turn, which it may be now."""
        self._number += 1
        self._kept.append((rank, self._number, work))
        self._count += not self._busy

    def take(self, message: Connections, _stamp: int) -> None:
        """It is the node's turn: so many messages of these topics there have been; none are named where all may be."""
        if not self.on:
            self.on = True
            self._rest(None)
        self._wanted = dict(zip(message.inputs, message.received, strict=True))

    def go_on(self) -> None:
        """Something came: end the turn if all is there that belongs to it."""
        if self._busy:
            return
        self._busy = True
        try:
            if self._node.active:
                if self._wanted is None or self._lacks(self._wanted):
                    return
                self._do_kept()
            elif self._missing is not None:
                self._rest(None)
            self._wanted = None
        finally:
            self._busy = False
        self._input.acknowledge(self._node.time.clocks.now or 0)

    def _lacks(self, wanted: Mapping[str, int]) -> bool:
        """Take in what lies about, input by input; whether some of what is wanted, by topic, is still to come."""
        missing = None
        for item in self._node.inputs:
            if item is not self._input and (item.topic in wanted or self._around or not wanted):
                while item.take():
                    pass
                item.tell_loss()
                if item.counts.received < wanted.get(item.topic, 0):
                    missing = item
                    break
        if missing is not self._missing:
            self._rest(missing)
        self._around &= missing is not None
        to_come = any(count < wanted.get(name, 0) for name, count in self.received.items())
        return to_come or missing is not None

    def look_around(self) -> None:
        """Take in at the next turn what others say than the replay and its nodes, too: somebody at a screen."""
        self._around = True

    def _do_kept(self) -> None:
        kept, self._kept = sorted(self._kept, key=lambda item: item[:2]), []
        for _, _, work in kept:
            try:
                work()
            except Exception as error:
                self._node.report_defect("turn", error)
        # What was kept because of it is for another turn.
        self._count += bool(self._kept)

    def let_go(self) -> None:
        """What others wait for has been said: they may have their turns while this one goes on."""
        if self._busy:
            topic = free_topic(self._node.get_fully_qualified_name())
            self._node.account.acknowledge(Processed(topic=topic, sequence=self._input.sequence))

    # Coroutines.

    async def rest(self, seconds: float) -> None:
        """Until it is the node's turn after so much message time."""
        rest = _Rest(self._node.time.clocks.now, seconds, Future())
        self._rests.append(rest)
        await rest.over

    def look(self, now: int) -> None:
        """Time has gone on: who has rested long enough is to go on."""
        for rest in [rest for rest in self._rests if rest.is_over(now)]:
            self._rests.remove(rest)
            self.keep(RESTS, partial(self._wake, rest.over))

    def _wake(self, over: Future) -> None:
        over.set_result(None)
        go_on = getattr(self._node.executor, "go_on", None)
        if go_on is not None:
            go_on(self._node)

    # Actions.

    def serves(self, action: str) -> None:
        self.received[goals_name(action)] = 0

    async def begin(self, action: str) -> None:
        """A goal has been accepted: it is begun when it is the node's turn."""
        if not self.on:
            return
        begun: Future = Future()
        self._come(goals_name(action), GOALS, partial(self._wake, begun))
        await begun

    def ended(self, action: str, handle: Any) -> None:
        if not self._node.replayed:
            return
        name = results_name(action, bytes(handle.goal_id.uuid)[:MARK])
        self.sent[name] = self.sent.get(name, 0) + 1

    def result(self, name: str, work: Callable[[], None]) -> None:
        """A result has come: what follows from it is done when it is the node's turn."""
        if self.on:
            self._come(name, RESULTS, work)
        else:
            work()

    def calls(self, name: str, listeners: Callable[[], int]) -> None:
        self.sent[name], self._listeners[name] = 0, listeners

    def _come(self, name: str, rank: int, work: Callable[[], None]) -> None:
        self.received[name] = self.received.get(name, 0) + 1
        self.keep(rank, work)
        self._node.account.acknowledge(Processed(topic=name, received=self.received[name]))
        self.go_on()


class Caller:
    """Sends a node's goals to an action, and hands back what comes of them."""

    def __init__(self, node: SuiteNode, action_type: type, name: str) -> None:
        self._turns, self._me = node.turns, node.get_fully_qualified_name()
        self.client = ActionClient(node, action_type, name)
        action = node.resolve_topic_name(name)
        self._goals, self._results = goals_name(action), results_name(action, mark_of(self._me))
        self._turns.calls(self._goals, lambda: int(self.ready))
        self._turns.received[self._results] = 0

    @property
    def ready(self) -> bool:
        return bool(self.client.server_is_ready())

    def send(self, goal: Any, ended: Callable[[Any], None]) -> None:
        """Send a goal. ended : called with the answer, None where the goal was refused."""
        self._turns.sent[self._goals] += 1
        sent = self.client.send_goal_async(goal, goal_uuid=goal_id(self._me))
        sent.add_done_callback(lambda done: self._accepted(done.result(), ended))

    def _accepted(self, handle: Any, ended: Callable[[Any], None]) -> None:
        if handle is None or not handle.accepted:
            ended(None)
            return
        handle.get_result_async().add_done_callback(
            lambda done: self._turns.result(self._results, lambda: ended(done.result()))
        )

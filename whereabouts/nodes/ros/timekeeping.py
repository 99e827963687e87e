"""The time of a node: which messages are of it, and when a new run begins."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from rclpy.clock import JumpThreshold, ROSClock, TimeJump
from rclpy.duration import Duration

from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.ros.inputs import Input, Waiting
from whereabouts.system.clocks import TOLERANCE, Clocks, Message, Ruling

if TYPE_CHECKING:
    from whereabouts.nodes.ros.base import SuiteNode

# s without any message at all after which nobody is waited for; a lock-step replay goes on by then as well.
SILENCE = 30.0
# Several publishers of /clock may be less than this apart.
CLOCK_JUMP = Duration(seconds=-1)

Stamped = tuple[Input, Waiting]


@dataclass
class _Tick:
    period: int
    callback: Callable[[], None]
    due: int = 0


class Timekeeper:
    """Follows the stamps of a node's sensors, and /clock where the node does.

    clocks : of all sensors, by topic. heard_at : when any message came last, s of `time.perf_counter`.
    """

    def __init__(self, node: SuiteNode) -> None:
        self._node = node
        self.clocks: Clocks[Stamped] = Clocks()
        self.heard_at = time.perf_counter()
        self._ticks: list[_Tick] = []
        # Whether messages have told of a jump that /clock has yet to make.
        self._jump_expected = False
        back = JumpThreshold(min_forward=None, min_backward=CLOCK_JUMP, on_clock_change=False)
        self._handle = node.get_clock().create_jump_callback(back, post_callback=self._on_clock_jump)

    def follow(self, item: Input, waiting: Waiting) -> None:
        """Let a sensor's message in if its stamp is of this time, and begin a new run where time itself went back."""
        elapsed = 0 if self._node.settings.report_processed else item.silence(waiting.arrived)
        ruling = self.clocks.take(item.topic, waiting.stamp, (item, waiting), elapsed)
        if not ruling.taken:
            off = (waiting.stamp - (self.clocks.now or 0)) / NANOSECONDS
            where = f"{abs(off):.3f} s {'ahead of' if off > 0 else 'behind'} the time of all inputs"
            text = (
                f"{item.topic}: a message with a stamp {where} is held back until other messages confirm it"
            )
            clock = self.clocks.sources.get(item.topic)
            if clock is not None and clock.is_apart:
                # Nobody can tell which is right; that it was heard first is no reason to be silent about it.
                text = (
                    f"{item.topic}: its clock is {where}, which arrived first. Its messages are dropped "
                    "until the clocks agree: synchronise them"
                )
            self._node.complain(text, (item.topic, "time"))
        self._obey(ruling)
        self._tick()

    def call_every(self, period: float, callback: Callable[[], None]) -> None:
        """Call back every `period` seconds of message time."""
        self._ticks.append(_Tick(round(period * NANOSECONDS), callback))

    def _tick(self) -> None:
        now = self.clocks.now
        if now is None:
            return
        self._node.turns.look(now)
        for tick in self._ticks:
            if not tick.due - tick.period <= now < tick.due:
                tick.due = now + tick.period
                tick.callback()

    def stop(self) -> None:
        self._ticks.clear()
        self.begin()

    def begin(self, remembered: int | None = None) -> None:
        """The next message tells what time it is; two of them where that is far from what is remembered, ns."""
        self._refuse(self.clocks.begin(remembered, patience=0))

    def mind_silence(self) -> None:
        """Nothing comes any more: neither transforms that are waited for nor what would confirm a stamp ahead.

        A simulation that stands still goes on one day. Where nothing is in lock-step, the time that has passed tells
        which stamps may be right.
        """
        lock_step = self._node.settings.report_processed
        if time.perf_counter() - self.heard_at < SILENCE or (self._simulated and not lock_step):
            return
        if lock_step:
            self._obey(self.clocks.flush())
        for item in self._node.inputs:
            item.serve_waiting(give_up=True)

    def _obey(self, ruling: Ruling[Stamped]) -> None:
        self._refuse(ruling.refused)
        if ruling.new_run:
            self._node.transforms.back_to(ruling.taken[0].stamp)
            self._jump_expected = self._simulated and self._ros_time() > ruling.taken[-1].stamp + TOLERANCE
            self._node.begin_run(ruling.new_run, ruling.counted)
        for message in ruling.taken:
            item, waiting = message.item
            item.admit(waiting, message.late)

    def _refuse(self, messages: list[Message[Stamped]]) -> None:
        for message in messages:
            item, waiting = message.item
            item.drop(
                "of another time", f"no other message confirms its stamp {waiting.stamp / NANOSECONDS:.3f}"
            )

    @property
    def _simulated(self) -> bool:
        """Whether the node's clock follows /clock."""
        return bool(cast(ROSClock, self._node.get_clock()).ros_time_is_active)

    def _ros_time(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _on_clock_jump(self, jump: TimeJump) -> None:
        """/clock went back: a new run, unless messages have said so before."""
        now = self._ros_time()
        told, self._jump_expected = self._jump_expected, False
        if not self._node.inputs or (told and abs(now - (self.clocks.now or 0)) <= 2 * TOLERANCE):
            return
        self._refuse(self.clocks.begin(now))
        self._node.transforms.back_to(now)
        self._node.begin_run(f"/clock went back by {-jump.delta.nanoseconds / NANOSECONDS:.3f} s")

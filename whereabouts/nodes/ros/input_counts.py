"""What became of the messages of one topic, which of them never came, and how much of a node they may take."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

from whereabouts.nodes.messages.stamps import NANOSECONDS

FEWEST = 10  # periods before any is taken for usual
# ns, and periods, without a message from which on one that came steadily has stopped.
SILENT, SILENT_PERIODS = 3 * NANOSECONDS, 10


@dataclass
class InputCounts:
    """What became of the messages of one topic."""

    received: int = 0
    used: int = 0
    late: int = 0
    inactive: int = 0
    lost: int = 0
    reported_lost: int = 0
    stamp_gaps: int = 0
    repeated_stamps: int = 0
    drops: Counter[str] = field(default_factory=Counter)

    @property
    def dropped(self) -> int:
        return sum(self.drops.values())

    @property
    def missing(self) -> int:
        """How many never came, by the publisher's numbers or as the middleware tells."""
        return max(self.lost, self.reported_lost)


class MessageGaps:
    """Finds what was lost on the way or left out by a sensor's driver, and counts it.

    one_publisher : whether a single one sends, which numbers its messages; None until it was looked.
    """

    def __init__(self, counts: InputCounts) -> None:
        self._counts = counts
        self.one_publisher: bool | None = None
        self._sequence = 0
        self._periods: deque[int] = deque(maxlen=50)
        self.new_run()

    def new_run(self) -> None:
        self._periods.clear()
        self._last_stamp: int | None = None
        self._alike = 0  # messages in a row with the stamp of the one before

    def watch_publishers(self, count: int) -> None:
        """Numbers of several publishers interleave and say nothing."""
        # The graph may not know yet of the one whose message has just come.
        self.one_publisher = count <= 1
        if not self.one_publisher:
            self._sequence = 0

    def check_sequence(self, sequence: int) -> int:
        """How many are lost before this one: with a single publisher, a jump. A smaller number is a restart."""
        jumped = self.one_publisher and sequence > self._sequence + 1 and self._sequence > 0
        lost = sequence - self._sequence - 1 if jumped else 0
        self._counts.lost += lost
        self._sequence = sequence
        return lost

    def check_period(self, stamp: int) -> None:
        """A gap between stamps of several usual periods: the sensor or its driver left something out."""
        repeated = stamp == self._last_stamp
        self._counts.repeated_stamps += repeated
        self._alike = self._alike + 1 if repeated else 0
        if self._last_stamp is not None and stamp > self._last_stamp:
            period = stamp - self._last_stamp
            if len(self._periods) >= FEWEST:
                usual = self._period(0.5)
                self._counts.stamp_gaps += max(0, round(period / usual) - 1) if usual > 0 else 0
            self._periods.append(period)
        self._last_stamp = stamp

    @property
    def stamps_stand(self) -> bool:
        """Whether many messages in a row have one stamp: nobody sets it. A few may be several sensors'."""
        return self._alike >= FEWEST

    def stopped(self, silent: int) -> bool:
        """Whether messages came steadily, nearly all at one time between stamps, and have not for `silent` ns."""
        steady = len(self._periods) >= FEWEST and self._period(0.9) < 2 * self._period(0.5)
        return steady and silent > max(SILENT_PERIODS * self._period(0.5), SILENT)

    def _period(self, share: float) -> int:
        """Time between stamps, ns, that a share of them keeps."""
        return sorted(self._periods)[int(share * len(self._periods))]


# s over which a budget is even: a burst of as much passes.
BURST = 2.0
# What an input is over its budget by is forgotten beyond this, s: one slow message does not silence it for long.
DEBT = 1.0


@dataclass(frozen=True)
class Budget:
    """messages, bytes : per second. share : of the node's time."""

    messages: float = 300.0
    bytes: float = 64e6
    share: float = 0.8


DEFAULT = Budget()
# By type, where it differs. Everybody sends transforms on one topic.
BUDGETS = {
    "tf2_msgs/TFMessage": Budget(messages=5000.0),
    "nav_msgs/Odometry": Budget(messages=1500.0),
    "sensor_msgs/PointCloud2": Budget(bytes=256e6),
    "sensor_msgs/Image": Budget(bytes=512e6),
}


class Purse:
    """What an input has spent of its budget; every second pays back one second's worth."""

    def __init__(self, budget: Budget) -> None:
        self._limits = (budget.messages, budget.bytes, budget.share)
        self._spent = [0.0, 0.0, 0.0]
        self._then = 0.0

    def over(self, now: float) -> str:
        """Which of the budgets is spent at `now`, s; "" for none."""
        passed, self._then = max(now - self._then, 0.0), now
        self._spent = [
            max(s - passed * limit, 0.0) for s, limit in zip(self._spent, self._limits, strict=True)
        ]
        words = ("messages", "bytes", "s of handling")
        for spent, limit, word in zip(self._spent, self._limits, words, strict=True):
            if spent >= BURST * limit:
                return f"more than {limit:g} {word} per second"
        return ""

    def spend(self, size: int, seconds: float) -> None:
        """One message has been handled."""
        costs = (1.0, float(size), seconds)
        self._spent = [
            min(s + cost, (BURST + DEBT) * limit)
            for s, cost, limit in zip(self._spent, costs, self._limits, strict=True)
        ]

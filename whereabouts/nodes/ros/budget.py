"""How much of a node one input may take: messages, bytes and time, each per second."""

from __future__ import annotations

from dataclasses import dataclass

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

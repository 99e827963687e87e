"""Time as the stamps of several sources tell it, each with a clock of its own; knows neither ROS nor a wall clock.

A source's next stamp is expected near its last one, or near where the other sources are. One that is not is held back:
it never moves time. If the source goes on as before, it was wrong, and is refused. If further messages confirm it, and
all sources that are alive went the same way or fell silent, then time itself has moved: ahead, and all goes on, or
back, and a new run begins. What is decided follows from the order of messages alone, so that a replay repeats it.
"""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

NANOSECONDS = 1_000_000_000
# ns by which a stamp may be off and is still taken: detectors are up to 5 s late, and clocks as far apart.
TOLERANCE = 11 * NANOSECONDS // 2
# A source of which as little is known as this is given all the time there is.
LEAST_PATIENCE = NANOSECONDS
# Messages of one source that are held back at most.
MOST_HELD = 64

Item = TypeVar("Item")


@dataclass(frozen=True)
class Message(Generic[Item]):
    """A message and its stamp, ns; `item` is the caller's. late : older than the source's newest."""

    source: Hashable
    stamp: int
    item: Item
    order: int
    late: bool = False


@dataclass
class Ruling(Generic[Item]):
    """What follows from one message.

    taken : messages to handle now, in order. refused : messages that belong to no time there is. new_run : why a new
    run begins before the first of `taken` is handled; empty otherwise. counted : false where the run that ends was
    but a single message, which was wrong: nothing is lost with it.
    """

    taken: list[Message[Item]] = field(default_factory=list)
    refused: list[Message[Item]] = field(default_factory=list)
    new_run: str = ""
    counted: bool = True


class SourceClock(Generic[Item]):
    """What the messages of one source say about time.

    newest : newest stamp taken, ns. confirmed : the one that a further message has reached as well, so that a single
    message moves nobody's time. refused : messages that were found to be of no time.
    """

    def __init__(self, patience: int | None = None) -> None:
        self._patience = patience
        self.refused = 0
        self.held: list[Message[Item]] = []
        self._gaps: deque[int] = deque(maxlen=20)
        self._lags: deque[int] = deque(maxlen=20)
        self.forget()

    def forget(self) -> None:
        """Its next message is its first; how often it speaks is still known."""
        self.newest: int | None = None
        self.confirmed: int | None = None
        self.mark = 0  # stamp held when another source last spoke as usual

    @property
    def gap(self) -> int | None:
        """Usual time between messages, ns; None where too few came."""
        return round(statistics.median(self._gaps)) if len(self._gaps) >= 3 else None

    @property
    def lag(self) -> float:
        """How far it is usually behind the newest of all sources, s."""
        return statistics.median(self._lags) / NANOSECONDS if self._lags else 0.0

    @property
    def patience(self) -> int:
        """For how long its silence says nothing, ns."""
        gap = self.gap
        if self._patience is not None:
            return self._patience
        return TOLERANCE if gap is None else min(max(3 * gap, LEAST_PATIENCE), TOLERANCE)

    @property
    def is_apart(self) -> bool:
        """Whether what is held goes on by a clock of its own, for longer than one may be wrong."""
        return len(self.held) > 2 and self.held[-1].stamp - self.held[0].stamp > TOLERANCE

    @property
    def advance(self) -> int:
        """How far it got in the time that is held, while all others were silent, ns."""
        return max(message.stamp for message in self.held) - self.mark

    def goes_on(self, elapsed: int) -> bool:
        """Whether what is held confirms itself: two messages that follow each other, or three one after the other.

        Two that are far apart say nothing: one of them may be wrong.
        """
        if len(self.held) != 2:
            return len(self.held) > 2
        return not self._leaps(self.held[0].stamp, self.held[1].stamp, elapsed)

    def _leaps(self, before: int, stamp: int, elapsed: int = 0) -> bool:
        return stamp - before > TOLERANCE + max(3 * (self.gap or 0), elapsed)

    def follows(self, stamp: int, elapsed: int) -> bool:
        """Whether a stamp goes on from the newest, or from the one before if a single message has leapt since.

        elapsed : time since the last message, where somebody has measured it, ns.
        """
        assert self.newest is not None
        assert self.confirmed is not None
        if abs(stamp - self.newest) <= TOLERANCE:
            return True
        reach = TOLERANCE + max(3 * (self.gap or 0), elapsed)
        return any(-TOLERANCE <= stamp - last <= reach for last in (self.newest, self.confirmed))

    def take(self, stamp: int, now: int | None) -> bool:
        """Move on; whether the message is late."""
        if now is not None:
            self._lags.append(now - stamp)
        if self.newest is None or self.confirmed is None:
            self.newest = self.confirmed = stamp
            return False
        if stamp >= self.newest:
            self._gaps.append(stamp - self.newest)
            self.newest, self.confirmed = stamp, self.newest
            return False
        self.confirmed = max(self.confirmed, stamp)
        return True

    def hold(self, message: Message[Item], elapsed: int = 0) -> list[Message[Item]]:
        """Keep a message that does not fit; returns those before it that it does not confirm."""
        out: list[Message[Item]] = []
        if self.held and (
            message.stamp < self.held[-1].stamp - TOLERANCE
            or self._ahead(message) != self._ahead(self.held[0])
            or self._leaves(message.stamp, elapsed)
        ):
            out = self.release()
        if not self.held:
            self.mark = message.stamp
        self.held.append(message)
        if len(self.held) > MOST_HELD:
            out.append(self.held.pop(0))
        return out

    def _leaves(self, stamp: int, elapsed: int) -> bool:
        """Whether a stamp leaps away from messages that follow each other, as those of a clock that is apart do."""
        stamps = [message.stamp for message in self.held[-2:]]
        return len(stamps) == 2 and not self._leaps(*stamps) and self._leaps(stamps[1], stamp, elapsed)

    def _ahead(self, message: Message[Item]) -> bool:
        return self.newest is None or message.stamp > self.newest

    def release(self) -> list[Message[Item]]:
        """What was held, which is not any more."""
        held, self.held = self.held, []
        return held


class Clocks(Generic[Item]):
    """The time of a node, from all its sources.

    sources : by name, in the order in which they were first heard.
    """

    def __init__(self) -> None:
        self.sources: dict[Hashable, SourceClock[Item]] = {}
        self._order = 0
        self._taken = 0  # messages of this run

    @property
    def now(self) -> int | None:
        """Newest stamp that more than a single message speaks for, ns; None before the first."""
        return self._now()

    def _now(self, without: Hashable = None) -> int | None:
        known = [
            c.confirmed for name, c in self.sources.items() if c.confirmed is not None and name != without
        ]
        return max(known, default=None)

    def begin(self, stamp: int | None = None, patience: int = TOLERANCE) -> list[Message[Item]]:
        """Begin a new run, at `stamp` (ns) where that is known; returns what was held, which is lost.

        patience : ns for which messages of another time have to go on until they are believed.
        """
        lost = [message for clock in self.sources.values() for message in clock.release()]
        for clock in self.sources.values():
            clock.forget()
        self._taken = 0
        self.sources.pop(SAID, None)
        if stamp is not None:
            said: SourceClock[Item] = SourceClock(patience)
            said.take(stamp, None)
            self.sources[SAID] = said
        return lost

    def take(self, source: Hashable, stamp: int, item: Item, elapsed: int = 0) -> Ruling[Item]:
        """Judge the next message of a source.

        elapsed : time since its last one by a clock that cannot jump, ns; zero where nothing may depend on that.
        """
        clock = self.sources.setdefault(source, SourceClock())
        self._order += 1
        message = Message(source, stamp, item, self._order)
        ruling: Ruling[Item] = Ruling()
        if self._fits(source, clock, stamp, elapsed):
            self._settle(clock, message, ruling)
            self._accept(message, ruling)
            self._mark()
            self._admit(ruling)
        else:
            ruling.refused += clock.hold(message, elapsed)
            self._decide(source, clock, ruling, elapsed)
        for refused in ruling.refused:
            self.sources[refused.source].refused += 1
        return ruling

    def flush(self) -> Ruling[Item]:
        """Nobody says anything any more: what is ahead of time is taken as it is."""
        ruling: Ruling[Item] = Ruling()
        ahead = {
            name: clock
            for name, clock in self.sources.items()
            if clock.held and (clock.newest is None or clock.held[0].stamp > clock.newest)
        }
        self._move(ahead, ruling)
        return ruling

    def _fits(self, source: Hashable, clock: SourceClock[Item], stamp: int, elapsed: int) -> bool:
        if clock.newest is not None and clock.follows(stamp, elapsed):
            return True
        others = self._now(without=source)
        if clock.newest is None:
            return others is None or abs(stamp - others) <= 2 * TOLERANCE
        if others is None:
            return False
        # It went to where the others are: it had stalled, or its clock was put right.
        return clock.newest < stamp <= others + TOLERANCE or abs(stamp - others) <= TOLERANCE

    def _settle(self, clock: SourceClock[Item], message: Message[Item], ruling: Ruling[Item]) -> None:
        """What a source's messages that were held are, now that one of it fits.

        They were wrong; but those of a source that had not been heard yet, and that this one goes on from, only were
        farther from a first message of another source, which may have been the wrong one.
        """
        held = clock.release()
        if clock.newest is not None or any(abs(h.stamp - message.stamp) > TOLERANCE for h in held):
            ruling.refused += held
            return
        for early in held:
            self._accept(early, ruling)

    def _accept(self, message: Message[Item], ruling: Ruling[Item]) -> None:
        clock = self.sources[message.source]
        if clock.newest is not None and message.stamp < clock.newest - TOLERANCE:
            clock.forget()
        late = clock.take(message.stamp, self.now)
        self._taken += 1
        ruling.taken.append(Message(message.source, message.stamp, message.item, message.order, late))

    def _mark(self) -> None:
        """A source has spoken as usual: those whose messages are held do not have the word alone."""
        for clock in self.sources.values():
            if clock.held:
                clock.mark = clock.held[-1].stamp

    def _admit(self, ruling: Ruling[Item]) -> None:
        """Take what was held until now that another source has come there as well; it was there first."""
        for name, clock in self.sources.items():
            if clock.held and self._fits(name, clock, clock.held[0].stamp, 0):
                later, ruling.taken = ruling.taken, []
                for message in clock.release():
                    self._accept(message, ruling)
                ruling.taken += later

    def _decide(self, source: Hashable, clock: SourceClock[Item], ruling: Ruling[Item], elapsed: int) -> None:
        """Whether time has moved to where this source's messages are held."""
        here = clock.held[-1].stamp
        group = {
            name: other
            for name, other in self.sources.items()
            if other.held and abs(other.held[-1].stamp - here) <= 2 * TOLERANCE
        }
        # Two sources that are wrong once each are no evidence, however well they agree.
        if not any(other.goes_on(elapsed if other is clock else 0) for other in group.values()):
            return
        now = self.now
        if now is None:
            self._move(group, ruling)
            return
        rest = [c for name, c in self.sources.items() if name not in group and c.newest is not None]
        alive = [c for c in rest if c.newest is not None and now - c.newest <= 2 * TOLERANCE]
        if any(clock.advance < c.patience for c in alive):
            return
        before = now if clock.newest is None else clock.newest
        if clock.held[0].stamp > before:
            self._move(group, ruling)
            return
        names = ", ".join(str(name) for name in group)
        ruling.new_run = f"{names}: time went back by {(before - clock.held[0].stamp) / NANOSECONDS:.3f} s"
        ruling.counted = self._taken > 1
        held = {name: other.release() for name, other in group.items()}
        ruling.refused += self.begin()
        for name, messages in held.items():
            self.sources[name].held = messages
        self._move(group, ruling)

    def _move(self, group: dict[Hashable, SourceClock[Item]], ruling: Ruling[Item]) -> None:
        """Time is where this group of sources is: take what was held, in the order in which it came."""
        messages = sorted((m for clock in group.values() for m in clock.release()), key=lambda m: m.order)
        for clock in group.values():
            clock.forget()
        for message in messages:
            self._accept(message, ruling)


# Name of what was said about the time otherwise, such as by a clock that was put back.
SAID = "time as it was said"

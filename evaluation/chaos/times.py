"""Clocks that are wrong and networks that lose, as a node's sensors: how often it begins a new run.

All sensors of a node speak ten times a second and make sense, but for their stamps and for what gets lost. A stamp that
is far off, a source that is late, apart from the others or silent, and a network that loses cost no run; a bag that
loops and a jump of /clock one each.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rclpy.time import Time

from evaluation.chaos.generator import LINKS, Fuzzer
from evaluation.chaos.network import Link
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts_msgs.srv import Reset

PERIOD = NANOSECONDS // 10
# s by which a single stamp is off.
YEAR = 365.0 * 24.0 * 3600.0
FAR = (2.0, 7.0, 60.0, 3600.0, 24.0 * 3600.0, YEAR, 20.0 * YEAR)
# s by which a source is late, or two are apart; s of silence; s by which a bag or /clock goes back.
LATE, SILENT, BACK = 5.0, 13.0, 60.0
# When the first message comes, s; each play begins a day after the one before.
BEGIN, DAY = 1.6e9, 24.0 * 3600.0
SETTLED = 1.5


class ChaosStage:
    """The sensors of a node.

    call : hands an input a message and takes care of what it does. now : ns that the robot's clock shows.
    """

    def __init__(self, node: Any, seed: int, call: Callable[[str, Callable[[], Any]], None]) -> None:
        self.node = node
        self.rng = np.random.default_rng(seed)
        self.sources = [item for item in node.inputs if item.tells_time]
        self.now = round(BEGIN * NANOSECONDS)
        self.simulated = False
        self._fuzzer = Fuzzer(seed, sense=1.0)
        self._call = call

    def begin(self) -> None:
        """Another day, and a node that knows nothing of the one before."""
        self.now += round(DAY * NANOSECONDS)
        self.node._reset(Reset.Request(reason="another play"), Reset.Response())

    def any(self) -> Any:
        """One of the sources."""
        return self.sources[int(self.rng.integers(len(self.sources)))]

    def say(self, source: Any, off: float = 0.0) -> None:
        """One message whose stamp is off by some seconds."""
        self.deliver(source, self.message(source, off))

    def message(self, source: Any, off: float = 0.0) -> Any:
        """What a sensor says now."""
        message = self._fuzzer.message(source.opener.kind)
        message.header.stamp = time_message(min(self.now + round(off * NANOSECONDS), 2**31 * NANOSECONDS - 1))
        return serialize_message(message) if source.opener.packed else message

    def deliver(self, source: Any, message: Any) -> None:
        """Hand the node a message."""
        self._call(source.topic, lambda: source._receive(message, {}))

    def go(
        self, seconds: float, off: Mapping[int, float] | None = None, silent: Collection[int] = ()
    ) -> None:
        """Let time go on. off : s by source, counted from the last one. silent : sources that say nothing."""
        for _ in range(round(seconds * NANOSECONDS / PERIOD)):
            self._step()
            for index, source in enumerate(self.sources):
                if index - len(self.sources) not in silent:
                    self.say(source, (off or {}).get(index - len(self.sources), 0.0))

    def go_lossy(self, seconds: float) -> None:
        """Let time go on while the network loses, doubles, delays and exchanges messages."""
        links: list[Link[Any]] = [Link(self.rng) for _ in self.sources]
        for _ in range(round(seconds * NANOSECONDS / PERIOD)):
            self._step()
            for source, link in zip(self.sources, links, strict=True):
                for message in link.send(self.message(source)):
                    self.deliver(source, message)
        for source, link in zip(self.sources, links, strict=True):
            for message in link.rest():
                self.deliver(source, message)

    def jump(self, seconds: float) -> None:
        """Put the robot's clock, and all that is stamped by it, elsewhere."""
        self.now += round(seconds * NANOSECONDS)
        self._tell()

    def simulate(self, wanted: bool) -> None:
        """Let the node's own clock follow /clock, or the machine again."""
        self.node.set_parameters([Parameter("use_sim_time", value=wanted)])
        self.simulated = wanted
        self._tell()

    def _step(self) -> None:
        self.now += PERIOD
        self._tell()
        for parent, child in LINKS[:2]:
            pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
            self.node.transforms.insert(transform_message(parent, child, self.now, pose), static=False)

    def _tell(self) -> None:
        if self.simulated:
            clock = self.node.get_clock()
            clock.set_ros_time_override(Time(nanoseconds=self.now, clock_type=clock.clock_type))


def _ahead(stage: ChaosStage) -> None:
    stage.go(2.0)
    stage.say(stage.any(), float(stage.rng.choice(FAR)))
    stage.go(2.0)


def _behind(stage: ChaosStage) -> None:
    stage.go(2.0)
    stage.say(stage.any(), -float(stage.rng.choice(FAR)))
    stage.go(2.0)


def _late(stage: ChaosStage) -> None:
    stage.go(6.0, {-1: -LATE})


def _apart(stage: ChaosStage) -> None:
    stage.go(6.0, {-len(stage.sources): -LATE})


def _stalled(stage: ChaosStage) -> None:
    stage.go(2.0)
    stage.go(SILENT, silent={-int(stage.rng.integers(1, len(stage.sources) + 1))})
    stage.go(2.0)


def _lossy(stage: ChaosStage) -> None:
    stage.go(1.0)
    stage.go_lossy(6.0)
    stage.go(1.0)


def _looped(stage: ChaosStage) -> None:
    stage.go(8.0)
    stage.jump(-BACK)
    stage.go(8.0)


def _clock(stage: ChaosStage) -> None:
    stage.simulate(True)
    stage.go(4.0)
    stage.jump(-BACK)
    stage.go(4.0)
    stage.simulate(False)


@dataclass(frozen=True)
class Fault:
    """What happens to time, how many runs begin because of it, and how many sources it takes."""

    play: Callable[[ChaosStage], None]
    runs: int = 0
    sources: int = 1


FAULTS: dict[str, Fault] = {
    "one stamp far ahead": Fault(_ahead),
    "one stamp far behind": Fault(_behind),
    "a source 5 s late": Fault(_late, sources=2),
    "first source 5 s behind": Fault(_apart, sources=2),
    "a stalled source": Fault(_stalled),
    "a network that loses": Fault(_lossy),
    "a bag that loops": Fault(_looped, runs=1),
    "/clock jumps back": Fault(_clock, runs=1),
}


@dataclass
class Plays:
    """How often a fault was played, the new runs it cost, and those it may cost."""

    played: int = 0
    runs: int = 0
    wanted: int = 0


def play(stage: ChaosStage, name: str, told: dict[str, Plays]) -> str:
    """Play a fault and count; what is wrong with what the node made of it, empty where nothing is."""
    fault = FAULTS[name]
    stage.begin()
    stage.go(SETTLED)
    before, used = stage.node.epoch, [item._time.newest for item in stage.sources]
    fault.play(stage)
    runs = stage.node.epoch - before
    count = told.setdefault(name, Plays())
    count.played, count.runs, count.wanted = count.played + 1, count.runs + runs, count.wanted + fault.runs
    if [item._time.newest for item in stage.sources] == used:
        return f"{name}: nothing was taken in any more"
    return "" if runs == fault.runs else f"{name}: other than {fault.runs} new runs: {runs}"

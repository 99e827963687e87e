"""One node in this process, fed by hand: `python -m evaluation.chaos.worker NODE SEED SECONDS PROGRESS RESULT`.

No message goes over DDS, so that thousands a second reach what stands behind the node's inputs. The number of the input
under way stands in the file PROGRESS: who looks after this process can tell which one ended it; the seed repeats it.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import mmap
import os
import re
import resource
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from unique_identifier_msgs.msg import UUID

from estimation.errors import WhereaboutsError
from evaluation.chaos.generator import LINKS, START, Fuzzer
from evaluation.chaos.times import FAULTS, ChaosStage, Plays, play
from whereabouts.node_names import NODES
from whereabouts.nodes.messages import transforms
from whereabouts.nodes.messages.envelopes import envelope
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.ros.base import SuiteNode, start
from whereabouts.nodes.ros.executor import NodeExecutor
from whereabouts.nodes.ros.input_counts import Budget, Purse

HERE = (0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0)
# Messages between two looks at timers, two calls of each service and two goals of each action.
TIMERS, CALLS, GOALS = 20, 50, 200
NUMBER = re.compile(r"(?<!line )\b\d[\d.e+-]*")
# Bytes of address space: what wants more is refused, as on a robot.
ROOM = 8 << 30
SENSES = (0.8, 0.97, 0.995, 0.999)
# Set to let everything in that the middleware delivers: then the libraries have to hold by themselves.
OPEN_VARIABLE = "WHEREABOUTS_CHAOS_OPEN"
# Of a process's time, the part for clocks that are wrong; faults to begin with, of those of the seed.
TIMES_SHARE, AT_LEAST = 0.2, 2
# What each node may be given besides its defaults, so that what is off by default is tried too.
PARAMETERS: dict[str, list[dict[str, Any]]] = {
    "scan_registration": [{}, {"cloud_topics": ["points"]}],
    "loop_closure": [{}, {"cloud_topic": "points"}],
    "world_model": [{"store_path": "world.sqlite"}, {"region": [-1e6, 1e6, -1e6, 1e6, -10.0, 10.0]}],
    "verifier": [{}, {"cloud_topic": "points"}],
}


class FedGoal:
    """Stands for the handle of a goal that nobody waits for."""

    is_cancel_requested = False

    def __init__(self, request: Any, goal_id: UUID) -> None:
        self.request, self.goal_id = request, goal_id

    def ignore(self, *_: Any) -> None:
        """Whatever the action says."""

    succeed = abort = canceled = publish_feedback = ignore


class Worker:
    """Feeds one node."""

    def __init__(self, name: str, seed: int, progress: Path) -> None:
        options = PARAMETERS.get(name, [{}])
        given = {"diagnostics_period": 0.1, "transform_timeout": 0.05, **options[seed % len(options)]}
        self.node = _node_class(name)(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])
        self.executor = NodeExecutor()
        self.executor.add_node(self.node)
        self.defects: Counter[str] = Counter()
        self.slowest = (0.0, "")
        self.done = 0
        self.actions: list[tuple[Any, Any]] = []
        self.plays: dict[str, Plays] = {}
        self._seed = seed
        self._fuzzer = Fuzzer(seed)
        self._watch_defects()
        add_action = self.node.add_action
        self.node.add_action = self._note_action(add_action)  # type: ignore[method-assign]
        progress.write_bytes(bytes(8))
        with progress.open("r+b") as file:
            self._progress = mmap.mmap(file.fileno(), 8)
        if not start(self.node):
            raise RuntimeError(f"{name} did not start")
        for item in self.node.inputs:
            item._purse = Purse(Budget(float("inf"), float("inf"), float("inf")))
        for parent, child in LINKS:
            self.node.transforms.insert(
                transform_message(parent, child, START, HERE), static=child == "laser"
            )

    def open(self) -> None:
        """Take the envelopes away."""
        for item in self.node.inputs:
            item.opener.envelope.check = _anything
        envelope(TransformStamped).check = _anything
        vars(transforms)["POSITION"] = float("inf")

    def _watch_defects(self) -> None:
        complaints = self.node.complaints
        complain = complaints.complain

        def noted(text: str, key: Any = None, defect: bool = False) -> None:
            if defect:
                lines = [line.strip() for line in text.splitlines() if line.strip()]
                place = next((line for line in reversed(lines) if line.startswith("File")), "")
                self.defects[f"{NUMBER.sub('N', lines[0][:120])} | {place}"] += 1
            complain(text, key, defect)

        complaints.complain = noted  # type: ignore[method-assign]

    def _note_action(self, add_action: Any) -> Any:
        def add(action_type: Any, name: str, execute: Any) -> Any:
            self.actions.append((action_type.Goal, execute))
            return add_action(action_type, name, execute)

        return add

    def run(self, seconds: float) -> None:
        """Feed for so long."""
        end = time.monotonic() + seconds
        services = [item for item in self.node.services if "/_" not in item.srv_name and _own(item)]
        while time.monotonic() < end:
            for item in list(self.node.inputs):
                self._feed(item)
            if self.done % TIMERS < len(self.node.inputs):
                self.executor.spin_once(timeout_sec=0)
            if self.done % CALLS < len(self.node.inputs):
                for service in services:
                    self._count(service.srv_name, lambda service=service: self._ask(service))
            if self.actions and self.done % GOALS < len(self.node.inputs):
                kind, execute = self.actions[self.done % len(self.actions)]
                goal = FedGoal(self._fuzzer.message(kind), UUID(uuid=list(self._fuzzer.rng.bytes(16))))
                self.executor.create_task(_carry_out(execute, goal))

    def play(self, seconds: float) -> None:
        """Stamps that are wrong and messages that get lost, for so long; faults in turn, by seed and node."""
        stage = ChaosStage(self.node, self._seed, self._count)
        names = [name for name, fault in FAULTS.items() if fault.sources <= len(stage.sources)]
        end, turn = time.monotonic() + seconds, AT_LEAST * (self._seed + NODES.index(self.node.node_name))
        first = turn
        while time.monotonic() < end or turn < first + AT_LEAST:
            wrong = play(stage, names[turn % len(names)], self.plays)
            self.defects[wrong] += bool(wrong)
            turn += 1
        self.defects += Counter()  # without what was right

    def _feed(self, item: Any) -> None:
        fuzzer, kind = self._fuzzer, item.opener.kind
        fuzzer.sense = SENSES[int(fuzzer.rng.integers(len(SENSES)))]
        message: Any
        if item.opener.packed:
            broken = fuzzer.rng.random() < 0.5
            message = fuzzer.bytes(kind) if broken else serialize_message(fuzzer.message(kind))
        else:
            message = fuzzer.mutated(kind) if fuzzer.rng.random() < 0.3 else fuzzer.message(kind)
            if message is None:
                self.done += 1
                return
        self._count(item.topic, lambda: item._receive(message, {}))

    def _ask(self, service: Any) -> None:
        try:
            service.callback(self._fuzzer.message(service.srv_type.Request), service.srv_type.Response())
        except Exception as error:
            self.node.report_defect(service.srv_name, error)

    def _count(self, name: str, call: Any) -> None:
        self._progress[:] = struct.pack("<q", self.done)
        begun = time.perf_counter()
        call()
        self.done += 1
        taken = time.perf_counter() - begun
        if taken > self.slowest[0] and self.done > 500:
            self.slowest = (taken, f"{name} #{self.done}")


def _anything(message: Any) -> None:
    """No check at all."""


def _own(service: Any) -> bool:
    return bool(service.srv_type.__module__.startswith("whereabouts_msgs"))


async def _carry_out(execute: Callable[[Any], Coroutine[Any, Any, Any]], goal: FedGoal) -> None:
    """As an action server does: what cannot be done is refused, which is no defect."""
    with suppress(WhereaboutsError):
        await execute(goal)


def _node_class(name: str) -> type[SuiteNode]:
    module = importlib.import_module(f"whereabouts.nodes.{name}_node")
    return next(
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, SuiteNode) and value.node_name == name
    )


def resident() -> int:
    """Bytes of this process in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def main() -> None:
    """Entry point."""
    name, seed, seconds, progress, result = sys.argv[1:6]
    faulthandler.enable()
    resource.setrlimit(resource.RLIMIT_AS, (ROOM, ROOM))
    rclpy.init()
    worker = Worker(name, int(seed), Path(progress))
    if os.environ.get(OPEN_VARIABLE):
        worker.open()
    half = 0.5 * (1.0 - TIMES_SHARE) * float(seconds)
    worker.run(half)
    before, then = resident(), time.monotonic()
    worker.run(half)
    slope = (resident() - before) / (time.monotonic() - then)
    worker.play(TIMES_SHARE * float(seconds))
    counts = {item.topic: vars(item.counts)["used"] for item in worker.node.inputs}
    said = {
        "node": name, "inputs": worker.done, "defects": dict(worker.defects), "bytes_per_s": slope,
        "used": counts, "slowest": worker.slowest, "resident": resident(),
        "plays": {name: vars(told) for name, told in worker.plays.items()},
    }  # fmt: skip
    Path(result).write_text(json.dumps(said))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()

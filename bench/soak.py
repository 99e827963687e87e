"""A long day through all nodes at speed: memory, latency and losses, drawn over bag time.

    python bench/soak.py [--hours 1] [--bag BAG]      writes bench/soak.txt and bench/soak.png

The robot of the demo goes on driving through its apartment, round after round, and is replayed in lock-step. A bag is
repeated with its stamps moved on, so that time never jumps; the robot then does, from where it ended to where it
began. Growth is the slope of a node's anonymous memory over the second half of the run (Theil-Sen): pages of libraries
turn from private to shared and back with what else runs on the machine, by 30 MiB of loop_closure's.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import theilslopes

from evaluation.process_usage import family, own_memory
from whereabouts.cli.run import NODES
from whereabouts.logs import McapWriter, RawMessage, open_raw
from whereabouts.nodes.messages.message_types import UnknownTypeError, message_class
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.nodes.runtime.suite_run import SuiteRun, prepare_environment, replay_spec, run_suite
from whereabouts.simulation.home.apartment_bag import record
from whereabouts.simulation.home.apartment_day import ApartmentDay
from whereabouts.system.progress import progress_bar

RESULT = Path(__file__).with_suffix(".txt")
PICTURE = Path(__file__).parent / "soak.png"
ROUND = 150.0
"""s that a round through the apartment takes at least."""
EVERY = 20.0
MIB = 1024.0


def move_stamps(message: Any, by: int) -> None:
    """Add nanoseconds to every time in a message that is not zero."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind == "builtin_interfaces/Time":
            if nanoseconds(value):
                setattr(message, name, time_message(nanoseconds(value) + by))
        elif "/" in kind:
            for item in value if isinstance(value, list) else [value]:
                move_stamps(item, by)


def repeat(bag: Path, target: Path, times: int) -> float:
    """Write a bag several times in a row; returns its length in seconds."""
    from rclpy.serialization import deserialize_message, serialize_message

    with McapWriter(target) as writer, progress_bar() as bar:
        task = bar.add_task("writing the long bag", total=times)
        first = last = offset = 0
        for turn in range(times):
            with open_raw(bag) as log:
                for message in log:
                    try:
                        kind = message_class(message.topic.type_name)
                    except UnknownTypeError:
                        continue
                    first = first or message.log_time
                    static = message.name.endswith("tf_static")
                    if turn and static:
                        continue
                    last = max(last, message.log_time + offset)
                    data = bytes(message.data)
                    if turn:
                        moved = deserialize_message(data, kind)
                        move_stamps(moved, offset)
                        data = serialize_message(moved)
                    writer.write_raw(message.topic, data, message.log_time + offset)
            offset = last - first + NANOSECONDS // 10
            bar.update(task, completed=turn + 1)
    return (last - first) / NANOSECONDS


class Monitor:
    """Samples the nodes' memory as the replay goes on."""

    def __init__(self, run: SuiteRun) -> None:
        self._run = run
        self._start = 0
        self._due = 0
        self.times: list[float] = []
        self.memory: dict[str, list[float]] = defaultdict(list)
        self.together: list[float] = []  # proportional, the host that nodes are forked from with them

    def look(self, message: RawMessage) -> None:
        """Called after every message."""
        self._start = self._start or message.log_time
        if message.log_time < self._due or self._run.supervisor is None:
            return
        self._due = message.log_time + int(EVERY * NANOSECONDS)
        self.times.append((message.log_time - self._start) / NANOSECONDS)
        for name, node in self._run.supervisor.nodes.items():
            text = Path(f"/proc/{node.process.pid}/smaps_rollup").read_text()
            written = re.findall(r"^Anonymous:\s+(\d+) kB", text, re.MULTILINE)
            self.memory[name.strip("/")].append(int(written[0]) / MIB)
        host = self._run.supervisor.host_pid
        processes = {one for node in self._run.supervisor.nodes.values() for one in family(node.process.pid)}
        self.together.append(sum(own_memory(one)[1] for one in processes | ({host} if host else set())))


def latencies(recording: Path) -> dict[str, list[tuple[float, float]]]:
    """Seconds since the start and p99 latency of the slowest input, in ms, by node, from its diagnostics."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.serialization import deserialize_message

    found: dict[str, list[tuple[float, float]]] = defaultdict(list)
    start = 0
    with open_raw(recording, ["/diagnostics"]) as log:
        for message in log:
            start = start or message.log_time
            for status in deserialize_message(bytes(message.data), DiagnosticArray).status:
                worst = [float(item.value) for item in status.values if item.key.endswith("latency p99 [ms]")]
                if worst:
                    found[status.name].append(((message.log_time - start) / NANOSECONDS, max(worst)))
    return found


def growth(times: list[float], values: list[float]) -> float:
    """MiB per hour over the second half."""
    half = len(times) // 2
    return float(theilslopes(values[half:], np.array(times[half:]) / 3600.0)[0])


def draw(monitor: Monitor, delays: dict[str, list[tuple[float, float]]]) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for name, values in monitor.memory.items():
        left.plot(np.array(monitor.times) / 60.0, values, label=name)
        if delays.get(name):
            times, p99 = np.array(delays[name]).T
            right.plot(times / 60.0, p99, label=name)
    left.set(xlabel="bag time, min", ylabel="anonymous memory, MiB", ylim=(0, None), title="memory")
    right.set(
        xlabel="bag time, min", ylabel="p99 latency of the slowest input, ms", yscale="log", title="latency"
    )
    left.legend(fontsize=8)
    figure.savefig(PICTURE, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--bag", type=Path, default=None)
    options = parser.parse_args()
    prepare_environment(private=True)
    with tempfile.TemporaryDirectory() as folder:
        long, out = Path(folder) / "long.mcap", Path(folder) / "out.mcap"
        seconds = 3600.0 * options.hours
        if options.bag is None:
            print("simulating a long day")
            record(long, seconds, ApartmentDay(rounds=max(3, math.ceil(seconds / ROUND))))
        else:
            once = repeat(options.bag, long, 1)
            seconds = repeat(options.bag, long, max(1, round(seconds / once)))
        os.chdir(folder)
        run = SuiteRun(
            long,
            [replay_spec(name) for name in NODES],
            Path(folder) / "logs",
            record=[("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")],
            output=out,
            on_event=print,
        )
        monitor = Monitor(run)
        run.on_message = monitor.look
        with progress_bar() as bar:
            task = bar.add_task("replaying", total=100)
            run.on_progress = lambda share: bar.update(task, completed=round(100 * share))
            account = run_suite(run)
        delays = latencies(out)
    rows = [
        f"{seconds / 60:.0f} min of bag time in {account.wall_seconds / 60:.0f} min, "
        f"{account.published.total()} messages, "
        f"{account.total_lost} lost, {account.unanswered.total()} unanswered",
        f"{'node':20} {'MiB at start':>12} {'MiB at end':>11} {'MiB per hour':>13} {'p99 at end, ms':>15}",
    ]
    for name, values in monitor.memory.items():
        p99 = f"{delays[name][-1][1]:15.1f}" if delays.get(name) else f"{'-':>15}"
        rows.append(
            f"{name:20} {values[0]:12.0f} {values[-1]:11.0f} {growth(monitor.times, values):13.1f} {p99}"
        )
    whole = monitor.together
    rows.append(
        f"all together, proportional: {whole[0]:.0f} MiB at start, {max(whole):.0f} at most, {whole[-1]:.0f} at end"
    )
    text = "\n".join(rows) + "\n"
    print(text)
    RESULT.write_text(text)
    draw(monitor, delays)


if __name__ == "__main__":
    main()

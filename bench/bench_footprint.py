"""What each node costs before it has anything to do: seconds until it is active, and resident memory.

    python bench/bench_footprint.py            writes its last result to bench/bench_footprint.txt

The alternative is `bare`: an rclpy node that subscribes a scan and imports nothing else. Every node is started alone,
warm (a first start has filled the compilation cache), then all together. Private: pages that no other process
shares; shared libraries are counted once in the sum of proportional set sizes.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from evaluation.process_usage import family
from whereabouts.cli.run import NODES
from whereabouts.nodes.runtime.suite_run import prepare_environment

RESULT = Path(__file__).with_suffix(".txt")
SETTLE = 3.0
MIB = 1024.0


@dataclass
class ProcessMemory:
    """Of a process, in MiB."""

    resident: float
    proportional: float
    private: float


def memory(pid: int) -> ProcessMemory:
    """Of a process and those that it made for itself, from the kernel's own account."""
    found: dict[str, float] = defaultdict(float)
    for own in family(pid):
        text = Path(f"/proc/{own}/smaps_rollup").read_text()
        for name, size in re.findall(r"^(\w+):\s+(\d+) kB", text, re.MULTILINE):
            found[name] += int(size) / MIB
    return ProcessMemory(found["Rss"], found["Pss"], found["Private_Clean"] + found["Private_Dirty"])


@contextmanager
def processes(commands: dict[str, list[str]]) -> Iterator[dict[str, tuple[subprocess.Popen[str], float]]]:
    """Started nodes and the seconds each took to become active."""
    running: dict[str, tuple[subprocess.Popen[str], float]] = {}
    try:
        for name, command in commands.items():
            started = time.monotonic()
            process = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True
            )
            running[name] = (process, started)
        states = wait_until_active(list(commands), {name: start for name, (_, start) in running.items()})
        yield {name: (process, states[name]) for name, (process, _) in running.items()}
    finally:
        for process, _ in running.values():
            process.terminate()
        for process, _ in running.values():
            process.wait()


def wait_until_active(names: list[str], started: dict[str, float]) -> dict[str, float]:
    """Seconds from start to the active state, or for `bare` to being in the graph."""
    import rclpy
    from lifecycle_msgs.msg import State
    from lifecycle_msgs.srv import GetState
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor

    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("footprint", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    clients = {name: node.create_client(GetState, f"/{name}/get_state") for name in names if name != "bare"}
    took: dict[str, float] = {}
    while len(took) < len(names):
        for name in set(names) - set(took):
            if name == "bare":
                if "bare" in node.get_node_names():
                    took[name] = time.monotonic() - started[name]
            elif clients[name].service_is_ready():
                future = clients[name].call_async(GetState.Request())
                executor.spin_until_future_complete(future, timeout_sec=0.5)
                if future.done() and future.result().current_state.id == State.PRIMARY_STATE_ACTIVE:
                    took[name] = time.monotonic() - started[name]
        executor.spin_once(timeout_sec=0.02)
        if time.monotonic() - max(started.values()) > 180.0:
            raise SystemExit(f"not active after 180 s: {', '.join(sorted(set(names) - set(took)))}")
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()
    return took


BARE = """
import rclpy
from sensor_msgs.msg import LaserScan
rclpy.init()
node = rclpy.create_node("bare")
node.create_subscription(LaserScan, "scan", lambda message: None, 10)
rclpy.spin(node)
"""


def command(name: str) -> list[str]:
    if name == "bare":
        return [sys.executable, "-c", BARE]
    from whereabouts.nodes.runtime.supervisor import NodeSpec

    return NodeSpec(name).command()


def from_one_host() -> str:
    """All nodes as `whereabouts run` starts them; the host is counted with them."""
    from whereabouts.nodes.runtime.supervisor import NodeSpec, Supervisor

    with tempfile.TemporaryDirectory() as folder, Supervisor(Path(folder), hosted=True) as supervisor:
        started = time.monotonic()
        for name in NODES:
            supervisor.start(NodeSpec(name))
        while not all(node.was_active for node in supervisor.nodes.values()):
            supervisor.check()
            time.sleep(0.01)
        seconds = time.monotonic() - started
        time.sleep(SETTLE)
        host = supervisor.host_pid
        used = [memory(node.process.pid) for node in supervisor.nodes.values()]
        used += [memory(host)] if host else []
    return (
        f"{'the same, one host':20} {seconds:14.1f} {sum(m.resident for m in used):13.0f} "
        f"{sum(m.private for m in used):12.0f}   proportional {sum(m.proportional for m in used):.0f} MiB"
    )


def main() -> None:
    prepare_environment(private=True)
    os.chdir(tempfile.mkdtemp())
    os.environ["HOME"] = os.getcwd()
    rows = [f"{'node':20} {'active after s':>14} {'resident MiB':>13} {'private MiB':>12}"]
    everything = {name: command(name) for name in NODES}
    with processes(everything):
        time.sleep(SETTLE)
    for name in ("bare", *NODES):
        with processes({name: command(name)}) as running:
            time.sleep(SETTLE)
            process, seconds = running[name]
            used = memory(process.pid)
            rows.append(f"{name:20} {seconds:14.1f} {used.resident:13.0f} {used.private:12.0f}")
            print(rows[-1], flush=True)
    with processes(everything) as running:
        time.sleep(SETTLE)
        all_used = [memory(process.pid) for process, _ in running.values()]
        slowest = max(seconds for _, seconds in running.values())
    rows.append(
        f"{'all eight together':20} {slowest:14.1f} {sum(m.resident for m in all_used):13.0f} "
        f"{sum(m.private for m in all_used):12.0f}   proportional {sum(m.proportional for m in all_used):.0f} MiB"
    )
    rows.append(from_one_host())
    text = "\n".join(rows) + "\n"
    print(text)
    RESULT.write_text(text)


if __name__ == "__main__":
    main()

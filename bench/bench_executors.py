"""What a message costs a node that does nothing with it: this project's executor beside rclpy's own two.

    python bench/bench_executors.py            writes its last result to bench/bench_executors.txt

The node has what a node of the suite has: a scan at 250 Hz, ten more subscriptions, five services, a timer. Cost is
processor time of its process, the middleware's threads included, by turns. Waiting: a second with a coroutine that
waits for a future, as actions do. Timer: whether a timer alone wakes up `spin`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.task import Future
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Trigger

from whereabouts.nodes.ros.executor import NodeExecutor

RESULT = Path(__file__).with_suffix(".txt")
KINDS: dict[str, Callable[[], Any]] = {
    "NodeExecutor": NodeExecutor,
    "EventsExecutor": EventsExecutor,
    "SingleThreadedExecutor": SingleThreadedExecutor,
}
MESSAGES, TURNS, PERIOD = 1500, 3, 0.004
LONGEST = 60.0


def publish() -> None:
    """Scans until nobody listens any more."""
    rclpy.init()
    node = rclpy.create_node("publisher")
    publisher = node.create_publisher(LaserScan, "scan", 50)
    scan = LaserScan(ranges=[1.0] * 360)
    while publisher.get_subscription_count() < 1:
        time.sleep(0.05)
    while publisher.get_subscription_count():
        publisher.publish(scan)
        time.sleep(PERIOD)


def made(kind: str) -> tuple[Any, Any, list[int]]:
    """Executor, node, and a list that holds how many messages have come."""
    rclpy.init()
    node, got = rclpy.create_node("subscriber"), [0]

    def take(_: Any) -> None:
        got[0] += 1

    node.create_subscription(LaserScan, "scan", take, 50)
    for number in range(10):
        node.create_subscription(LaserScan, f"other_{number}", take, 50)
    for number in range(5):
        node.create_service(Trigger, f"service_{number}", lambda request, response: response)
    executor = KINDS[kind]()
    executor.add_node(node)
    return executor, node, got


def cost(kind: str) -> float:
    """ms of processor time for each message."""
    executor, _, got = made(kind)
    while got[0] < 1:
        executor.spin_once(timeout_sec=1.0)
    before, begun = got[0], time.process_time()
    while got[0] < before + MESSAGES:
        executor.spin_once(timeout_sec=1.0)
    return 1e3 * (time.process_time() - begun) / MESSAGES


def waiting(kind: str) -> float:
    """ms of processor time for a second in which a coroutine waits."""
    executor, _, _ = made(kind)
    future = Future()

    async def wait() -> None:
        await future

    executor.create_task(wait)
    begun, until = time.process_time(), time.monotonic() + 2.0
    while time.monotonic() < until:
        executor.spin_once(timeout_sec=0.5)
    return 1e3 * (time.process_time() - begun) / 2.0


def timer(kind: str) -> float:
    """0 where `spin` calls a timer while nothing else happens; ends this process."""
    executor, node, _ = made(kind)

    def called() -> None:
        print(0.0, flush=True)
        os._exit(0)

    node.create_timer(0.5, called, clock=Clock(clock_type=ClockType.STEADY_TIME))
    executor.spin()
    return 1.0


def measured(what: str, kind: str) -> float:
    """A figure from a process of its own; NaN where it does not come."""
    command = [sys.executable, __file__, what, kind]
    try:
        out = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST if what != "timer" else 15.0
        )
    except subprocess.TimeoutExpired:
        return float("nan")
    return float(out.stdout)


def main() -> None:
    if len(sys.argv) > 2:
        print({"cost": cost, "waiting": waiting, "timer": timer}[sys.argv[1]](sys.argv[2]), flush=True)
        os._exit(0)
    if len(sys.argv) > 1:
        publish()
        return
    os.environ["ROS_DOMAIN_ID"] = "87"
    costs: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for _ in range(TURNS):
        for kind in KINDS:
            publisher = subprocess.Popen([sys.executable, __file__, "publish"])
            costs[kind].append(measured("cost", kind))
            publisher.kill()
            publisher.wait()
    lines = ["executor                ms per message (least, most)   ms per s waiting   timer alone"]
    for kind, values in costs.items():
        spread = f"{np.median(values):.2f} ({min(values):.2f}, {max(values):.2f})"
        called = "called" if measured("timer", kind) == 0.0 else "not called"
        lines.append(f"{kind:24s}{spread:31s}{measured('waiting', kind):<19.1f}{called}")
    text = "\n".join(lines)
    print(text)
    RESULT.write_text(text + "\n")


if __name__ == "__main__":
    main()

"""Nodes over DDS: latency and losses at sensor rate, against a node that does nothing but answer.

    python bench/bench_nodes.py            writes its last result to bench/bench_nodes.txt

Latency is from just before a scan is published to the arrival of the answer in another process, on this machine. Where
others use the machine too, `chrt -f 1 python bench/bench_nodes.py` keeps their work out of the figures.
The alternative is `echo`: an rclpy node of ten lines that answers each scan with an empty Odometry.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

RESULT = Path(__file__).with_suffix(".txt")
SCAN_RATE, SCAN_COUNT, WARM_UP = 40.0, 1200, 80
CLOUD_RATE, CLOUD_COUNT, CLOUD_BYTES = 10.0, 100, 1_200_000


def environment(profile: bool) -> None:
    """Private domain; the shipped DDS profile or Fast DDS's defaults."""
    from whereabouts.system.resources import config_file

    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    if profile:
        os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(config_file("fastdds.xml"))


def echo() -> None:
    """The alternative: answers `scan` with an empty `odometry`, and counts `points`."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import LaserScan, PointCloud2
    from std_msgs.msg import UInt32

    rclpy.init()
    node = rclpy.create_node("echo")
    odometry, count = (
        node.create_publisher(Odometry, "odometry", 10),
        node.create_publisher(UInt32, "count", 10),
    )
    seen = 0

    def answer(message: LaserScan) -> None:
        odometry.publish(Odometry(header=message.header))

    def tally(_: PointCloud2) -> None:
        nonlocal seen
        seen += 1
        count.publish(UInt32(data=seen))

    node.create_subscription(LaserScan, "scan", answer, qos_profile_sensor_data)
    node.create_subscription(PointCloud2, "points", tally, qos_profile_sensor_data)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    os._exit(0)


@contextmanager
def process(command: list[str]) -> Iterator[None]:
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        child.terminate()
        child.wait()


def scan_messages(count: int, beams: int) -> list[Any]:
    """Scans of a drive through a floor, ready to publish."""
    from sensor_msgs.msg import LaserScan

    from whereabouts.nodes.messages.conversions import array_of
    from whereabouts.simulation import Drive, Lidar, random_floor

    rng = np.random.default_rng(1)
    world, waypoints = random_floor(rng)
    drive, lidar = Drive(waypoints), Lidar(beams=beams)
    messages = []
    for k in range(count):
        scan = lidar.scan(world, drive(k / SCAN_RATE), rng, k / SCAN_RATE).scan
        message = LaserScan(angle_min=scan.angle_min, angle_increment=scan.angle_increment)
        message.header.frame_id = "base_link"
        message.range_min, message.range_max = scan.range_min, scan.range_max
        message.ranges = array_of("f", scan.ranges.astype(np.float32))
        messages.append(message)
    return messages


class Prober:
    """Publishes at a rate and notes when each answer comes."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from nav_msgs.msg import Odometry
        from rclpy.executors import SingleThreadedExecutor
        from std_msgs.msg import UInt32

        rclpy.init()
        self.node = rclpy.create_node("prober")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.answers: dict[int, float] = {}
        self.tally = 0
        self.labelled = self.skipped = 0
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._note, 10)
        self.node.create_subscription(Odometry, "odometry", self._answer, 100)
        self.node.create_subscription(UInt32, "count", self._count, 100)

    def close(self) -> None:
        import rclpy

        self.node.destroy_node()
        rclpy.shutdown()

    def _answer(self, message: Any) -> None:
        self.answers[message.header.stamp.sec * 10**9 + message.header.stamp.nanosec] = time.perf_counter()

    def _count(self, message: Any) -> None:
        self.tally = message.data

    def _note(self, message: Any) -> None:
        """How many scans the node labelled, and how many there was no time for, by its own account."""
        told = {item.key: item.value for status in message.status for item in status.values}
        if "scans labelled" in told:
            self.labelled, self.skipped = int(told["scans labelled"]), int(told["labels skipped"])

    def spin_until(self, done: Callable[[], bool], timeout: float) -> None:
        deadline = time.perf_counter() + timeout
        while not done() and time.perf_counter() < deadline:
            self.executor.spin_once(timeout_sec=min(0.02, max(0.0, deadline - time.perf_counter())))

    def publish_at(self, publisher: Any, messages: list[Any], rate: float) -> dict[int, float]:
        """Send times by stamp; the stamp of message k is k periods after the start of the epoch."""
        sent = {}
        start = time.perf_counter()
        for k, message in enumerate(messages):
            due = start + k / rate
            self.spin_until(lambda due=due: time.perf_counter() >= due, max(0.0, due - time.perf_counter()))
            stamp = 10**18 + round(k / rate * 1e9)
            message.header.stamp.sec, message.header.stamp.nanosec = stamp // 10**9, stamp % 10**9
            sent[stamp] = time.perf_counter()
            publisher.publish(message)
        return sent


def scan_latency(command: list[str], beams: int) -> tuple[np.ndarray, int, float]:
    """Latencies in ms after warm-up, how many scans got no answer, and the share that was labelled, NaN for none."""
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import LaserScan

    messages = scan_messages(SCAN_COUNT, beams)
    prober = Prober()
    with process(command):
        publisher = prober.node.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
        prober.spin_until(lambda: publisher.get_subscription_count() > 0, 30.0)
        sent = prober.publish_at(publisher, messages, SCAN_RATE)
        prober.spin_until(lambda: len(prober.answers) == len(sent), 3.0)
    prober.close()
    known = prober.labelled + prober.skipped
    stamps = list(sent)[WARM_UP:]
    latencies = np.array([prober.answers[s] - sent[s] for s in stamps if s in prober.answers]) * 1e3
    return latencies, len(stamps) - len(latencies), prober.labelled / known if known else float("nan")


def cloud_delivery() -> float:
    """Share of best-effort clouds that arrive in another process."""
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import PointCloud2

    from whereabouts.nodes.messages.conversions import array_of

    prober = Prober()
    with process([sys.executable, __file__, "--echo"]):
        publisher = prober.node.create_publisher(PointCloud2, "points", qos_profile_sensor_data)
        prober.spin_until(lambda: publisher.get_subscription_count() > 0, 30.0)
        message = PointCloud2(height=1, width=CLOUD_BYTES // 12, point_step=12, row_step=CLOUD_BYTES)
        message.data = array_of("B", np.zeros(CLOUD_BYTES, dtype=np.uint8))
        # The writer knows its reader a moment before the reader knows its writer: count from the first that arrives.
        while not prober.tally:
            prober.publish_at(publisher, [message], CLOUD_RATE)
            prober.spin_until(lambda: prober.tally > 0, 1.0)
        before = prober.tally
        prober.publish_at(publisher, [message] * CLOUD_COUNT, CLOUD_RATE)
        prober.spin_until(lambda: prober.tally == before + CLOUD_COUNT, 3.0)
    prober.close()
    return (prober.tally - before) / CLOUD_COUNT


def in_child(what: str, profile: bool) -> str:
    """Run one measurement in a process of its own, so that each starts from the same state."""
    answer = subprocess.run(
        [sys.executable, __file__, "--measure", what, "--profile" if profile else "--defaults"],
        capture_output=True,
        text=True,
        check=True,
    )
    return answer.stdout.strip().splitlines()[-1]


def measure(what: str, profile: bool) -> None:
    environment(profile)
    if what == "clouds":
        print(cloud_delivery())
        return
    kind, beams = what.split(":")
    node = [sys.executable, "-m", "whereabouts.nodes.scan_registration_node"]
    command = [sys.executable, __file__, "--echo"] if kind == "echo" else node
    latencies, missing, labelled = scan_latency(command, int(beams))
    p50, p99 = np.percentile(latencies, [50, 99])
    print(f"{p50} {p99} {latencies.max()} {missing} {labelled}")


def main() -> None:
    how = ", with real-time priority" if os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR) else ""
    lines = [
        f"scans at {SCAN_RATE:.0f} Hz, {SCAN_COUNT - WARM_UP} after warm-up, best effort; latency in ms{how}"
    ]
    lines.append(f"{'':34}{'p50':>8}{'p99':>8}{'max':>8}{'lost':>6}{'p50 / echo':>12}{'labelled':>10}")
    for beams in (361, 1081):
        floor = None
        for kind in ("echo", "scan_registration"):
            p50, p99, worst, missing, share = (float(x) for x in in_child(f"{kind}:{beams}", True).split())
            floor = floor or p50
            name = f"{kind}, {beams} beams"
            labelled = "" if np.isnan(share) else f"{100 * share:8.0f} %"
            lines.append(
                f"{name:34}{p50:8.2f}{p99:8.2f}{worst:8.2f}{missing:6.0f}{p50 / floor:12.1f}{labelled}"
            )
    lines.append("")
    lines.append(
        f"clouds of {CLOUD_BYTES / 1e6:.1f} MB at {CLOUD_RATE:.0f} Hz, best effort: share that arrives"
    )
    for name, profile in (("config/fastdds.xml", True), ("Fast DDS defaults", False)):
        lines.append(f"{name:34}{100 * float(in_child('clouds', profile)):7.0f} %")
    text = "\n".join(lines) + "\n"
    print(text)
    RESULT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    if "--echo" in sys.argv:
        echo()
    elif "--measure" in sys.argv:
        measure(sys.argv[sys.argv.index("--measure") + 1], "--profile" in sys.argv)
    else:
        main()

"""What the console costs beside a suite that talks: `python bench/bench_console.py [--viewers 10] [--seconds 20]`.

A publisher says what the suite says on a usual day: transforms and odometry 20 times a second, people 10, their paths
2, thirty things 2, a map of 400 x 400 cells every 5 s. Viewers take everything the console sends. Its processor time is
set against that of a bare node with the same subscriptions that does nothing with them. The time to the first paint is
that of a real browser, where one is installed. Results go to the .txt beside.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import rclpy
from geometry_msgs.msg import Point, TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.node import Node
from tf2_msgs.msg import TFMessage
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from evaluation.browser import CHROMIUM, Browser
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts.nodes.runtime.suite_run import prepare_environment
from whereabouts_msgs.msg import (
    DiscreteDistribution,
    PredictedPath,
    PredictedPathArray,
    PredictedPoint,
    Target,
    TargetArray,
    WorldObject,
    WorldState,
)

RESULT = Path(__file__).with_suffix(".txt")
BARE = """
import rclpy, sys
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from whereabouts.console.heard import TOPICS
from whereabouts.nodes.messages.message_types import message_class
rclpy.init()
node = Node("bare")
for topic, name in TOPICS.items():
    node.create_subscription(message_class(name), topic, lambda message: None, qos_profile_sensor_data)
executor = SingleThreadedExecutor()
executor.add_node(node)
print("ready", flush=True)
executor.spin()
"""


class Talker:
    """Publishes at a suite's rates in a thread of its own."""

    def __init__(self) -> None:
        rclpy.init()
        self._node = node = Node("talker")
        self._ended = threading.Event()
        self._step = 0
        self._tf = node.create_publisher(TFMessage, "tf", 10)
        self._odometry = node.create_publisher(Odometry, "odometry", 10)
        self._targets = node.create_publisher(TargetArray, "targets", 10)
        self._paths = node.create_publisher(PredictedPathArray, "predicted_paths", 10)
        self._world = node.create_publisher(WorldState, "world_state", LATCHED)
        self._map = node.create_publisher(OccupancyGrid, "map", LATCHED)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._ended.set()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _run(self) -> None:
        while not self._ended.wait(0.05):
            self._step += 1
            self._drive()
            if self._step % 2 == 0:
                self._targets.publish(self._stamped(TargetArray(targets=[_person(k) for k in range(4)])))
            if self._step % 10 == 5:
                self._world.publish(
                    self._stamped(WorldState(objects=[_thing(k, self._step) for k in range(30)]))
                )
            if self._step % 10 == 0:
                self._paths.publish(self._stamped(PredictedPathArray(paths=[_path(k) for k in range(4)])))
            if self._step % 100 == 1:
                self._map.publish(self._stamped(_map()))

    def _stamped(self, message: Any, frame: str = "map") -> Any:
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(50_000_000 * self._step, 10**9)
        return message

    def _drive(self) -> None:
        moved = self._stamped(TransformStamped(child_frame_id="odom"))
        self._tf.publish(TFMessage(transforms=[moved]))
        odometry = self._stamped(Odometry(child_frame_id="base_link"), "odom")
        odometry.pose.pose.position.x = 0.01 * self._step
        self._odometry.publish(odometry)


def _person(label: int) -> Target:
    return Target(label=label, position=Point(x=float(label), y=2.0))


def _path(label: int) -> PredictedPath:
    points = [PredictedPoint(position=Point(x=label + 0.1 * k, y=2.0)) for k in range(30)]
    return PredictedPath(label=label, points=points)


def _thing(number: int, step: int) -> WorldObject:
    item = WorldObject(id=f"cup-{number}", existence_probability=0.9)
    item.class_distribution = DiscreteDistribution(values=["cup", "bowl"], probabilities=[0.9, 0.1])
    item.pose.pose.position.x = 0.1 * number + 1e-3 * (step % 10)
    return item


def _map() -> OccupancyGrid:
    cells = np.random.default_rng(0).choice(np.array([-1, 0, 100], dtype=np.int8), 400 * 400)
    message = OccupancyGrid(data=cells.tolist())
    message.info.width = message.info.height = 400
    message.info.resolution = 0.05
    return message


def spent(process: int) -> float:
    """Processor seconds of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share(process: int, seconds: float) -> float:
    """Of one core, per cent, over so many seconds."""
    before, begun = spent(process), time.monotonic()
    time.sleep(seconds)
    return 100 * (spent(process) - before) / (time.monotonic() - begun)


def watch(address: str, count: list[int], ended: threading.Event) -> None:
    with suppress(ConnectionClosed), connect(address, max_size=None) as socket:
        while not ended.is_set():
            socket.recv(timeout=10.0)
            count[0] += 1


def first_paint(address: str) -> float | None:
    """Seconds from asking for the page to something on it; None without a browser."""
    if CHROMIUM is None:
        return None
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        Browser(Path(folder) / "profile") as browser,
    ):
        browser.open(address)
        for _ in range(200):
            time.sleep(0.05)
            found = browser.run("performance.getEntriesByName('first-contentful-paint')[0]?.startTime")
            if found:
                return float(found) / 1e3
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--viewers", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args()
    prepare_environment(private=True)
    lines = [f"{platform.machine()}, Python {platform.python_version()}, load {os.getloadavg()[0]:.1f}"]
    talker = Talker()
    bare = subprocess.Popen([sys.executable, "-c", BARE], stdout=subprocess.PIPE, text=True)
    assert bare.stdout is not None
    bare.stdout.readline()
    nothing = share(bare.pid, given.seconds)
    bare.kill()
    bare.wait()
    console = subprocess.Popen(
        [sys.executable, "-m", "whereabouts.cli.main", "console", "--port", "8097"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert console.stdout is not None
    address = re.sub(r".*(http\S+)\s*", r"\1", console.stdout.readline())
    time.sleep(2.0)
    ended, count = threading.Event(), [0]
    try:
        idle = share(console.pid, given.seconds)
        painted = first_paint(address)
        threads = [
            threading.Thread(target=watch, args=("ws://localhost:8097/api/live", count, ended), daemon=True)
            for _ in range(given.viewers)
        ]
        threads[0].start()
        time.sleep(2.0)
        alone = share(console.pid, given.seconds)
        for thread in threads[1:]:
            thread.start()
        time.sleep(2.0)
        count[0] = 0
        busy = share(console.pid, given.seconds)
        rate = count[0] / given.seconds / given.viewers
    finally:
        ended.set()
        console.terminate()
        console.wait()
        talker.end()
    page = (Path(__file__).parents[1] / "whereabouts/console/page.html").stat().st_size
    lines += [
        f"page {page / 1e3:.1f} kB; first paint {'not measured' if painted is None else f'{painted:.2f} s'}",
        f"bare node with the same subscriptions  {nothing:5.1f} % of a core",
        f"console, nobody looks                  {idle:5.1f} %  ({idle / nothing:.2f} of the bare node)",
        f"console, one viewer                   {alone:5.1f} %  ({alone / nothing:.2f} of the bare node)",
        f"console, {given.viewers} viewers at {rate:.1f} Hz           {busy:5.1f} %  "
        f"({busy / nothing:.2f} of the bare node)",
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    RESULT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

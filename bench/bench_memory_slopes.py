"""Does the memory of `world_model` and `loop_closure` grow with the time they run? The nodes' handlers, compressed.

    python bench/bench_memory_slopes.py [world_model|loop_closure ...] [--hours 10] [--looks 12000] [--blame]

Both nodes run in this process and are handed messages directly, without DDS and without waiting: world_model 12,000
looks (two a second of the demo's apartment, people coming and going under new labels), loop_closure ten hours of
driving through it (a scan a second, maps every two). Growth is the slope of the process's anonymous memory over the
second half; the results are appended to the .txt beside. --blame says which lines hold what came in that half.
"""

from __future__ import annotations

import argparse
import gc
import os
import re
import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

# Before numpy starts its threads: one core is what is measured.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import rclpy
from rclpy.serialization import deserialize_message
from scipy.stats import theilslopes
from sensor_msgs.msg import LaserScan

from estimation.geometry.poses import between, compound, pose_to_quaternion
from registration import Scan
from whereabouts.logs.bags.encode import header, xyz
from whereabouts.messages.type_names import EVIDENCE
from whereabouts.nodes.loop_closure_node import LoopClosureNode
from whereabouts.nodes.messages.conversions import array_of, spatial
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.world_model_node import WorldModelNode
from whereabouts.simulation.home.apartment_bag import START, TARGETS
from whereabouts.simulation.home.apartment_day import LASER_MOUNT, THINGS, ApartmentDay
from whereabouts.simulation.home.floor_plan import CAMERA_HEIGHT
from whereabouts.simulation.walkers import positions
from whereabouts.simulation.world_bag import SuiteMessages, distribution
from whereabouts_msgs.msg import TargetArray
from whereabouts_msgs.msg import WorldEvidence as EvidenceMessage

RESULT = Path(__file__).with_suffix(".txt")
LOOK_PERIOD = 0.5
ROWS = 24
"""Points of a run at which memory is looked at."""
STAY = 120.0
"""s after which somebody has a new label."""
Feed = Iterator[float]
"""Hands the node one message after the other; yields the seconds since the start."""


def anonymous() -> float:
    """MiB that the process has written. Pages of libraries count as private or shared by who else runs meanwhile."""
    text = Path("/proc/self/smaps_rollup").read_text()
    return int(re.findall(r"^Anonymous:\s+(\d+) kB", text, re.MULTILINE)[0]) / 1024.0


def place(node: SuiteNode, parent: str, child: str, stamp: int, pose: np.ndarray) -> None:
    """Say on tf where a frame is; pose (6,)."""
    position, quaternion = pose_to_quaternion(pose)
    node.transforms.insert(transform_message(parent, child, stamp, (*position, *quaternion)))


def world_model_feed(node: WorldModelNode, looks: int) -> Feed:
    """Evidence and people of the apartment, twice a second."""
    day, rng = ApartmentDay(rounds=3), np.random.default_rng(0)
    make = SuiteMessages(EVIDENCE, TARGETS)
    for k in range(looks):
        moment = LOOK_PERIOD * k
        # Round after round, people as they are in the first three.
        time_of_day = moment % day.duration
        stamp = START + moment
        pose, pan = day.drive(time_of_day), day.camera.pan(moment)
        people = positions([person.walker for person in day.people], time_of_day)
        lying = {n: (THINGS[n][0], spot) for n, spot in day.things(time_of_day).items() if spot is not None}
        evidence = day.camera.look(rng, pose + np.array([0.0, 0.0, pan]), day.home.blocks, lying)
        at = round(stamp * NANOSECONDS)
        place(node, "map", "base_link", at, spatial(pose))
        place(node, "base_link", "camera", at, np.array([0.0, 0.0, CAMERA_HEIGHT, 0.0, 0.0, pan]))
        seen = make.serialized(make.evidence(evidence, stamp, "camera"), EVIDENCE)
        node._take_evidence(deserialize_message(seen, EvidenceMessage), at)
        node._take_targets(targets(make, people + rng.normal(0.0, 0.05, people.shape), moment, at), at)
        yield moment


def targets(make: SuiteMessages, people: np.ndarray, moment: float, at: int) -> TargetArray:
    """People (P, 2) as the tracker says them; everybody has a new label every two minutes."""
    told = [
        {
            "label": 1 + number + len(people) * int((moment + 40.0 * number) / STAY),
            "position": xyz([*spot, 0.0]),
            "state_covariance": (0.01 * np.eye(4)).ravel(),
            "weight": 1.0,
            "extent": 0.05 * np.eye(2).ravel(),
            "measurement_rate": 5.0,
            "class_distribution": distribution({"person": 1.0}),
            "last_seen": header(at, "")["stamp"],
        }
        for number, spot in enumerate(people)
    ]
    message = make.make(TARGETS, header=header(at, "map"), targets=told, expected_count=float(len(told)))
    return deserialize_message(make.serialized(message, TARGETS), TargetArray)


def loop_closure_feed(node: LoopClosureNode, hours: float) -> Feed:
    """Scans of the apartment's three rounds, again and again with new noise, by an odometry that drifts."""
    rng = np.random.default_rng(0)
    lap = [(m.pose, m.scan) for m in ApartmentDay(rounds=3).moments() if m.scan is not None][::8]
    odometry, before = np.zeros(3), lap[0][0]
    for k in range(int(3600.0 * hours)):
        pose, scan = lap[k % len(lap)]
        step = between(before, pose)
        noise = np.array([0.01, 0.01, 0.002]) * np.hypot(*step[:2]) + np.array([5e-4, 5e-4, 3e-4])
        odometry, before = compound(odometry, step + noise * rng.normal(size=3)), pose
        at = round((START + k) * NANOSECONDS)
        place(node, "odom", "base_link", at, spatial(odometry))
        place(node, "base_link", "laser", at, spatial(LASER_MOUNT))
        ranges = scan.ranges + rng.normal(0.0, 0.005, len(scan))
        node._take_view(scan_message(replace(scan, ranges=ranges), at), at)
        if k % 2:
            node._publisher.send()
        yield float(k)


def scan_message(scan: Scan, at: int) -> LaserScan:
    message = LaserScan()
    message.header.stamp, message.header.frame_id = time_message(at), "laser"
    message.angle_min, message.angle_increment = scan.angle_min, scan.angle_increment
    message.angle_max = scan.angle_min + scan.angle_increment * (len(scan) - 1)
    message.range_min, message.range_max = scan.range_min, min(scan.range_max, 1e9)
    message.ranges = array_of("f", scan.ranges.astype(np.float32))
    return message


def measure(name: str, feed: Feed, seconds: float, figures: SimpleNamespace, blame: bool) -> list[str]:
    """Rows of the table; the slope is in the last."""
    rows = [f"{name}: hours, anonymous MiB, processor s; {figures.names}"]
    hours: list[float] = []
    memory: list[float] = []
    before = None
    for moment in feed:
        if moment < seconds * len(hours) / ROWS:
            continue
        gc.collect()
        hours.append(moment / 3600.0)
        memory.append(anonymous())
        rows.append(f"{hours[-1]:6.2f} {memory[-1]:8.1f} {time.process_time():8.0f}  {figures.now()}")
        print(rows[-1], flush=True)
        if blame and before is None and len(hours) > ROWS // 2:
            tracemalloc.start(5)
            before = tracemalloc.take_snapshot()
    half = len(hours) // 2
    slope = float(theilslopes(memory[half:], hours[half:])[0])
    rows.append(f"{name}: {slope:.2f} MiB per hour over the second half of {hours[-1]:.2f} h")
    if before is not None:
        for item in tracemalloc.take_snapshot().compare_to(before, "traceback")[:12]:
            print(f"{item.size_diff / 1024.0:.0f} KiB, {item.count_diff}", *item.traceback.format(), sep="\n")
    return rows


def world_model(options: argparse.Namespace) -> list[str]:
    node = WorldModelNode()
    start(node)

    def now() -> str:
        health = node.model.health
        return f"{health['objects']:.0f} {health['anchors']:.0f} {health['leaves']:.0f}"

    figures = SimpleNamespace(names="objects, anchors, leaves", now=now)
    feed = world_model_feed(node, options.looks)
    return measure("world_model", feed, LOOK_PERIOD * options.looks, figures, options.blame)


def loop_closure(options: argparse.Namespace) -> list[str]:
    node = LoopClosureNode()
    start(node)

    def now() -> str:
        slam = node._map.slam
        return f"{len(slam.keyframes)} {len(slam.graph.edges)} {len(slam.closures)}"

    figures = SimpleNamespace(names="keyframes, edges, closures", now=now)
    feed = loop_closure_feed(node, options.hours)
    return measure("loop_closure", feed, 3600.0 * options.hours, figures, options.blame)


def start(node: SuiteNode) -> None:
    node.trigger_configure()
    node.trigger_activate()
    if not node.active:
        raise SystemExit(f"{node.get_name()} did not become active")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    runs = {"world_model": world_model, "loop_closure": loop_closure}
    parser.add_argument("nodes", nargs="*", help="both without")
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("--looks", type=int, default=12_000)
    parser.add_argument("--blame", action="store_true")
    options = parser.parse_args()
    for name in options.nodes or runs:
        rclpy.init(args=["--ros-args", "--log-level", "error"])
        rows = runs[name](options)
        rclpy.shutdown()
        print(rows[-1], flush=True)
        with RESULT.open("a", encoding="utf-8") as file:
            file.write("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()

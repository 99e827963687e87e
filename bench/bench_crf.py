"""Times of the joint CRF on one core against beams and movers, and how long until it is ready.

Run: PYTHONPATH=. python bench/bench_crf.py. The last results are in bench_crf.txt.
"""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from evaluation.scenes.labelled_pairs import labelled
from evaluation.scenes.scan_pairs import free_pose
from registration.crf import JointModel
from registration.crf.online import ScanSegmenter
from whereabouts.simulation import Lidar, random_room
from whereabouts.simulation.movers import crowd, outlines
from whereabouts.simulation.shapes import joined

READY = """
import time
begun = time.perf_counter()
from registration.crf.online import ScanSegmenter
from registration.registration_warm_up import warm_up_segmenter
warm_up_segmenter(ScanSegmenter())
print(time.perf_counter() - begun)
"""


def pairs_of(beams: int, movers: int, count: int) -> list:
    """Pairs of scans half a second apart in furnished rooms with that many movers."""
    rng = np.random.default_rng([beams, movers])
    lidar = Lidar(beams, np.deg2rad(270.0))
    pairs = []
    for _ in range(count):
        room = random_room(rng)
        first = free_pose(room, rng, 2.0)
        second = first + np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.1, 0.1)])
        things = crowd(rng, first[:2], movers, (1.0, 3.0)) if movers else []
        pairs.append(labelled(room, things, (first, second), (0.0, 0.5), lidar, rng))
    return pairs


def online(beams: int, movers: int, runs: int) -> list[float]:
    """Seconds that each scan of a robot that follows itself takes, eight a second, each against two earlier ones."""
    rng = np.random.default_rng([beams, movers, 1])
    lidar, segmenter = Lidar(beams, np.deg2rad(270.0)), ScanSegmenter(in_time=False)
    seconds = []
    for _ in range(runs):
        segmenter.reset()
        room = random_room(rng)
        start = free_pose(room, rng, 2.0)
        things = crowd(rng, start[:2], movers, (1.0, 3.0)) if movers else []
        way = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.2, 0.2)])
        for stamp in np.arange(0.0, 4.0, 0.125):
            pose = start + stamp * way
            place = joined([room, outlines(things, stamp - 2.0)]) if things else room
            scan = lidar.scan(place, pose, rng, float(stamp)).scan
            begun = time.process_time()
            segmenter.segment(scan, stamp, pose + rng.normal(0.0, [0.02, 0.02, 0.01]))
            segmenter.keep(scan, stamp, pose)
            # The first second has fewer to compare with.
            if stamp > 1.0:
                seconds.append(time.process_time() - begun)
    return seconds


def main() -> None:
    """A line per number of beams and movers: milliseconds of processor time."""
    model = JointModel.load()
    print("processor time in ms, per pair of new scans; 40 rooms each")
    for beams in (181, 361, 721, 1081):
        for movers in (0, 1, 3, 8):
            pairs = pairs_of(beams, movers, 40)
            # Rare ways through the code are loaded when first taken.
            for pair in pairs:
                model.infer(pair.scan_a, pair.scan_b)
            seconds = []
            for pair in pairs:
                # What is made ready once per scan counts: neither was seen before.
                scan_a, scan_b = replace(pair.scan_a), replace(pair.scan_b)
                begun = time.process_time()
                model.infer(scan_a, scan_b)
                seconds.append(time.process_time() - begun)
            median, high = 1e3 * np.median(seconds), 1e3 * np.percentile(seconds, 99)
            print(f"{beams:5d} beams, {movers} movers: median {median:6.1f}  p99 {high:6.1f}", flush=True)
    print("the same per scan of a robot, against two earlier scans; 8 rooms each", flush=True)
    for beams in (361, 1081):
        for movers in (0, 1, 3, 8):
            online(beams, movers, 2)
            seconds = online(beams, movers, 8)
            median, high = 1e3 * np.median(seconds), 1e3 * np.percentile(seconds, 99)
            print(f"{beams:5d} beams, {movers} movers: median {median:6.1f}  p99 {high:6.1f}", flush=True)
    for kind in ("first", "second"):
        ready = subprocess.run([sys.executable, "-c", READY], capture_output=True, text=True, check=True)
        print(f"ready to label, {kind} start of a process: {float(ready.stdout):.2f} s", flush=True)


if __name__ == "__main__":
    main()

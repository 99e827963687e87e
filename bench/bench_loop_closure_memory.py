"""A long day in a place that is known: memory, keyframes, edges and milliseconds of `Slam`, thinned and not.

    python bench/bench_loop_closure_memory.py [--hours 1] [--keep-all] [--blame]   # appends to the .txt beside it

The robot of the demo goes on driving through its apartment, followed as `scan_registration` does, and the occupancy
grid kept up to date as the node does; no DDS, no nodes. Growth is the slope of the process's anonymous memory over the
second half of the run. --blame says which lines hold what came in the second half.
"""

from __future__ import annotations

import argparse
import gc
import math
import re
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import theilslopes

from estimation.geometry.poses import between, compound, inverse
from estimation.metrics.statistics import absolute_trajectory_error
from loop_closure.loop_closure_warm_up import warm_up
from loop_closure.maps.map_grid import MapGrid
from loop_closure.slam.trajectory import Slam
from registration import Scan
from whereabouts.logs import OdometryRecord, ScanRecord
from whereabouts.recorded.follow import Follower
from whereabouts.simulation.home.apartment_day import LASER_MOUNT, ApartmentDay

RESULT = Path(__file__).with_suffix(".txt")
ROUND = 150.0  # s that a round through the apartment takes at least
EVERY = 16  # scans between maps: two seconds
ROWS = 8  # printed lines per hour
Array = NDArray[np.float64]


def anonymous() -> float:
    """MiB that the process has written. Pages of libraries count as private or shared by who else runs meanwhile."""
    text = Path("/proc/self/smaps_rollup").read_text()
    return int(re.findall(r"^Anonymous:\s+(\d+) kB", text, re.MULTILINE)[0]) / 1024.0


def day(hours: float) -> Iterator[tuple[Scan, Array, Array, Array]]:
    """Scans with the sensor's pose by odometry, its covariance, and the true pose."""
    seconds = 3600.0 * hours
    follower = Follower()
    for moment in ApartmentDay(rounds=max(3, math.ceil(seconds / ROUND))).moments(seconds):
        follower.add_wheels(OdometryRecord(moment.wheels, moment.time))
        if moment.scan is None:
            continue
        record = ScanRecord(moment.scan, moment.time, sensor_pose=LASER_MOUNT)
        found = follower.add_scan(record)
        pose = compound(compound(inverse(LASER_MOUNT), found.pose), LASER_MOUNT)
        yield moment.scan, pose, found.covariance, compound(moment.pose, LASER_MOUNT)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--keep-all", action="store_true", help="as it is without thinning")
    parser.add_argument("--blame", action="store_true")
    options = parser.parse_args()
    warm_up()
    slam, grid = Slam(thin=not options.keep_all), MapGrid()
    hours: list[float] = []
    memory: list[float] = []
    spent: list[float] = []
    truth: dict[float, Array] = {}
    start: float | None = None
    before = None
    rows = [
        f"{'thinned' if not options.keep_all else 'all kept'}: hour, keyframes, edges, anonymous MiB, "
        "p99 and slowest ms per scan since the row before"
    ]
    for count, (scan, pose, covariance, true) in enumerate(day(options.hours)):
        start = scan.stamp if start is None else start
        begun = time.perf_counter()
        slam.process(scan, pose, covariance)
        if count % EVERY == 0:
            grid.update(slam)
        spent.append(1e3 * (time.perf_counter() - begun))
        truth[scan.stamp] = true
        hour = (scan.stamp - start) / 3600.0
        if count % 160 == 159:
            hours.append(hour)
            memory.append(anonymous())
        if options.blame and before is None and hour > 0.5 * options.hours:
            gc.collect()
            tracemalloc.start()
            before = tracemalloc.take_snapshot()
        if hour * ROWS >= len(rows):
            tail = f"{np.quantile(spent, 0.99):6.0f} {max(spent):6.0f}"
            rows.append(
                f"{hour:5.2f} {len(slam.keyframes):6d} {len(slam.graph.edges):6d} {anonymous():7.0f} {tail}"
            )
            spent.clear()
            print(rows[-1], flush=True)
    half = len(hours) // 2
    slope = float(theilslopes(memory[half:], hours[half:])[0])
    placed = slam.trajectory()
    expected = np.array([between(next(iter(truth.values())), truth[stamp]) for stamp in placed[:, 0]])
    error = absolute_trajectory_error(placed[:, 1:3], expected[:, :2]).rmse
    made = slam.keyframes[len(slam.keyframes) - 1].number + 1
    rows.append(
        f"{hours[-1]:.2f} h: {slope:.1f} MiB per hour over the second half; {len(slam.keyframes)} keyframes left of "
        f"{made}; trajectory error {error:.3f} m"
    )
    print(rows[-1])
    if before is not None:
        for item in tracemalloc.take_snapshot().compare_to(before, "lineno")[:15]:
            print(item)
    with RESULT.open("a") as file:
        file.write("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()

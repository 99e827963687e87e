"""What closing loops and drawing the map cost each scan: at a pace, and everything at once.

    python bench/bench_loop_closure_pace.py LOG.. > bench/bench_loop_closure_pace.txt

Logs are CARMEN logs, or `killian`. As the node does it: keyframes are taken out on the way, and the grid is drawn after
each keyframe; at once it is brought up to date every 80 scans, two seconds at 40 Hz. Odometry is worked out before.
At a pace scans come at 40 Hz and smoothing has a process of its own, as in the node. Behind: keyframes that still are
to be worked on. Times are those of a clock: nothing else may run on the machine.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from estimation.metrics.statistics import absolute_trajectory_error
from evaluation.killian import graph_file
from evaluation.slam.slam_following import followed
from evaluation.slam.slam_judging import Followed
from loop_closure.graph.smoother_process import SmootherProcess
from loop_closure.loop_closure_warm_up import warm_up, warm_up_recognition
from loop_closure.maps.map_grid import MapGrid
from loop_closure.slam.trajectory import Slam
from whereabouts.nodes.mapping.map_in_use import DRAWN, PACE

# Made before there are threads.
ASIDE = SmootherProcess()
PERIOD = 0.025  # s between scans at a pace
EVERY = 80  # scans between maps that are drawn at once


def drive(log: Followed, pace: float | None, scans: int | None) -> str:
    """A row: processor ms per scan, and what came of it."""
    aside = None if pace is None else ASIDE
    slam, grid = Slam(thin=True, every_scan=True, pace=pace, aside=aside), MapGrid()
    spent, behind, made = [], [], 0
    for number, record in enumerate(log.records[:scans]):
        begun = time.perf_counter()
        update = slam.process(record.scan, log.poses[number], log.covariances[number])
        if pace is not None and (update.keyframe is not None or grid.behind):
            grid.update(slam, DRAWN)
        elif pace is None and number % EVERY == EVERY - 1:
            grid.update(slam)
        taken = time.perf_counter() - begun
        spent.append(1e3 * taken)
        if pace is not None:
            time.sleep(max(0.0, PERIOD - taken))
        behind.append(update.behind)
        made += len(update.closures)
    estimate = slam.trajectory()[:, 1:3]
    truth = log.truth[: len(estimate), :2]
    known = np.isfinite(truth[:, 0])
    error = absolute_trajectory_error(estimate[known], truth[known]).rmse
    name = "at once" if pace is None else f"{pace:g} ms"
    p50, p99 = np.quantile(spent, [0.5, 0.99])
    return (
        f"  {name:10s} {p50:7.2f} {p99:7.1f} {max(spent):7.0f} {np.mean(behind):8.1f} {max(behind):5d} {made:6d} "
        f"{len(slam.closures):6d} {error:8.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="+")
    parser.add_argument(
        "--scans", type=int, default=None, help="of each log, from its beginning; all by default"
    )
    options = parser.parse_args()
    warm_up()
    warm_up_recognition()
    print("pace            p50     p99 slowest   behind  most   made   left    ATE m")
    for given in options.logs:
        path = graph_file() if given == "killian" else Path(given)
        wheels = given == "killian" or path.name.endswith(".clf.bz2")
        truth = {"intel.clf.bz2": "intel", "fr079.clf.bz2": "freiburg-079"}.get(path.name)
        reference = None if truth is None else path.with_name(f"{truth}-corrected.log.gz")
        log = followed(path, reference, wheels)
        print(f"{path.name}, {len(log.records[: options.scans])} scans", flush=True)
        for pace in (PACE, None):
            print(drive(log, pace, options.scans), flush=True)


if __name__ == "__main__":
    main()

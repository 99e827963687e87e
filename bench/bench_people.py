"""Time per scan of the people tracker: `python bench/bench_people.py`; last result in bench_people.txt."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from evaluation.scenes.people_scenes import crowded_room
from tracking import PeopleTracker
from tracking.people.people_warm_up import warm_up
from whereabouts.simulation import Lidar


def main() -> None:
    """Rooms with more and more people, scanners of so many beams all around at 10 Hz; processor time on one core."""
    warm_up()
    print("beams  people  candidates  mean ms  p99 ms")
    for beams, count in ((720, 1), (720, 4), (720, 8), (720, 12), (361, 12)):
        took, candidates = [], []
        lidar = Lidar(beams, 2.0 * np.pi * (beams - 1) / beams, range_max=12.0, sigma=0.01)
        for seed in range(3):
            rng = np.random.default_rng([count, seed])
            tracker = PeopleTracker()
            room = replace(crowded_room(rng, count, moving=seed > 0, duration=15.0), lidar=lidar)
            for scan in room.scans(rng):
                begun = time.process_time()
                tracker.step(scan.scan, scan.pose, scan.scan.stamp)
                took.append(time.process_time() - begun)
                candidates.append(tracker.health.potential)
        mean, most = 1e3 * np.mean(took), 1e3 * np.percentile(took, 99)
        print(f"{beams:5d}  {count:6d}  {np.mean(candidates):10.1f}  {mean:7.2f}  {most:6.2f}")


if __name__ == "__main__":
    main()

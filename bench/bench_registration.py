"""Times of registration and odometry on one core, as ratios to one fixed piece of work in the same run.

Run: PYTHONPATH=. python bench/bench_registration.py. The last results are in bench_registration.txt.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from evaluation.datasets import recording
from evaluation.experiments.odometry import follow, simulated_floor
from evaluation.scenes.scan_pairs import CROWDED, EASY, HARD, random_pair
from registration import Odometry, align, align_globally
from whereabouts.logs import open_log
from whereabouts.simulation import Lidar


def reference() -> float:
    """Seconds of a fixed piece of numpy work, the unit of all ratios: least of 20."""
    values = np.random.default_rng(0).standard_normal((300, 300))
    return min(timed(lambda: np.linalg.eigvalsh(values @ values.T)) for _ in range(20))


def timed(call: Callable[[], object]) -> float:
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def line(name: str, seconds: float, unit: float, extra: str = "") -> None:
    print(f"{name:48s} {1e3 * seconds:9.3f} ms {seconds / unit:9.3f} x  {extra}", flush=True)


def pairwise(unit: float) -> None:
    for lidar, label in (
        (Lidar(361, 2.0 * np.pi * 360 / 361), "361"),
        (Lidar(1081, np.deg2rad(270.0)), "1081"),
    ):
        for kind, difficulty in (("easy", EASY), ("hard", HARD), ("movers", CROWDED)):
            rng = np.random.default_rng(0)
            pairs = [random_pair(rng, lidar, difficulty) for _ in range(100)]
            align(pairs[0].source.scan, pairs[0].target.scan)
            best = [
                min(timed(lambda p=pair: align(p.source.scan, p.target.scan)) for _ in range(3))
                for pair in pairs
            ]
            line(f"align, {label} beams, {kind}: median of pairs", float(np.median(best)), unit)
        pair = random_pair(np.random.default_rng(1), lidar, EASY)
        seconds = min(timed(lambda p=pair: align_globally(p.source.scan, p.target.scan)) for _ in range(5))
        line(f"align_globally, {label} beams", seconds, unit)


def odometry(unit: float) -> None:
    for beams in (180, 361):
        records, _ = simulated_floor(0, 3, Lidar(beams))
        follow(records[:20], True)
        seconds = float(np.mean(follow(records, True).seconds))
        line(
            f"odometry, {beams} beams, simulated: mean per scan",
            seconds,
            unit,
            f"{1.0 / seconds:.0f} scans/s",
        )
    for name in ("intel.clf.bz2", "fr079.clf.bz2"):
        path = recording(f"carmen/{name}")
        if path is None:
            print(f"{name} is absent")
            continue
        with open_log(path) as log:
            records = list(log.scans())
        seconds = float(np.mean(follow(records, True).seconds))
        line(f"odometry, {name}: mean per scan", seconds, unit, f"{1.0 / seconds:.0f} scans/s")


def clouds(unit: float) -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(-40.0, 40.0, (120_000, 3))
    base[:50_000, 2] = -1.5
    base[50_000:70_000, 0], base[70_000:90_000, 0] = 40.0, -40.0
    base[90_000:105_000, 1], base[105_000:, 1] = 40.0, -40.0
    base[50_000:, 2] *= 0.1
    tracker = Odometry()
    seconds = [timed(lambda k=k: tracker.register(base - [0.3 * k, 0.0, 0.0], 0.1 * k)) for k in range(12)]
    line("odometry, cloud of 120,000 points: median", float(np.median(seconds[2:])), unit)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "").parse_args()
    unit = reference()
    print(f"unit: eigenvalues of a 300 x 300 matrix, {1e3 * unit:.3f} ms")
    pairwise(unit)
    odometry(unit)
    clouds(unit)

"""What becomes of closed loops when a log is shaken: noise, scans dropped and doubled, stamps that are off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound
from estimation.metrics.statistics import absolute_trajectory_error
from evaluation.experiments.odometry import CORRECTED, noisy
from evaluation.report import Report, RunOptions
from evaluation.slam import slam_places
from evaluation.slam.slam_following import followed_records, mapped
from evaluation.slam.slam_judging import (
    Followed,
    closures_of,
    false_closures,
    keyframe_truth,
    largest_miss,
    misses,
    recall,
    revisits_among,
)
from loop_closure.graph.pose_graph import SmoothedGraph
from whereabouts.logs import ScanRecord, open_log
from whereabouts.system.progress import track

Array = NDArray[np.float64]
Records = list[ScanRecord]
SHARE = 0.1  # of the scans that are dropped or doubled
STAMPS = 0.005  # seconds


def dropped(records: Records, rng: np.random.Generator) -> Records:
    """Without a tenth of the scans."""
    return [record for record in records if rng.random() >= SHARE]


def doubled(records: Records, rng: np.random.Generator) -> Records:
    """A tenth of the scans come twice."""
    return [record for record in records for _ in range(1 + (rng.random() < SHARE))]


def shaken_stamps(records: Records, rng: np.random.Generator) -> Records:
    """Stamps off by up to 5 ms."""
    made = []
    for record in records:
        stamp = record.stamp + rng.uniform(-STAMPS, STAMPS)
        made.append(replace(record, stamp=stamp, scan=replace(record.scan, stamp=stamp)))
    return made


def noisy_odometry(log: Followed, sigma: float, rng: np.random.Generator) -> Followed:
    """Every step of the odometry off by `sigma` metres in x and in y; its covariance does not say so."""
    poses = [log.poses[0]]
    for k in range(1, len(log.poses)):
        step = between(log.poses[k - 1], log.poses[k]) + np.array([*rng.normal(0.0, sigma, 2), 0.0])
        poses.append(compound(poses[-1], step))
    return replace(log, poses=np.array(poses))


CASES: dict[str, tuple[Callable[[Records, np.random.Generator], Records], float]] = {
    "noise of 1 mm on ranges and odometry": (lambda records, rng: noisy(records, rng, 0.001), 0.001),
    "noise of 1 cm on ranges and odometry": (lambda records, rng: noisy(records, rng, 0.01), 0.01),
    "a tenth of the scans dropped": (dropped, 0.0),
    "a tenth of the scans doubled": (doubled, 0.0),
    "stamps shaken by 5 ms": (shaken_stamps, 0.0),
}


def shaken(options: RunOptions, report: Report) -> None:
    """The table: one run of every case for each seed."""
    assert options.data is not None
    rows: list[list[object]] = []
    samples: dict[str, int] = {}
    worst, false_in_all, closures = 0.0, 0, 0
    for number, name in enumerate(CORRECTED[: 1 if options.quick else None]):
        with open_log(options.data / "carmen" / name) as log:
            records = list(log.scans())
        samples[name] = len(records)
        for k, (case, (change, sigma)) in enumerate(track(CASES.items(), f"shaken {name}")):
            rng = np.random.default_rng([options.seed, 2, number, k])
            followed = followed_records(change(records, rng), None, False)
            if sigma > 0.0:
                followed = noisy_odometry(followed, sigma, rng)
            with slam_places.without(slam_places.BUILDINGS[name], options):
                slam, estimate, _ = mapped(followed, SmoothedGraph())
            missed = misses(followed, closures_of(slam))
            false, miss = len(false_closures(missed)), largest_miss(missed)
            revisits = revisits_among(slam.keyframes.paths, keyframe_truth(slam, followed))
            share = recall({closure.later for closure in slam.closures}, revisits)
            error = absolute_trajectory_error(estimate[:, :2], followed.truth[:, :2]).rmse
            rows.append([name, case, false, miss, len(slam.closures), share, float(error)])
            worst, false_in_all = max(worst, miss), false_in_all + false
            closures += len(slam.closures)
    rows.append(["all", "the worst and the sum", false_in_all, worst, closures, "", ""])
    samples["all"] = sum(samples.values())
    note = (
        "False: more than 0.5 m or 10° off a mapper's poses. Over the seeds the greatest number is the "
        "worst run. No wheels: noise on odometry is put on every step, and its covariance does not say so."
        " The place model was trained without the building; parameters that are set by hand were chosen with the"
        " unshaken logs in view."
    )
    columns = [
        "log",
        "shaken by",
        "false closures ↓",
        "largest miss, m ↓",
        "closures",
        "revisits closed, % ↑",
        "ATE, m ↓",
    ]
    report.add(
        "Closures on shaken logs", columns, rows, note, "shaken", data="model left out", samples=samples
    )

"""Odometry on recorded logs: absolute and relative error, with wheels and without, beside wheels and KISS-ICP.

Ground truth of the raw logs are the corrected poses of a mapper, joined by readings. Logs without odometry of their
own (scans of corrected logs) are followed without wheels. Errors are without loop closure. Simulated floors say
whether the published covariances are right.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.metrics import absolute_trajectory_error, anees_bounds
from estimation.poses import between, compound, wrap_angle
from evaluation.report import Options, Report, Table
from registration import Odometry, OdometryConfig
from whereabouts.logs import ScanRecord, open_log
from whereabouts.progress import track
from whereabouts.simulation import Drive, Lidar, Wheels, random_floor

Array = NDArray[np.float64]
RAW = {"intel.clf.bz2": "intel-corrected.log.gz", "fr079.clf.bz2": "freiburg-079-corrected.log.gz"}
CORRECTED = (
    "freiburg-101-corrected.log.gz",
    "belgioioso-corrected.log.gz",
    "infinite-corridor-corrected.log.gz",
)
NOISY = 4  # repetitions of the endless corridor with 1 cm of noise
LENGTH = 20.0  # metres over which relative errors are taken


@dataclass
class Run:
    """Poses (N, 3), seconds per scan, how many scans were unsure."""

    poses: Array
    seconds: Array
    unsure: int


def run(options: Options) -> Report:
    """All tables; recordings are left out, and said so, where they are absent."""
    report = Report("odometry")
    if options.data is None or not (options.data / "carmen").exists():
        report.notes.append("the CARMEN recordings are absent")
    else:
        _recorded(options, options.data / "carmen", report)
    _simulated(options, report)
    return report


def follow(records: list[ScanRecord], wheels: bool, config: OdometryConfig | None = None) -> Run:
    """Odometry over scans, with the motion of the wheels as guess or without."""
    odometry = Odometry(config)
    poses, seconds, unsure = [], [], 0
    last: Array | None = None
    for record in records:
        guess = None
        if wheels and record.odometry is not None:
            guess = np.zeros(3) if last is None else between(last, record.odometry)
            last = record.odometry
        begun = time.perf_counter()
        poses.append(odometry.register(record.scan, record.stamp, guess))
        seconds.append(time.perf_counter() - begun)
        unsure += odometry.unsure
    return Run(np.array(poses), np.array(seconds), unsure)


def noisy(records: list[ScanRecord], seed: int, sigma: float = 0.01) -> list[ScanRecord]:
    """The same scans with noise of `sigma` m added to their ranges."""
    rng = np.random.default_rng(seed)
    return [
        replace(r, scan=replace(r.scan, ranges=r.scan.ranges + rng.normal(0.0, sigma, len(r.scan))))
        for r in records
    ]


def joined(raw: list[ScanRecord], corrected: list[ScanRecord]) -> NDArray[np.int64]:
    """Index of the raw scan each corrected scan is, (M,): same readings, same order; -1 where there is none."""
    index = np.full(len(corrected), -1, dtype=np.int64)
    at = 0
    for k, record in enumerate(corrected):
        for candidate in range(at, min(at + 600, len(raw))):
            # Corrected logs are rounded to the centimetre.
            if np.abs(raw[candidate].scan.ranges - record.scan.ranges).max() < 0.011:
                index[k], at = candidate, candidate + 1
                break
    return index


def relative_errors(estimate: Array, truth: Array, length: float = LENGTH) -> tuple[float, float]:
    """Median error over `length` metres of path: share of the length, radians per metre."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))))
    away, turn = [], []
    for k in range(0, len(truth), 3):
        end = int(np.searchsorted(along, along[k] + length))
        if end >= len(truth):
            break
        error = between(between(truth[k], truth[end]), between(estimate[k], estimate[end]))
        away.append(np.hypot(error[0], error[1]) / length)
        turn.append(abs(error[2]) / length)
    return (float(np.median(away)), float(np.median(turn))) if away else (float("nan"), float("nan"))


def _records(path: Path) -> list[ScanRecord]:
    with open_log(path) as log:
        return list(log.scans())


def _recorded(options: Options, folder: Path, report: Report) -> None:
    rows: list[list[object]] = []
    for name, truth_name in track(RAW.items(), "raw logs"):
        raw, corrected = _records(folder / name), _records(folder / truth_name)
        index = joined(raw, corrected)
        known = index >= 0
        truth = np.array([record.pose for record in corrected])[known]
        odometry = np.array([record.odometry for record in raw])
        runs = {
            "ours, wheels": follow(raw, True),
            "ours, no wheels": follow(raw, False),
            "wheels alone": Run(odometry, np.full(len(raw), np.nan), 0),
        }
        if not options.quick:
            config = OdometryConfig(scan_method="kiss_icp")
            runs["KISS-ICP, wheels"] = follow(raw, True, config)
            runs["KISS-ICP, no wheels"] = follow(raw, False, config)
        for method, outcome in runs.items():
            rows.append(_row(report, name, method, outcome, outcome.poses[index[known]], truth))
    for name in track(CORRECTED, "corrected logs"):
        records = _records(folder / name)
        truth = np.array([record.pose for record in records])
        outcome = follow(records, False)
        rows.append(_row(report, name, "ours, no wheels", outcome, outcome.poses, truth))
    if not options.quick:
        # One run says little where a single wrong turn decides: `records` and `truth` are those of the corridor.
        for seed in range(NOISY):
            outcome = follow(noisy(records, seed), False)
            rows.append(_row(report, name, f"the same, noise {seed + 1}", outcome, outcome.poses, truth))
    columns = ["log", "method", "ATE m", "20 m error %", "°/m", "unsure scans", "scans/s"]
    note = "corrected logs hold one scan per metre and no odometry; an endless corridor then leaves the motion open"
    report.tables.append(Table("Recorded logs, no loop closure", columns, rows, note))


def _row(report: Report, log: str, method: str, outcome: Run, estimate: Array, truth: Array) -> list[object]:
    absolute = absolute_trajectory_error(estimate[:, :2], truth[:, :2]).rmse
    share, turn = relative_errors(estimate, truth)
    speed = 1.0 / float(np.median(outcome.seconds[1:])) if len(outcome.seconds) > 1 else float("nan")
    for what, number in (("ate_m", absolute), ("relative_percent", 100.0 * share), ("scans_per_s", speed)):
        report.figures[f"{log} {method} {what}"] = float(number)
    return [
        log,
        method,
        round(absolute, 3),
        round(100.0 * share, 2),
        round(float(np.rad2deg(turn)), 3),
        outcome.unsure,
        round(speed) if np.isfinite(speed) else "",
    ]


def simulated_floor(seed: int, rooms: int, lidar: Lidar) -> tuple[list[ScanRecord], Array]:
    """A round through a simulated floor at 5 scans a second: scans with wheel odometry, and the true poses."""
    rng = np.random.default_rng(seed)
    shapes, waypoints = random_floor(rng, rooms)
    drive, wheels = Drive(waypoints, speed=0.5, turn_rate=0.8), Wheels()
    records: list[ScanRecord] = []
    truth: list[Array] = []
    reported = np.zeros(3)
    for stamp in np.arange(0.0, drive.duration, 0.2):
        seen = lidar.scan(shapes, drive(stamp), rng, float(stamp))
        if truth:
            step = wheels.motion(truth[-1], seen.pose, rng)
            reported = compound(reported, step)
        records.append(ScanRecord(seen.scan, float(stamp), odometry=reported))
        truth.append(seen.pose)
    return records, np.array(truth)


def _simulated(options: Options, report: Report) -> None:
    """Errors and NEES of increments and of the pose along simulated floors."""
    floors = 3 if options.quick else 12
    rows: list[list[object]] = []
    for label, lidar in {"180 beams": Lidar(180), "361 beams": Lidar(361)}.items():
        steps: list[float] = []
        poses: list[float] = []
        absolute = []
        for floor in track(range(floors), f"floors, {label}"):
            records, truth = simulated_floor(options.seed + floor, 3, lidar)
            odometry = Odometry()
            estimate = []
            for k, record in enumerate(records):
                before = records[k - 1].odometry if k else None
                guess = (
                    between(before, record.odometry)
                    if before is not None and record.odometry is not None
                    else None
                )
                estimate.append(odometry.register(record.scan, record.stamp, guess))
                if k:
                    error = odometry.increment - between(truth[k - 1], truth[k])
                    error[2] = wrap_angle(error[2])
                    steps.append(float(error @ np.linalg.solve(odometry.increment_covariance, error)))
                if k and k % 50 == 0:
                    error = odometry.pose - between(truth[0], truth[k])
                    error[2] = wrap_angle(error[2])
                    poses.append(float(error @ np.linalg.solve(odometry.covariance, error)))
            absolute.append(absolute_trajectory_error(np.array(estimate)[:, :2], truth[:, :2]).rmse)
        low, high = (bound / 3.0 for bound in anees_bounds(len(steps), 3))
        numbers = [float(np.mean(absolute)), float(np.mean(steps)) / 3.0, float(np.mean(poses)) / 3.0]
        rows.append([label, floors, *(round(number, 3) for number in numbers), round(low, 3), round(high, 3)])
        for what, number in zip(("ate_m", "nees_increment", "nees_pose"), numbers, strict=True):
            report.figures[f"floors {label} {what}"] = number
    columns = ["scanner", "floors", "ATE m", "NEES of increments", "NEES of poses", "95 % from", "to"]
    note = "NEES per dimension; the bounds are for independent increments"
    report.tables.append(Table("Simulated floors", columns, rows, note))

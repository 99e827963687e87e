"""Odometry on recorded logs and simulated floors, beside wheels, a plain scan matcher and KISS-ICP.

Ground truth of the raw logs are the corrected poses of a mapper, joined by readings. Logs without odometry of their
own (scans of corrected logs) are followed without wheels. Errors are without loop closure. intel and fr079 are what
odometry was tuned on, csail and the corrected logs were looked at on the way; the wheels that fail took part in
nothing. Simulated floors say whether the published covariances are right.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound, wrap_angle
from estimation.metrics.statistics import absolute_trajectory_error, anees_bounds
from evaluation.peers.point_to_line import PointToLine
from evaluation.registration.odometry_people import WithoutMovers, drive_among, with_wheels
from evaluation.registration.odometry_wheels import FAULTS, with_faults
from evaluation.report import Part, Report, RunOptions, Table
from evaluation.scenes.people_scenes import peopled_floor
from evaluation.scenes.small_robot import SHORT_RANGE, flat, way
from registration import Odometry, OdometryConfig
from whereabouts.logs import OdometryRecord, ScanRecord, open_log
from whereabouts.recorded.follow import follow as follow_log
from whereabouts.simulation import Drive, Lidar, Shapes, Wheels, random_floor
from whereabouts.system.progress import track

Array = NDArray[np.float64]
RAW = {
    "mit-csail.clf.bz2": "csail-corrected.log.gz",
    "intel.clf.bz2": "intel-corrected.log.gz",
    "fr079.clf.bz2": "freiburg-079-corrected.log.gz",
}
CORRECTED = (
    "freiburg-101-corrected.log.gz",
    "belgioioso-corrected.log.gz",
    "infinite-corridor-corrected.log.gz",
)
# Also where a log was only looked at while something was chosen.
JUDGED = dict.fromkeys((*RAW, *CORRECTED), "tuned on")
NEEDS = tuple(f"carmen/{name}" for name in (*RAW, *RAW.values(), *CORRECTED))
SCANNERS = {
    "floor": SHORT_RANGE,
    "posts": Lidar(720, np.deg2rad(359.5), range_min=0.1, range_max=12.0, posts=0.2),
    "depth camera": Lidar(640, np.deg2rad(57.0), range_min=0.45, range_max=5.0, sigma=0.02),
}
PACES = {"slow": (0.22, 0.8), "fast": (0.7, 1.5)}  # m/s, rad/s
TICK = 0.02  # s between readings of the wheels
LENGTH = 20.0  # metres over which relative errors are taken
COLUMNS = ["ATE, m ↓", "20 m error, % ↓", "turn, °/m ↓", "unsure scans", "speed, scans/s ↑"]


@dataclass
class OdometryRun:
    """Poses (N, 3), seconds per scan, how many scans were unsure."""

    poses: Array
    seconds: Array
    unsure: int


def follow(
    records: list[ScanRecord], wheels: bool, config: OdometryConfig | None = None, by: Any = None
) -> OdometryRun:
    """Odometry over scans, with the motion of the wheels as guess or without; `by` follows in its place."""
    odometry: Any = by or Odometry(config)
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
    return OdometryRun(np.array(poses), np.array(seconds), unsure)


def noisy(records: list[ScanRecord], rng: np.random.Generator, sigma: float) -> list[ScanRecord]:
    """The same scans with noise of `sigma` m added to their ranges."""
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


def relative_errors(estimate: Array, truth: Array) -> tuple[float, float]:
    """Median error over `LENGTH` metres of path: share of the length, radians per metre."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))))
    away, turn = [], []
    for k in range(0, len(truth), 3):
        end = int(np.searchsorted(along, along[k] + LENGTH))
        if end >= len(truth):
            break
        error = between(between(truth[k], truth[end]), between(estimate[k], estimate[end]))
        away.append(np.hypot(error[0], error[1]) / LENGTH)
        turn.append(abs(error[2]) / LENGTH)
    return (float(np.median(away)), float(np.median(turn))) if away else (float("nan"), float("nan"))


def _records(path: Path) -> list[ScanRecord]:
    with open_log(path) as log:
        return list(log.scans())


def _recorded(options: RunOptions, report: Report) -> None:
    assert options.data is not None
    folder = options.data / "carmen"
    rows: list[list[object]] = []
    samples: dict[str, int] = {}
    chosen = {name: RAW[name] for name in list(RAW)[: 1 if options.quick else None]}
    for name, truth_name in track(chosen.items(), "raw logs"):
        raw, corrected = _records(folder / name), _records(folder / truth_name)
        index = joined(raw, corrected)
        known = index >= 0
        truth = np.array([record.pose for record in corrected])[known]
        samples[name] = len(truth)
        for method, outcome in _methods(raw, options.quick):
            rows.append([name, method, *errors(outcome, outcome.poses[index[known]], truth)])
    for name in track(CORRECTED, "corrected logs"):
        records = _records(folder / name)
        truth = np.array([record.pose for record in records])
        samples[name] = len(truth)
        for method, follower in (("ours, no wheels", None), ("point to line, no wheels", PointToLine())):
            outcome = follow(records, False, by=follower)
            rows.append([name, method, *errors(outcome, outcome.poses, truth)])
    note = (
        "ATE: RMS of what is left of the positions after the best rigid motion onto a mapper's poses, as they "
        "are; `experiment slam` says how good these are. 20 m error: median over 20 m of path. Corrected logs hold one "
        "scan per metre and no wheels; an endless corridor then leaves the motion along it open."
    )
    report.add(
        "Recorded logs, no loop closure",
        ["log", "method", *COLUMNS],
        rows,
        note,
        "logs",
        data=JUDGED,
        samples=samples,
    )


def _methods(raw: list[ScanRecord], quick: bool) -> list[tuple[str, OdometryRun]]:
    """Every method's run over a raw log."""
    odometry = np.array([record.odometry for record in raw])
    runs = [
        ("ours, wheels", follow(raw, True)),
        ("ours, no wheels", follow(raw, False)),
        ("point to line, wheels", follow(raw, True, by=PointToLine())),
        ("point to line, no wheels", follow(raw, False, by=PointToLine())),
        ("wheels alone", OdometryRun(odometry, np.full(len(raw), np.nan), 0)),
    ]
    if not quick:
        config = OdometryConfig(scan_method="kiss_icp")
        runs += [
            ("KISS-ICP, wheels", follow(raw, True, config)),
            ("KISS-ICP, no wheels", follow(raw, False, config)),
        ]
    return runs


def errors(outcome: OdometryRun, estimate: Array, truth: Array) -> list[object]:
    """The cells of COLUMNS."""
    absolute = absolute_trajectory_error(estimate[:, :2], truth[:, :2]).rmse
    share, turn = relative_errors(estimate, truth)
    timed = len(outcome.seconds) > 1 and np.isfinite(outcome.seconds[1:]).any()
    speed: object = 1.0 / float(np.median(outcome.seconds[1:])) if timed else ""
    return [float(absolute), 100.0 * share, float(np.rad2deg(turn)), outcome.unsure, speed]


def _noise(options: RunOptions, report: Report) -> None:
    """One run says little where a single wrong turn decides."""
    assert options.data is not None
    name = CORRECTED[-1]
    records = _records(options.data / "carmen" / name)
    truth = np.array([record.pose for record in records])
    rows: list[list[object]] = []
    for k, (label, sigma) in enumerate({"1 mm": 0.001, "1 cm": 0.01}.items()):
        outcome = follow(noisy(records, np.random.default_rng([options.seed, k]), sigma), False)
        rows.append([label, *errors(outcome, outcome.poses, truth)])
    report.add(
        "An endless corridor again, with noise on its ranges",
        ["noise added", *COLUMNS],
        rows,
        f"{name}, without wheels; one run for each seed. The log was looked at when odometry was tuned.",
        "corridor",
        data="tuned on",
        samples=len(records),
    )


def simulated_floor(seed: int | Sequence[int], rooms: int, lidar: Lidar) -> tuple[list[ScanRecord], Array]:
    """A round through a simulated floor at 5 scans a second: scans with wheel odometry, and the true poses."""
    rng = np.random.default_rng(seed)
    shapes, waypoints = random_floor(rng, rooms)
    return drive_through(shapes, Drive(waypoints, speed=0.5, turn_rate=0.8), lidar, rng)


def drive_through(
    shapes: Shapes, drive: Drive, lidar: Lidar, rng: np.random.Generator
) -> tuple[list[ScanRecord], Array]:
    """Scans of a drive, with wheel odometry, and the true poses."""
    stamps = np.arange(0.0, drive.duration, 0.2).tolist()
    scans = (lidar.scan(shapes, drive if lidar.sweep_time else drive(at), rng, at).scan for at in stamps)
    return with_wheels(((scan, drive(scan.stamp)) for scan in scans), rng)


def _small(options: RunOptions, report: Report) -> None:
    """Scanners of ordinary robots: one that sees 3.5 m and turns as slowly as it is asked, and two more."""
    runs = options.share(10, 3)
    found: dict[tuple[str, str], list[list[Any]]] = {}
    for run in track(range(runs), "ordinary scanners"):
        floor, waypoints = random_floor(np.random.default_rng([options.seed, 5, run]), 2)
        drive = Drive(waypoints, speed=0.22, turn_rate=0.8)
        drives = {"flat": (flat(), way(), SHORT_RANGE)}
        drives |= {name: (floor, drive, lidar) for name, lidar in SCANNERS.items()}
        for place, (shapes, path, lidar) in drives.items():
            rng = np.random.default_rng([options.seed, 6, run])
            records, truth = drive_through(shapes, path, lidar, rng)
            for method, outcome in _methods(records, True):
                found.setdefault((place, method), []).append(errors(outcome, outcome.poses, truth))
    note = (
        "5 scans a second, at 0.22 m/s and turning with 46 °/s. Flat: two furnished rooms. The others: rooms along a "
        "corridor 2.2 m wide, much of which shows two bare walls. Flat and floor: 360 beams all round, each swept in "
        "0.2 s, ranges to 3.5 m with 1.5 cm of noise. Posts: 720 beams to 12 m, some of them onto four posts of the "
        "robot itself, 0.2 m away. Depth camera: a line of 640 beams over 57°, to 5 m with 2 cm of noise."
    )
    report.tables.append(
        _compared("Ordinary scanners, simulated", "place", found, note, "short-range", "simulated", runs)
    )


def _swept(options: RunOptions, report: Report) -> None:
    """A scanner of 3.5 m sight that turns five times a second, and wheels that are read 50 times."""
    runs = options.share(10, 3)
    found: dict[tuple[str, str], list[list[Any]]] = {}
    for run in track(range(runs), "sweeps"):
        for pace, (speed, turn_rate) in PACES.items():
            rng = np.random.default_rng([options.seed, 7, run])
            floor, waypoints = random_floor(rng, 2)
            log, truth = swept_log(floor, Drive(waypoints, speed=speed, turn_rate=turn_rate), rng)
            for method, wheels in (("ours, wheels", True), ("ours, no wheels", False)):
                steps = list(follow_log(log, use_wheels=wheels))
                unsure = sum(not step.converged for step in steps)
                poses = np.array([step.pose for step in steps])
                outcome = OdometryRun(poses, np.full(len(steps), np.nan), unsure)
                found.setdefault((pace, method), []).append(errors(outcome, outcome.poses, truth))
    note = (
        "Rooms along a corridor, 360 beams all round, each swept in 0.2 s, ranges to 3.5 m with 1.5 cm of noise. Slow: "
        "0.22 m/s and turning with 46 °/s; fast: 0.7 m/s and 86 °/s. Turns begin and end within sweeps."
    )
    report.tables.append(
        _compared("Sweeps and wheels, simulated", "robot", found, note, "sweeps", "simulated", runs)
    )


def swept_log(
    shapes: Shapes, drive: Drive, rng: np.random.Generator
) -> tuple[list[ScanRecord | OdometryRecord], Array]:
    """Scans as they are complete among readings of the wheels, 50 a second, and the true poses of the scans."""
    wheels = Wheels()
    log: list[ScanRecord | OdometryRecord] = []
    truth: list[Array] = []
    reported, begun = np.zeros(3), 0.0
    for tick in range(int(drive.duration / TICK)):
        stamp = tick * TICK
        reported = compound(reported, wheels.motion(drive(max(stamp - TICK, 0.0)), drive(stamp), rng))
        log.append(OdometryRecord(reported, stamp))
        if tick % 10 == 0 and tick:
            log.append(ScanRecord(SHORT_RANGE.scan(shapes, drive, rng, begun).scan, begun))
            truth.append(drive(begun))
            begun = stamp
    return log, np.array(truth)


def _wheels(options: RunOptions, report: Report) -> None:
    """Wheels that fail beside good ones, on simulated floors of one scanner."""
    floors = options.share(15, 5)
    found: dict[tuple[str, str], list[list[Any]]] = {}
    for floor in track(range(floors), "wheels that fail"):
        records, truth = simulated_floor([options.seed, 1, floor], 3, Lidar(181, np.pi))
        for k, fault in enumerate(FAULTS):
            rng = np.random.default_rng([options.seed, 2, floor, k])
            driven = with_faults(records, fault, rng)
            wheels = np.array([record.odometry for record in driven])
            for method, run in (
                ("ours", follow(driven, True)),
                ("point to line", follow(driven, True, by=PointToLine())),
                ("wheels alone", OdometryRun(wheels, np.full(len(driven), np.nan), 0)),
            ):
                found.setdefault((fault, method), []).append(errors(run, run.poses, truth))
    note = (
        "181 beams over 180°, 5 scans a second at 0.5 m/s. Stall: ten times a floor the wheels stand for 1 s and go on "
        "from there; catch up: they then report all of it in one step; jump: five times a floor by up to 1 m and 60°; "
        "slip: for 2 s at a time they turn twice as far as the robot goes."
    )
    report.tables.append(
        _compared("Wheels that fail, simulated floors", "wheels", found, note, "wheels", "left out", floors)
    )


def _people(options: RunOptions, report: Report) -> None:
    """Among people, some of whom walk where walls leave the way open."""
    runs = options.share(12, 4)
    found: dict[tuple[str, str], list[list[Any]]] = {}
    for run in track(range(runs), "people"):
        for place, standing in (("some stand", 0.4), ("all walk", 0.0)):
            rng = np.random.default_rng([options.seed, 8, run])
            records, truth = drive_among(peopled_floor(rng, standing=standing), rng)
            methods: list[tuple[str, bool, Any]] = [
                ("ours, movers left out, wheels", True, WithoutMovers()),
                ("ours, movers left out, no wheels", False, WithoutMovers()),
                ("ours, wheels", True, None),
                ("ours, no wheels", False, None),
                ("point to line, wheels", True, PointToLine()),
            ]
            for method, wheels, by in methods:
                outcome = follow(records, wheels, by=by)
                found.setdefault((place, method), []).append(errors(outcome, outcome.poses, truth))
    note = (
        "Up to 12 people in rooms along a corridor, 361 beams over 180°, 10 scans a second, a minute at 0.5 m/s. "
        "Movers left out: each scan without what was found to move in the one before, as by the node scan_registration."
    )
    report.tables.append(
        _compared("Among people, simulated", "people", found, note, "people", "left out", runs)
    )


def _compared(
    title: str,
    what: str,
    found: dict[tuple[str, str], list[list[Any]]],
    note: str,
    name: str,
    data: str,
    runs: int,
) -> Table:
    """Means over runs of each (what, method), with the worst of them."""
    rows: list[list[object]] = []
    for (each, method), cells in found.items():
        absolute = [float(cell[0]) for cell in cells]
        rows.append([each, method, float(np.mean(absolute)), max(absolute), *_means(cells)])
    columns = [what, "method", COLUMNS[0], "worst ATE, m ↓", *COLUMNS[1:4]]
    return Table(title, columns, rows, note, name, data=data, samples=runs)


def _means(every: list[list[Any]]) -> list[float]:
    """Mean 20 m error, turn and number of unsure scans."""
    return [float(np.nanmean([each[column] for each in every])) for column in (1, 2, 3)]


def _simulated(options: RunOptions, report: Report) -> None:
    """Errors and NEES of increments and of the pose along simulated floors."""
    floors = options.share(60, 6)
    rows: list[list[object]] = []
    for label, lidar in {"180 beams": Lidar(180), "361 beams": Lidar(361)}.items():
        steps: list[float] = []
        poses: list[float] = []
        absolute = []
        for floor in track(range(floors), f"floors, {label}"):
            records, truth = simulated_floor([options.seed, 0, floor], 3, lidar)
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
        rows.append(
            [
                label,
                float(np.mean(absolute)),
                float(np.mean(steps)) / 3.0,
                float(np.mean(poses)) / 3.0,
                f"{low:.2f} to {high:.2f}",
            ]
        )
    columns = ["scanner", "ATE, m ↓", "NEES of increments", "NEES of poses", "95 % of the time within"]
    note = "NEES per dimension, 1 is right; the bounds are for independent increments."
    report.add("Simulated floors", columns, rows, note, "floors", data="simulated", samples=floors)


PARTS = {
    "logs": Part(_recorded, random=False, needs=NEEDS),
    "noise": Part(_noise, quick_seeds=3, needs=(f"carmen/{CORRECTED[-1]}",)),
    "wheels": Part(_wheels, quick_seeds=3),
    "floors": Part(_simulated),
    "short ranges": Part(_small),
    "sweeps": Part(_swept),
    "people": Part(_people, quick_seeds=1),
}

"""Closed loops on recorded logs: error before and after, false closures, revisits closed, smoother beside filter.

Corrected poses of the CARMEN logs are those of a mapper (no survey); Killian Court is held against its own solved
graph and constraints. A closure is false where it is off the reference by more than 0.5 m or 10 degrees (3 m at Killian
Court, whose solved graph is itself compressed by more than a metre in a featureless corridor). A revisit is a keyframe
within 2 m of one at least 20 m of path earlier, with the same or the opposite heading. The relations metric is that of
Kümmerle et al. (2009), with relations of 1 to 20 m made from the corrected poses; its published figures are for the
ACES log, which is not here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.metrics import absolute_trajectory_error, align_points, relations_error
from estimation.poses import between, compound, inverse, wrap_angle
from loop_closure.esdf import EsdfGraph
from loop_closure.graph import PoseGraph, SmoothedGraph
from loop_closure.slam import Slam
from registration import Odometry
from whereabouts.experiments.odometry import RAW, joined
from whereabouts.experiments.report import Options, Report, Table
from whereabouts.follow import Follower
from whereabouts.logs import OdometryRecord, ScanRecord, open_log
from whereabouts.progress import track
from whereabouts.simulation.outdoor import SpinningLidar, random_neighbourhood, round_trip

Array = NDArray[np.float64]
CORRECTED = (
    "freiburg-101-corrected.log.gz",
    "belgioioso-corrected.log.gz",
    "infinite-corridor-corrected.log.gz",
)
CLOSE = (0.2, 2.0)  # metres between the poses of close relations
PUBLISHED = (
    ["published for ACES: scan matching", "", "", "", "", "", 0.173, 0.614, "", ""],
    ["published for ACES: particle filter", "", "", "", "", "", 0.060, "", "", ""],
    ["published for ACES: graph mapping", "", "", "", "", "", 0.044, 0.044, 0.4, ""],
)


@dataclass
class Followed:
    """A log after odometry. poses (N, 3) of the sensor, covariances (N, 3, 3); truth (N, 3), NaN where unknown."""

    records: list[ScanRecord]
    poses: Array
    covariances: Array
    truth: Array
    seconds: float


def run(options: Options) -> Report:
    """All tables; recordings are left out, and said so, where they are absent."""
    report = Report("slam")
    rows: list[list[object]] = []
    folder = None if options.data is None else options.data / "carmen"
    if folder is None or not folder.exists():
        report.notes.append("the CARMEN recordings are absent")
    else:
        names = list(RAW) if options.quick else [*RAW, *CORRECTED]
        for name in track(names, "logs"):
            log = followed(folder / name, folder / RAW[name] if name in RAW else None, name in RAW)
            kinds: dict[str, PoseGraph] = {"smoothed": SmoothedGraph()}
            if name in RAW and not options.quick:
                kinds["ESDF"] = EsdfGraph()
            for kind, graph in kinds.items():
                rows.append(_row(report, name, kind, log, graph, 0.5))
    if not options.quick:
        _killian(report, rows)
    columns = [
        "log", "back end", "ATE before", "ATE m", "closures (false)", "revisits closed %", "relations m", "± m", "°",
        "within 2 m",
    ]  # fmt: skip
    report.tables.append(Table("Recorded logs", columns, [*rows, *PUBLISHED]))
    if not options.quick:
        _outdoor(options, report)
    return report


def followed(path: Path, truth_path: Path | None, wheels: bool) -> Followed:
    """Odometry of the sensor along a log."""
    begun = time.perf_counter()
    follower = Follower(use_wheels=wheels)
    records, poses, covariances = [], [], []
    with open_log(path) as log:
        for record in log:
            if isinstance(record, OdometryRecord):
                follower.add_wheels(record)
            elif isinstance(record, ScanRecord):
                outcome = follower.add_scan(record)
                mount = np.zeros(3) if record.sensor_pose is None else np.asarray(record.sensor_pose)
                records.append(record)
                poses.append(compound(compound(inverse(mount), outcome.pose), mount))
                covariances.append(outcome.covariance)
    truth = np.full((len(records), 3), np.nan)
    if truth_path is not None:
        with open_log(truth_path) as log:
            corrected = list(log.scans())
        index = joined(records, corrected)
        for number, record in zip(index, corrected, strict=True):
            if number >= 0 and record.pose is not None:
                truth[number] = record.pose
    else:
        for number, record in enumerate(records):
            if record.pose is not None:
                truth[number] = record.pose
    return Followed(records, np.array(poses), np.array(covariances), truth, time.perf_counter() - begun)


def _row(
    report: Report, name: str, kind: str, log: Followed, graph: PoseGraph, tolerance: float
) -> list[object]:
    begun = time.perf_counter()
    slam = Slam(graph=graph)
    for record, pose, covariance in zip(log.records, log.poses, log.covariances, strict=True):
        slam.process(record.scan, pose, covariance)
    estimate = slam.trajectory()[:, 1:]
    elapsed = time.perf_counter() - begun + log.seconds
    known = np.flatnonzero(np.isfinite(log.truth[:, 0]))
    truth = log.truth[known]
    before = absolute_trajectory_error(log.poses[known, :2], truth[:, :2]).rmse
    after = absolute_trajectory_error(estimate[known, :2], truth[:, :2]).rmse
    scaled = with_scale(estimate[known, :2], truth[:, :2])
    places = keyframe_truth(slam, log)
    false = len(false_closures(slam, places, tolerance))
    closed, revisits = recall(slam, places)
    relations = relations_error(*relations_of(estimate[known], truth), tolerance=0.5)
    close = relations_error(*relations_of(estimate[known], truth, *CLOSE), tolerance=0.5)
    share = 100.0 * closed / max(revisits, 1)
    duration = float(np.ptp([record.stamp for record in log.records]))
    figures = {
        "ate_before_m": before, "ate_m": after, "closures": len(slam.closures), "false": false,
        "revisits": revisits, "revisits_closed_percent": share, "relations_m": relations.translation_mean,
        "relations_deg": float(np.degrees(relations.rotation_mean)), "times_real_time": duration / elapsed,
        "close_relations_m": close.translation_mean,
        "jitter_of_the_reference_m": jitter(log.poses[known], truth),
        "reference_is_longer_by": scaled[0] - 1.0, "ate_scaled_m": scaled[1],
    }  # fmt: skip
    for what, value in figures.items():
        report.figures[f"{name} {kind} {what}"] = float(value)
    return [
        name, kind, round(before, 3), round(after, 4), f"{len(slam.closures)} ({false})", round(share, 1),
        round(relations.translation_mean, 4), round(relations.translation_std, 4),
        round(float(np.degrees(relations.rotation_mean)), 2), round(close.translation_mean, 4),
    ]  # fmt: skip


def keyframe_truth(slam: Slam, log: Followed) -> Array:
    """True pose (K, 3) of every keyframe: that of the nearest scan that has one, moved on by odometry."""
    known = np.flatnonzero(np.isfinite(log.truth[:, 0]))
    out = []
    for number in slam.first_visits().values():
        at = int(known[np.argmin(np.abs(known - number))])
        out.append(compound(log.truth[at], between(log.poses[at], log.poses[number])))
    return np.array(out)


def false_closures(slam: Slam, truth: Array, tolerance: float) -> list[int]:
    """Numbers of the closures off the truth by more than `tolerance` metres or 10 degrees."""
    wrong = []
    for number, closure in enumerate(slam.closures):
        miss = between(between(truth[closure.earlier], truth[closure.later]), closure.relative)
        if np.hypot(*miss[:2]) > tolerance or abs(miss[2]) > np.deg2rad(10.0):
            wrong.append(number)
    return wrong


def recall(slam: Slam, truth: Array, near: float = 2.0, apart: float = 20.0) -> tuple[int, int]:
    """How many keyframes that revisit a place have a closure, and how many revisit one."""
    paths = slam.keyframes.paths
    closed = {closure.later for closure in slam.closures}
    done = revisits = 0
    for k in range(len(truth)):
        away = np.hypot(*(truth[:k, :2] - truth[k, :2]).T)
        turned = np.abs(wrap_angle(truth[:k, 2] - truth[k, 2]))
        alike = (turned < np.pi / 4) | (turned > 3 * np.pi / 4)
        if ((away < near) & (paths[:k] < paths[k] - apart) & alike).any():
            revisits += 1
            done += k in closed
    return done, revisits


def with_scale(estimate: Array, truth: Array) -> tuple[float, float]:
    """Scale that brings `estimate` (N, 2) closest to `truth`, and the error in metres that is left with it."""
    T = align_points(estimate, truth)
    moved = (estimate - estimate.mean(axis=0)) @ T[:2, :2].T
    wanted = truth - truth.mean(axis=0)
    scale = float((moved * wanted).sum() / (moved**2).sum())
    return scale, float(np.sqrt(((scale * moved - wanted) ** 2).sum(axis=1).mean()))


def jitter(odometry: Array, truth: Array) -> float:
    """Median difference in metres between steps of the reference and of odometry, from one of its poses to the next.

    Odometry is good to millimetres over so little: what is left is the reference's own.
    """
    steps = np.array(
        [
            between(between(truth[k], truth[k + 1]), between(odometry[k], odometry[k + 1]))
            for k in range(len(truth) - 1)
        ]
    )
    return float(np.median(np.hypot(steps[:, 0], steps[:, 1])))


def relations_of(
    estimate: Array, truth: Array, least: float = 1.0, farthest: float = 20.0, most: int = 4000
) -> tuple[Array, Array]:
    """Trajectory (N, 4) and relations (M, 5) between true poses `least` to `farthest` metres apart.

    Positions in the arrays stand for stamps.
    """
    rng = np.random.default_rng(0)
    stamps = np.arange(len(truth), dtype=np.float64) * 10.0
    # Close pairs are rare among all: more are drawn.
    pairs = rng.integers(0, len(truth), ((20 if farthest > 10.0 else 100) * most, 2))
    away = np.hypot(*(truth[pairs[:, 0], :2] - truth[pairs[:, 1], :2]).T)
    pairs = pairs[(away > least) & (away < farthest)][:most]
    motions = np.array([between(truth[i], truth[j]) for i, j in pairs])
    return np.column_stack((stamps, estimate)), np.column_stack((stamps[pairs], motions))


def _killian(report: Report, rows: list[list[object]]) -> None:
    from whereabouts.killian import DownloadError, graph_file

    try:
        path = graph_file()
    except DownloadError as error:
        report.notes.append(f"Killian Court: {error}")
        return
    rows.append(_row(report, "killian.g2o", "smoothed", followed(path, None, True), SmoothedGraph(), 3.0))


def _outdoor(options: Options, report: Report) -> None:
    """A simulated outdoor round of 200 clouds."""
    rng = np.random.default_rng(options.seed)
    world, poses, lidar = random_neighbourhood(rng), round_trip(), SpinningLidar()
    truth = np.linalg.inv(poses[0]) @ poses
    odometry, slam = Odometry(), Slam()
    before = []
    for number, pose in enumerate(track(poses, "clouds")):
        cloud = lidar.cloud(world, pose, rng)
        before.append(odometry.register(cloud, 0.5 * number))
        slam.process(cloud, before[-1], odometry.covariance, 0.5 * number)
    after = slam.trajectory()
    first = absolute_trajectory_error(np.array(before)[:, :3, 3], truth[:, :3, 3]).rmse
    error = absolute_trajectory_error(after[:, 1:4], truth[:, :3, 3]).rmse
    report.figures |= {"outdoor ate_before_m": first, "outdoor ate_m": error}
    report.tables.append(
        Table(
            "Simulated outdoor round, 200 clouds",
            ["ATE before m", "ATE m", "closures"],
            [[round(first, 3), round(error, 3), len(slam.closures)]],
        )
    )

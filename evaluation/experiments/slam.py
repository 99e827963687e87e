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
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.metrics import absolute_trajectory_error, relations_error
from estimation.poses import compound, inverse
from evaluation.experiments import slam_as_node, slam_in_map
from evaluation.experiments.odometry import RAW, joined
from evaluation.experiments.slam_judging import (
    CLOSE,
    Followed,
    against_scans,
    false_closures,
    jitter,
    keyframe_truth,
    recall,
    recall_with_overlap,
    relations_of,
    with_scale,
    worth,
)
from evaluation.report import Options, Report, Table
from loop_closure.esdf import EsdfGraph
from loop_closure.graph import PoseGraph, SmoothedGraph
from loop_closure.slam import Slam
from registration import Odometry
from whereabouts.follow import Follower
from whereabouts.logs import OdometryRecord, ScanRecord, open_log
from whereabouts.logs.g2o import read_g2o
from whereabouts.progress import track
from whereabouts.simulation.outdoor import SpinningLidar, random_neighbourhood, round_trip

Array = NDArray[np.float64]
CORRECTED = (
    "freiburg-101-corrected.log.gz",
    "belgioioso-corrected.log.gz",
    "infinite-corridor-corrected.log.gz",
)
COLUMNS = [
    "log", "back end", "ATE before", "ATE m", "closures (false)", "revisits closed %", "with overlap %",
    "relations m", "± m", "°", "within 2 m", "× real time",
]  # fmt: skip
BLANK = [""] * 4
PUBLISHED = (
    ["proximity search, correlative matching, gtsam: intel", "", "", 0.076, *BLANK, "", "", "", ""],
    ["the same: fr079", "", "", 0.073, *BLANK, "", "", "", ""],
    ["published for ACES: scan matching", "", "", "", "", "", "", 0.173, 0.614, "", "", ""],
    ["published for ACES: particle filter", "", "", "", "", "", "", 0.060, "", "", "", ""],
    ["published for ACES: graph mapping", "", "", "", "", "", "", 0.044, 0.044, 0.4, "", ""],
)


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
            rows.append(slam_as_node.row(report, name, log, 0.5))
    if not options.quick:
        _killian(report, rows)
    report.tables.append(Table("Recorded logs", COLUMNS, [*rows, *PUBLISHED]))
    if not options.quick:
        _outdoor(options, report)
        slam_in_map.table(report, options.seed)
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
    slam, estimate, elapsed = mapped(log, graph)
    known = np.flatnonzero(np.isfinite(log.truth[:, 0]))
    truth = log.truth[known]
    before = absolute_trajectory_error(log.poses[known, :2], truth[:, :2]).rmse
    after = absolute_trajectory_error(estimate[known, :2], truth[:, :2]).rmse
    scaled = with_scale(estimate[known, :2], truth[:, :2])
    places = keyframe_truth(slam, log)
    false = len(false_closures(slam, places, tolerance))
    (closed, revisits), overlapping = recall(slam, places), recall_with_overlap(slam, places)
    relations = relations_error(*relations_of(estimate[known], truth), tolerance=0.5)
    close = relations_error(*relations_of(estimate[known], truth, *CLOSE), tolerance=0.5)
    direct, odometry = against_scans(slam, places), worth(slam, places)
    shares = 100.0 * closed / max(revisits, 1), 100.0 * overlapping[0] / max(overlapping[1], 1)
    figures = {
        "ate_before_m": before, "ate_m": after, "closures": len(slam.closures), "false": false,
        "revisits": revisits, "revisits_closed_percent": shares[0], "overlapping_closed_percent": shares[1],
        "relations_m": relations.translation_mean, "relations_deg": float(np.degrees(relations.rotation_mean)),
        "close_relations_m": close.translation_mean, "seconds": elapsed,
        "jitter_of_the_reference_m": jitter(log.poses[known], truth),
        "reference_is_longer_by": scaled[0] - 1.0, "ate_scaled_m": scaled[1],
        "misses_direct_m": direct[0, 0], "misses_direct_deg": np.degrees(direct[0, 1]),
        "reference_misses_direct_m": direct[1, 0], "reference_misses_direct_deg": np.degrees(direct[1, 1]),
        "odometry_error_per_deviation_100m": odometry[0], "odometry_turn_per_deviation_100m": odometry[1],
    }  # fmt: skip
    # The other logs have no times of their own.
    ratio: object = ""
    if name in RAW:
        figures["times_real_time"] = float(np.ptp([record.stamp for record in log.records])) / elapsed
        ratio = round(figures["times_real_time"], 1)
    for what, value in figures.items():
        # Where no two scans fix all directions there is nothing to say.
        if np.isfinite(value):
            report.figures[f"{name} {kind} {what}"] = float(value)
    return [
        name, kind, round(before, 3), round(after, 4), f"{len(slam.closures)} ({false})", round(shares[0], 1),
        round(shares[1], 1), round(relations.translation_mean, 4), round(relations.translation_std, 4),
        round(float(np.degrees(relations.rotation_mean)), 2), round(close.translation_mean, 4), ratio,
    ]  # fmt: skip


def mapped(log: Followed, graph: PoseGraph) -> tuple[Slam, Array, float]:
    """A log with its loops closed, the poses (N, 3) of its scans, and seconds taken, odometry included."""
    begun = time.perf_counter()
    slam = Slam(graph=graph)
    for record, pose, covariance in zip(log.records, log.poses, log.covariances, strict=True):
        slam.process(record.scan, pose, covariance)
    estimate = slam.trajectory()[:, 1:]
    return slam, estimate, time.perf_counter() - begun + log.seconds


def _killian(report: Report, rows: list[list[object]]) -> None:
    from whereabouts.killian import DownloadError, graph_file

    try:
        path = graph_file()
    except DownloadError as error:
        report.notes.append(f"Killian Court: {error}")
        return
    log = followed(path, None, True)
    rows.append(_row(report, "killian.g2o", "smoothed", log, SmoothedGraph(), 3.0))
    rows.append(slam_as_node.row(report, "killian.g2o", log, 3.0, read_g2o(path)))


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

"""A log after odometry, and with its loops closed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import compound, inverse
from evaluation.experiments.odometry import RAW, joined
from evaluation.slam.slam_judging import Followed
from loop_closure.graph.pose_graph import PoseGraph
from loop_closure.slam.trajectory import Slam
from loop_closure.slam_config import Proposals
from whereabouts.logs import OdometryRecord, ScanRecord, open_log
from whereabouts.recorded.follow import Follower

Array = NDArray[np.float64]


def followed(path: Path, truth_path: Path | None, wheels: bool) -> Followed:
    """Odometry of the sensor along a log."""
    with open_log(path) as log:
        records = [record for record in log if isinstance(record, OdometryRecord | ScanRecord)]
    corrected: list[ScanRecord] | None = None
    if truth_path is not None:
        with open_log(truth_path) as log:
            corrected = list(log.scans())
    return followed_records(records, corrected, wheels)


def followed_log(folder: Path, name: str) -> Followed:
    """One of the CARMEN logs in a folder: a raw one with its wheels, a corrected one without."""
    return followed(folder / name, folder / RAW[name] if name in RAW else None, name in RAW)


def followed_records(
    given: Sequence[OdometryRecord | ScanRecord], corrected: list[ScanRecord] | None, wheels: bool
) -> Followed:
    """Odometry of the sensor along records; truth is that of `corrected` scans, else the records' own poses."""
    begun = time.perf_counter()
    follower = Follower(use_wheels=wheels)
    records, poses, covariances = [], [], []
    for record in given:
        if isinstance(record, OdometryRecord):
            follower.add_wheels(record)
            continue
        outcome = follower.add_scan(record)
        mount = np.zeros(3) if record.sensor_pose is None else np.asarray(record.sensor_pose)
        records.append(record)
        poses.append(compound(compound(inverse(mount), outcome.pose), mount))
        covariances.append(outcome.covariance)
    elapsed = time.perf_counter() - begun
    truth = np.full((len(records), 3), np.nan)
    known = records if corrected is None else corrected
    index = range(len(records)) if corrected is None else joined(records, corrected)
    for number, record in zip(index, known, strict=True):
        if number >= 0 and record.pose is not None:
            truth[number] = record.pose
    return Followed(records, np.array(poses), np.array(covariances), truth, elapsed)


def mapped(log: Followed, graph: PoseGraph, proposals: Proposals = "both") -> tuple[Slam, Array, float]:
    """A log with its loops closed, the poses (N, 3) of its scans, and seconds taken, odometry included."""
    begun = time.perf_counter()
    slam = Slam(graph=graph, proposals=proposals)
    for record, pose, covariance in zip(log.records, log.poses, log.covariances, strict=True):
        slam.process(record.scan, pose, covariance)
    estimate = slam.trajectory()[:, 1:]
    return slam, estimate, time.perf_counter() - begun + log.seconds

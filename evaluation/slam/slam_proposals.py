"""What proposes loop closures: the estimate's uncertainty, the place classifier alone (Paper A, 4.3), or both."""

from __future__ import annotations

import time

import numpy as np

from estimation.metrics.statistics import absolute_trajectory_error
from evaluation.report import Report, RunOptions
from evaluation.slam import slam_places
from evaluation.slam.slam_following import followed_log, mapped
from evaluation.slam.slam_judging import (
    closures_of,
    false_closures,
    keyframe_truth,
    largest_miss,
    misses,
    recalls,
)
from loop_closure.graph.pose_graph import SmoothedGraph
from loop_closure.slam_config import Proposals
from whereabouts.system.progress import track

LOGS = ("freiburg-101-corrected.log.gz", "belgioioso-corrected.log.gz", "mit-csail.clf.bz2")
MODES: tuple[Proposals, ...] = ("path", "places", "both")
COLUMNS = [
    "log", "proposals", "ATE, m ↓", "closures", "false closures ↓", "largest miss, m ↓", "revisits closed, % ↑",
    "with overlap closed, % ↑", "keyframes per processor second ↑",
]  # fmt: skip
NOTE = (
    "path: candidates lie within the uncertainty of the estimate. places: the classifier is asked about every keyframe "
    "against all before it, wherever they are; registration and the vote along the path are the same. both: path, and "
    "the classifier where the estimate is too uncertain to say where to look. False: more than 0.5 m or 10° off the "
    "reference as it is. The place model was trained without the building."
)


def table(options: RunOptions, report: Report) -> None:
    """Every mode over the logs."""
    assert options.data is not None
    folder = options.data / "carmen"
    rows: list[list[object]] = []
    samples: dict[str, int] = {}
    for name in track(LOGS[: 1 if options.quick else None], "what proposes closures"):
        log = followed_log(folder, name)
        samples[name] = len(log.records)
        known = np.flatnonzero(np.isfinite(log.truth[:, 0]))
        for mode in MODES:
            with slam_places.without(slam_places.BUILDINGS[name], options):
                begun = time.process_time()
                slam, estimate, _ = mapped(log, SmoothedGraph(), mode)
                elapsed = time.process_time() - begun
            missed = misses(log, closures_of(slam))
            error = absolute_trajectory_error(estimate[known, :2], log.truth[known, :2]).rmse
            rows.append([
                name, mode, float(error), len(missed), len(false_closures(missed, 0.5)), largest_miss(missed),
                *recalls(slam, keyframe_truth(slam, log)), len(slam.keyframes) / elapsed,
            ])  # fmt: skip
    report.add(
        "What proposes closures", COLUMNS, rows, NOTE, "proposals", data=slam_places.JUDGED, samples=samples
    )

"""The scans of `extended_targets`: OSPA, cardinality and time of the filters, other trackers' beside ours."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.phd.target_scores import Score
from tracking import ExtendedTargetPhd, PhdConfig

SCENES = ("cross_spawn", "parallel", "six", "six_pd09")
PUBLISHED = "extended_targets, published with the scans"
# As published: mean OSPA, ms per scan.
OTHERS: dict[str, tuple[list[float | None], str]] = {
    "true association, Kalman filter (floor)": ([5.9, 5.9, 6.0, 6.5], "-"),
    "extended-target PMBM, Octave": ([11.0, 5.9, 6.5, 8.8], "250 to 540"),
    "ET-GM-PHD with sub-partitions, numpy": ([14.9, 13.7, 14.2, 21.3], "4 to 11"),
    "GGIW-PHD, multi-partition, Octave": ([15.8, 18.6, None, None], "800 to 1400"),
    "GGIW-PHD, one DBSCAN partition, C++": ([16.8, 19.6, 12.6, 19.8], "0.04 to 0.1"),
    "Stone Soup GM-PHD on DBSCAN clusters": ([18.7, 20.4, 13.0, 19.7], "6 to 25"),
}


def config_of(given: dict[str, Any], **settings: Any) -> PhdConfig:
    """The configuration a scene's own parameters ask for."""
    x0, x1, y0, y1 = given["area"]
    births = [
        (w, np.array(m, dtype=float), np.diag(np.array(given["birth_P"], dtype=float)))
        for w, m in zip(given["birth_w"], given["birth_m"], strict=True)
    ]
    return PhdConfig(
        surveillance=((x0, x1), (y0, y1)),
        clutter_rate=given["lam_c"],
        detection_probability=given["pD"],
        survival_probability=given["pS"],
        measurement_noise=given["sigma_e"],
        process_noise=given["sigma_v"],
        measurement_rate=given["gamma"],
        births=births,
        spawn=(given["spawn_w"], np.diag(np.array(given["spawn_Q"], dtype=float))),
        **settings,
    )


def follow(path: Path, realisation: int, settings: dict[str, Any]) -> tuple[Score, np.ndarray]:
    """One realisation through the filter: its score, and milliseconds of processor time per scan (K,)."""
    with np.load(path) as data:
        truth, rows, given = data["truth"], data["meas"], json.loads(str(data["params"]))
    filter_ = ExtendedTargetPhd(config_of(given, **settings))
    score, times = Score(given["ospa_c"], given["ospa_p"]), np.empty(given["K"])
    rows = rows[rows[:, 0] == realisation]
    for k in range(1, given["K"] + 1):
        returns = rows[rows[:, 1] == k, 2:4]
        begun = time.process_time()
        targets = filter_.step(returns, k * given["T"])
        times[k - 1] = 1e3 * (time.process_time() - begun)
        score.add(targets, truth[truth[:, 0] == k, 2:4], filter_.expected_count)
    return score, times


def realisations(path: Path) -> list[int]:
    """The numbers of the realisations in a file."""
    with np.load(path) as data:
        return [int(r) for r in np.unique(data["meas"][:, 0])]

"""Times and OSPA of the extended-target filters, beside named alternatives in the same run.

`python bench/bench_tracking.py` prints the tables and writes them to `bench/bench_tracking.txt`. Scans are simulated
(Poisson numbers of returns about targets at constant velocity, and uniform clutter) or, where they are present, those
of `extended_targets`. Stone Soup takes part where it is installed (requirements/evaluation.txt). Times are of
processor time on one core. Nothing here is a test.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from importlib.util import find_spec
from pathlib import Path
from time import process_time

# Before numpy starts its threads: one core is what is measured.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from estimation.metrics.statistics import ospa
from evaluation.datasets import recording
from evaluation.peers.stone_soup_phd import StoneSoupPhd
from evaluation.phd.phd_recorded import SCENES, config_of
from evaluation.phd.target_scores import positions
from tracking import ExtendedTargetPhd, PhdConfig, PointTargetPhd
from tracking.phd.correction import CellStatistics, cell_log_factor, centroid_log_likelihood
from tracking.phd.partitions import PartitionBuilder

NOISE = 20.0


def scene(targets: int, rate: float, clutter: float, steps: int, side: float) -> tuple[PhdConfig, list]:
    """A configuration with a birth place per target, and `steps` scans of all targets on a grid, moving."""
    rng = np.random.default_rng(0)
    columns = int(np.ceil(np.sqrt(targets)))
    grid = np.array([divmod(i, columns) for i in range(targets)], dtype=float)
    start = (grid - (columns - 1) / 2) * (1.6 * side / columns)
    velocity = rng.uniform(-5, 5, (targets, 2))
    births = [(0.1, np.array([*p, 0.0, 0.0]), np.diag([100.0, 100.0, 25.0, 25.0])) for p in start]
    config = PhdConfig(
        surveillance=((-side, side), (-side, side)),
        clutter_rate=clutter,
        measurement_rate=rate,
        births=births,
    )
    scans = []
    for k in range(steps):
        centres = np.repeat(start + k * velocity, rng.poisson(rate, targets), axis=0)
        seen = centres + rng.normal(0, NOISE, centres.shape)
        scans.append(np.vstack([seen, rng.uniform(-side, side, (rng.poisson(clutter), 2))]))
    return config, scans


Tracker = ExtendedTargetPhd | StoneSoupPhd


def run(filter_: Tracker, scans: list) -> tuple[float, float, float]:
    """Milliseconds per scan, mean and 99th percentile, without the first five; expected targets at the end."""
    times = []
    for k, scan in enumerate(scans):
        begin = process_time()
        filter_.step(scan, float(k))
        times.append(1e3 * (process_time() - begin))
    return float(np.mean(times[5:])), float(np.percentile(times[5:], 99)), filter_.expected_count


def trackers(config: PhdConfig) -> dict[str, Tracker]:
    """What is compared."""
    text = {**config.__dict__, "filter": "phd"}
    found: dict[str, Tracker] = {
        "mixture (default)": ExtendedTargetPhd(config),
        "ET-GM-PHD with sub-partitions": ExtendedTargetPhd(PhdConfig(**text)),
        "ET-GM-PHD, one partition": ExtendedTargetPhd(
            PhdConfig(**{**text, "partitioner": "single", "subpartitions": False})
        ),
    }
    if find_spec("stonesoup"):
        found["Stone Soup GM-PHD on DBSCAN clusters"] = StoneSoupPhd(config)
    return found


def filters() -> list[str]:
    """Whole scans of well separated targets, as a ratio to the default."""
    rows = [f"{'scene':<46}{'filter':<38}{'ms mean':>9}{'p99':>9}{'ratio':>8}{'count':>8}"]
    for targets, rate, clutter, steps, side in (
        (2, 10, 10, 150, 1000.0),
        (5, 10, 10, 150, 1000.0),
        (10, 20, 10, 40, 1000.0),
        (25, 20, 25, 40, 2800.0),
        (50, 20, 50, 40, 4000.0),
    ):
        config, scans = scene(targets, rate, clutter, steps, side)
        variants = trackers(config)
        if targets <= 5:
            variants["point-target GM-PHD on raw returns"] = PointTargetPhd(config)
        base = 0.0
        for name, filter_ in variants.items():
            mean, high, count = run(filter_, scans)
            base = base or mean
            label = f"{targets} targets × {rate} returns + {clutter} clutter"
            rows.append(f"{label:<46}{name:<38}{mean:9.2f}{high:9.2f}{mean / base:8.2f}{count:8.1f}")
    return rows


def recorded() -> list[str]:
    """Mean OSPA (p = 2, c = 60 m) and time on the recorded scans."""
    rows = ["", f"{'recorded scans, all realisations':<46}{'filter':<38}{'OSPA':>9}{'ms mean':>9}{'p99':>8}"]
    for name in SCENES:
        path = recording(f"extended_targets/{name}.npz")
        if path is None:
            return ["", "extended_targets is absent: no recorded scans"]
        with np.load(path) as data:
            truth, returns, given = data["truth"], data["meas"], json.loads(str(data["params"]))
        errors: dict[str, list[float]] = {}
        times: dict[str, list[float]] = {}
        for realisation in np.unique(returns[:, 0]):
            mine = returns[returns[:, 0] == realisation]
            for label, filter_ in trackers(config_of(given)).items():
                for k in range(1, given["K"] + 1):
                    begin = process_time()
                    targets = filter_.step(mine[mine[:, 1] == k, 2:4], k * given["T"])
                    times.setdefault(label, []).append(1e3 * (process_time() - begin))
                    found = targets if isinstance(targets, np.ndarray) else positions(targets)
                    error = ospa(found, truth[truth[:, 0] == k, 2:4], given["ospa_c"], given["ospa_p"])
                    errors.setdefault(label, []).append(error)
        for label, values in errors.items():
            mean, high = np.mean(times[label]), np.percentile(times[label], 99)
            rows.append(f"{name:<46}{label:<38}{np.mean(values):9.2f}{mean:9.2f}{high:8.2f}")
    return rows


def likelihoods(repeats: int = 30) -> list[str]:
    """Likelihood of 20 cells of 20 returns under 10 components: factorised against stacked (9d)."""
    rng = np.random.default_rng(1)
    z, means = rng.normal(0, NOISE, (400, 2)), rng.normal(0, NOISE, (10, 4))
    P, R = np.tile(100.0 * np.eye(4), (10, 1, 1)), NOISE**2 * np.eye(2)
    builder = PartitionBuilder()
    builder.group([(tuple(builder.cell(np.arange(20 * c, 20 * c + 20)) for c in range(20)), 0.0)])
    partitions = builder.build()

    def factorised() -> np.ndarray:
        cells = CellStatistics.of(z, partitions)
        logs = centroid_log_likelihood(cells.means, cells.counts, means[:, :2], P[:, :2, :2], R)
        return logs + cell_log_factor(cells, R)[:, None]

    def stacked() -> np.ndarray:
        H, noise = np.tile(np.eye(2, 4), (20, 1)), NOISE**2 * np.eye(40)
        out = np.empty((20, 10))
        for c in range(20):
            for j in range(10):
                S, e = H @ P[j] @ H.T + noise, z[20 * c : 20 * c + 20].ravel() - H @ means[j]
                logs = e @ np.linalg.solve(S, e) + np.linalg.slogdet(2 * np.pi * S)[1]
                out[c, j] = -0.5 * logs
        return out

    np.testing.assert_allclose(factorised(), stacked())
    times = []
    for function in (factorised, stacked):
        samples = []
        for _ in range(repeats):
            begin = process_time()
            function()
            samples.append(1e3 * (process_time() - begin))
        times.append(min(samples))
    return [
        "",
        "20 cells × 20 returns × 10 components, likelihoods (9d), least of 30 rounds:",
        f"  factorised {times[0]:.3f} ms, stacked 40 × 40 matrices {times[1]:.3f} ms: "
        f"ratio {times[0] / times[1]:.4f}",
    ]


def main() -> None:
    """Prints and writes the table."""
    head = f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core"
    # Compiled loops are loaded before anything is measured.
    config, scans = scene(2, 10, 10, 10, 1000.0)
    for filter_ in trackers(config).values():
        run(filter_, scans)
    text = "\n".join([head, "", *filters(), *recorded(), *likelihoods()]) + "\n"
    print(text)
    Path(__file__).with_suffix(".txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

"""Extended targets: the text's PHD filter, what goes beyond it, and the point-target filter, on the same scans.

Section 5 of Paper B. Figure 3 (OSPA and cardinality over time), partitioning against K-means, Figure 4 (a target
hidden by another), and the scans of `extended_targets` where they are present.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from evaluation.experiments import phd_hidden as hiding
from evaluation.experiments import phd_monte_carlo as monte_carlo
from evaluation.experiments import phd_recorded as recorded
from evaluation.report import Options, Report, Table
from whereabouts.parallel import each
from whereabouts.simulation.hidden_people import PERIOD

# What is compared, by the name it has in the tables.
FILTERS: dict[str, dict[str, Any]] = {
    "PMBM (default)": {},
    "ET-GM-PHD (the text)": {"filter": "phd"},
    "ET-GM-PHD, no sub-partitions": {"filter": "phd", "subpartitions": False},
    "ET-GM-PHD, one partition": {"filter": "phd", "partitioner": "single", "subpartitions": False},
}
K_MEANS: dict[str, dict[str, Any]] = {
    "ET-GM-PHD, K-means": {"filter": "phd", "partitioner": "kmeans", "subpartitions": False},
}
POINTS: dict[str, dict[str, Any]] = {"GM-PHD for points": {"point": True}}
# Scenes of the hidden person: walking speed, m/s, and distances of both people, m.
WALKS = {
    "1.0 m/s at 7 m": (1.0, (5.0, 7.0)),
    "0.5 m/s at 7 m": (0.5, (5.0, 7.0)),
    "0.7 m/s at 11 m": (0.7, (4.0, 11.0)),
}


def run(options: Options) -> Report:
    """All tables; the recorded scans are left out, and said so, where they are absent."""
    report = Report("phd")
    if options.quick:
        report.notes.append("quick: fewer runs of the same protocol.")
    _figure_3(options, report)
    _crossings(options, report)
    _figure_4(options, report)
    if options.data is None or not (options.data / "extended_targets").exists():
        report.notes.append("extended_targets is absent: no recorded scans")
    else:
        _recorded(options, options.data / "extended_targets", report)
    return report


def _parallel(options: Options, what: str, function: Any, calls: list[tuple[Any, ...]]) -> list[Any]:
    """The function's results in order, on the processes of the options, with progress."""
    return each(function, calls, options.jobs, what)


def _figure_3(options: Options, report: Report) -> None:
    """OSPA and cardinality over time, extended against point targets, distances against K-means."""
    count = 10 if options.quick else 1000
    for title, make in monte_carlo.SCENES.items():
        scene = make()
        truth = np.array([len(there) for there in scene.positions])
        runs: dict[str, np.ndarray] = {}
        rows: list[list[Any]] = []
        for name, settings in (FILTERS | K_MEANS | POINTS).items():
            calls = [(scene, settings, 1000 * options.seed + r) for r in range(count)]
            runs[name] = np.array(_parallel(options, f"{title}: {name}", monte_carlo.follow, calls))
            values = runs[name]
            expected, reported = values[:, :, 1] - truth, values[:, :, 2] - truth
            numbers = [values[:, :, 0].mean(), values[:, :, 0].std(), expected.mean(), reported.mean()]
            rows.append(
                [name, *(round(float(number), 3) for number in numbers), float(np.abs(reported).mean())]
            )
            report.figures[f"monte_carlo.{title}.{name}.ospa"] = float(numbers[0])
            report.figures[f"monte_carlo.{title}.{name}.count_bias"] = float(numbers[3])
        columns = [
            "filter",
            "mean OSPA, m",
            "its deviation",
            "expected - true",
            "reported - true",
            "|reported - true|",
        ]
        note = (
            f"{count} runs of 100 scans (theirs 1000): 10 returns per target, 10 clutter. Theirs, in words only: the "
            "extended filter significantly outperforms the point filter and counts right except where targets are "
            "close; distances are significantly better than K-means."
        )
        report.tables.append(Table(f"Figure 3, {title}", columns, rows, note))
        file = "figure-3-" + title.split(" ")[0]
        report.pictures.append(monte_carlo.draw(options.out, file, runs, scene))


def _crossings(options: Options, report: Report) -> None:
    """Do labels survive?"""
    count = 40 if options.quick else 500
    rows: list[list[Any]] = []
    for name in ("PMBM (default)", "ET-GM-PHD (the text)"):
        calls = [(FILTERS[name], 1000 * options.seed + r) for r in range(count)]
        kept = 100.0 * float(
            np.mean(_parallel(options, f"crossings: {name}", monte_carlo.crossing_kept, calls))
        )
        rows.append([name, round(kept, 1)])
        report.figures[f"crossings_kept_percent.{name}"] = kept
    note = f"{count} pairs that meet at 30° to 150°, labels 12 scans before and after; the text's filter has no labels."
    report.tables.append(Table("Crossings that keep both labels", ["filter", "%"], rows, note))


def _figure_4(options: Options, report: Report) -> None:
    """A person hidden by another: constant against variable detection probability."""
    count = 5 if options.quick else 100
    rows: list[list[Any]] = []
    shown: dict[str, hiding.HiddenRun] = {}
    for walk, (speed, away) in WALKS.items():
        for name, (settings, variable) in hiding.FILTERS.items():
            calls = [(settings, variable, 1000 * options.seed + r, speed, away) for r in range(count)]
            runs = _parallel(options, f"hidden person: {name}", hiding.follow, calls)
            hidden = float(np.mean([run.hidden.sum() * PERIOD for run in runs]))
            kept = 100.0 * float(np.mean([run.kept for run in runs]))
            fall, jump = (float(np.mean([getattr(run, what) for run in runs])) for what in ("fall", "jump"))
            rows.append([walk, name, round(hidden, 2), round(kept, 1), round(fall, 2), round(jump, 2)])
            report.figures |= {f"hidden.{walk}.{name}.kept_percent": kept, f"hidden.{walk}.{name}.jump": jump}
            shown.setdefault(name, runs[0])
    columns = ["walk", "filter", "hidden, s", "kept with label, %", "largest shortfall", "largest surplus"]
    note = (
        f"{count} runs. Theirs, one recording: lost for two sweeps with constant p_D, kept with variable p_D, and then "
        "a jump of the expected number when the person re-appears."
    )
    report.tables.append(Table("Figure 4, a person hidden by another (simulated)", columns, rows, note))
    report.pictures.append(hiding.draw(options.out, shown))


def _recorded(options: Options, folder: Path, report: Report) -> None:
    """Mean OSPA on the recorded scans, the others' as published with them."""
    rows: list[list[Any]] = []
    for name, settings in FILTERS.items():
        values, times, biases = [], [], []
        for scene in recorded.SCENES:
            path = folder / f"{scene}.npz"
            numbers = recorded.realisations(path)[: 4 if options.quick else None]
            calls = [(path, r, settings) for r in numbers]
            done = _parallel(options, f"{scene}: {name}", recorded.follow, calls)
            values.append(float(np.mean([score.mean_ospa for score, _ in done])))
            biases.append(float(np.mean([score.count_bias for score, _ in done])))
            expected = float(np.mean([score.expected_bias for score, _ in done]))
            # The first scans load compiled code.
            times += [took[5:] for _, took in done]
            report.figures |= {
                f"ospa.{name}.{scene}": values[-1],
                f"count_bias.{name}.{scene}": biases[-1],
                f"expected_bias.{name}.{scene}": expected,
            }
        spent = np.concatenate(times)
        report.figures |= {
            f"ms_mean.{name}": float(spent.mean()),
            f"ms_p99.{name}": float(np.percentile(spent, 99)),
        }
        bias = max(biases, key=abs)
        rows.append(
            [name, *values, round(bias, 3), f"{spent.mean():.1f}, p99 {np.percentile(spent, 99):.1f}"]
        )
    rows += [[name, *numbers, None, spent] for name, (numbers, spent) in recorded.OTHERS.items()]
    note = "Times in ms per scan, ours in this run; the others' OSPA and times as published with the scans."
    columns = ["tracker", *recorded.SCENES, "largest count bias", "ms"]
    report.tables.append(Table("Mean OSPA (p = 2, c = 60 m) on extended_targets", columns, rows, note))

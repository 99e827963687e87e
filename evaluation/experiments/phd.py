"""Extended targets: the text's PHD filter, what goes beyond it, and the point-target filter, on the same scans.

Section 5 of Paper B. Figure 3 (OSPA and cardinality over time), partitioning against K-means, Figure 4 (a target
hidden by another), and the scans of `extended_targets` where they are present.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np

from evaluation.parallel import each
from evaluation.phd import phd_hidden as hiding
from evaluation.phd import phd_monte_carlo as monte_carlo
from evaluation.phd import phd_partitions as partitions
from evaluation.phd import phd_recorded as recorded
from evaluation.report import Part, Printed, Report, RunOptions
from evaluation.scenes.hidden_people import PERIOD

# What is compared, by the name it has in the tables.
PRINTED = hiding.PRINTED
FILTERS: dict[str, dict[str, Any]] = {
    "mixture (default)": {},
    "ET-GM-PHD as printed": PRINTED,
    "ET-GM-PHD with sub-partitions": {"filter": "phd"},
    "as printed, one partition": {**PRINTED, "partitioner": "single"},
}
# The mixture without its hypotheses; without p_D by bodies and without own rates it is in Figure 4.
STAGES: dict[str, dict[str, Any]] = {"mixture, one hypothesis": {"max_hypotheses": 1}}
K_MEANS: dict[str, dict[str, Any]] = {"as printed, K-means": {**PRINTED, "partitioner": "kmeans"}}
POINTS: dict[str, dict[str, Any]] = {"GM-PHD for points": {"filter": "gmphd"}}
CLUSTERS: dict[str, dict[str, Any]] = {
    "PDA on clusters, Stone Soup": {"association": "pda"},
    "JPDA on clusters, Stone Soup": {"association": "jpda"},
}
# Scenes of the hidden person: walking speed, m/s, and distances of both people, m.
WALKS = {
    "1.0 m/s at 7 m": (1.0, (5.0, 7.0)),
    "0.5 m/s at 7 m": (0.5, (5.0, 7.0)),
    "0.7 m/s at 11 m": (0.7, (4.0, 11.0)),
}


def _figure_3(options: RunOptions, report: Report) -> None:
    """OSPA and cardinality over time, extended against point targets, distances against K-means."""
    count = options.share(100, 5)
    rows: list[list[Any]] = []
    for number, (title, make) in enumerate(monte_carlo.SCENES.items()):
        scene = make()
        truth = np.array([len(there) for there in scene.positions])
        runs: dict[str, np.ndarray] = {}
        clusters = CLUSTERS if find_spec("stonesoup") else {}
        for name, settings in (FILTERS | STAGES | K_MEANS | POINTS | clusters).items():
            calls = [(scene, settings, [options.seed, number, r]) for r in range(count)]
            runs[name] = np.array(each(monte_carlo.follow, calls, options.jobs, f"{title}: {name}"))
            values = runs[name]
            expected, reported = values[:, :, 1] - truth, values[:, :, 2] - truth
            numbers = (values[:, :, 0].mean(), values[:, :, 0].std(), expected.mean(), reported.mean())
            rows.append([title, name, *map(float, numbers), float(np.abs(reported).mean())])
        file = "figure-3-" + title.split(" ")[0]
        report.pictures.append(monte_carlo.draw(options.out, file, runs, scene))
    columns = [
        "scene",
        "filter",
        "OSPA, m ↓",
        "deviation of OSPA, m",
        "expected less true number",
        "reported less true number",
        "wrong by, targets ↓",
    ]
    note = (
        "Runs of 100 scans (the text: 1000 runs), 10 returns per target, 10 of clutter; OSPA with p = 2, c = 60 m. The "
        "text, in words only: the extended filter outperforms the point filter and counts right except where targets "
        "are close; distances are better than K-means. PDA and JPDA know one return per target and get centroids of "
        "clusters; PDA lets several tracks fall on one target. One hypothesis: the mixture without the others."
    )
    report.add(
        "Figure 3: filters on the text's scenes",
        columns,
        rows,
        note,
        "figure-3",
        data="simulated",
        samples=count,
    )


def _crossings(options: RunOptions, report: Report) -> None:
    """Do labels survive?"""
    count = options.share(500, 100)
    rows: list[list[Any]] = []
    compared = (FILTERS | STAGES).items()
    for name, settings in [one for one in compared if one[0] != "as printed, one partition"]:
        calls = [(settings, [options.seed, 2, r]) for r in range(count)]
        kept = each(monte_carlo.crossing_kept, calls, options.jobs, f"crossings: {name}")
        rows.append([name, 100.0 * float(np.mean(kept))])
    note = (
        "Two targets meet at 30° to 150°; labels 12 scans before and after. The text's filter has no labels; these are "
        "those that its components carry."
    )
    report.add(
        "Crossings that keep both labels",
        ["filter", "kept, % ↑"],
        rows,
        note,
        "crossings",
        data="simulated",
        samples=count,
    )


def _figure_4(options: RunOptions, report: Report) -> None:
    """A person hidden by another: constant against variable detection probability."""
    count = options.share(50, 5)
    rows: list[list[Any]] = []
    shown: dict[str, hiding.HiddenRun] = {}
    for walk, (speed, away) in WALKS.items():
        for name, (settings, variable) in hiding.FILTERS.items():
            calls = [(settings, variable, [options.seed, 3, r], speed, away) for r in range(count)]
            runs = each(hiding.follow, calls, options.jobs, f"hidden person: {name}")
            hidden = float(np.mean([run.hidden.sum() * PERIOD for run in runs]))
            followed, kept = (
                100.0 * float(np.mean([getattr(run, what) for run in runs])) for what in ("followed", "kept")
            )
            fall, jump = (float(np.mean([getattr(run, what) for run in runs])) for what in ("fall", "jump"))
            rows.append([walk, name, hidden, followed, kept, fall, jump])
            shown.setdefault(name, runs[0])
    columns = [
        "walk",
        "filter",
        "hidden, s",
        "followed, % ↑",
        "kept with label, % ↑",
        "largest shortfall ↓",
        "largest surplus ↓",
    ]
    note = (
        "Followed: a target within 1 m before, while and after; kept: under one label, which the text's filter has "
        "not. The text, one recording: lost for two sweeps with constant p_D, followed with variable p_D, and then the "
        "expected number jumps when the person re-appears: 1 + P_E (1 - p_D) at a detection. As printed it jumps so "
        "here, and at sweeps of half a body, too."
    )
    report.add(
        "Figure 4, a person hidden by another",
        columns,
        rows,
        note,
        "figure-4",
        data="simulated",
        samples=count,
    )
    report.pictures.append(hiding.draw(options.out, shown))


def _recorded(options: RunOptions, report: Report) -> None:
    """Mean OSPA on the recorded scans, the others' as published with them."""
    assert options.data is not None
    folder = options.data / "extended_targets"
    rows: list[list[Any]] = []
    used = 0
    for name, settings in FILTERS.items():
        values, times, biases = [], [], []
        for scene in recorded.SCENES:
            path = folder / f"{scene}.npz"
            numbers = recorded.realisations(path)[: 4 if options.quick else None]
            used = len(numbers)
            calls = [(path, r, settings) for r in numbers]
            done = each(recorded.follow, calls, options.jobs, f"{scene}: {name}")
            values.append(float(np.mean([score.mean_ospa for score, _ in done])))
            biases.append(float(np.mean([score.count_bias for score, _ in done])))
            # The first scans load compiled code.
            times += [took[5:] for _, took in done]
        spent = np.concatenate(times)
        late = float(np.percentile(spent, 99))
        rows.append([name, *values, max(biases, key=abs), float(spent.mean()), late])
    for name, (published, milliseconds) in recorded.OTHERS.items():
        cells = ["-" if value is None else Printed(value, recorded.PUBLISHED) for value in published]
        rows.append([name, *cells, "", milliseconds, ""])
    note = (
        "OSPA with p = 2, c = 60 m. Bias: reported less true number, of the worst scene. Times are of this run, the "
        "others' OSPA and times as published with the scans."
    )
    columns = ["tracker", *(f"{scene}, m ↓" for scene in recorded.SCENES), "bias of the count", "time, ms ↓"]
    report.add(
        "Scans of extended_targets",
        [*columns, "99 % of the scans within, ms ↓"],
        rows,
        note,
        "scans",
        data="simulated",
        samples=used,
    )


PARTS = {
    "figure 3": Part(_figure_3),
    "partitions": Part(partitions.table),
    "crossings": Part(_crossings),
    "figure 4": Part(_figure_4),
    "scans": Part(
        _recorded, random=False, needs=tuple(f"extended_targets/{scene}.npz" for scene in recorded.SCENES)
    ),
}

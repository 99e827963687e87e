"""Tables 6.1 to 6.3, Figures 6.12 to 6.16: what each step of the filters costs, on one long walk per scenario."""

from __future__ import annotations

from collections import Counter

import numpy as np

from estimation.map_frame import convert_with_ratio
from evaluation.experiments import conversion_pictures as pictures
from evaluation.experiments import conversion_tracking as tracking
from evaluation.report import Options, Printed, Report, Table


def costs(options: Options, report: Report) -> None:
    """One long walk per scenario; particles only follow its beginning, as all their steps are alike."""
    seconds, beginning = (5.0, 2.0) if options.quick else (100.0, 10.0)
    tracking.compiled()
    seed = int(np.random.default_rng([options.seed, 7]).integers(2**31))
    scenes = {s: tracking.walk(s, seed, seconds) for s in (1, 2, 3)}
    runs = {
        (s, name): tracking.track(scenes[s], seed, **tracking.FILTERS[name])
        for s in scenes
        for name in ("switching", "switching, polar K")
    }
    rows: list[list[object]] = []
    for s in scenes:
        short = tracking.walk(s, seed, beginning)
        full = 1e6 * tracking.track(short, seed, k_crit=0.0).cost / len(short.truth)
        for name, theirs in (("switching", {1: 0.7, 3: 64}.get(s, "")), ("switching, polar K", "")):
            cost = 1e6 * runs[s, name].cost / len(scenes[s].truth)
            rows.append([f"scenario {s}", name, cost, full, 100.0 * cost / full, theirs])
    columns = [
        "scenario",
        "filter",
        "step, µs ↓",
        "always particles: step, µs ↓",
        "share of that, % ↓",
        "text: share of that, %",
    ]
    note = f"Walks of {seconds:g} s, 1,000 particles. Processor time."
    report.tables.append(
        Table(
            "Cost beside a filter of particles only", columns, rows, note, "costs",
            {columns[-1]: "section 6.8.2"}, "simulated", len(scenes[1].truth),
        )
    )  # fmt: skip
    polar = {s: runs[s, "switching, polar K"] for s in scenes}
    _tables_of_the_text(report, polar, runs[3, "switching"])
    _pictures_of_the_text(options, report, polar, runs[3, "switching"])


def _tables_of_the_text(report: Report, polar: dict[int, tracking.Run], chosen: tracking.Run) -> None:
    ms = tracking.mean_ms
    kf, pf = ("KF",), ("PF, Gaussian", "PF, tested")
    predict = {s: 1e3 * float(np.mean(polar[s].predict_time[1:])) for s in polar}
    counts = {s: Counter(polar[s].kinds) for s in polar}
    said: list[tuple[str, str, float, float | str]] = [
        ("6.1", "KF update steps", counts[1]["KF"], 3999),
        ("6.1", "KF update, ms ↓", ms(polar[1], *kf), 5.6e-3),
        ("6.1", "KF prediction, ms ↓", predict[1], 4.2e-3),
        ("6.1", "K in a batch of 1,000, ms ↓", _ratio_time(), 5.9e-3),
        ("6.2", "PF update steps", sum(n for k, n in counts[2].items() if k.startswith("PF")), 3999),
        ("6.2", "PF update by samples, ms ↓", ms(polar[2], "PF, samples"), 1.26),
        ("6.2", "PF prediction, ms ↓", predict[2], 0.88),
        ("6.3", "KF update steps", counts[3]["KF"], 507),
        ("6.3", "PF update steps, Gaussian", sum(counts[3][k] for k in (*pf, "PF to KF")), 2686),
        ("6.3", "PF update steps, by samples", counts[3]["PF, samples"] + counts[3]["KF to PF"], 806),
        ("6.3", "KF update, ms ↓", ms(polar[3], *kf), 5.8e-3),
        ("6.3", "PF update, Gaussian, ms ↓", ms(polar[3], "PF, Gaussian"), 0.28),
        ("6.3", "PF update by samples, ms ↓", ms(polar[3], "PF, samples"), 1.25),
        ("6.3", "switch from KF to PF, ms ↓", ms(polar[3], "KF to PF") - ms(polar[3], "PF, samples"), 0.93),
        (
            "6.3",
            "Mardia's test and switch back, ms ↓",
            _tested(polar[3]) - ms(polar[3], "PF, Gaussian"),
            6.76,
        ),
        ("6.3", "KF update steps with K in the map", int((chosen.particles[1:] == 0).sum()) + 1, ""),
    ]
    rows: list[list[object]] = [
        [f"{table}: {what}", here, Printed(theirs, f"Table {table}") if theirs != "" else ""]
        for table, what, here, theirs in said
    ]
    note = (
        "The text used C++ on a 2.8 GHz laptop of 2008: compare ratios, not milliseconds. As in the text, K leaves out "
        "the robot's position, except in the last row. Processor time includes the checks of arguments."
    )
    title = "Steps of each kind, and what they take"
    report.tables.append(
        Table(
            title,
            ["step", "here", "text"],
            rows,
            note,
            "steps",
            {"text": "Tables 6.1 to 6.3"},
            "simulated",
            len(polar[3].kinds),
        )
    )


def _tested(run: tracking.Run) -> float:
    return tracking.mean_ms(run, "PF, tested", "PF to KF")


def _ratio_time() -> float:
    """Time of one K, conversion included, ms, in a batch of 1,000: the least of several rounds."""
    from timeit import repeat

    ranges = np.linspace(0.5, 8.0, 1000)

    def once() -> None:
        convert_with_ratio(ranges, 0.1, 0.02, 0.05)

    once()
    return min(repeat(once, number=20, repeat=7)) / 20


def _pictures_of_the_text(
    options: Options, report: Report, polar: dict[int, tracking.Run], chosen: tracking.Run
) -> None:
    for number, scenario in ((12, 1), (13, 2)):
        r = polar[scenario]
        values = {"prediction": 1e3 * r.predict_time[1:], "update": 1e3 * r.update_time[1:]}
        report.pictures.append(pictures.boxes(options.out, f"figure-6-{number}-times", values, "ms", True))
    r = polar[3]
    kinds = np.array(r.kinds)
    values = {k: 1e3 * r.update_time[kinds == k] for k in ("KF", "PF, Gaussian", "PF, samples", "PF, tested")}
    report.pictures.append(pictures.boxes(options.out, "figure-6-15-times", values, "update, ms", True))
    runs = {"K of the measurement": r, "K in the map": chosen}
    report.pictures.append(pictures.modes(options.out, runs, tracking.RATE))

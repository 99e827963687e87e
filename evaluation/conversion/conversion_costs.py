"""Tables 6.1 to 6.3, Figures 6.12 to 6.16: what each step of the filters costs, on one long walk per scenario."""

from __future__ import annotations

from collections import Counter

import numpy as np

from estimation.conversion.map_frame import convert_with_ratio
from evaluation.conversion import conversion_pictures as pictures
from evaluation.conversion import conversion_tracking as tracking
from evaluation.report import Printed, Report, RunOptions


def costs(options: RunOptions, report: Report) -> None:
    """One long walk per scenario; particles only follow its beginning, as all their steps are alike."""
    seconds, beginning = (5.0, 2.0) if options.quick else (100.0, 10.0)
    tracking.compiled()
    (seed,) = options.draws(7)
    scenes = {s: tracking.walk(s, seed, seconds) for s in (1, 2, 3)}
    runs = {
        (s, name): tracking.track(scenes[s], seed, **tracking.FILTERS[name])
        for s in scenes
        for name in ("switching", "switching, polar K", "Algorithm 1 as printed")
    }
    rows: list[list[object]] = []
    for s in scenes:
        short = tracking.walk(s, seed, beginning)
        full = 1e6 * tracking.track(short, seed, k_crit=0.0).cost / len(short.truth)
        said = {1: 0.7, 3: 64}.get(s, "")
        for name, theirs in (
            ("switching", said), ("switching, polar K", ""), ("Algorithm 1 as printed", said),
        ):  # fmt: skip
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
    note = (
        f"Walks of {seconds:g} s, 1,000 particles. Processor time. Without the robot's position in K: 'polar K'; "
        "without the switch: always particles."
    )
    report.add(
        "Cost beside a filter of particles only", columns, rows, note, "costs",
        {columns[-1]: "section 6.8.2"}, "simulated", len(scenes[1].truth),
    )  # fmt: skip
    polar = {s: runs[s, "switching, polar K"] for s in scenes}
    printed = {s: runs[s, "Algorithm 1 as printed"] for s in scenes}
    _tables_of_the_text(report, polar, printed, runs[3, "switching"])
    _pictures_of_the_text(options, report, polar, runs[3, "switching"])


def _steps(runs: dict[int, tracking.TrackedWalk]) -> dict[str, float]:
    """Counts and times of a filter's steps in the three scenarios, by the names of Tables 6.1 to 6.3."""
    ms = tracking.mean_ms
    kf, pf = ("KF",), ("PF, Gaussian", "PF, tested")
    predict = {s: 1e3 * float(np.mean(runs[s].predict_time[1:])) for s in runs}
    counts = {s: Counter(runs[s].kinds) for s in runs}
    third = runs[3]
    return {
        "6.1: KF update steps": counts[1]["KF"],
        "6.1: KF update, ms ↓": ms(runs[1], *kf),
        "6.1: KF prediction, ms ↓": predict[1],
        "6.2: PF update steps": sum(n for k, n in counts[2].items() if k.startswith("PF")),
        "6.2: PF update by samples, ms ↓": ms(runs[2], "PF, samples"),
        "6.2: PF prediction, ms ↓": predict[2],
        "6.3: KF update steps": counts[3]["KF"],
        "6.3: PF update steps, Gaussian": sum(counts[3][k] for k in (*pf, "PF to KF")),
        "6.3: PF update steps, by samples": counts[3]["PF, samples"] + counts[3]["KF to PF"],
        "6.3: KF update, ms ↓": ms(third, *kf),
        "6.3: PF update, Gaussian, ms ↓": ms(third, "PF, Gaussian"),
        "6.3: PF update by samples, ms ↓": ms(third, "PF, samples"),
        "6.3: switch from KF to PF, ms ↓": ms(third, "KF to PF") - ms(third, "PF, samples"),
        "6.3: Mardia's test and switch back, ms ↓": ms(third, "PF, tested", "PF to KF")
        - ms(third, "PF, Gaussian"),
    }


# Of the rows of `_steps`, in their order.
PRINTED = (3999, 5.6e-3, 4.2e-3, 3999, 1.26, 0.88, 507, 2686, 806, 5.8e-3, 0.28, 1.25, 0.93, 6.76)


def _tables_of_the_text(
    report: Report,
    polar: dict[int, tracking.TrackedWalk],
    printed: dict[int, tracking.TrackedWalk],
    chosen: tracking.TrackedWalk,
) -> None:
    """Text, Algorithm 1 as printed, and ours, row by row."""
    theirs, ours = _steps(printed), _steps(polar)
    rows: list[list[object]] = [
        [name, ours[name], theirs[name], Printed(said, f"Table {name[:3]}")]
        for name, said in zip(ours, PRINTED, strict=True)
    ]
    rows.insert(3, ["6.1: K in a batch of 1,000, ms ↓", _ratio_time(), "", Printed(5.9e-3, "Table 6.1")])
    rows.append(
        ["6.3: KF update steps with K in the map", int((chosen.particles[1:] == 0).sum()) + 1, "", ""]
    )
    note = (
        "The text used C++ on a 2.8 GHz laptop of 2008: compare ratios, not milliseconds. As in the text, K leaves out "
        "the robot's position, except in the last row. Processor time includes the checks of arguments. As printed: "
        "Algorithm 1 with the weights (6.16) to (6.18); the text's process noise is not printed."
    )
    title = "Steps of each kind, and what they take"
    report.add(
        title,
        ["step", "here", "as printed, here", "text"],
        rows,
        note,
        "steps",
        {"text": "Tables 6.1 to 6.3"},
        "simulated",
        len(polar[3].kinds),
    )


def _ratio_time() -> float:
    """Time of one K, conversion included, ms, in a batch of 1,000: the least of several rounds."""
    from timeit import repeat

    ranges = np.linspace(0.5, 8.0, 1000)

    def once() -> None:
        convert_with_ratio(ranges, 0.1, 0.02, 0.05)

    once()
    return min(repeat(once, number=20, repeat=7)) / 20


def _pictures_of_the_text(
    options: RunOptions, report: Report, polar: dict[int, tracking.TrackedWalk], chosen: tracking.TrackedWalk
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

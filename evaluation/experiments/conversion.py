"""When a converted measurement stops being Gaussian, and what a filter that switches then costs and gains.

Chapter 6 of the anchoring text: Figures 6.3 to 6.8 and 6.11 to 6.16, Tables 6.1 to 6.3.
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from evaluation.conversion import conversion_analysis as analysis
from evaluation.conversion import conversion_costs as costs
from evaluation.conversion import conversion_drive as driving
from evaluation.conversion import conversion_limits as limits
from evaluation.conversion import conversion_pictures as pictures
from evaluation.conversion import conversion_tracking as tracking
from evaluation.parallel import each
from evaluation.report import Part, Report, RunOptions

DEGREES = np.arange(0.5, 20.25, 0.5)
SOME = (2, 3, 5, 10, 20)
THEIRS_UP_TO = {"linear": 2.5, "dcm": 16, "ucm": 20, "mucm": 20}


def consistency(options: RunOptions, report: Report) -> None:
    """Figures 6.3 and 6.5 without samples, by quadrature, and Figure 6.4."""
    sigmas = np.radians(DEGREES)
    rows: list[list[object]] = []
    for m in analysis.METHODS:
        exact = np.array([analysis.exact_anes(s, m) for s in sigmas])
        reach = float(np.degrees(analysis.consistent_up_to(sigmas, exact)))
        rows.append([m, reach, THEIRS_UP_TO.get(m, ""), exact[4], exact[-1], float(np.abs(exact - 2).max())])
    columns = [
        "method",
        "consistent up to, ° ↑",
        "text: consistent up to, °",
        "ANES at 2.5°",
        "ANES at 20°",
        "largest |ANES - 2| ↓",
    ]
    note = (
        "2 is consistent. Up to: inside the 95 % interval of a mean over the text's 500 measurements. The methods are "
        "the text's as printed, without and with each of its corrections; the unscented transform is not in it."
    )
    report.add(
        "Consistency of converted measurements, exact", columns, rows, note, "consistency",
        {columns[2]: "Figure 6.3"}, "simulated",
    )  # fmt: skip
    lines: dict[str, FloatArray] = {
        m: np.array([analysis.exact_kl(s, m) for s in sigmas]) for m in analysis.METHODS[:4]
    }
    at = [int(np.flatnonzero(d == DEGREES)[0]) for d in SOME]
    rows = [[f"{d}°", *(line[k] for line in lines.values())] for d, k in zip(SOME, at, strict=True)]
    note = "In the text linearisation has the smallest distance. Without bins the MUCM must have it."
    report.add(
        "Kullback-Leibler distance, exact", ["σ_θ", *(f"{m}, nat ↓" for m in lines)], rows, note,
        "distances", data="simulated",
    )  # fmt: skip
    report.pictures.append(
        pictures.curves(options.out, "figure-6-5-kl", DEGREES, lines, "exact distance, nat", True)
    )
    report.pictures.append(pictures.bananas(options.out, options.seed))


def sampled(options: RunOptions, report: Report) -> None:
    """Figures 6.3, 6.5 and 6.6 with samples, as the text has them."""
    rng = np.random.default_rng([options.seed, 1])
    found: dict[str, FloatArray] = {
        m: np.array([analysis.sampled_anes(s, m, rng) for s in np.radians(DEGREES)]) for m in analysis.METHODS
    }
    report.add(
        "Consistency of converted measurements, 500 samples", ["method", "ANES at 2.5°", "ANES at 20°"],
        [[m, values[4], values[-1]] for m, values in found.items()], "2 is consistent.",
        "consistency-sampled", data="simulated", samples=analysis.ANES_SAMPLES,
    )  # fmt: skip
    report.pictures.append(
        pictures.curves(options.out, "figure-6-3-anes", DEGREES, found, "ANES, 500 measurements", True)
    )
    _binned(report, rng)
    steps = np.arange(0.5, 5.01, 0.25)
    sets = options.share(100, 20)
    passing = np.array([analysis.passing_fraction(np.radians(s), sets, rng) for s in steps])
    report.add(
        "Sets of 500 samples that pass Mardia's test", ["σ_θ", "passing, %"],
        [[f"{s:g}°", 100.0 * f] for s, f in zip(steps[::2], passing[::2], strict=True)],
        "In the text (Figure 6.6) none passes above 2.5°.", "mardia", data="simulated", samples=sets,
    )  # fmt: skip
    report.pictures.append(
        pictures.curves(options.out, "figure-6-6-mardia", steps, {"passing": passing}, "fraction", False)
    )


def _binned(report: Report, rng: np.random.Generator) -> None:
    """Figure 6.5 with the text's bins, and where its order comes from."""
    rows: list[list[object]] = []
    for degrees in SOME:
        for m in analysis.METHODS[:4]:
            b = analysis.binned_kl(np.radians(degrees), m, rng)
            row = [b.every_bin, b.around_gaussian, b.skipping_empty, 100.0 * b.dropped_empty]
            rows.append([f"{degrees}°", m, *row])
    columns = [
        "σ_θ",
        "method",
        "all bins, nat ↓",
        "bins on the Gaussian, nat ↓",
        "empty bins skipped, nat ↓",
        "samples skipped, %",
    ]
    note = (
        "Some samples lie where the Gaussian has no mass. If their bins are skipped, linearisation looks best at large "
        "angles."
    )
    report.add(
        "Kullback-Leibler distance over bins", columns, rows, note, "distances-binned",
        data="simulated", samples=analysis.KL_SAMPLES,
    )  # fmt: skip


def operating_points(options: RunOptions, report: Report) -> None:
    """Figure 6.8."""
    rng = np.random.default_rng([options.seed, 2])
    points = limits.operating_points()
    # The seeds share out the points: none is judged twice.
    order = np.random.default_rng(2).permutation(len(points))
    chosen = order[options.seed % options.seeds :: options.seeds][: options.share(405, 50)]
    seeds = rng.integers(2**31, size=len(chosen)).tolist()
    calls = [(*points[k], 0.0, seed) for k, seed in zip(chosen, seeds, strict=True)]
    found = each(limits.find_limit, calls, options.jobs)
    late = 100.0 * float(np.mean([x.by_ratio > x.measured + np.radians(0.5) for x in found]))
    shares = [
        [100.0 * by(found, degrees) for degrees in (1.0, 0.5)]
        for by in (limits.within, limits.best_fixed_angle)
    ]
    rows: list[list[object]] = [
        ["K = 1.075", shares[0][0], 99.5, shares[0][1], 63.9, late],
        ["best single angle", shares[1][0], 37, shares[1][1], "", ""],
    ]
    columns = [
        "measure",
        "within 1°, % ↑",
        "text: within 1°, %",
        "within 0.5°, % ↑",
        "text: within 0.5°, %",
        "more than 0.5° too large, % ↓",
    ]
    note = "Ranges 1 to 10 m, σ_r 0.01 to 0.05 m, all around: drawn from the text's 810 points."
    printed = dict.fromkeys((columns[2], columns[4]), "Figure 6.8")
    title = "The largest angle that is still Gaussian, predicted"
    report.add(title, columns, rows, note, "limits", printed, data="simulated", samples=len(found))
    boxes = limits.normalised(found)
    rows = [[name, float(np.subtract(*np.nanpercentile(v, [75, 25])))] for name, v in boxes.items()]
    note = "In the text (Figure 6.8) it is least for K, and most for the absolute bias and the angle."
    report.add(
        "How much the critical value varies", ["measure", "interquartile range over mean ↓"], rows, note,
        "boxes", data="simulated", samples=len(found),
    )  # fmt: skip
    report.pictures.append(pictures.boxes(options.out, "figure-6-8-boxes", boxes, "critical value / mean"))


def where_k_fails(options: RunOptions, report: Report) -> None:
    """Operating points outside the text's: much range noise, an uncertain robot."""
    rng = np.random.default_rng([options.seed, 3])
    rows: list[list[object]] = []
    noises = (0.02, 0.2) if options.quick else (0.001, 0.005, 0.02, 0.05, 0.08, 0.1, 0.2, 0.3)
    for relative in noises:
        x = limits.find_limit(1.0, 0.0, relative, 0.0, int(rng.integers(2**31)))
        rows.append([f"{relative:g}", np.degrees(x.measured), np.degrees(x.by_ratio)])
    note = (
        "Only σ_r / range matters. If it is large, the product of both noises is not Gaussian even at tiny angles. K "
        "shows this only from 0.3 on, where it exceeds 1.075 at every angle. A hyphen: no angle is small enough."
    )
    columns = ["σ_r / range", "largest angle, °", "largest by K, °"]
    title = "Where K fails: range noise large against the range"
    report.add(title, columns, rows, note, "range-noise", data="simulated")
    rows = []
    far = (2.0, 8.0) if options.quick else (2.0, 4.0, 6.0, 8.0)
    for p, r in [(p, r) for p in (0.02, 0.05, 0.1) for r in far]:
        x = limits.find_limit(r, 0.0, 0.02, p, int(rng.integers(2**31)))
        angles = [float(np.degrees(a)) for a in (x.measured, x.by_ratio, x.by_polar_ratio)]
        rows.append([f"{p:g} m", f"{r:g} m", *angles])
    means = [float(np.mean([abs(row[k] - row[2]) for row in rows])) for k in (3, 4)]  # type: ignore[operator]
    rows.append(["all", "mean error", "", *means])
    columns = ["σ_position", "range", "largest angle, °", "by K in the map, °", "by K of the measurement, °"]
    note = "σ_r = 0.02 m. K in the map takes the covariance of the robot's position in."
    title = "K with an uncertain robot position"
    report.add(title, columns, rows, note, "robot-position", data="simulated")


def drive(options: RunOptions, report: Report) -> None:
    """Figure 6.11."""
    simulated = driving.drive(*options.draws(4))
    if options.quick:
        simulated = driving.RecordedDrive(
            simulated.stamps[::10], simulated.path[::10], simulated.covariances[::10]
        )
    ranges: dict[str, FloatArray] = {}
    rows: list[list[object]] = []
    for degrees in (1, 2, 3):
        for label, with_position in (("measurement", False), ("map", True)):
            values = np.array(
                [driving.critical_range(P, np.radians(degrees), with_position) for P in simulated.covariances]
            )
            ranges[f"σ_θ,obj = {degrees}°, K in {label}"] = values
            rows.append([f"{degrees}°", label, *np.percentile(values, [10, 50, 90]).tolist()])
    note = (
        "A simulated drive of 24 m replaces the text's log. In the text (Figure 6.11) the range is 2.5 to 6 m most of "
        "the time, and below 10 m most of the time from 2° on."
    )
    columns = ["σ_θ,obj", "K of", "10 of 100 below, m", "median, m", "90 of 100 below, m"]
    title = "Range from which on K exceeds 1.075"
    report.add(title, columns, rows, note, "drive", data="simulated", samples=len(simulated.stamps))
    report.pictures.append(pictures.drive_ranges(options.out, simulated, ranges))


def comparison(options: RunOptions, report: Report) -> None:
    """Section 6.8.2: error and consistency of the filters on the same walks."""
    rows: list[list[object]] = []
    count = options.share(40, 6)
    seeds = options.draws(5, count)
    for scenario, seconds in {1: 6.0, 2: 12.0, 3: 12.0}.items():
        found = tracking.paired(
            scenario, seeds, 4.0 if options.quick else seconds, tracking.FILTERS, options.jobs
        )
        ours = found["switching"]
        for name, values in found.items():
            less: list[object] = [
                1e3 * float((ours[:, 0] - values[:, 0]).mean()),
                float((np.abs(ours[:, 1] - 2) - np.abs(values[:, 1] - 2)).mean()),
            ]
            rows.append(
                [
                    f"scenario {scenario}",
                    name,
                    1e3 * float(values[:, 0].mean()),
                    float(values[:, 1].mean()),
                    *(["", ""] if name == "switching" else less),
                    float(1e6 * np.median(values[:, 2])),
                ]
            )
    columns = [
        "scenario",
        "filter",
        "RMSE, mm ↓",
        "ANEES",
        "RMSE of switching less its, mm ↓",
        "|ANEES - 2| of switching less its ↓",
        "step, µs ↓",
    ]
    note = (
        "Walks of 6, 12 and 12 s, the same for all filters. An ANEES of 2 is consistent. 'polar K' leaves the robot's "
        "position covariance out of K, as the text's modes imply. 'plain Kalman' aligns the measurement's covariance "
        "with the measured bearing, all others with the predicted one. So these are ours without the robot's position "
        "in K, without Kalman steps, without particles, and without particles and the predicted bearing. The text "
        "prints no errors of its filters."
    )
    title = "Error and consistency of the filters"
    report.add(title, columns, rows, note, "filters", data="simulated", samples=count)


def between(options: RunOptions, report: Report) -> None:
    """Is there room for a mode between the Kalman filter and 250 samples?"""
    count = options.share(5, 5)
    seeds = options.draws(6, count)
    found = tracking.paired(2, seeds, 2.0 if options.quick else 12.0, tracking.BETWEEN, options.jobs)
    plain = found["always Kalman"]
    rows: list[list[object]] = [
        [
            name,
            1e3 * float(values[:, 0].mean()),
            float(values[:, 1].mean()),
            1e3 * float((values[:, 0] - plain[:, 0]).mean()),
            float(1e6 * np.median(values[:, 2])),
        ]
        for name, values in found.items()
    ]
    note = (
        "Here K of the measurement demands particles all the time. A third mode, such as a Gaussian mixture, cannot "
        "gain more than very many particles gain over the Kalman mode. So it pays only if the last row is clearly "
        "below 0."
    )
    columns = ["filter", "RMSE, mm ↓", "ANEES", "RMSE less the Kalman filter's, mm ↓", "step, µs ↓"]
    title = "What a third mode could gain, scenario 2"
    report.add(title, columns, rows, note, "between", data="simulated", samples=count)


PARTS = {
    "exact": Part(consistency, random=False),
    "samples": Part(sampled),
    "operating points": Part(operating_points),
    "where K fails": Part(where_k_fails),
    "drive": Part(drive),
    "filters": Part(comparison, quick_seeds=3),
    "between": Part(between),
    "costs": Part(costs.costs),
}

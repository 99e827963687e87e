"""When a converted measurement stops being Gaussian, and what a filter that switches then costs and gains.

Chapter 6 of the anchoring text: Figures 6.3 to 6.8 and 6.11 to 6.16, Tables 6.1 to 6.3.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from estimation.checks import FloatArray
from estimation.map_frame import convert_with_ratio
from evaluation.experiments import conversion_analysis as analysis
from evaluation.experiments import conversion_drive as driving
from evaluation.experiments import conversion_limits as limits
from evaluation.experiments import conversion_pictures as pictures
from evaluation.experiments import conversion_tracking as tracking
from evaluation.report import Options, Report, Table
from whereabouts.parallel import each


def run(options: Options) -> Report:
    """Every figure and table, theirs beside ours; the full run takes a few minutes on two cores."""
    report = Report("conversion")
    if options.quick:
        report.notes.append("quick: fewer repetitions, operating points and seeds; the same protocol.")
    consistency(options, report)
    distances(options, report)
    operating_points(options, report)
    drive(options, report)
    comparison(options, report)
    between(options, report)
    costs(options, report)
    return report


def consistency(options: Options, report: Report) -> None:
    """Figures 6.3, 6.4, 6.6."""
    rng = np.random.default_rng([options.seed, 1])
    degrees = np.arange(0.5, 20.25, 0.5)
    sigmas = np.radians(degrees)
    exact: dict[str, FloatArray] = {
        m: np.array([analysis.exact_anes(s, m) for s in sigmas]) for m in analysis.METHODS
    }
    sampled: dict[str, FloatArray] = {
        m: np.array([analysis.sampled_anes(s, m, rng) for s in sigmas]) for m in analysis.METHODS
    }
    theirs = {"linear": "2.5", "dcm": "16", "ucm": "20", "mucm": "20", "unscented": "-"}
    rows = []
    for m in analysis.METHODS:
        reach = float(np.degrees(analysis.consistent_up_to(sigmas, exact[m])))
        error = float(np.abs(exact[m] - 2).max())
        rows.append(
            [m, theirs[m], reach, float(exact[m][4]), float(exact[m][-1]), float(sampled[m][-1]), error]
        )
        report.figures[f"consistent_up_to_deg.{m}"] = reach
        report.figures[f"anes_error.{m}"] = error
    columns = [
        "method",
        "theirs, up to °",
        "ours, up to °",
        "ANES at 2.5°",
        "at 20°",
        "at 20°, 500",
        "largest |ANES - 2|",
    ]
    note = "Exact: by quadrature. Consistent: inside the 95 % interval of a mean over the text's 500 measurements."
    report.tables.append(
        Table("Figure 6.3: ANES of converted measurements (2 is consistent)", columns, rows, note)
    )
    report.pictures.append(
        pictures.curves(options.out, "figure-6-3-anes", degrees, sampled, "ANES, 500 measurements", True)
    )
    report.pictures.append(pictures.bananas(options.out, options.seed))
    repetitions = 20 if options.quick else 100
    steps = np.arange(0.5, 5.01, 0.25)
    passing = np.array([analysis.passing_fraction(np.radians(s), repetitions, rng) for s in steps])
    # The last angle at which any set passes: beyond it all fail.
    last = float(steps[np.flatnonzero(passing > 0)[-1]])
    report.figures["all_sets_fail_beyond_deg"] = last
    report.tables.append(
        Table(
            "Figure 6.6: fraction of sets of 500 samples that pass Mardia's test",
            ["σ_θ, °", "fraction"],
            [[float(s), float(f)] for s, f in zip(steps[::2], passing[::2], strict=True)],
            f"Theirs: none passes above 2.5°. Ours: none above {last:g}°.",
        )
    )
    report.pictures.append(
        pictures.curves(options.out, "figure-6-6-mardia", steps, {"passing": passing}, "fraction", False)
    )


def distances(options: Options, report: Report) -> None:
    """Figure 6.5, and where its order comes from."""
    rng = np.random.default_rng([options.seed, 2])
    rows = []
    for degrees in (2, 3, 5, 10, 20):
        for m in analysis.METHODS[:4]:
            b = analysis.binned_kl(np.radians(degrees), m, rng)
            exact = analysis.exact_kl(np.radians(degrees), m)
            rows.append(
                [degrees, m, exact, b.every_bin, b.around_gaussian, b.skipping_empty, b.dropped_empty]
            )
            report.figures[f"kl_exact.{m}.{degrees}deg"] = exact
            report.figures[f"kl_skipping.{m}.{degrees}deg"] = b.skipping_empty
    columns = [
        "σ_θ, °",
        "method",
        "exact",
        "all bins",
        "bins on Gaussian",
        "empty bins skipped",
        "share skipped",
    ]
    note = (
        "Theirs: linearisation has the smallest distance. It does not: without bins the MUCM has, as it must, "
        "being the Gaussian of the samples' own mean and covariance. Linearisation comes out smallest at large "
        "angles only where bins in which the Gaussian is empty are skipped, that is where the samples it misses "
        "(last column) are not counted against it."
    )
    report.tables.append(Table("Figure 6.5: Kullback-Leibler distance, nat", columns, rows, note))
    degrees_all = np.arange(0.5, 20.25, 0.5)
    lines: dict[str, FloatArray] = {
        m: np.array([analysis.exact_kl(np.radians(d), m) for d in degrees_all]) for m in analysis.METHODS[:4]
    }
    report.pictures.append(
        pictures.curves(options.out, "figure-6-5-kl", degrees_all, lines, "exact distance, nat", True)
    )


def operating_points(options: Options, report: Report) -> None:
    """Figure 6.8, and the operating points at which K fails."""
    points = limits.operating_points()[:: 31 if options.quick else 1]
    seeds = np.random.SeedSequence([options.seed, 3]).generate_state(len(points) + 200).tolist()
    calls = [(r, b, s, 0.0, seed) for (r, b, s), seed in zip(points, seeds, strict=False)]
    found = each(limits.find_limit, calls, options.jobs)
    rows = []
    for degrees, theirs, fixed in ((1.0, "99.5 %", "37 %"), (0.5, "63.9 %", "-")):
        ours, angle = limits.within(found, degrees), limits.best_fixed_angle(found, degrees)
        rows.append([degrees, theirs, f"{100 * ours:.1f} %", fixed, f"{100 * angle:.1f} %"])
        report.figures[f"ratio_within_{degrees:g}deg"] = ours
        report.figures[f"fixed_angle_within_{degrees:g}deg"] = angle
    late = float(np.mean([x.by_ratio > x.measured + np.radians(0.5) for x in found]))
    report.tables.append(
        Table(
            f"Figure 6.8: largest angle predicted by K = 1.075 at {len(found)} operating points",
            ["within, °", "theirs, K", "ours, K", "theirs, one angle", "ours, best one angle"],
            rows,
            f"Ranges 1-10 m, σ_r 0.01-0.05 m, all around. Predicted more than 0.5° too large: {100 * late:.1f} %.",
        )
    )
    spread = {k: float(np.subtract(*np.percentile(v, [75, 25]))) for k, v in limits.normalised(found).items()}
    rows = [[name, width] for name, width in spread.items()]
    note = "Theirs: least for K, most for the absolute bias and the angle (drawn only)."
    report.tables.append(
        Table(
            "Figure 6.8: height of the boxes (interquartile range over mean)", ["measure", "ours"], rows, note
        )
    )
    report.pictures.append(
        pictures.boxes(options.out, "figure-6-8-boxes", limits.normalised(found), "critical value / mean")
    )
    _failing_ratios(options, report, seeds[len(points) :])
    _with_position(options, report, seeds[len(points) + 50 :])


def _failing_ratios(options: Options, report: Report, seeds: list[int]) -> None:
    rows = []
    for relative, seed in zip((0.001, 0.005, 0.02, 0.05, 0.08, 0.1, 0.2, 0.3), seeds, strict=False):
        x = limits.find_limit(1.0, 0.0, relative, 0.0, seed)
        rows.append([relative, _degrees(x.measured), _degrees(x.by_ratio)])
    note = (
        "Scale does not matter, only σ_r / range. From about 0.1 on the product of both noises is not Gaussian "
        "even for tiny angles, which K does not see until 0.3, where it exceeds 1.075 at any angle."
    )
    columns = ["σ_r / range", "largest angle, °", "by K, °"]
    report.tables.append(Table("Where K fails: range noise large against the range", columns, rows, note))


def _with_position(options: Options, report: Report, seeds: list[int]) -> None:
    grid = [(p, r) for p in (0.02, 0.05, 0.1) for r in (2.0, 4.0, 6.0, 8.0)]
    found = [limits.find_limit(r, 0.0, 0.02, p, seed) for (p, r), seed in zip(grid, seeds, strict=False)]
    rows = [
        [x.position, x.range, _degrees(x.measured), _degrees(x.by_ratio), _degrees(x.by_polar_ratio)]
        for x in found
    ]
    errors = {
        by: float(np.degrees(np.mean([abs(getattr(x, by) - x.measured) for x in found])))
        for by in ("by_ratio", "by_polar_ratio")
    }
    report.figures["position_map_ratio_error_deg"] = errors["by_ratio"]
    report.figures["position_polar_ratio_error_deg"] = errors["by_polar_ratio"]
    note = (
        f"σ_r = 0.02 m. Mean error {errors['by_ratio']:.2f}° with the position's covariance in K (too late), "
        f"{errors['by_polar_ratio']:.2f}° without (too early)."
    )
    columns = [
        "σ_position, m",
        "range, m",
        "largest angle, °",
        "by K in the map, °",
        "by K of the measurement, °",
    ]
    report.tables.append(Table("K with an uncertain robot position", columns, rows, note))


def drive(options: Options, report: Report) -> None:
    """Figure 6.11."""
    simulated = driving.drive(options.seed)
    if options.quick:
        simulated = driving.Drive(simulated.stamps[::10], simulated.path[::10], simulated.covariances[::10])
    ranges: dict[str, FloatArray] = {}
    rows = []
    for degrees in (1, 2, 3):
        for label, with_position in (("measurement", False), ("map", True)):
            values = np.array(
                [driving.critical_range(P, np.radians(degrees), with_position) for P in simulated.covariances]
            )
            ranges[f"σ_θ,obj = {degrees}°, K in {label}"] = values
            low, middle, high = np.percentile(values, [10, 50, 90])
            rows.append([degrees, label, float(low), float(middle), float(high)])
            report.figures[f"critical_range_m.{label}.{degrees}deg"] = float(middle)
    note = (
        f"A simulated {simulated.length:.0f} m drive in place of the AMIGO log. Theirs: 2.5 to 6 m most of the time, "
        "below 10 m most of the time for 2° and more."
    )
    columns = ["σ_θ,obj, °", "K of", "10 %, m", "median, m", "90 %, m"]
    report.tables.append(Table("Figure 6.11: range from which on K exceeds 1.075", columns, rows, note))
    report.pictures.append(pictures.drive_ranges(options.out, simulated, ranges))


def comparison(options: Options, report: Report) -> None:
    """Error and consistency of the filters on the same walks."""
    rows = []
    plan = {1: (100, 6.0), 2: (100, 12.0), 3: (100, 12.0)}
    if options.quick:
        plan = dict.fromkeys(plan, (3, 4.0))
    for scenario, (seeds, seconds) in plan.items():
        names = list(tracking.FILTERS)
        found = tracking.paired(scenario, seeds, seconds, names, options.jobs)
        ours = found["switching"]
        for name in names:
            values = found[name]
            error, error_ci = tracking.difference(ours[:, 0], values[:, 0])
            off, off_ci = tracking.difference(np.abs(ours[:, 1] - 2), np.abs(values[:, 1] - 2))
            rows.append(
                [
                    scenario,
                    name,
                    float(values[:, 0].mean()),
                    float(values[:, 1].mean()),
                    "-" if name == "switching" else f"{1e3 * error:+.2f} ± {1e3 * error_ci:.2f} mm",
                    "-" if name == "switching" else f"{off:+.3f} ± {off_ci:.3f}",
                    float(1e6 * np.median(values[:, 2])),
                ]
            )
            key = f"scenario{scenario}.{name}"
            report.figures[f"{key}.rmse_m"] = float(values[:, 0].mean())
            report.figures[f"{key}.anees"] = float(values[:, 1].mean())
            report.figures[f"{key}.rmse_difference_m"] = error
            report.figures[f"{key}.anees_error_difference"] = off
    columns = [
        "scenario",
        "filter",
        "RMSE, m",
        "ANEES (2)",
        "RMSE: ours - its",
        "|ANEES - 2|: ours - its",
        "µs/step",
    ]
    note = (
        f"The same {plan[1][0]}, {plan[2][0]} and {plan[3][0]} walks of {plan[1][1]:g}, {plan[2][1]:g} and "
        f"{plan[3][1]:g} s for all; mean and 95 % interval of the paired difference, negative where the switching "
        "filter is better. 'polar K' leaves the robot's position covariance out of K, as the text's modes imply; "
        "'plain Kalman' aligns the measurement's covariance with the measured bearing, all others with the predicted."
    )
    report.tables.append(Table("Section 6.8.2: error and consistency", columns, rows, note))


def between(options: Options, report: Report) -> None:
    """Is there room for a mode between the Kalman filter and 250 samples?"""
    found = tracking.between(2 if options.quick else 15, 2.0 if options.quick else 12.0, options.jobs)
    rows = []
    for name, values in found.items():
        error, half = tracking.difference(values[:, 0], found["always Kalman"][:, 0])
        rows.append(
            [
                name,
                float(values[:, 0].mean()),
                float(values[:, 1].mean()),
                "-" if name == "always Kalman" else f"{1e3 * error:+.2f} ± {1e3 * half:.2f} mm",
                float(1e6 * np.median(values[:, 2])),
            ]
        )
        report.figures[f"between.{name}.rmse_m"] = float(values[:, 0].mean())
        report.figures[f"between.{name}.rmse_difference_m"] = error
        report.figures[f"between.{name}.step_us"] = float(1e6 * np.median(values[:, 2]))
    pays = error + half < 0.0
    verdict = "It is." if pays else "It is not: the particles' own noise costs more than the bend."
    if options.quick:
        verdict = "Two short walks cannot tell."
    note = (
        "K of the measurement asks for particles all the time here. A third mode, such as a Gaussian mixture, can gain "
        "at most what very many particles gain over the Kalman mode: it pays only if the last row is clearly below 0. "
        + verdict
    )
    columns = ["filter", "RMSE, m", "ANEES (2)", "RMSE: its - Kalman's", "µs/step"]
    report.tables.append(Table("Room between the modes, scenario 2", columns, rows, note))


def costs(options: Options, report: Report) -> None:
    """Tables 6.1 to 6.3, Figures 6.12 to 6.16: one long walk per scenario, timed alone."""
    seconds = 5.0 if options.quick else 100.0
    tracking.track(tracking.walk(3, 0, 3.0), 0, position_in_ratio=False)  # compile outside the timing
    scenes = {s: tracking.walk(s, options.seed, seconds) for s in (1, 2, 3)}
    runs = {
        (s, name): tracking.track(scenes[s], options.seed, **tracking.FILTERS[name])
        for s in scenes
        for name in ("switching", "switching, polar K", "always particles")
    }
    rows = []
    for s in scenes:
        full = runs[s, "always particles"].cost
        for name, theirs in (("switching", {1: "0.7 %", 2: "-", 3: "64 %"}[s]), ("switching, polar K", "")):
            share = runs[s, name].cost / full
            rows.append([s, name, 1e3 * runs[s, name].cost, 1e3 * full, theirs, f"{100 * share:.2f} %"])
            report.figures[f"cost_share.scenario{s}.{name}"] = share
    columns = ["scenario", "filter", "total, ms", "always particles, ms", "theirs", "share"]
    report.tables.append(Table("Cost against an always-particle filter of the same size", columns, rows))
    _tables_of_the_text(report, {s: runs[s, "switching, polar K"] for s in scenes}, runs[3, "switching"])
    _pictures_of_the_text(
        options, report, {s: runs[s, "switching, polar K"] for s in scenes}, runs[3, "switching"]
    )


def _tables_of_the_text(report: Report, polar: dict[int, tracking.Run], chosen: tracking.Run) -> None:
    ratio_ms = _ratio_time()
    ms = tracking.mean_ms
    kf, pf = ("KF",), ("PF, Gaussian", "PF, tested")
    predict = {s: 1e3 * float(np.mean(polar[s].predict_time[1:])) for s in polar}
    counts = {s: Counter(polar[s].kinds) for s in polar}
    in_kf = chosen.particles[1:] == 0
    rows = [
        ["6.1", "KF update steps", 3999, counts[1]["KF"]],
        ["6.1", "KF update, ms", 5.6e-3, ms(polar[1], *kf)],
        ["6.1", "KF prediction, ms", 4.2e-3, predict[1]],
        ["6.1", "K, ms (ours in a batch of 1,000)", 5.9e-3, ratio_ms],
        ["6.2", "PF update steps", 3999, sum(n for k, n in counts[2].items() if k.startswith("PF"))],
        ["6.2", "PF update (samples), ms", 1.26, ms(polar[2], "PF, samples")],
        ["6.2", "PF prediction, ms", 0.88, predict[2]],
        ["6.3", "KF update steps", 507, counts[3]["KF"]],
        ["6.3", "PF update steps (Gaussian)", 2686, sum(counts[3][k] for k in (*pf, "PF to KF"))],
        ["6.3", "PF update steps (samples)", 806, counts[3]["PF, samples"] + counts[3]["KF to PF"]],
        ["6.3", "KF update, ms", 5.8e-3, ms(polar[3], *kf)],
        ["6.3", "PF update (Gaussian), ms", 0.28, ms(polar[3], "PF, Gaussian")],
        ["6.3", "PF update (samples), ms", 1.25, ms(polar[3], "PF, samples")],
        ["6.3", "KF to PF switch, ms", 0.93, ms(polar[3], "KF to PF") - ms(polar[3], "PF, samples")],
        ["6.3", "Mardia test (and switch back), ms", 6.76, _tested(polar[3]) - ms(polar[3], "PF, Gaussian")],
        ["6.3", "KF update steps, K in the map", "-", int(in_kf.sum()) + 1],
    ]
    note = (
        "Their machine was a 2.8 GHz laptop of 2008 and C++; compare ratios, not milliseconds. K without the robot's "
        "position, as in the text; the last row is this project's choice. Processor time, argument checks included."
    )
    report.tables.append(Table("Tables 6.1 to 6.3", ["table", "figure", "theirs", "ours"], rows, note))


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


def _degrees(angle: float) -> float | str:
    return "none" if not np.isfinite(angle) else float(np.degrees(angle))

"""Where people are going: correct exits of a hall, displacement errors at a hotel, how much paths swing, and times.

Chapter 4 of the anchoring text: Figures 4.6 to 4.13. The hall is the text's, on another day than the two it used: the
data has 1 August with 146 walks (many fragments and people standing about), the text 30 July and 10 September.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments import intentions_days as elsewhere
from evaluation.experiments import intentions_pictures as pictures
from evaluation.experiments import intentions_protocol as protocol
from evaluation.report import Options, Report, Table
from tracking.intentions import IntentionConfig, IntentionModel
from tracking.social_forces import Forces
from tracking.social_forces_fit import fit_forces
from whereabouts.logs.trajectories import read_trajectories
from whereabouts.progress import track

Array = NDArray[np.float64]
HALL, HOTEL = "edinburgh_01Aug.txt.gz", "hotel_obsmat.txt.gz"
THEIRS = {"ghmm": (0.56, None, None, None, 0.90), "linear": (0.05, None, None, None, 0.77)}
NAMES = {"routes": "routes (default)", "ghmm": "plain GHMM", "linear": "linear + social forces"}


def run(options: Options) -> Report:
    """All tables and pictures; about four minutes, quick a fifth of it."""
    report = Report("intentions")
    complete: list[Array] = []
    walks: dict[int, Array] = {}
    folder = None if options.data is None else options.data / "trajectories"
    if folder is None or not (folder / HALL).exists():
        report.notes.append(f"{HALL} is absent: the hall is left out")
    else:
        complete = hall(options, report, list(read_trajectories(folder / HALL).trajectories.values()))
    if folder is None or not (folder / HOTEL).exists():
        report.notes.append(f"{HOTEL} is absent: the hotel is left out")
    else:
        walks = read_trajectories(folder / HOTEL).trajectories
        hotel(options, report, walks)
    elsewhere.other_days(options, report, complete, list(walks.values()), NAMES)
    timing(options, report)
    return report


def hall(options: Options, report: Report, walks: list[Array]) -> list[Array]:
    """Figures 4.6, 4.8, 4.9, the pictures, and how much paths swing; the complete walks."""
    both = np.concatenate(walks)
    low, high = both[:, :2].min(axis=0), both[:, :2].max(axis=0)
    complete = [walk for walk in walks if protocol.is_complete(walk, low, high)]
    by_time = sorted(walks, key=lambda walk: float(walk[0, 2]))
    days = {
        "complete walks, file order": complete,
        "complete walks, by time": sorted(complete, key=lambda walk: float(walk[0, 2])),
        "all, file order": walks,
        "all, by time": by_time,
    }
    ended = "complete walks, by time, learned when they had ended"
    days[ended] = days["complete walks, by time"]
    if not options.quick:
        order = np.random.default_rng(options.seed).permutation(len(complete))
        days["complete walks, shuffled"] = [complete[k] for k in order]
    rows: list[list[object]] = []
    for method in protocol.METHODS:
        if method in THEIRS:
            rows.append([f"theirs, {NAMES[method]}", "30 July", 500, *THEIRS[method]])
    kept: dict[str, dict[str, protocol.Online]] = {}
    for day, chosen in track(days.items(), "days"):
        kept[day] = {}
        for method in protocol.METHODS:
            outcome = kept[day][method] = protocol.online(chosen, method, ended=day == ended)
            rates = outcome.rates.tolist()
            rows.append([NAMES[method], day, len(outcome.correct), *(round(rate, 3) for rate in rates)])
            for fraction, rate in zip(protocol.FRACTIONS, rates, strict=True):
                report.figures[f"correct.{method}.{day}.{fraction:g}"] = rate
    columns = ["method", "walks", "predictions", *(f"{100 * f:g} %" for f in protocol.FRACTIONS)]
    note = (
        "Right: within 29 pixels (0.716 m) of the exit, after this share of the walk; learned online, the first 10 "
        "walks only learned. Theirs is another day with 500 walks; the text prints the first and the last number. "
        "Complete: from border to border (0.6 m) over more than 3 m and without standing about, as the text's day."
    )
    report.tables.append(Table("Figure 4.9: correct exits", columns, rows, note))
    shown = kept["complete walks, by time"]
    report.pictures.append(
        pictures.fractions(options.out, {NAMES[m]: o.rates for m, o in shown.items()}, THEIRS)
    )
    report.pictures.append(
        pictures.over_learned(options.out, {NAMES[m]: o.correct for m, o in kept["all, by time"].items()})
    )
    elsewhere.more_walks(options, report, complete, NAMES)
    growth(options, report, kept["all, by time"])
    swings(options, report, complete)
    model = kept["all, by time"]["ghmm"].model
    assert model is not None
    report.pictures.append(pictures.manifolds(options.out, model, walks))
    routes = IntentionModel()
    for walk in by_time:
        routes.learn(walk)
    report.pictures.append(pictures.consistency(options.out, by_time, complete))
    report.pictures.append(pictures.scenes(options.out, routes, by_time, "hall-scenes"))
    return complete


def growth(options: Options, report: Report, outcomes: dict[str, protocol.Online]) -> None:
    """Figure 4.6: size of map and model, and the time to learn a walk."""
    plain, routes = outcomes["ghmm"], outcomes["routes"]
    at = [k for k in (10, 25, 50, 100, len(plain.sizes) - 1) if k < len(plain.sizes)]
    rows = [
        [k + 1, *plain.sizes[k], round(plain.learn_ms[k], 2), round(routes.learn_ms[k], 2)]
        for k in sorted(set(at))
    ]
    columns = ["learned", "nodes", "states", "edges", "GHMM, ms per walk", "routes, ms per walk"]
    median = float(np.median(plain.learn_ms)), float(np.median(routes.learn_ms))
    report.figures |= {
        "learn_ms.ghmm": median[0],
        "learn_ms.routes": median[1],
        "nodes": float(plain.sizes[-1][0]),
        "states": float(plain.sizes[-1][1]),
        "edges": float(plain.sizes[-1][2]),
        "believe_ms.ghmm": float(np.median(plain.belief_ms)),
        "believe_ms.routes": float(np.median(routes.belief_ms)),
    }
    note = (
        f"Medians per whole walk: {median[0]:.2f} and {median[1]:.2f} ms; theirs is below 4 ms per measurement. "
        f"Belief over a whole partial walk: {report.figures['believe_ms.ghmm']:.2f} and "
        f"{report.figures['believe_ms.routes']:.2f} ms; theirs below 0.5 ms per measurement."
    )
    report.tables.append(Table("Figure 4.6: growth, 1 August by time", columns, rows, note))
    report.pictures.append(pictures.growth(options.out, plain))


def swings(options: Options, report: Report, walks: list[Array]) -> None:
    """Sections 4.6.4 and 4.6.5: consistency of the predicted path over time."""
    ordered = sorted(walks, key=lambda walk: float(walk[0, 2]))
    rows = []
    for method in protocol.METHODS:
        moved = protocol.swing(ordered, method, 15 if options.quick else 40)
        rows.append(
            [
                NAMES[method],
                len(moved),
                *(round(float(v), 3) for v in (moved.mean(), *np.percentile(moved, (50, 90)))),
            ]
        )
        report.figures[f"swing_m.{method}"] = float(moved.mean())
    columns = ["method", "moments", "mean, m", "median", "90 %"]
    note = "Mean distance of two predictions half a second apart over the 5 s both look at. Theirs: pictures."
    report.tables.append(
        Table("How much predicted paths swing, complete walks of the hall", columns, rows, note)
    )


def hotel(options: Options, report: Report, people: dict[int, Array]) -> None:
    """Displacement errors beside constant velocity."""
    stride = 4 if options.quick else 1
    variants = {
        "constant velocity, last step": ("last step", False),
        "constant velocity, mean of 8": ("mean of 8", False),
        "nothing learned": ("fresh", False),
        "learned online": ("learned", False),
        "learned online, with the others": ("learned", True),
    }
    rows: list[list[object]] = []
    horizons = (0, 1, 2, 3, 5, 7, 9, 11)
    for name, (method, others) in track(variants.items(), "hotel"):
        errors, squares = protocol.displacement(people, method, others=others, stride=stride)
        mean = errors.mean(axis=0)
        nees = float(squares.mean()) / 2.0 if len(squares) else None
        cells = [round(float(mean[k]), 3) for k in horizons]
        rows.append([name, len(errors), *cells, round(float(mean.mean()), 3), nees and round(nees, 2)])
        for k in range(protocol.AHEAD):
            report.figures[f"hotel.{name}.{0.4 * (k + 1):.1f}s"] = float(mean[k])
        report.figures[f"hotel.{name}.average"] = float(mean.mean())
    columns = ["prediction", "moments", *(f"{0.4 * (k + 1):.1f} s" for k in horizons), "average", "NEES"]
    note = "m; 3.2 s seen, 4.8 s predicted; NEES per dimension of the stated covariances, 1 is consistent."
    report.tables.append(Table("Hotel: average and final displacement errors", columns, rows, note))
    forces(report, list(people.values()))
    model = IntentionModel()
    ordered = sorted(people.values(), key=lambda rows_: float(rows_[-1, 2]))
    for walk in ordered[: len(ordered) // 2]:
        model.learn(walk)
    report.pictures.append(pictures.scenes(options.out, model, ordered[len(ordered) // 2 :], "hotel-scenes"))


def forces(report: Report, people: list[Array]) -> None:
    """Social-force parameters from the recording, destinations known; the text sets them by hand."""
    fitted = fit_forces(people)
    rows: list[list[object]] = [["theirs, at 24.7 mm a pixel", 4.0, None, 1.24, None]]
    for name, values, error in (
        ("default", Forces(), fitted.before),
        ("fitted", fitted.forces, fitted.error),
    ):
        rows.append([name, values.relaxation, values.people_strength, values.people_range, error])
    report.figures |= {
        "forces.relaxation_s": fitted.forces.relaxation,
        "forces.people_strength": fitted.forces.people_strength,
        "forces.people_range_m": fitted.forces.people_range,
        "forces.error_m": fitted.error,
        "forces.error_default_m": fitted.before,
    }
    columns = ["forces", "relaxation, s", "people, m/s²", "range, m", "error over 4.8 s, m"]
    note = (
        f"{fitted.followed} people at moments of their walks, half of the moments fitted, the other half judged. "
        "People turn faster to where they are known to go than the default has it, which does not know."
    )
    report.tables.append(Table("Hotel: social forces from data", columns, rows, note))


def timing(options: Options, report: Report) -> None:
    """Times with 500 learned trajectories between simulated exits, one core."""
    rows = []
    for method in ("routes", "ghmm"):
        model = IntentionModel(IntentionConfig(method=method))
        walks = simulated_walks(options.seed, 540)
        for walk in walks[:500]:
            model.learn(walk)
        partials = [walk[: len(walk) // 2] for walk in walks[500:520]]
        learn, believe, predict = [], [], []
        model.predict_all(partials, 10.0)
        for walk in walks[520:]:
            begun = time.process_time()
            model.learn(walk)
            learn.append(time.process_time() - begun)
        model.intentions(partials[0])
        for partial in partials:
            begun = time.process_time()
            model.intentions(partial)
            believe.append(time.process_time() - begun)
        for _ in range(5):
            begun = time.process_time()
            model.predict_all(partials, 10.0)
            predict.append(time.process_time() - begun)
        numbers = [1e3 * float(np.median(learn)), 1e3 * float(np.median(believe)), 1e3 * min(predict)]
        rows.append([NAMES[method], *(round(number, 2) for number in numbers)])
        for what, number in zip(("learn", "believe", "predict_20"), numbers, strict=True):
            report.figures[f"time_ms.{what}.{method}"] = number
    columns = ["method", "learn a walk, ms", "belief, ms per person", "20 people over 10 s, ms"]
    note = "500 learned walks of some 100 observations; the belief is over the whole walk so far."
    report.tables.append(Table("Times", columns, rows, note))


def simulated_walks(seed: int, count: int) -> list[Array]:
    """Walks (N, 3) between the exits of a simulated hall, each along a bend of its own, at 9 observations a second."""
    rng = np.random.default_rng(seed)
    exits = np.array(
        [[0.5, 0.3], [7.5, 0.2], [12.0, 0.2], [15.6, 0.8], [15.2, 11.0], [6.0, 11.0], [0.3, 7.0]]
    )
    walks = []
    for k in range(count):
        a, b = exits[rng.choice(len(exits), 2, replace=False)] + rng.normal(0.0, 0.25, (2, 2))
        pace = rng.uniform(0.9, 1.6)
        t = np.arange(0.0, np.hypot(*(b - a)) / pace, 1.0 / 9.0)
        share = np.linspace(0.0, 1.0, len(t))[:, None]
        bend = rng.normal(0.0, 0.6, 2) * np.sin(np.pi * share)
        points = a + share * (b - a) + bend + rng.normal(0.0, 0.03, (len(t), 2))
        walks.append(np.column_stack((points, 30.0 * k + t)))
    return walks

"""Where people are going: correct exits of a hall, displacement errors at a hotel, how much paths swing, and times.

Chapter 4 of the anchoring text: Figures 4.6 to 4.13. The hall is the text's, on another day than the two it used: the
data has 1 August with 146 walks (many fragments and people standing about), the text 30 July and 10 September. Choices
were made on that day, and one on the hotel's people (how sure a goal must be to stop a path).
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from evaluation.intentions import intentions_days as elsewhere
from evaluation.intentions import intentions_pictures as pictures
from evaluation.intentions import intentions_protocol as protocol
from evaluation.intentions.social_forces_fit import fit_forces
from evaluation.intentions.trajectories import read_trajectories
from evaluation.report import Part, Report, RunOptions
from tracking.intentions import IntentionConfig, IntentionModel
from tracking.prediction.social_forces import Forces
from whereabouts.system.progress import track

Array = NDArray[np.float64]
HALL, HOTEL = "trajectories/edinburgh_01Aug.txt.gz", "trajectories/hotel_obsmat.txt.gz"
NAMES = {
    "routes": "routes (default)",
    "ghmm": "plain GHMM",
    "linear": "linear + social forces",
    "printed": "as printed",
}
# Of the text, on another day: after 5 and after 85 % of the walk.
THEIRS = {"ghmm": (56, 90), "linear": (5, 77)}
BY_TIME = "complete walks, by time"


def walks_of(options: RunOptions, name: str) -> dict[int, Array]:
    """The walks of a recording."""
    assert options.data is not None
    return read_trajectories(options.data / name).trajectories


def complete_walks(options: RunOptions) -> list[Array]:
    """Of the hall those from border to border."""
    walks = list(walks_of(options, HALL).values())
    both = np.concatenate(walks)
    low, high = both[:, :2].min(axis=0), both[:, :2].max(axis=0)
    return [walk for walk in walks if protocol.is_complete(walk, low, high)]


def by_time(walks: list[Array]) -> list[Array]:
    """Ordered by their starts."""
    return sorted(walks, key=lambda walk: float(walk[0, 2]))


def hall(options: RunOptions, report: Report) -> None:
    """Figures 4.6, 4.8 and 4.9, and the pictures."""
    walks, complete = list(walks_of(options, HALL).values()), complete_walks(options)
    ended = "complete walks, by time, learned when they had ended"
    days = {BY_TIME: by_time(complete), "all, by time": by_time(walks)}
    if not options.quick:
        days |= {ended: by_time(complete), "complete walks, file order": complete, "all, file order": walks}
    rows: list[list[object]] = []
    kept: dict[str, dict[str, protocol.Online]] = {}
    for day, chosen in track(days.items(), "days"):
        kept[day] = {}
        for method in (*protocol.METHODS, *protocol.STAGES):
            outcome = kept[day][method] = protocol.online(chosen, method, ended=day == ended)
            theirs = THEIRS.get(method, ("", "")) if day == BY_TIME else ("", "")
            rows.append([day, NAMES.get(method, method), *(100.0 * outcome.rates).tolist(), *theirs])
    printed = {f"text: {elsewhere.COLUMNS[k]}": "Figure 4.9" for k in (0, -1)}
    note = (
        f"Right: within 29 pixels (0.716 m) of the exit. {elsewhere.ONLINE} Complete: from border to border (0.6 m), "
        "over more than 3 m, without standing about, as on the text's day, which had 500 walks. 'Learned "
        "when they had ended' is what a robot can know. The text learns each walk before the next is predicted. As "
        "printed: the plain GHMM, (4.1) to (4.11), and the text's benchmark, straight on."
    )
    columns = ["walks", "method", *elsewhere.COLUMNS, *printed]
    counts = {day: len(found["routes"].correct) for day, found in kept.items()}
    title = "Correct exits of the hall, 1 August"
    report.add(title, columns, rows, note, "hall", printed, "tuned on", counts)
    sure = [
        [day, NAMES[method], *elsewhere.surety([found[method]])]
        for day, found in kept.items()
        for method in ("routes", "ghmm")
    ]
    elsewhere.how_sure(report, sure, "sure-hall", "tuned on", sum(counts.values()))
    shown = {NAMES[method]: kept[BY_TIME][method].rates for method in protocol.METHODS}
    theirs_drawn = {
        NAMES[m]: (0.01 * low, None, None, None, 0.01 * high) for m, (low, high) in THEIRS.items()
    }
    report.pictures.append(pictures.fractions(options.out, shown, theirs_drawn))
    report.pictures.append(
        pictures.over_learned(
            options.out, {NAMES[m]: kept["all, by time"][m].correct for m in protocol.METHODS}
        )
    )
    growth(options, report, kept["all, by time"])
    model = kept["all, by time"]["ghmm"].model
    assert model is not None
    report.pictures.append(pictures.manifolds(options.out, model, walks))
    routes = IntentionModel()
    for walk in by_time(walks):
        routes.learn(walk)
    report.pictures.append(pictures.consistency(options.out, by_time(walks), complete))
    report.pictures.append(pictures.scenes(options.out, routes, by_time(walks), "hall-scenes"))


def growth(options: RunOptions, report: Report, outcomes: dict[str, protocol.Online]) -> None:
    """Figure 4.6: size of map and model, and the time to learn a walk."""
    plain, routes = outcomes["ghmm"], outcomes["routes"]
    at = sorted({k for k in (10, 25, 50, 100, len(plain.sizes) - 1) if k < len(plain.sizes)})
    rows: list[list[object]] = [
        [f"{k + 1} walks", *plain.sizes[k], plain.learn_ms[k], routes.learn_ms[k]] for k in at
    ]
    columns = [
        "learned",
        "nodes",
        "states",
        "edges",
        "plain GHMM: learn a walk, ms ↓",
        "routes: learn a walk, ms ↓",
    ]
    note = "The text learns a measurement in less than 4 ms and updates a belief in 0.5 ms. Here it is whole walks."
    title = "Growth of map and model, 1 August by time"
    report.add(title, columns, rows, note, "growth", data="tuned on", samples=1)
    report.pictures.append(pictures.growth(options.out, plain))


def swings(options: RunOptions, report: Report) -> None:
    """Sections 4.6.4 and 4.6.5: consistency of the predicted path over time."""
    rows: list[list[object]] = []
    counts = {}
    for method in (*protocol.METHODS, protocol.PRINTED):
        count = (4 if method == protocol.PRINTED else 10) if options.quick else 40
        moved = protocol.swing(by_time(complete_walks(options)), method, count)
        name = NAMES.get(method, "as printed")
        rows.append([name, float(moved.mean()), *np.percentile(moved, (50, 90)).tolist()])
        counts[name] = len(moved)
    columns = ["method", "mean, m ↓", "median, m ↓", "90 of 100 below, m ↓"]
    note = "Mean distance of two predictions half a second apart, over the 5 s both look at. The text has pictures."
    title = "How much predicted paths swing, complete walks of the hall"
    report.add(title, columns, rows, note, "swing", data="tuned on", samples=counts)


def orders(options: RunOptions, report: Report) -> None:
    """The hall's complete walks in random orders, and what the number of learned walks is worth."""
    walks = complete_walks(options)
    rng = np.random.default_rng([options.seed, 1])
    chosen = [rng.permutation(len(walks)) for _ in range(options.share(20, 5))]
    alone = [walk - [0.0, 0.0, walk[0, 2]] for walk in walks]
    note = "Complete walks of 1 August. Times count from the start of each walk, so nobody is known to come together."
    rows, _ = elsewhere.correct("hall, random orders", [[alone[k] for k in order] for order in chosen], NAMES)
    count = len(chosen) * (len(walks) - protocol.FIRST)
    columns = ["walks", "method", *elsewhere.COLUMNS]
    title = "Correct exits in random orders"
    report.add(title, columns, rows, note, "orders", data="tuned on", samples=count)
    elsewhere.more_walks(options, report, walks, NAMES)


def hotel(options: RunOptions, report: Report) -> None:
    """Displacement errors beside constant velocity, correct exits, and social forces."""
    people = walks_of(options, HOTEL)
    variants = {
        "constant velocity, last step": ("last step", False),
        "constant velocity, mean of 8": ("mean of 8", False),
        "nothing learned": ("fresh", False),
        "learned online": ("learned", False),
        "learned online, with the others": ("learned", True),
        "as printed (4.12) to (4.18)": (protocol.PRINTED, False),
        "as printed, with the others": (protocol.PRINTED, True),
    }
    rows: list[list[object]] = []
    horizons = (0, 1, 2, 3, 5, 7, 9, 11)
    moments: dict[str, int] = {}
    for name, (method, others) in track(variants.items(), "hotel"):
        stride = (30 if method == protocol.PRINTED else 10) if options.quick else 1
        errors, squares = protocol.displacement(people, method, others=others, stride=stride)
        mean = errors.mean(axis=0)
        nees: object = float(squares.mean()) / 2.0 if len(squares) else ""
        rows.append([name, *(float(mean[k]) for k in horizons), float(mean.mean()), nees])
        moments[name] = len(errors)
    columns = [
        "prediction",
        *(f"after {0.4 * (k + 1):.1f} s, m ↓" for k in horizons),
        "average, m ↓",
        "NEES per dimension",
    ]
    note = (
        "3.2 s are seen, 4.8 s predicted. NEES of the stated covariances: 1 is consistent. As printed: goals by the "
        "GHMM, the Kalman filter with social forces, Table 4.2 for everybody; mass and noises are not printed."
    )
    title = "Displacement errors at the hotel"
    report.add(title, columns, rows, note, "hotel", data="tuned on", samples=moments)
    gone = [walk for walk in people.values() if np.hypot(*(walk[-1] - walk[0])[:2]) > 3.0]
    rows, sure = elsewhere.correct("hotel", [by_time(gone)], NAMES)
    note = f"All people who walked more than 3 m. The exits are the open ends of a street. {elsewhere.ONLINE}"
    columns = ["walks", "method", *elsewhere.COLUMNS]
    title, count = "Correct exits at the hotel", len(gone) - protocol.FIRST
    report.add(title, columns, rows, note, "hotel-exits", data="tuned on", samples=count)
    elsewhere.how_sure(report, sure, "sure-hotel", "tuned on", count)
    forces(report, list(people.values()))
    model = IntentionModel()
    ordered = sorted(people.values(), key=lambda rows_: float(rows_[-1, 2]))
    for walk in ordered[: len(ordered) // 2]:
        model.learn(walk)
    report.pictures.append(pictures.scenes(options.out, model, ordered[len(ordered) // 2 :], "hotel-scenes"))


def forces(report: Report, people: list[Array]) -> None:
    """Social-force parameters from the recording, destinations known; the text sets them by hand."""
    fitted = fit_forces(people)
    rows: list[list[object]] = [
        [name, values.relaxation, values.people_strength, values.people_range, error]
        for name, values, error in (
            ("default", Forces(), fitted.before),
            ("fitted", fitted.forces, fitted.error),
        )
    ]
    columns = ["forces", "relaxation, s", "people, m/s²", "range, m", "error over 4.8 s, m ↓"]
    note = (
        "The model is fitted on half of the moments and judged on the other half. The text sets a relaxation "
        "of 4 s and a range of 1.24 m, at 24.7 mm a pixel."
    )
    title = "Social forces from the hotel's people"
    report.add(title, columns, rows, note, "forces", data="tuned on", samples=fitted.followed)


def timing(options: RunOptions, report: Report) -> None:
    """Times with 500 learned trajectories between simulated exits, one core."""
    rows: list[list[object]] = []
    learned = 100 if options.quick else 500
    for method in ("routes", "ghmm"):
        model = IntentionModel(IntentionConfig(method=method))
        walks = simulated_walks(options.draws(2)[0], learned + 40)
        for walk in walks[:learned]:
            model.learn(walk)
        partials = [walk[: len(walk) // 2] for walk in walks[learned : learned + 20]]
        learn, believe, predict = [], [], []
        model.predict_all(partials, 10.0)
        for walk in walks[learned + 20 :]:
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
        rows.append([NAMES[method], *numbers])
    columns = ["method", "learn a walk, ms ↓", "belief of a person, ms ↓", "20 people over 10 s, ms ↓"]
    note = f"{learned} learned walks of some 100 observations. The belief is over the whole walk so far."
    report.add("Times", columns, rows, note, "times", data="simulated", samples=20)


def days(options: RunOptions, report: Report) -> None:
    """Whole days of simulated walks, as many as on the text's day."""
    elsewhere.simulated_days(options, report, NAMES)


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


PARTS = {
    "hall": Part(hall, random=False, needs=(HALL,)),
    "swing": Part(swings, random=False, needs=(HALL,)),
    "orders": Part(orders, needs=(HALL,)),
    "hotel": Part(hotel, random=False, needs=(HOTEL,)),
    "days": Part(days),
    "times": Part(timing),
}

"""Correct exits on more than one day: over walks learned, and on simulated days."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evaluation.intentions import intentions_protocol as protocol
from evaluation.report import Report, RunOptions
from whereabouts.system.progress import track

Array = NDArray[np.float64]
COLUMNS = [f"after {f:g} of the walk, % ↑" for f in protocol.FRACTIONS]
ONLINE = "Learned online, one walk after the other; the first 10 are only learned."

# Exits of a simulated hall: place, axis along the border, deviation along it in m, how popular. The one of 0.8 m is no
# door but where people drift out of view.
EXITS = (
    ((7.5, 0.15), 0, 0.06, 5.0),
    ((15.6, 0.6), 1, 0.15, 6.0),
    ((15.2, 11.1), 0, 0.17, 6.0),
    ((12.1, 0.15), 0, 0.12, 2.5),
    ((5.7, 0.15), 0, 0.8, 1.1),
    ((15.6, 4.0), 1, 0.17, 1.5),
)
LOW, HIGH = np.array([0.15, 0.0]), np.array([15.75, 11.25])


def simulated_day(seed: int, count: int) -> list[Array]:
    """A day of `count` walks (N, 3) by their starts: habits that differ by day, each walk bent in its own way.

    From each exit people go to some others far more than to the rest, along the habitual bend of the pair; one in seven
    follows another person within 3 s to the same exit. Made so that the plain GHMM does on it as on a recorded day.
    """
    rng = np.random.default_rng(seed)
    popular = np.array([exit_[3] for exit_ in EXITS]) / sum(exit_[3] for exit_ in EXITS)
    habit = np.exp(2.5 * rng.standard_normal((len(EXITS), len(EXITS)))) * popular
    np.fill_diagonal(habit, 0.0)
    habit /= habit.sum(axis=1, keepdims=True)
    bends = np.abs(rng.normal(0.0, 0.9, habit.shape))
    walks: list[Array] = []
    now, pair, pace = 0.0, (0, 1), 1.2
    for _ in range(count):
        begun = now + rng.uniform(0.0, 3.0)
        if not walks or rng.random() > 0.15:
            now += rng.exponential(25.0)
            origin = int(rng.choice(len(EXITS), p=popular))
            begun, pair = now, (origin, int(rng.choice(len(EXITS), p=habit[origin])))
            pace = rng.uniform(0.9, 1.6)
        walks.append(_walk(rng, pair, bends[pair], pace, begun))
    return sorted(walks, key=lambda walk: float(walk[0, 2]))


def _walk(rng: np.random.Generator, pair: tuple[int, int], bend: float, pace: float, begun: float) -> Array:
    """One walk between two exits, at 9 observations a second; it bends towards the middle of the hall."""
    ends = []
    for which in pair:
        place, axis, width, _ = EXITS[which]
        point = np.array(place)
        point[axis] += rng.uniform(-width, width) if width > 0.5 else rng.normal(0.0, width)
        point[1 - axis] += rng.normal(0.0, 0.06)
        ends.append(point)
    way = ends[1] - ends[0]
    length = float(np.hypot(*way))
    across = np.array([-way[1], way[0]]) / length
    if across @ (0.5 * (LOW + HIGH) - 0.5 * (ends[0] + ends[1])) < 0.0:
        across = -across
    t = np.arange(0.0, max(1.1 * length / pace, 1.5), 1.0 / 9.0)
    share = t / (t[-1] + 1.0 / 9.0)
    waves = np.array(
        [rng.normal(0.0, s) * np.sin(k * np.pi * share) for k, s in ((1, 0.45), (2, 0.27), (3, 0.135))]
    )
    aside = min(1.0, length / 6.0) * (bend * np.sin(np.pi * share) ** 0.7 + waves.sum(axis=0))
    points = ends[0] + share[:, None] * way + aside[:, None] * across + rng.normal(0.0, 0.04, (len(t), 2))
    return np.column_stack((points.clip(LOW, HIGH), begun + t))


def correct(
    name: str, days: list[list[Array]], names: dict[str, str]
) -> tuple[list[list[object]], list[list[object]]]:
    """Per method a row with the mean share of correct exits over some days, %, and one of `surety`."""
    rows: list[list[object]] = []
    sure: list[list[object]] = []
    for method in protocol.METHODS:
        outcomes = [protocol.online(day, method) for day in track(days, f"{name}, {names[method]}")]
        rates = [outcome.rates for outcome in outcomes]
        rows.append([name, names[method], *(100.0 * np.mean(rates, axis=0)).tolist()])
        if method != "linear":
            sure.append([name, names[method], *surety(outcomes)])
    return rows, sure


def surety(outcomes: list[protocol.Online]) -> list[float]:
    """How often the first goal was right, %; how probable it was told to be, and among the goals alone, %."""
    right = np.mean([outcome.correct.mean() for outcome in outcomes])
    said = np.mean([outcome.said.mean(axis=(0, 1)) for outcome in outcomes], axis=0)
    return [100.0 * float(right), *(100.0 * said).tolist()]


def how_sure(report: Report, rows: list[list[object]], key: str, data: str, judged: int) -> None:
    """The table of `surety`."""
    columns = ["walks", "method", "right, % ↑", "told, %", "told among the goals alone, %"]
    note = "The first goal, over all moments. A probability that is honest is as large as what is right is frequent."
    report.add("How sure goals are told", columns, rows, note, key, data=data, samples=judged)


def more_walks(options: RunOptions, report: Report, walks: list[Array], names: dict[str, str]) -> None:
    """What the number of learned walks is worth, as the recorded day has a sixth of the text's."""
    rows: list[list[object]] = []
    judged = options.share(150, 15)
    for count in track((10, 20, 45, len(walks) - 1), "walks learned"):
        for method in ("routes", "ghmm"):
            rng = np.random.default_rng([options.seed, 3])
            rates = protocol.held_out(walks, method, count, judged, rng)
            rows.append([f"after {count} others", names[method], *(100.0 * rates).tolist()])
    note = "Each walk is judged after others drawn at random. Times are unknown."
    title = "Correct exits over walks learned, complete walks of 1 August"
    columns = ["learned", "method", *COLUMNS]
    report.add(title, columns, rows, note, "learned", data="tuned on", samples=judged)


def simulated_days(options: RunOptions, report: Report, names: dict[str, str]) -> None:
    """Correct exits online on days of 510 walks, as many as on the text's day."""
    count = 60 if options.quick else 510
    day = simulated_day(options.draws(4)[0], count)
    rows, sure = correct("simulated day", [day], names)
    note = f"Six exits, {count} walks, habits drawn anew for each day. {ONLINE}"
    columns = ["walks", "method", *COLUMNS]
    title, judged = "Correct exits on simulated days", count - protocol.FIRST
    report.add(title, columns, rows, note, "days", data="simulated", samples=judged)
    how_sure(report, sure, "sure-days", "simulated", judged)

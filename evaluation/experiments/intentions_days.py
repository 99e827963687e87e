"""Correct exits beyond the recorded day: over walks learned, in random orders, at the hotel, on simulated days."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments import intentions_protocol as protocol
from evaluation.report import Options, Report, Table
from whereabouts.progress import track

Array = NDArray[np.float64]
COLUMNS = [f"{100 * f:g} %" for f in protocol.FRACTIONS]

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


def more_walks(options: Options, report: Report, walks: list[Array], names: dict[str, str]) -> None:
    """What the number of learned walks is worth, as the recorded day has a sixth of the text's."""
    rows: list[list[object]] = []
    for method in ("routes", "ghmm"):
        for count in track((10, 20, 45, len(walks) - 1), f"{names[method]}, walks learned"):
            repeats = 1 if options.quick or count == len(walks) - 1 else 5
            rates = np.mean(
                [protocol.held_out(walks, method, count, options.seed + k) for k in range(repeats)], axis=0
            )
            rows.append([names[method], count, repeats * len(walks), *(round(float(r), 3) for r in rates)])
            for fraction, rate in zip(protocol.FRACTIONS, rates, strict=True):
                report.figures[f"held_out.{method}.{count}.{fraction:g}"] = float(rate)
    note = (
        "Each complete walk after others drawn at random, times unknown: online, half of this day's 81 predictions "
        "are made with fewer than 50 walks, a tenth of the text's 500."
    )
    columns = ["method", "learned", "predictions", *COLUMNS]
    report.tables.append(Table("Correct exits over walks learned, 1 August", columns, rows, note))


def other_days(
    options: Options, report: Report, walks: list[Array], hotel: list[Array], names: dict[str, str]
) -> None:
    """Correct exits online, mean and deviation over days: one day is little to judge by.

    walks : the complete ones of the recorded hall; hotel : walks of the other place. Either may be empty.
    """
    rows: list[list[object]] = []
    for name, days in _days(options, walks, hotel):
        for method in protocol.METHODS:
            outcomes = [protocol.online(day, method) for day in track(days, f"{name}, {names[method]}")]
            rates = np.array([outcome.rates for outcome in outcomes])
            mean, spread = rates.mean(axis=0), rates.std(axis=0)
            told = [
                f"{m:.3f} ± {s:.3f}" if len(days) > 1 else f"{m:.3f}"
                for m, s in zip(mean, spread, strict=True)
            ]
            rows.append([names[method], name, len(days), len(outcomes[0].correct), *told])
            for fraction, rate in zip(protocol.FRACTIONS, mean, strict=True):
                report.figures[f"days.{method}.{name}.{fraction:g}"] = float(rate)
    note = (
        "Online, within 0.716 m, mean and deviation over days. Random orders: times count from each start, so that "
        "nobody knows who came together. Hotel: all who got on by more than 3 m, by time; its exits are the open ends "
        "of a street. Simulated: six exits, habits drawn anew for each day, 510 walks."
    )
    columns = ["method", "walks", "days", "predictions each", *COLUMNS]
    report.tables.append(Table("Correct exits on other days", columns, rows, note))


def _days(
    options: Options, walks: list[Array], hotel: list[Array]
) -> Iterator[tuple[str, list[list[Array]]]]:
    alone = [walk - [0.0, 0.0, walk[0, 2]] for walk in walks]
    rng = np.random.default_rng(options.seed)
    if walks:
        orders = [rng.permutation(len(walks)) for _ in range(3 if options.quick else 20)]
        yield "hall, complete, random orders", [[alone[k] for k in order] for order in orders]
    gone = [walk for walk in hotel if np.hypot(*(walk[-1] - walk[0])[:2]) > 3.0]
    if gone:
        yield "hotel", [sorted(gone, key=lambda walk: float(walk[0, 2]))]
    seeds, count = (1, 120) if options.quick else (4, 510)
    yield f"simulated, {count} walks", [simulated_day(options.seed + k, count) for k in range(seeds)]

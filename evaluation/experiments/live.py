"""A robot that acts on what it knows: beliefs kept by maintenance and a thing fetched, beside patrol and direct search.

Every day is drawn anew: three people, each of whom carries two of six things to other furniture after the robot's first
tour. All robots have the same camera, base, world model and first tour; the patrol gets the metres that maintenance
took. Parameters are those shipped. There is no ROS in it: the robot knows its pose and tracks nobody.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.demo.live.live_library import LibraryRobot, Outcome
from evaluation.parallel import each
from evaluation.report import Part, Report, RunOptions, Table
from whereabouts.simulation.home.live_apartment import HOME_OF, REACH, LiveDay

MAINTAINED, TIMEOUT = 200.0, 240.0
"""s of keeping beliefs, and of the search."""
DAYS, QUICK_DAYS = 40, 1


@dataclass
class Day:
    """One day.

    kept : by maintenance, by patrol. searched : our way, directly; both begin with what maintenance has kept.
    """

    asked: str
    kept: tuple[Outcome, Outcome]
    searched: tuple[Outcome, Outcome]


def live_day(seed: int, maintained: float = MAINTAINED) -> Day:
    """One day, with all four robots from the same first tour."""
    asked = sorted(HOME_OF)[int(np.random.default_rng([seed, 8]).integers(len(HOME_OF)))]
    ours = LibraryRobot(LiveDay(seed, scans=False, clouds=False))
    ours.tour()
    patrol = copy.deepcopy(ours)
    ours.maintain(maintained)
    patrol.patrol(maintained, ours.outcome.metres)
    kept = copy.deepcopy(ours.outcome), patrol.outcome
    direct = copy.deepcopy(ours)
    ours.fetch(asked, TIMEOUT)
    direct.fetch(asked, TIMEOUT, direct=True)
    return Day(asked, kept, (ours.outcome, direct.outcome))


def _days(options: RunOptions, report: Report) -> None:
    """Both questions about the same days."""
    count = options.share(DAYS, QUICK_DAYS)
    seeds = options.draws(29, count)
    maintained = 120.0 if options.quick else MAINTAINED
    found = each(live_day, [(seed, maintained) for seed in seeds], options.jobs, "days")
    report.tables += [_search_table(found), _maintenance_table(found, maintained)]


def _search_table(days: Sequence[Day]) -> Table:
    rows: list[list[object]] = []
    for index, name in enumerate(("search", "direct search")):
        runs = [day.searched[index] for day in days]
        there = [run.reached <= REACH for run in runs]
        right = [run.fetched == day.asked for run, day in zip(runs, days, strict=True)]
        wrong = [run.fetched not in (None, day.asked) for run, day in zip(runs, days, strict=True)]
        rows.append(
            [
                name, 100.0 * float(np.mean(there)), 100.0 * float(np.mean(right)), 100.0 * float(np.mean(wrong)),
                _mean(runs, lambda run: run.searched), _mean(runs, lambda run: run.seconds),
                _mean(runs, lambda run: float(len(run.failures))),
            ]
        )  # fmt: skip
    columns = [
        "", "reached, % ↑", "right one fetched, % ↑", "wrong one fetched, % ↓", "driven, m ↓", "time, s ↓",
        "failures on the way ↓",
    ]  # fmt: skip
    note = (
        f"Reached: the robot stands within {REACH:g} m of the asked thing and believes it to be there. Wanted: 95 %. "
        "Both begin with what maintenance has kept. Direct: to where it was seen last, then from room to room."
    )
    return Table(
        "The robot is asked for a thing that was carried about", columns, rows, note, "search",
        data="simulated", samples=len(days),
    )  # fmt: skip


def _maintenance_table(days: Sequence[Day], maintained: float) -> Table:
    rows: list[list[object]] = []
    for index, name in enumerate(("maintenance", "patrol")):
        runs = [day.kept[index] for day in days]
        fewer = [day.kept[index].wrong < day.kept[1 - index].wrong for day in days]
        rows.append(
            [
                name, _mean(runs, lambda run: run.wrong), 100.0 * float(np.mean(fewer)),
                _mean(runs, lambda run: run.unknown),
                _mean(runs, lambda run: run.metres), _mean(runs, lambda run: float(run.looks)),
            ]
        )  # fmt: skip
    note = (
        f"Means over {maintained:g} s in which people carry six of twelve things elsewhere. Wrong: believed to be "
        "where no such thing lies within 0.4 m. Fewer: than the other robot on the same day."
    )
    columns = [
        "", "wrong beliefs ↓", "days with fewer, % ↑", "things nobody knows the place of ↓", "driven, m ↓", "tasks",
    ]  # fmt: skip
    return Table(
        "Beliefs kept, at equal metres",
        columns,
        rows,
        note,
        "maintenance",
        data="simulated",
        samples=len(days),
    )


def _mean(runs: Sequence[Outcome], value: Callable[[Outcome], float]) -> float:
    return float(np.mean([value(run) for run in runs]))


PARTS = {"days": Part(_days, quick_seeds=1)}

"""A robot's morning in an apartment, replayed over DDS through all nodes: the shipped day, and days nobody looked at.

One setting of the tracker was chosen on the shipped day (seed 20) and on days 21 and 22. The other days are drawn anew
for this experiment. The world model has its shipped rates: those of new and of removed things were chosen on the
apartment's days 300 to 307.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from evaluation.report import Part, Report, RunOptions, Table

FIRST_DAY = 200
"""Seed of the first other day."""
PROCESSES = (
    "whereabouts.nodes.scan_registration_node",
    "whereabouts.nodes.loop_closure_node",
    "whereabouts.nodes.target_tracker_node",
    "whereabouts.nodes.motion_predictor_node",
    "whereabouts.nodes.world_model_node",
    "whereabouts.nodes.world_maintenance_node",
    "whereabouts.nodes.verifier_node",
    "whereabouts.nodes.object_search_node",
)
# What is told of a day: name in `evaluation.demo.demo_report.figures`, heading, and what is asked for.
ROWS: tuple[tuple[str, str, float | None], ...] = (
    ("loops_closed_rmse_m", "trajectory with loops closed, RMS, m ↓", 0.15),
    ("wheels_rmse_m", "trajectory of the wheels, RMS, m", None),
    ("ospa_m", "people: OSPA, 1 m at most, m ↓", 0.3),
    ("people_missed_per_scan", "people missed, /scan ↓", None),
    ("people_false_per_scan", "false people, /scan ↓", None),
    ("people_labels", "labels for three people ↓", 6),
    ("people_switches", "changes of a person's label ↓", 4),
    ("things", "things there are", None),
    ("things_right", "things right at the end (class, within 0.4 m) ↑", None),
    ("things_extra", "things too many ↓", 0),
    ("things_kept_name", "things under their first name ↑", None),
    ("identity_switches", "changes of a thing's name ↓", 0),
    ("lost", "messages lost ↓", 0),
    ("unanswered", "messages unanswered ↓", 0),
)
COSTS: tuple[tuple[str, str, float | None], ...] = (
    ("speed", "replay, times real time ↑", 4),
    ("processor_s_per_bag_s", "processor time of the eight nodes per time of the bag, s ↓", 0.45),
    ("memory_proportional_mib", "memory of the eight nodes, shared pages once, MiB ↓", 1144),
)


def _shipped_day(options: RunOptions, report: Report) -> None:
    """The bag of `make demo`."""
    with TemporaryDirectory() as folder:
        found = _replayed(None, Path(folder))
    report.tables.append(_table("The day of the demo", "shipped-day", ROWS, found, "tuned on"))
    report.tables.append(_table("What it costs", "costs", COSTS, found, "simulated"))


def _other_days(options: RunOptions, report: Report) -> None:
    """The same home, people and things, drawn anew: another seed of every noise."""
    with TemporaryDirectory() as folder:
        found = _replayed(FIRST_DAY + options.seed, Path(folder))
    report.tables.append(
        _table("Other days, left out of every choice", "other-days", ROWS, found, "left out")
    )


def _replayed(seed: int | None, folder: Path) -> dict[str, Any]:
    """Figures of a day, None for the shipped one; needs ROS."""
    from evaluation.demo.demo_report import figures, judge
    from evaluation.demo.demo_runs import apartment_bag
    from evaluation.demo.replay import replay
    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.simulation.home.apartment_bag import record
    from whereabouts.simulation.home.apartment_day import ApartmentDay

    prepare_environment(private=True)
    if seed is None:
        bag = apartment_bag(folder)
    else:
        bag = folder / "day.mcap"
        record(bag, day=ApartmentDay(seed=seed))
    recording, run = replay(bag, folder / "out")
    return figures(judge(recording, bag, run))


def _table(
    title: str, name: str, rows: tuple[tuple[str, str, float | None], ...], found: dict[str, Any], data: str
) -> Table:
    cells = [[heading, "" if wanted is None else wanted, _count(found[key])] for key, heading, wanted in rows]
    note = "A person is expected after 1.5 s in plain view, until hidden for 3 s."
    return Table(
        title,
        ["", "asked for", "here"],
        cells,
        note if name != "costs" else "",
        name,
        {"asked for": "design"},
        data,
        1,
    )


def _count(value: Any) -> float:
    return float(len(value) if isinstance(value, list) else value)


PARTS = {
    "shipped day": Part(_shipped_day, random=False),
    "other days": Part(_other_days, quick_seeds=1),
}

"""What `whereabouts demo` does: each kind of demo from its bag or day to the report, and what is said meanwhile."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from time import monotonic
from typing import Any

import typer

from evaluation.demo.page import Row
from whereabouts.cli.common import write_figures
from whereabouts.system.progress import share_bar

LASER_NODES = ("scan_registration", "loop_closure", "target_tracker", "motion_predictor")
"""What a laser alone is enough for; clouds go through the first two."""


def apartment(out: Path, rate: float | None, seconds: float | None, json_file: Path | None) -> None:
    """The shipped bag through all nodes; where it is not there it is made first."""
    from evaluation.demo.demo_report import figures, judge, summary, write
    from evaluation.demo.replay import replay
    from whereabouts.nodes.runtime.suite_run import prepare_environment

    prepare_environment(private=True)
    out.mkdir(parents=True, exist_ok=True)
    path = apartment_bag(out, seconds)
    typer.echo(f"replaying {path} through eight nodes over DDS")
    with share_bar("replaying") as share:
        recording, run = replay(path, out, rate, on_event=_say, on_progress=share)
    typer.echo("writing the report")
    judged = judge(recording, path, run)
    page = write(out, judged)
    write_figures(json_file, figures(judged))
    _tell(summary(figures(judged), judged), page)


def live(out: Path, seeds: range, json_file: Path | None) -> None:
    """One day, or several, each in a folder of its own; ends with 1 where the wrong thing was fetched, or none."""
    if len(seeds) == 1:
        write_figures(json_file, live_day(out, seeds[0]))
        return
    found = []
    for seed in seeds:
        typer.echo(f"day {seed}")
        found.append(live_day(out / f"day-{seed}", seed))
    right = sum(day["right"] for day in found)
    write_figures(json_file, {"days": found, "days_right": right})
    for day in found:
        typer.echo(
            f"  day {day['seed']}: asked for the {day['asked']}, fetched {day['fetched'] or 'nothing'} after "
            f"{day.get('search_m', 0.0):.0f} m; wrong beliefs {day['wrong_beliefs']:.2f} (libraries "
            f"{day['library_wrong']:.2f}, patrol {day['naive_wrong']:.2f})"
        )
    typer.echo(f"the right thing was fetched on {right} of {len(found)} days")
    if right < len(found):
        raise typer.Exit(1)


def live_day(out: Path, seed: int) -> dict[str, Any]:
    """The robot acts; beside it the same day with a robot that patrols and searches directly. Returns the figures."""
    from evaluation.demo.live.live_demo import run_live
    from evaluation.demo.live.live_library import run_naive, run_ours
    from evaluation.demo.live.live_report import LiveTold, figures, sentences, summary, write
    from evaluation.demo.live.live_story import Script
    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.simulation.home.live_apartment import LiveDay

    prepare_environment(private=True)
    day, script, begun = LiveDay(seed), Script(), monotonic()
    typer.echo("a simulated robot drives where eight nodes send it, over DDS")
    with share_bar("living") as share:
        story, robot = run_live(out, day, script, None, _say, share)
        wall = monotonic() - begun
        share(1.0)
    typer.echo("the same day with a robot that patrols and searches directly")
    library = run_ours(seed, script.maintained, script.timeout)
    naive = run_naive(seed, library.metres, script.maintained, script.timeout)
    told = LiveTold(story, day, robot.map, library, naive, wall)
    page = write(out, told)
    for sentence in sentences(told):
        typer.echo(f"  {sentence}")
    _tell(summary(told), page)
    return figures(told)


def weeks(out: Path, weeks: int, seed: int, json_file: Path | None) -> None:
    """A month at home, remembered."""
    from evaluation.demo.demo_weeks import figures, live_through, summary, write

    typer.echo(f"living through {weeks} weeks at home")
    with share_bar("living") as share:
        month = live_through(out, 7 * weeks, seed, share)
    page = write(out, month)
    write_figures(json_file, figures(month))
    for question, answer, _ in month.answers:
        typer.echo(f"  {question}? {answer.sentence}")
    _tell(summary(month), page)


def recorded(name: str, out: Path, rate: float | None, seconds: float | None, json_file: Path | None) -> None:
    """A recording through the nodes that need a laser alone."""
    from evaluation.demo.recorded import bag_of, figures, run_recorded, write
    from whereabouts.nodes.runtime.suite_run import prepare_environment

    prepare_environment(private=True)
    out.mkdir(parents=True, exist_ok=True)
    bag = _excerpt(bag_of(name, out), out, seconds)
    given = node_parameters(bag)
    typer.echo(f"replaying {bag} through {' and '.join(given)} over DDS")
    with share_bar("replaying") as share:
        said, account = run_recorded(bag, out, given, rate, _say, share)
    page = write(out, bag, said, account)
    found = figures(said, account)
    write_figures(json_file, found)
    for key, value in found.items():
        typer.echo(f"  {key}: {value:g}")
    typer.echo(f"report: {page}")


def _say(text: str) -> None:
    """What happens meanwhile."""
    typer.echo(text, err=True)


def _tell(rows: Iterable[Row], page: Path) -> None:
    """What was wanted, what came of it, and where the report is."""
    for row in rows:
        typer.echo(f"  {row.name}: {row.value}{f' (wanted: {row.wanted})' if row.wanted else ''}")
    typer.echo(f"report: {page}")


def apartment_bag(out: Path, seconds: float | None = None) -> Path:
    """The apartment's bag: the checkout's, else made in `out`. seconds : only so many from its beginning."""
    from whereabouts.simulation.home.apartment_bag import record

    shipped = Path(__file__).resolve().parents[2] / "bags" / "apartment.mcap"
    if shipped.exists():
        return _excerpt(shipped, out, seconds)
    made = out / ("apartment.mcap" if seconds is None else f"apartment-{seconds:g}s.mcap")
    if not made.exists():
        typer.echo(f"making {made}")
        record(made, seconds)
    return made


def _excerpt(bag: Path, out: Path, seconds: float | None) -> Path:
    """The beginning of a bag, in `out`; itself where it is wanted whole."""
    from whereabouts.logs import convert_log

    if seconds is None:
        return bag
    target = out / f"{bag.name.split('.')[0]}-{seconds:g}s.mcap"
    convert_log(bag, target, seconds=seconds)
    return target


def node_parameters(path: Path) -> dict[str, dict[str, Any]]:
    """The nodes that a bag has something for, and what they have to know of it; says what was chosen.

    Raises
    ------
    NothingRecognisedError : there are neither scans nor clouds in it.
    """
    from whereabouts.parameters.parameter_base import model_of
    from whereabouts.robot.bags import survey_bag
    from whereabouts.robot.choice import choose
    from whereabouts.robot.findings import findings
    from whereabouts.robot.robot_file import parameters
    from whereabouts.system.log_errors import NothingRecognisedError

    survey = survey_bag(path)
    choice = choose(survey)
    if not choice.scans and not choice.clouds:
        raise NothingRecognisedError(path, "has neither LaserScan nor PointCloud2 messages")
    for finding in findings(survey, choice):
        typer.echo(str(finding))
    given = parameters(choice)
    frames = {name: given["/**"][name] for name in ("base_frame", "odom_frame", "map_frame")}
    nodes = LASER_NODES if choice.scans and not choice.clouds else LASER_NODES[:2]
    return {
        node: {name: value for name, value in frames.items() if name in model_of(node).model_fields}
        | given.get(node, {})
        for node in nodes
    }

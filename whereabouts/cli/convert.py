"""`whereabouts convert`: any readable log as a rosbag2 MCAP recording."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from whereabouts.cli.common import JsonFile, argument, option, write_figures
from whereabouts.system.counting import counted

if TYPE_CHECKING:
    from whereabouts.logs.log_conversion import Conversion


Source = Annotated[
    Path,
    argument(
        "IN",
        "CARMEN log (.clf, .log, also .gz, .bz2), g2o file with laser, ROS 1 bag, ROS 2 bag (folder, "
        ".mcap, .db3), or a zip archive with one of these.",
    ),
]
Target = Annotated[Path, argument("OUT", "OUT.mcap writes one file; any other name writes a rosbag2 folder.")]
Topic = Annotated[list[str] | None, option("--topic", "Convert only this topic. Can be repeated.")]
MaxRange = Annotated[
    float | None,
    option(
        "--max-range",
        "Readings of a CARMEN or g2o log beyond this are no-returns, in metres. Default: the log's own limit, "
        "or 50 m if it states none.",
        min=0.1,
    ),
]
Rate = Annotated[
    float | None,
    option(
        "--rate",
        "Replace the stamps of a CARMEN or g2o log: from 0 on, this many scans per second. For logs whose "
        "stamps are zero, rounded or outside of what ROS can express.",
        min=0.001,
    ),
]
Seconds = Annotated[
    float | None, option("--seconds", "Convert only so many seconds from the beginning.", min=0.001)
]


def convert(
    source: Source,
    target: Target,
    topic: Topic = None,
    max_range: MaxRange = None,
    rate: Rate = None,
    seconds: Seconds = None,
    json_file: JsonFile = None,
) -> None:
    """Convert a robot log to a rosbag2 recording in MCAP, for `ros2 bag`.

    CARMEN and g2o logs become sensor_msgs/LaserScan on /scan (rear laser: /rear_scan), nav_msgs/Odometry on
    /wheel_odom and the laser's mount on /tf_static. From a ROS 1 bag it keeps all messages
    whose type ROS 2 knows. It copies a ROS 2 bag, even if its recorder was killed.

    Header stamps stay as recorded. Log times set the pace of a player, so they never go backwards: a message that is
    stamped earlier than the one before it gets that one's log time.

    OUT appears only when everything is written. Warnings on standard error list what was left out or is unusual, and
    where it occurs first.
    """
    from estimation.errors import InputError
    from whereabouts.logs.format_detection import detect
    from whereabouts.logs.log_conversion import convert_log
    from whereabouts.system.log_errors import WriteError
    from whereabouts.system.progress import share_bar

    if target.exists() and source.exists() and target.samefile(source):
        raise WriteError(target, "is the log that is read; name another file")
    if (max_range or rate) and detect(source)[0] not in ("carmen", "g2o"):
        raise InputError("--max-range and --rate are for CARMEN and g2o logs; a bag keeps what was recorded")
    with share_bar(f"converting {source.name}") as share:
        result = convert_log(source, target, topic, max_range, rate, share, seconds)
    for line in result.summary.lines():
        typer.echo(line, err=True)
    typer.echo(_sentence(target, result))
    write_figures(json_file, _figures(source, target, result))


def _sentence(target: Path, result: Conversion) -> str:
    """One line: what was written, and how much was left out."""
    counts = [(result.scans, "scan"), (result.clouds, "cloud"), (result.odometry, "odometry message")]
    rest = sum(result.messages.values()) - sum(count for count, _ in counts)
    parts = [counted(count, name) for count, name in (*counts, (rest, "other message")) if count]
    skipped = result.summary.skipped_count
    left_out = f"; {skipped} skipped" if skipped else ""
    return f"{target}: {', '.join(parts)} over {result.duration:.1f} s{left_out}"


def _figures(source: Path, target: Path, result: Conversion) -> dict[str, object]:
    told = asdict(result)
    account = told.pop("summary")
    told |= {"duration_s": told.pop("duration"), "skipped": account["skipped"], "notes": account["notes"]}
    return {"source": str(source), "target": str(target), **told}

"""`whereabouts convert`: any readable log as a rosbag2 MCAP recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from whereabouts.cli.common import JsonFile, write_figures

if TYPE_CHECKING:
    from whereabouts.logs.conversion import Conversion


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN",
            help="CARMEN log (.clf, .log, also .gz, .bz2), g2o file with laser, ROS 1 bag, ROS 2 bag (folder, "
            ".mcap, .db3), or a zip archive with one of these.",
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="OUT.mcap writes one file; any other name writes a rosbag2 folder."
        ),
    ],
    topic: Annotated[
        list[str] | None,
        typer.Option("--topic", help="Convert only this topic. Can be repeated."),
    ] = None,
    max_range: Annotated[
        float | None,
        typer.Option(
            "--max-range",
            min=0.1,
            help="Metres from which a reading is a no-return, instead of what a CARMEN or g2o log says "
            "(50 m where it says nothing).",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            min=0.001,
            help="Scans per second: stamp the scans of a CARMEN or g2o log anew, from 0 on. For logs whose "
            "stamps are zero, rounded or beyond what ROS can express.",
        ),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Convert a robot log to a rosbag2 recording in MCAP, readable by `ros2 bag`.

    CARMEN and g2o logs become sensor_msgs/LaserScan on /scan (rear laser: /rear_scan), nav_msgs/Odometry on
    /wheel_odom and the laser's mount on /tf_static. Of a ROS 1 bag every message is kept that ROS 2 can carry;
    a ROS 2 bag is copied, also when its recorder was killed.

    Header stamps stay as recorded. Log times, by which a player paces messages, never go backwards: a message
    stamped earlier than the one before it is logged together with that one.

    OUT appears when everything is written; after an error nothing is left behind. What was left out, or is
    unusual, is listed on standard error with the place of its first occurrence.
    """
    from whereabouts.logs.conversion import convert_log
    from whereabouts.progress import progress_bar

    with progress_bar() as bar:
        task = bar.add_task(f"converting {source.name}", total=100)
        result = convert_log(
            source,
            target,
            topic,
            max_range,
            rate,
            lambda share: bar.update(task, completed=round(100 * share)),
        )
    for line in result.summary.lines():
        typer.echo(line, err=True)
    typer.echo(_sentence(target, result))
    write_figures(json_file, _figures(source, target, result))


def _sentence(target: Path, result: Conversion) -> str:
    """One line: what was written, and how much was left out."""
    counted = [(result.scans, "scan"), (result.clouds, "cloud"), (result.odometry, "odometry message")]
    rest = sum(result.messages.values()) - sum(count for count, _ in counted)
    counted.append((rest, "other message"))
    parts = [f"{count} {name}{'s' * (count != 1)}" for count, name in counted if count]
    skipped = result.summary.skipped_count
    left_out = f"; {skipped} skipped" if skipped else ""
    return f"{target}: {', '.join(parts)} over {result.duration:.1f} s{left_out}"


def _figures(source: Path, target: Path, result: Conversion) -> dict[str, object]:
    account = result.summary.as_dict()
    return {
        "source": str(source),
        "target": str(target),
        "scans": result.scans,
        "odometry": result.odometry,
        "clouds": result.clouds,
        "messages": result.messages,
        "duration_s": result.duration,
        "skipped": account["skipped"],
        "notes": account["notes"],
    }

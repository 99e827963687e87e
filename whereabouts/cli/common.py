"""Options and output that several sub-commands share."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from whereabouts.logs import Log
    from whereabouts.robot.robot_log import RobotLog


def option(name: str, what: str, **more: Any) -> Any:
    """An option of a command, and what it says or does; more : as of `typer.Option`."""
    return typer.Option(name, help=what, **more)


def argument(metavar: str, what: str) -> Any:
    """What stands in a command line without the name of an option."""
    return typer.Argument(metavar=metavar, help=what)


def target_file(path: Path | None) -> Path | None:
    """Callback of an option that names a file to write: whether it can be is said before any work is done.

    Raises WriteError: its folder does not exist or may not be written, or a folder stands in its place.
    """
    from whereabouts.system.log_errors import WriteError

    if path is None:
        return None
    if not path.parent.is_dir():
        raise WriteError(path, f"directory {path.parent} does not exist; create it first")
    if path.is_dir():
        raise WriteError(path, "is a directory")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise WriteError(path, f"directory {path.parent} may not be written")
    return path


def target_folder(path: Path | None) -> Path | None:
    """The same for a folder that is made where it is missing.

    Raises WriteError: a file stands in the way, or the folder may not be made or written.
    """
    from whereabouts.system.log_errors import WriteError

    if path is None:
        return None
    known = next(parent for parent in (path, *path.absolute().parents) if parent.exists())
    if not known.is_dir():
        raise WriteError(path, f"{known} is a file; name a directory")
    if not os.access(known, os.W_OK | os.X_OK):
        raise WriteError(path, f"directory {known} may not be written")
    return path


def file_to_write(name: str, metavar: str, what: str) -> Any:
    """An option that names a file to write; see `target_file`."""
    return option(name, what, metavar=metavar, callback=target_file)


def require_places(path: Path | None) -> None:
    from estimation.errors import InputError

    if path is not None and not path.is_file():
        raise InputError(
            f"--places {path}: there is no such file; name a YAML file with rooms and furniture, or leave --places out"
        )


Namespace = Annotated[str, option("--namespace", "Namespace of the suite, such as /robot1.")]
AnyLog = Annotated[Path, argument("IN", "Any readable log: CARMEN, g2o with laser, ROS 1 or ROS 2 bag.")]
TopicToUse = Annotated[
    str | None, option("--topic", "Topic of the scans or clouds; default: the first one found.")
]
WithWheels = Annotated[
    bool, option("--wheels/--no-wheels", "Use the log's wheel odometry, if any, as initial guess.")
]
ParamsFile = Annotated[
    Path | None,
    option(
        "--params",
        "ROS parameter file, such as `setup` writes: topics, frames and settings. The trajectory is then that of "
        "the robot's frame, as tf says how the sensor is mounted.",
        metavar="robot.yaml",
    ),
]
TumFile = Annotated[Path | None, file_to_write("--out", "T.tum", "Write the trajectory, one line per scan.")]
JsonFile = Annotated[Path | None, file_to_write("--json", "FILE", "Write the figures to FILE as JSON.")]


@dataclass
class LogReading:
    """A log that is being read: what to iterate, and the topic of its scans or clouds.

    robot : the log as the parameter file of a robot says, where one is in use.
    """

    source: Path
    log: Log
    robot: RobotLog | None
    topic: str | None
    _share: Callable[[float], None]

    @property
    def records(self) -> Any:
        """The log, or what of it is the robot's."""
        return self.log if self.robot is None else self.robot

    def advance(self, count: int) -> None:
        if count % 50 == 0:
            self._share(self.log.progress)

    def require(self, count: int, what: str = "scans or clouds") -> None:
        """Raises NothingRecognisedError where there were none."""
        from whereabouts.system.log_errors import NothingRecognisedError

        if not count:
            wanted = f"on topic {self.topic}" if self.topic else "in it"
            there = ", ".join(f"/{name}" for name in self.log.summary.records)
            raise NothingRecognisedError(
                self.source,
                f"there are no {what} {wanted} that can be used{f'; it has {there}' if there else ''}",
            )


@contextmanager
def reading(
    source: Path, what: str, params: Path | None = None, topic: str | None = None
) -> Iterator[LogReading]:
    """Read a log with a progress bar; what there is to say of it is said at the end, also where nothing came of it."""
    from whereabouts.logs import open_log
    from whereabouts.robot.robot_log import RobotLog
    from whereabouts.system.progress import share_bar

    with open_log(source) as log, share_bar(f"{what} {source.name}") as share:
        robot = None if params is None else RobotLog(log, params, topic)
        try:
            yield LogReading(source, log, robot, topic if robot is None else robot.topic, share)
        finally:
            for line in [*log.summary.lines(), *([] if robot is None else robot.lines())]:
                typer.echo(line, err=True)


def write_figures(path: Path | None, figures: Mapping[str, Any]) -> None:
    """Write figures as JSON, atomically; nothing where no file was asked for."""
    from whereabouts.system.atomic import write_text

    if path is not None:
        write_text(path, json.dumps(figures, indent=2) + "\n")

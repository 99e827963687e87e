"""`whereabouts track`: people in the laser scans of a recorded log, without ROS."""

from __future__ import annotations

import time
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from whereabouts.cli.common import (
    JsonFile,
    LogReading,
    ParamsFile,
    TopicToUse,
    WithWheels,
    argument,
    file_to_write,
    option,
    reading,
    write_figures,
)
from whereabouts.system.counting import counted

if TYPE_CHECKING:
    from whereabouts.recorded.people_tracks import TrackedScan

COLUMNS = ("time", "label", "x", "y", "vx", "vy", "weight")
OF_ALL = ("person", "label_probability")  # columns besides where all targets are written


# Trackers by name, what is written, and in which frame.
Filter = StrEnum("Filter", ["mixture", "phd", "gmphd"])
Targets = StrEnum("Targets", ["people", "all"])
TrackedFrame = StrEnum("TrackedFrame", ["laser", "odom"])
Source = Annotated[Path, argument("IN", "Any readable log with planar scans: CARMEN, ROS 1 or 2 bag.")]
Out = Annotated[
    Path | None,
    file_to_write(
        "--out",
        "tracks.csv",
        "Write the tracks: time, label, x, y, vx, vy, weight (of all targets also person, label_probability).",
    ),
]
FrameOption = Annotated[
    TrackedFrame,
    typer.Option(help="Frame of the tracks: the scanner, or the robot's pose at the first scan."),
]
FilterOption = Annotated[
    Filter,
    option(
        "--filter",
        "mixture: everything that stands free, with its class. phd: the reference's filter on single returns. "
        "gmphd: its filter for points, on clusters. The last two know no classes.",
    ),
]
TargetsOption = Annotated[
    Targets,
    typer.Option(
        help="Write people only, or everything that stands free or moves, with the probabilities that it is a person "
        "and has its own label."
    ),
]


def track(
    source: Source,
    out: Out = None,
    frame: FrameOption = TrackedFrame.odom,
    filter_: FilterOption = Filter.mixture,
    targets: TargetsOption = Targets.people,
    topic: TopicToUse = None,
    wheels: WithWheels = True,
    params: ParamsFile = None,
    json_file: JsonFile = None,
) -> None:
    """Track people through a recorded log.

    The file has one row per person and scan, with the stamp of the scan's header. A scan without people has no row.
    Velocities are over ground, along the axes of the frame. Hidden people keep their label.
    """
    from tracking.people.scan_filters import tracker_of
    from whereabouts.parameter_file import settings_for
    from whereabouts.system.atomic import write_csv

    every = targets is Targets.all
    people = None if params is None else settings_for(params, "target_tracker").people
    tracker = tracker_of(filter_.value, people)
    started = time.perf_counter()
    with reading(source, "tracking in", params, topic) as log:
        rows: list[list[str]] = []
        stamps, counts = [], []
        for scan in _tracked(log, wheels, tracker, every):
            stamps.append(scan.stamp)
            counts.append(len(scan.targets))
            rows += [_row(scan, target, frame, every) for target in scan.targets]
        log.require(len(stamps), "scans")
    elapsed = time.perf_counter() - started
    if out is not None:
        write_csv(out, (*COLUMNS, *OF_ALL) if every else COLUMNS, rows)
    scans, labels, most = len(stamps), len({row[1] for row in rows}), max(counts)
    duration = stamps[-1] - stamps[0]
    told = counted(labels, "target") if every else counted(labels, "person", "people")
    typer.echo(
        f"{counted(scans, 'scan')} over {duration:.1f} s: {told}, at most {most} at a time, "
        f"{len(rows) / scans:.2f} per scan, {scans / elapsed:.0f} scans/s{f', written to {out}' if out else ''}"
    )
    figures = {"source": str(source), "scans": scans, "labels": labels, "most_at_once": most}
    figures |= {"people_per_scan": len(rows) / scans, "duration_s": duration}
    write_figures(json_file, {**figures, "scans_per_second": scans / elapsed})


def _tracked(log: LogReading, wheels: bool, tracker: Any, every: bool) -> Iterator[TrackedScan]:
    """Scans with who is in them. Raises InputError where the scanner is tilted."""
    from estimation.errors import InputError
    from whereabouts.recorded.people_tracks import track_people

    given: dict[str, Any] = {"topic": log.topic, "use_wheels": wheels, "tracker": tracker}
    for count, tracked in enumerate(track_people(log.records, every_class=every, **given)):
        if log.robot is not None and log.robot.tilted:
            raise InputError(
                f"{log.source}: {log.robot.lines()[0]}, but people are only found in a level plane"
            )
        log.advance(count)
        yield tracked


def _row(scan: TrackedScan, target: Any, frame: TrackedFrame, every: bool) -> list[str]:
    state = scan.in_laser(target) if frame is TrackedFrame.laser else target.mean
    numbers = (*state, target.weight, *(getattr(target, name) for name in OF_ALL if every))
    return [f"{scan.stamp:.9f}", str(target.label), *(f"{value:.4f}" for value in numbers)]

"""`whereabouts track`: people in the laser scans of a recorded log, without ROS."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from whereabouts.cli.common import JsonFile, ParamsFile, TopicToUse, WithWheels, target_file, write_figures

COLUMNS = ("time", "label", "x", "y", "vx", "vy", "weight")


class Filter(StrEnum):
    """Trackers by name."""

    mixture = "mixture"
    phd = "phd"
    gmphd = "gmphd"


class Targets(StrEnum):
    """What is written."""

    people = "people"
    all = "all"


class TrackedFrame(StrEnum):
    """Frames in which tracks are written."""

    laser = "laser"
    odom = "odom"


def track(
    source: Annotated[
        Path, typer.Argument(metavar="IN", help="Any readable log with planar scans: CARMEN, ROS 1 or 2 bag.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="tracks.csv",
            help="Write the tracks: time, label, x, y, vx, vy, weight (and person).",
            callback=target_file,
        ),
    ] = None,
    frame: Annotated[
        TrackedFrame,
        typer.Option(help="Frame of the tracks: the scanner, or the robot's pose at the first scan."),
    ] = TrackedFrame.odom,
    filter_: Annotated[
        Filter,
        typer.Option(
            "--filter",
            help="mixture: everything that stands free, with its class. phd: the reference's filter on single returns. "
            "gmphd: its filter for points, on clusters. The last two know no classes.",
        ),
    ] = Filter.mixture,
    targets: Annotated[
        Targets,
        typer.Option(
            help="Write people only, or everything that stands free or moves, with its probability of being a person."
        ),
    ] = Targets.people,
    topic: TopicToUse = None,
    wheels: WithWheels = True,
    params: ParamsFile = None,
    json_file: JsonFile = None,
) -> None:
    """Track people through a recorded log.

    The file has one row per person and scan, with the stamp of the scan's header. A scan without people has no row.
    Velocities are over ground, along the axes of the frame. Hidden people keep their label.
    """
    import csv

    from estimation.errors import InputError
    from tracking.people.people_tracker import Person
    from tracking.people.scan_filters import tracker_of
    from whereabouts.logs import open_log
    from whereabouts.parameter_file import settings_for
    from whereabouts.recorded.people_tracks import track_people
    from whereabouts.robot.robot_log import RobotLog
    from whereabouts.system.atomic import atomic_path
    from whereabouts.system.log_errors import NothingRecognisedError
    from whereabouts.system.progress import progress_bar

    every = targets is Targets.all
    columns = (*COLUMNS, "person") if every else COLUMNS
    people = None if params is None else settings_for(params, "target_tracker").people
    tracker = tracker_of(filter_.value, people)
    rows: list[list[str]] = []
    labels: set[int] = set()
    scans, most = 0, 0
    first = last = 0.0
    started = time.perf_counter()
    with open_log(source) as log, progress_bar() as bar:
        task = bar.add_task(f"tracking in {source.name}", total=100)
        robot = None if params is None else RobotLog(log, params, topic)
        records: Any = robot or log
        topic = topic if robot is None else robot.topic
        for tracked in track_people(
            records, topic=topic, use_wheels=wheels, tracker=tracker, every_class=every
        ):
            if robot is not None and robot.tilted:
                raise InputError(f"{source}: {robot.lines()[0]}, but people are only found in a level plane")
            first = tracked.stamp if scans == 0 else first
            last = tracked.stamp
            scans += 1
            most = max(most, len(tracked.targets))
            for target in tracked.targets:
                labels.add(target.label)
                state = tracked.in_laser(target) if frame is TrackedFrame.laser else target.mean
                numbers = [f"{value:.4f}" for value in (*state, target.weight)]
                if every:
                    assert isinstance(target, Person)
                    numbers.append(f"{target.person:.4f}")
                rows.append([f"{tracked.stamp:.9f}", str(target.label), *numbers])
            if scans % 50 == 0:
                bar.update(task, completed=round(100 * log.progress))
        if scans == 0:
            raise NothingRecognisedError(
                source, f"there are no scans {f'on topic {topic}' if topic else 'in it'}"
            )
        for line in [*log.summary.lines(), *([] if robot is None else robot.lines())]:
            typer.echo(line, err=True)
    if out is not None:
        with atomic_path(out) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(rows)
    elapsed = time.perf_counter() - started
    what = "targets" if every else "people"
    typer.echo(
        f"{scans} scans over {last - first:.1f} s: {len(labels)} {what}, at most {most} at a time, "
        f"{len(rows) / scans:.2f} per scan, {scans / elapsed:.0f} scans/s{f', written to {out}' if out else ''}"
    )
    write_figures(
        json_file,
        {
            "source": str(source),
            "scans": scans,
            "labels": len(labels),
            "most_at_once": most,
            "people_per_scan": len(rows) / scans,
            "duration_s": last - first,
            "scans_per_second": scans / elapsed,
        },
    )

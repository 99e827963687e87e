"""`whereabouts slam`: a log with its loops closed, or found in a saved map; `whereabouts merge`: two maps as one."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from whereabouts.cli.common import (
    AnyLog,
    JsonFile,
    LogReading,
    ParamsFile,
    TopicToUse,
    TumFile,
    WithWheels,
    argument,
    file_to_write,
    option,
    reading,
    write_figures,
)
from whereabouts.system.counting import counted

Read = Callable[[str], AbstractContextManager[LogReading]]


# `loop_closure.slam_config.Proposals`, which is imported only when it is needed.
Proposals = StrEnum("Proposals", ["both", "path", "places"])
ClosuresOption = Annotated[
    Path | None, file_to_write("--closures", "C.csv", "Write the accepted closures to this file.")
]
MAP_OPTION = file_to_write(
    "--map",
    "M.png",
    "Write the map to M.npz. From planar scans also write M.pgm and M.yaml, as map_saver does.",
)
MapFile = Annotated[Path | None, MAP_OPTION]
InMap = Annotated[
    Path | None, option("--in-map", "Only localise in this map; do not change it.", metavar="M.npz")
]
Initial = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,YAW",
        help="With --in-map: initial pose in the map, in m and rad. Default: search for it.",
    ),
]
ProposalsOption = Annotated[
    Proposals,
    typer.Option(
        help="What says where a loop may close: the path and its uncertainty, the place classifier alone, or both."
    ),
]


def slam(
    source: AnyLog,
    out: TumFile = None,
    closures: ClosuresOption = None,
    map_file: MapFile = None,
    in_map: InMap = None,
    initial: Initial = None,
    proposals: ProposalsOption = Proposals.both,
    topic: TopicToUse = None,
    wheels: WithWheels = True,
    params: ParamsFile = None,
    json_file: JsonFile = None,
) -> None:
    """Compute the robot's trajectory from a recorded log with loops closed, or localise it in a saved map.

    If the log does not say how the sensor is mounted, it is the trajectory of the sensor. Its frame is that of the
    first scan. The format is `stamp x y z qx qy qz qw`, one line per scan, in the log's order. Closures are lines
    `stamp_a,stamp_b,x,y,yaw`: the later place b as seen from the earlier one a.

    In a saved map the trajectory is in the map's frame. It has no line for a scan while the robot's place is unknown.
    """
    if in_map is None and initial is not None:
        raise typer.BadParameter("--initial needs --in-map")
    if in_map is not None and (closures is not None or map_file is not None):
        raise typer.BadParameter("--in-map changes no map and closes no loop: neither --closures nor --map")
    read = partial(reading, source, params=params, topic=topic)
    if in_map is not None:
        figures = _locate(read, wheels, in_map, initial, out)
    else:
        figures = _map(read, wheels, params, out, closures, map_file, proposals)
    write_figures(json_file, {"source": str(source), **figures})


def _map(
    read: Read, wheels: bool, params: Path | None, out: Path | None, closures: Path | None,
    map_file: Path | None, proposals: Proposals,
) -> dict[str, Any]:  # fmt: skip
    import numpy as np

    from whereabouts.logs import write_tum
    from whereabouts.parameter_file import settings_for
    from whereabouts.recorded.mapping import closure_rows, map_log, write_map_files
    from whereabouts.system.atomic import write_text

    started = time.perf_counter()
    settings = settings_for(params, "loop_closure")
    config = None if params is None else settings.slam
    chosen: Any = settings.proposals if proposals is Proposals.both else proposals.value
    with read("mapping") as log:
        odometry = None if log.robot is None else log.robot.settings.odometry
        mapped = map_log(log.records, config, wheels, log.topic, log.advance, chosen, odometry)
        log.require(len(mapped.stamps))
    elapsed = time.perf_counter() - started
    poses = np.array(mapped.poses)
    if out is not None:
        write_tum(out, mapped.stamps, mapped.poses)
    if closures is not None:
        write_text(closures, "\n".join(closure_rows(mapped)) + "\n")
    if map_file is not None:
        write_map_files(mapped.slam, map_file, lambda text: typer.echo(text, err=True))
    duration = max(mapped.stamps) - min(mapped.stamps)
    keyframes = len(mapped.slam.keyframes)
    typer.echo(
        f"{counted(len(poses), 'scan')} over {duration:.1f} s, {counted(keyframes, 'keyframe')}, "
        f"{counted(len(mapped.closures), 'closure')}, "
        f"{len(poses) / elapsed:.0f} scans/s, {duration / elapsed:.0f} times real time"
    )
    return {
        "scans": len(poses),
        "keyframes": keyframes,
        "closures": len(mapped.closures),
        "duration_s": duration,
        "scans_per_second": len(poses) / elapsed,
        "times_real_time": duration / elapsed,
    }


def _locate(read: Read, wheels: bool, in_map: Path, initial: str | None, out: Path | None) -> dict[str, Any]:
    from loop_closure.maps.map_file import read_map
    from whereabouts.logs import write_tum
    from whereabouts.recorded.mapping import locate_log

    first = None if initial is None else _pose(initial)
    places = read_map(in_map)
    started = time.perf_counter()
    with read("locating") as log:
        located = locate_log(
            log.records, places, first, use_wheels=wheels, topic=log.topic, on_scan=log.advance
        )
        log.require(len(located.stamps))
    elapsed = time.perf_counter() - started
    known = [
        (stamp, pose) for stamp, pose in zip(located.stamps, located.poses, strict=True) if pose is not None
    ]
    if out is not None:
        write_tum(out, [stamp for stamp, _ in known], [pose for _, pose in known])
    start, confirmed = min(located.stamps), sum(located.confirmed)
    duration = max(located.stamps) - start
    after = known[0][0] - start if known else None
    when = "never found" if after is None else f"found after {after:.1f} s"
    typer.echo(
        f"{counted(len(located.stamps), 'scan')} over {duration:.1f} s, {when}, "
        f"known for {counted(len(known), 'scan')}, confirmed by {confirmed}, {duration / elapsed:.0f} times real time"
    )
    return {
        "map": str(in_map),
        "scans": len(located.stamps),
        "located": len(known),
        "confirmed": confirmed,
        "found_after_s": after,
        "duration_s": duration,
        "times_real_time": duration / elapsed,
    }


def _pose(text: str):  # type: ignore[no-untyped-def]
    import numpy as np

    try:
        pose = np.array([float(part) for part in text.split(",")])
    except ValueError:
        pose = np.zeros(0)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise typer.BadParameter(f"--initial: three numbers X,Y,YAW expected, got {text!r}")
    return pose


def merge(
    first: Annotated[Path, argument("FIRST.npz", "A saved map; its frame stays.")],
    second: Annotated[Path, argument("SECOND.npz", "A map of another session that overlaps it.")],
    map_file: Annotated[Path, MAP_OPTION],
) -> None:
    """Merge two saved maps: the second is found in the first without a guess, and both close loops with each other."""
    from loop_closure.maps.map_file import read_map
    from loop_closure.maps.merging import merge as joined
    from whereabouts.recorded.mapping import write_map_files

    slam, other = read_map(first), read_map(second)
    known, added = len(slam.keyframes), len(other.keyframes)
    found = joined(slam, other)
    write_map_files(slam, map_file, lambda text: typer.echo(text, err=True))
    closures = sum(edge.closure for edge in slam.graph.edges)
    typer.echo(
        f"{known} and {counted(added, 'keyframe')}, found at keyframe {found} of the second, "
        f"{counted(closures, 'closure')}; written to {map_file.with_suffix('.npz')}"
    )

"""`whereabouts odometry`: the trajectory of a recorded log, scan by scan, without ROS."""

from __future__ import annotations

import itertools
import math
import time
from typing import Any

import typer

from whereabouts.cli.common import (
    AnyLog,
    JsonFile,
    ParamsFile,
    TopicToUse,
    TumFile,
    WithWheels,
    reading,
    write_figures,
)
from whereabouts.system.counting import counted


def odometry(
    source: AnyLog,
    out: TumFile = None,
    topic: TopicToUse = None,
    wheels: WithWheels = True,
    params: ParamsFile = None,
    json_file: JsonFile = None,
) -> None:
    """Compute the robot's trajectory from a recorded log.

    If the log does not say how the sensor is mounted, it is the trajectory of the sensor. Its frame is that of the
    first scan. The format is `stamp x y z qx qy qz qw`, one line per scan, in the log's order.
    """
    from whereabouts.logs import write_tum
    from whereabouts.recorded.follow import follow

    stamps: list[float] = []
    poses: list[Any] = []
    unsure = 0
    started = time.perf_counter()
    with reading(source, "following", params, topic) as log:
        config = None if log.robot is None else log.robot.settings.odometry
        for followed in follow(log.records, config, use_wheels=wheels, topic=log.topic):
            stamps.append(followed.stamp)
            poses.append(followed.pose)
            unsure += not followed.converged
            if followed.reason:
                log.log.summary.note(followed.reason, f"time {followed.stamp:.3f}")
            log.advance(len(stamps))
        log.require(len(stamps))
    if out is not None:
        write_tum(out, stamps, poses)
    elapsed, count, duration = time.perf_counter() - started, len(stamps), stamps[-1] - stamps[0]
    places = (pose[:2] if pose.ndim == 1 else pose[:3, 3] for pose in poses)
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(places))
    typer.echo(
        f"{counted(count, 'scan')} over {duration:.1f} s, path {length:.1f} m, {unsure} unsure, "
        f"{count / elapsed:.0f} scans/s{f', written to {out}' if out else ''}"
    )
    figures = {"source": str(source), "scans": count, "unsure": unsure, "path_m": length}
    write_figures(json_file, {**figures, "duration_s": duration, "scans_per_second": count / elapsed})

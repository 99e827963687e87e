"""`whereabouts odometry`: the trajectory of a recorded log, scan by scan, without ROS."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from whereabouts.cli.common import JsonFile, ParamsFile, TopicToUse, TumFile, WithWheels, write_figures


def odometry(
    source: Annotated[
        Path,
        typer.Argument(metavar="IN", help="Any readable log: CARMEN, g2o with laser, ROS 1 or ROS 2 bag."),
    ],
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
    import numpy as np

    from whereabouts.logs import TumWriter, open_log
    from whereabouts.recorded.follow import follow
    from whereabouts.system.log_errors import NothingRecognisedError
    from whereabouts.system.progress import progress_bar

    count, unsure, length = 0, 0, 0.0
    last: np.ndarray | None = None
    first_stamp = last_stamp = 0.0
    started = time.perf_counter()
    writer = TumWriter(out) if out is not None else None
    with open_log(source) as log, progress_bar() as bar:
        task = bar.add_task(f"following {source.name}", total=100)
        if writer is not None:
            writer.__enter__()
        try:
            records: Any = log
            config = None
            if params is not None:
                from whereabouts.robot.robot_log import RobotLog

                records = RobotLog(log, params, topic)
                topic, config = records.topic, records.settings.odometry
            for followed in follow(records, config, use_wheels=wheels, topic=topic):
                position = followed.pose[:2] if followed.pose.ndim == 1 else followed.pose[:3, 3]
                length += 0.0 if last is None else float(np.linalg.norm(position - last))
                last = position
                first_stamp = followed.stamp if count == 0 else first_stamp
                last_stamp = followed.stamp
                count += 1
                unsure += not followed.converged
                if writer is not None:
                    writer.write(followed.stamp, followed.pose)
                if count % 50 == 0:
                    bar.update(task, completed=round(100 * log.progress))
            if count == 0:
                wanted = f"on topic {topic}" if topic else "in it"
                raise NothingRecognisedError(source, f"there are no scans or clouds {wanted}")
        except BaseException as error:
            if writer is not None:
                writer.__exit__(type(error), error, error.__traceback__)
            raise
        if writer is not None:
            writer.__exit__(None, None, None)
        for line in [*log.summary.lines(), *([] if records is log else records.lines())]:
            typer.echo(line, err=True)
    elapsed = time.perf_counter() - started
    typer.echo(
        f"{count} scans over {last_stamp - first_stamp:.1f} s, path {length:.1f} m, {unsure} unsure, "
        f"{count / elapsed:.0f} scans/s{f', written to {out}' if out else ''}"
    )
    write_figures(
        json_file,
        {
            "source": str(source),
            "scans": count,
            "unsure": unsure,
            "path_m": length,
            "duration_s": last_stamp - first_stamp,
            "scans_per_second": count / elapsed,
        },
    )

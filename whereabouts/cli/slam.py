"""`whereabouts slam`: a recorded log with its loops closed: trajectory, closures and map, without ROS."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from whereabouts.cli.common import JsonFile, TopicToUse, TumFile, WithWheels, write_figures


def slam(
    source: Annotated[
        Path,
        typer.Argument(metavar="IN", help="Any readable log: CARMEN, g2o with laser, ROS 1 or ROS 2 bag."),
    ],
    out: TumFile = None,
    closures: Annotated[
        Path | None,
        typer.Option("--closures", metavar="C.csv", help="Write the accepted closures."),
    ] = None,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", metavar="M.png", help="Write a picture; M.pgm and M.yaml with it (map_saver)."),
    ] = None,
    topic: TopicToUse = None,
    wheels: WithWheels = True,
    json_file: JsonFile = None,
) -> None:
    """Follow the robot through a recorded log and close its loops.

    The trajectory is that of the robot (of the sensor where the log does not say how it is mounted), in the
    frame of the first scan: `stamp x y z qx qy qz qw`, one line per scan, in the log's order. Closures are lines
    `stamp_a,stamp_b,x,y,yaw`: the later place b as seen from the earlier one a.
    """
    import numpy as np

    from whereabouts.atomic import atomic_path
    from whereabouts.log_errors import NothingRecognisedError
    from whereabouts.logs import open_log, write_tum
    from whereabouts.mapping import closure_rows, draw_grid, map_grid, map_log
    from whereabouts.progress import progress_bar

    started = time.perf_counter()
    with open_log(source) as log, progress_bar() as bar:
        task = bar.add_task(f"mapping {source.name}", total=100)

        def advance(count: int) -> None:
            if count % 50 == 0:
                bar.update(task, completed=round(100 * log.progress))

        mapped = map_log(log, use_wheels=wheels, topic=topic, on_scan=advance)
        for line in log.summary.lines():
            typer.echo(line, err=True)
    if not mapped.stamps:
        wanted = f"on topic {topic}" if topic else "in it"
        raise NothingRecognisedError(source, f"there are no scans or clouds {wanted}")
    elapsed = time.perf_counter() - started
    poses = np.array(mapped.poses)
    if out is not None:
        write_tum(out, mapped.stamps, mapped.poses)
    if closures is not None:
        with atomic_path(closures) as temporary:
            temporary.write_text("\n".join(closure_rows(mapped)) + "\n", encoding="ascii")
    if map_file is not None and poses.ndim == 2:
        grid = map_grid(mapped.slam)
        nodes = mapped.slam.graph.poses
        draw_grid(map_file, grid, nodes, [(nodes[c.earlier], nodes[c.later]) for c in mapped.slam.closures])
        grid.save(map_file.with_suffix(""))
    duration = max(mapped.stamps) - min(mapped.stamps)
    keyframes = len(mapped.slam.keyframes)
    typer.echo(
        f"{len(poses)} scans over {duration:.1f} s, {keyframes} keyframes, {len(mapped.closures)} closures, "
        f"{len(poses) / elapsed:.0f} scans/s, {duration / elapsed:.0f} times real time"
    )
    write_figures(
        json_file,
        {
            "source": str(source),
            "scans": len(poses),
            "keyframes": keyframes,
            "closures": len(mapped.closures),
            "duration_s": duration,
            "scans_per_second": len(poses) / elapsed,
            "times_real_time": duration / elapsed,
        },
    )

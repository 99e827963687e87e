"""Options and output that several sub-commands share."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

TopicToUse = Annotated[
    str | None, typer.Option("--topic", help="Topic of the scans or clouds; default: the first one found.")
]
WithWheels = Annotated[
    bool,
    typer.Option("--wheels/--no-wheels", help="Use the log's wheel odometry, if any, as initial guess."),
]
TumFile = Annotated[
    Path | None, typer.Option("--out", metavar="T.tum", help="Write the trajectory, one line per scan.")
]
JsonFile = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the figures to FILE as JSON.")
]

Dask = Annotated[
    str,
    typer.Option(
        "--dask",
        metavar="ADDRESS",
        help="Compute on a Dask cluster: tcp://HOST:8786, or local:N for N workers on this machine.",
    ),
]
Jobs = Annotated[int, typer.Option("--jobs", min=1, help="Number of processes.")]


def write_figures(path: Path | None, figures: Mapping[str, Any]) -> None:
    """Write figures as JSON, atomically; nothing where no file was asked for."""
    from whereabouts.atomic import atomic_path

    if path is None:
        return
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")

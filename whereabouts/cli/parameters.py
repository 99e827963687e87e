"""`whereabouts parameters`: ROS parameter files to begin with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from whereabouts.cli.common import argument, file_to_write, option
from whereabouts.node_names import NODES
from whereabouts.system.counting import counted


def parameters(
    nodes: Annotated[
        list[str] | None, argument("[NODE]...", f"Of these nodes: {', '.join(NODES)}. Default: all.")
    ] = None,
    expert: Annotated[
        bool, option("--expert", "Those that hardly anybody changes, in place of the usual ones.")
    ] = False,
    out: Annotated[
        Path | None, file_to_write("--out", "FILE", "Write them here; default: print them.")
    ] = None,
) -> None:
    """Write a ROS parameter file with the defaults, and the meaning, unit and range of each parameter."""
    from estimation.errors import InputError
    from whereabouts.parameters.yaml_text import parameter_file
    from whereabouts.system.atomic import atomic_path

    unknown = [name for name in nodes or () if name not in NODES]
    if unknown:
        raise InputError(f"no node is called {', '.join(unknown)}; there are: {', '.join(NODES)}")
    text = parameter_file(nodes or NODES, expert)
    if out is None:
        typer.echo(text, nl=False)
        return
    with atomic_path(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    typer.echo(
        f"{out}: {'expert parameters' if expert else 'parameters'} of {counted(len(nodes or NODES), 'node')}"
    )

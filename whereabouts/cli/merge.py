"""`whereabouts merge`: two saved maps become one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from whereabouts.cli.common import argument, file_to_write
from whereabouts.system.counting import counted


def merge(
    first: Annotated[Path, argument("FIRST.npz", "A saved map; its frame stays.")],
    second: Annotated[Path, argument("SECOND.npz", "A map of another session that overlaps it.")],
    map_file: Annotated[
        Path,
        file_to_write(
            "--map",
            "M.png",
            "Write the map to M.npz. From planar scans also write M.pgm and M.yaml, as map_saver does.",
        ),
    ],
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

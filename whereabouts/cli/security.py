"""`whereabouts security`: SROS2 policies of the nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from whereabouts.cli.common import option, target_folder


def security(
    out: Annotated[Path, option("--out", "Folder for the policies, one file each.", callback=target_folder)],
    config: Annotated[
        Path | None, option("--config", "The suite's file, as of `whereabouts run --config`.")
    ] = None,
) -> None:
    """Write least-privilege SROS2 policies: one for each node, one for clients and one for operators.

    docs/security.md says how to use them.
    """
    from whereabouts.sros2_policies import write_policies
    from whereabouts.suite_config import read_config

    for path in write_policies(read_config(config, {}), out):
        typer.echo(str(path))

"""`whereabouts experiment`: measures every figure of the pages, and compares two results."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from whereabouts.cli.common import JsonFile, argument, option, target_folder, write_figures

OUT = Path("experiments-out")

Dask = Annotated[
    str,
    option(
        "--dask",
        "Compute on a Dask cluster: tcp://HOST:8786, or local:N for N workers on this machine.",
        metavar="ADDRESS",
    ),
]
Folders = Annotated[
    list[Path] | None, argument("[OLD NEW]", "For `compare`: two folders or files of results.")
]
Out = Annotated[Path, option("--out", "Folder for NAME.json and its pictures.", callback=target_folder)]
Jobs = Annotated[
    int | None, option("--jobs", "Number of processes. Default: 1; for `all` one per core.", min=1)
]
LeftOut = Annotated[bool, option("--left-out", "Show only the results on data that took part in no choice.")]


def experiment(
    name: Annotated[str, argument("NAME", "An experiment, `all`, `list`, or `compare`.")],
    folders: Folders = None,
    out: Out = OUT,
    seed: Annotated[int, option("--seed", "Seed of the first repetition; the others follow.")] = 0,
    jobs: Jobs = None,
    dask: Dask = "",
    quick: Annotated[bool, option("--quick", "Fewer repetitions of the same protocol.")] = False,
    resume: Annotated[bool, option("--resume", "Continue an interrupted run.")] = False,
    left_out: LeftOut = False,
    json_file: JsonFile = None,
) -> None:
    """Run an experiment, print its tables and write its figures; or compare two results."""
    from estimation.errors import InputError
    from evaluation.datasets import data_directory
    from evaluation.parallel import cluster
    from evaluation.running import Run, experiments, run_each
    from evaluation.showing import show, show_comparison

    if name == "compare":
        if folders is None or len(folders) != 2:
            raise InputError(
                "compare takes two folders or files of results: whereabouts experiment compare OLD NEW"
            )
        if show_comparison(*folders):
            raise typer.Exit(1)
        return
    if folders:
        raise InputError(f"experiment {name}: unexpected {folders[0]}; only `compare` takes folders")
    known = experiments()
    if name == "list":
        for key, module in known.items():
            typer.echo(f"{key:14} {(module.__doc__ or '').splitlines()[0]}")
        return
    if name != "all" and name not in known:
        raise InputError(f"no experiment is called {name}; there are: {', '.join(known)}, all")
    out.mkdir(parents=True, exist_ok=True)
    every, data = name == "all", data_directory()
    workers = (jobs or os.cpu_count() or 1) if every else 1
    runs = [
        Run(key, out, quick, resume, 1 if every else jobs or 1, seed, data)
        for key in (known if every else [name])
    ]
    done = [asked for asked in runs if every and resume and asked.finished()]
    for asked in done:
        typer.echo(f"{asked.name}: done before")
    figures: dict[str, float] = {}
    with cluster(dask):
        open_runs = [asked for asked in runs if asked not in done]
        for number, result in enumerate(run_each(open_runs, workers), 1):
            show(result, left_out)
            if every:
                seconds = result.content["seconds"]
                typer.echo(f"{result.name}: {number} of {len(open_runs)}, {seconds:.0f} s", err=True)
            prefix = f"{result.name}." if every else ""
            figures |= {prefix + key: known["value"] for key, known in result.figures.items()}
    write_figures(json_file, figures)

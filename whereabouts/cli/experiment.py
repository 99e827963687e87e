"""`whereabouts experiment`: measures every figure of the pages, and compares two results."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from whereabouts.cli.common import Dask, JsonFile, target_folder, write_figures
from whereabouts.system.counting import counted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evaluation.results import Result

OUT = Path("experiments-out")


Folders = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[OLD NEW]", help="For `compare`: two folders or files of results."),
]
Out = Annotated[
    Path, typer.Option("--out", help="Folder for NAME.json and its pictures.", callback=target_folder)
]
Jobs = Annotated[
    int | None, typer.Option("--jobs", min=1, help="Number of processes. Default: 1; for `all` one per core.")
]
LeftOut = Annotated[
    bool, typer.Option("--left-out", help="Show only the results on data that took part in no choice.")
]


def experiment(
    name: Annotated[str, typer.Argument(metavar="NAME", help="An experiment, `all`, `list`, or `compare`.")],
    folders: Folders = None,
    out: Out = OUT,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the first repetition; the others follow.")] = 0,
    jobs: Jobs = None,
    dask: Dask = "",
    quick: Annotated[bool, typer.Option("--quick", help="Fewer repetitions of the same protocol.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted run.")] = False,
    left_out: LeftOut = False,
    json_file: JsonFile = None,
) -> None:
    """Run an experiment, print its tables and write its figures; or compare two results."""
    from estimation.errors import InputError
    from evaluation.parallel import cluster
    from evaluation.running import Run, experiments, run_each
    from whereabouts.datasets import data_directory

    if name == "compare":
        _compare(folders or [])
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
            _print(result, left_out)
            if every:
                seconds = result.content["seconds"]
                typer.echo(f"{result.name}: {number} of {len(open_runs)}, {seconds:.0f} s", err=True)
            prefix = f"{result.name}." if every else ""
            figures |= {prefix + key: known["value"] for key, known in result.figures.items()}
    write_figures(json_file, figures)


def _print(result: Result, left_out: bool) -> None:
    from evaluation.markdown import cell

    console = _console()
    for table in result.tables:
        rows = [row for row in table["rows"] if not left_out or _is_left_out(row, result)]
        if rows:
            _draw(console, table, [[cell(each, result.figures) for each in row] for row in rows])
    for note in result.content["notes"]:
        console.print(f"- {note}", markup=False)
    drawn = counted(len(result.content["pictures"]), "picture")
    console.print(f"{result.path}: {counted(len(result.figures), 'figure')}, {drawn}", markup=False)


def _is_left_out(row: list[Any], result: Result) -> bool:
    """Whether a row has a figure that is judged on data which took part in no choice."""
    keys = [cell["figure"] for cell in row if isinstance(cell, dict) and "figure" in cell]
    return any(result.figures[key].get("data") == "left out" for key in keys)


def _draw(console: Any, table: Mapping[str, Any], rows: list[list[str]]) -> None:
    from rich.table import Table

    from evaluation.markdown import column_heading

    drawn = Table(
        title=table["title"], title_justify="left", caption=table["note"] or None, caption_justify="left"
    )
    for index, column in enumerate(table["columns"]):
        drawn.add_column(column_heading(column), justify="left" if index == 0 else "right")
    for row in rows:
        drawn.add_row(*row)
    console.print(drawn)


def _compare(folders: list[Path]) -> None:
    """Print which figures left their spread; exit status 1 where one is worse."""
    from rich.table import Table

    from estimation.errors import InputError
    from evaluation.compare import VERDICTS, compare, load, ordered, warnings

    if len(folders) != 2:
        raise InputError(
            "compare takes two folders or files of results: whereabouts experiment compare OLD NEW"
        )
    old, new = (load(folder) for folder in folders)
    console = _console()
    for text in warnings(old, new):
        console.print(f"- {text}", markup=False)
    changes = ordered(compare(old, new))
    drawn = Table(title="Figures that left their spread", title_justify="left")
    for title in ("", "experiment", "figure", "old", "new", "spread", "unit", "judged on"):
        drawn.add_column(title, justify="right" if title in ("old", "new", "spread") else "left")
    for change in changes:
        numbers = (
            "-" if value is None else f"{value:.4g}" for value in (change.old, change.new, change.spread)
        )
        drawn.add_row(change.verdict, change.experiment, change.key, *numbers, change.unit, change.data)
    if changes:
        console.print(drawn)
    verdicts = [change.verdict for change in changes]
    counts = {word: verdicts.count(word) for word in VERDICTS}
    figures = sum(len(new[name].figures) for name in new if name in old)
    console.print(f"of {figures} figures: " + ", ".join(f"{count} {word}" for word, count in counts.items()))
    if counts["worse"]:
        raise typer.Exit(1)


def _console() -> Any:
    from rich.console import Console

    # Wide enough for every table when the output is a file or a pipe.
    return Console(width=None if Console().is_terminal else 200)

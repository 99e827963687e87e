"""`whereabouts experiment`: the reference's tables and figures, theirs beside ours."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from whereabouts.cli.common import Dask, Jobs, JsonFile, write_figures

if TYPE_CHECKING:
    from evaluation.report import Report, Table


def experiment(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the experiment, `all`, or `list`.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for pictures.")] = Path("experiments-out"),
    seed: Annotated[int, typer.Option("--seed", help="Seed of all random draws.")] = 0,
    jobs: Jobs = 1,
    dask: Dask = "",
    quick: Annotated[bool, typer.Option("--quick", help="Fewer repetitions of the same protocol.")] = False,
    json_file: JsonFile = None,
) -> None:
    """Run an experiment of the reference texts and print its tables."""
    from estimation.errors import InputError
    from evaluation.report import Options
    from whereabouts.datasets import data_directory
    from whereabouts.parallel import cluster

    known = experiments()
    if name == "list":
        for key, module in known.items():
            typer.echo(f"{key:14} {(module.__doc__ or '').splitlines()[0]}")
        return
    if name != "all" and name not in known:
        raise InputError(f"no experiment is called {name}; there are: {', '.join(known)}, all")
    figures: dict[str, float] = {}
    with cluster(dask):
        for key in known if name == "all" else [name]:
            folder = out / key
            folder.mkdir(parents=True, exist_ok=True)
            report = known[key].run(Options(folder, seed, jobs, quick, data_directory()))
            _print(report)
            figures |= {
                f"{key}.{figure}" if name == "all" else figure: value
                for figure, value in report.figures.items()
            }
    write_figures(json_file, figures)


def experiments() -> dict[str, Any]:
    """Experiment modules by name: those of the package that have a `run`."""
    import importlib
    import pkgutil

    import evaluation.experiments as package

    modules = {}
    for info in pkgutil.iter_modules(package.__path__):
        if "_" in info.name or info.name == "report":
            continue
        module = importlib.import_module(f"{package.__name__}.{info.name}")
        if hasattr(module, "run"):
            modules[info.name] = module
    return modules


def _print(report: Report) -> None:
    from rich.console import Console

    # Wide enough for every table when the output is a file or a pipe.
    console = Console(width=None if Console().is_terminal else 160)
    for table in report.tables:
        _print_table(console, table)
    for note in report.notes:
        console.print(f"- {note}", markup=False)
    for picture in report.pictures:
        console.print(f"picture: {picture}", markup=False)


def _print_table(console: Any, table: Table) -> None:
    from rich.table import Table as RichTable

    drawn = RichTable(
        title=table.title, title_justify="left", caption=table.note or None, caption_justify="left"
    )
    for index, column in enumerate(table.columns):
        drawn.add_column(column, justify="left" if index == 0 else "right")
    for row in table.rows:
        drawn.add_row(*(_cell(value) for value in row))
    console.print(drawn)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)

"""Results on the terminal: their tables, and which figures left their spread between two of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from evaluation.compare import VERDICTS, compare, load, ordered, warnings
from evaluation.markdown import cell, column_heading
from evaluation.results import Result
from whereabouts.system.counting import counted


def show(result: Result, left_out: bool = False) -> None:
    """Print the tables and notes of a result; left_out : only rows on data that took part in no choice."""
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
    keys = [each["figure"] for each in row if isinstance(each, dict) and "figure" in each]
    return any(result.figures[key].get("data") == "left out" for key in keys)


def _draw(console: Console, table: Mapping[str, Any], rows: list[list[str]]) -> None:
    drawn = Table(
        title=table["title"], title_justify="left", caption=table["note"] or None, caption_justify="left"
    )
    for index, column in enumerate(table["columns"]):
        drawn.add_column(column_heading(column), justify="left" if index == 0 else "right")
    for row in rows:
        drawn.add_row(*row)
    console.print(drawn)


def show_comparison(old_path: Path, new_path: Path) -> bool:
    """Print which figures left their spread between two results; whether one is worse."""
    old, new = load(old_path), load(new_path)
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
    return counts["worse"] > 0


def _console() -> Console:
    # Wide enough for every table when the output is a file or a pipe.
    return Console(width=None if Console().is_terminal else 200)

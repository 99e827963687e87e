"""How results are shown: numbers, cells and tables, the same on the terminal and in pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

ARROWS = {"lower": " ↓", "higher": " ↑"}
BESIDE = ("%", "°")
"""Units that stand at the number without a blank."""
ABSENT = "-"


def number(value: float | None) -> str:
    """Three digits, whole from 100 on."""
    if value is None:
        return ABSENT
    if float(value).is_integer() or abs(value) >= 100.0:
        return f"{value:.0f}"
    return f"{value:.3g}"


def with_spread(figure: Mapping[str, Any]) -> str:
    """The mean, and from where to where it was over the seeds: "0.31 (0.29 to 0.34)"."""
    low, high = number(figure.get("low")), number(figure.get("high"))
    text = number(figure["value"])
    return text if low == high else f"{text} ({low} to {high})"


def with_unit(figure: Mapping[str, Any], spread: bool = False) -> str:
    """A figure in a sentence: "0.31 m"."""
    text = with_spread(figure) if spread else number(figure["value"])
    unit = figure.get("unit", "")
    return text + ("" if not unit else unit if unit in BESIDE else f" {unit}")


def cell(content: Any, figures: Mapping[str, Mapping[str, Any]]) -> str:
    """One cell of a table; a figure that is not there is a hyphen."""
    if not isinstance(content, Mapping):
        return str(content)
    if "printed" in content:
        value = content["printed"]
        return value if isinstance(value, str) else number(value)
    figure = figures.get(content["figure"])
    return ABSENT if figure is None else with_spread(figure)


def column_heading(column: Mapping[str, str]) -> str:
    """Name, unit and arrow of a column."""
    name, unit = column["name"], column["unit"]
    return (f"{name}, {unit}" if unit and unit != name else name) + ARROWS.get(column["better"], "")


def table(content: Mapping[str, Any], figures: Mapping[str, Mapping[str, Any]]) -> str:
    """A table of results as Markdown, with what its data had to do with any choice in a column of its own."""
    judged = [_judged(row, figures) for row in content["rows"]]
    headings = [column_heading(column) for column in content["columns"]]
    rows = [[cell(each, figures) for each in row] for row in content["rows"]]
    if len(set(judged)) > 1:
        headings.append("judged on")
        rows = [[*row, word] for row, word in zip(rows, judged, strict=True)]
    return pipes(headings, rows)


def _judged(row: Sequence[Any], figures: Mapping[str, Mapping[str, Any]]) -> str:
    words = (
        figures.get(each["figure"], {}).get("data", "")
        for each in row
        if isinstance(each, Mapping) and "figure" in each
    )
    return next((word for word in words if word), "")


def pipes(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""

    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(text.replace("|", "\\|").replace("\n", " ") for text in cells) + " |"

    return "\n".join([line(headings), line(["---"] * len(headings)), *map(line, rows)])

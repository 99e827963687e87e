"""Results are files: `results/NAME.json` holds every figure of an experiment, with all that one has to know of it.

    figures   key -> value, unit, better, data, samples, printed, where; over several seeds low, high and values
    tables    title, heading, columns, note, rows; a cell is a text, {"figure": key} or {"printed": value, "where": ...}
    pictures  file -> digest
    digest    of the sources and models; recordings -> digest
    command, commit, changed, quick, seeds, seconds, processor, versions, finished

A value over several seeds is their mean, low the smallest of them and high the largest.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from estimation.errors import InputError
from evaluation.digest import ROOT, data_digest, file_digest, source_digest
from evaluation.report import Printed, Report, Table, heading, keyed

SCHEMA = 1
DIGITS = 6
"""Significant digits that are kept: enough for every page, few enough to read a difference."""
LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "kiss-icp",
    "small_gicp",
    "kiss-matcher",
    "gtsam",
    "scikit-learn",
    "lightgbm",
    "stonesoup",
)
FOLDER = ROOT / "results"


@dataclass(frozen=True)
class Result:
    """A file of results, as it was read."""

    path: Path
    content: Mapping[str, Any]

    @property
    def name(self) -> str:
        return str(self.content["experiment"])

    @property
    def figures(self) -> Mapping[str, Mapping[str, Any]]:
        return self.content["figures"]

    @property
    def tables(self) -> Sequence[Mapping[str, Any]]:
        return self.content["tables"]

    def table(self, name: str) -> Mapping[str, Any]:
        """A table by its name."""
        for table in self.tables:
            if table["name"] == name:
                return table
        known = ", ".join(table["name"] for table in self.tables)
        raise InputError(f"{self.path}: no table is called {name}; there are: {known}")

    def stale(self, data: Path | None = None) -> list[str]:
        """What has changed since this was measured: sources, pictures and, where they are present, recordings."""
        changed = []
        if source_digest(module_of(self.name)) != self.content["digest"]:
            changed.append("sources")
        for file, digest in self.content["pictures"].items():
            path = self.path.parent / file
            if not path.exists() or file_digest(path) != digest:
                changed.append(file)
        recorded = self.content["recordings"]
        if data is not None and recorded and data_digest(data, recorded) != recorded:
            changed.append("recordings")
        return changed


def module_of(experiment: str) -> str:
    """The module of an experiment."""
    return f"evaluation.experiments.{experiment}"


def read(path: Path) -> Result:
    """Read one file of results.

    Raises
    ------
    InputError : it is not one.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise InputError(
                f"{path}: schema {content['schema']}, {SCHEMA} expected: run the experiment again"
            )
        for name in ("experiment", "figures", "tables", "pictures", "digest", "recordings"):
            content[name]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not a file of results: {type(error).__name__}: {error}") from None
    return Result(path, content)


def read_all(folder: Path = FOLDER) -> dict[str, Result]:
    """All results of a folder by experiment."""
    return {path.stem: read(path) for path in sorted(folder.glob("*.json"))}


def record(report: Report) -> dict[str, Any]:
    """A report as it is kept: figures by key, tables whose cells refer to them, notes and pictures."""
    figures = {}
    for key, figure in report.every_figure().items():
        known: dict[str, Any] = {"value": rounded(figure.value) if math.isfinite(figure.value) else None}
        known |= {
            name: getattr(figure, name)
            for name in ("unit", "better", "data", "samples")
            if getattr(figure, name)
        }
        if figure.printed is not None:
            known |= {"printed": figure.printed.value, "where": figure.printed.where}
        figures[key] = known
    tables = [_table(table) for table in report.tables]
    return {
        "figures": figures, "tables": tables, "notes": report.notes,
        "pictures": [str(path) for path in report.pictures],
    }  # fmt: skip


def merged(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The same part at several seeds: mean, smallest and largest of every figure; the tables of the first."""
    figures: dict[str, Any] = {}
    for key in dict.fromkeys(key for found in records for key in found["figures"]):
        every = [found["figures"][key] for found in records if key in found["figures"]]
        values = [each["value"] for each in every]
        known = [value for value in values if value is not None]
        figures[key] = {**every[0], "value": rounded(sum(known) / len(known)) if known else None}
        if len(records) > 1 and known:
            figures[key] |= {"low": min(known), "high": max(known), "values": values}
    notes = list(dict.fromkeys(note for found in records for note in found["notes"]))
    return {"figures": figures, "tables": records[0]["tables"], "notes": notes}


def rounded(value: float) -> float | int:
    """To the digits that are kept; whole numbers are whole."""
    if float(value).is_integer() and abs(value) < 10**DIGITS:
        return int(value)
    return float(f"{value:.{DIGITS}g}")


def _table(table: Table) -> dict[str, Any]:
    rows = []
    for cells, keys in zip(table.rows, keyed(table), strict=True):
        row: list[Any] = []
        for title, cell, key in zip(table.columns, cells, keys, strict=True):
            if key:
                row.append({"figure": key})
            elif isinstance(cell, Printed):
                row.append({"printed": cell.value, "where": cell.where})
            elif title in table.printed and cell not in (None, "", "-"):
                row.append({"printed": cell, "where": table.printed[title]})
            else:
                row.append("" if cell is None else cell if isinstance(cell, str) else str(cell))
        rows.append(row)
    columns = [heading(title) for title in table.columns]
    return {
        "name": table.key, "title": table.title, "note": table.note,
        "columns": [{"name": name, "unit": unit, "better": better} for name, unit, better in columns],
        "rows": rows,
    }  # fmt: skip


def versions() -> dict[str, str]:
    """Of the libraries that figures may depend on, as far as they are installed."""
    import platform

    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def processor() -> str:
    """Name and number of cores."""
    import os
    import platform

    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{name}, {os.cpu_count()} cores"


def commit() -> tuple[str, bool]:
    """The commit of the checkout, and whether files differ from it; "" outside a checkout."""
    import subprocess

    def git(*arguments: str) -> str:
        answer = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
        return answer.stdout.strip() if answer.returncode == 0 else ""

    try:
        return git("rev-parse", "--short=12", "HEAD"), bool(git("status", "--porcelain", "--", ":!results"))
    except OSError:
        return "", False

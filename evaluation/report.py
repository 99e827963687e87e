"""What every experiment takes and returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Options:
    """How to run an experiment.

    out : folder for pictures. seed : of every random draw. jobs : processes to use.
    quick : fewer repetitions, the same protocol; the report says so.
    data : folder of recordings, None where they are absent.
    """

    out: Path
    seed: int = 0
    jobs: int = 1
    quick: bool = False
    data: Path | None = None


@dataclass
class Table:
    """One table: a row is a list as long as `columns`; numbers stay numbers until they are printed."""

    title: str
    columns: list[str]
    rows: list[list[Any]]
    note: str = ""


@dataclass
class Report:
    """The outcome of an experiment: tables for people, `figures` (flat, named numbers) for `--json`."""

    name: str
    tables: list[Table] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    pictures: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

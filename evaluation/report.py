"""What every experiment takes and returns: tables, whose numbers are the figures that pages are written from."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SEEDS = 5
"""Repetitions of everything that draws at random."""

UNITS = frozenset(
    "% m mm cm km ° °/m rad rad/m s ms µs min nat MiB kB × 1/s scans/s /scan".split()  # noqa: SIM905
)
ARROWS = {"↓": "lower", "↑": "higher"}


@dataclass(frozen=True)
class RunOptions:
    """How to run a part of an experiment.

    out : folder for pictures. seed : of every random draw. jobs : processes to use.
    quick : fewer repetitions of the same protocol. seeds : over how many seeds the part is repeated.
    data : folder of recordings, None where they are absent. kept : folder for what other parts of the same run use
    again; files named after the experiment are gone once it is written. None: nothing is kept.
    """

    out: Path
    seed: int = 0
    jobs: int = 1
    quick: bool = False
    data: Path | None = None
    seeds: int = 1
    kept: Path | None = None

    def draws(self, stream: int, count: int = 1) -> list[int]:
        """Seeds of the runs of one repetition; stream : of which part they are."""
        import numpy as np

        seeds: list[int] = np.random.default_rng([self.seed, stream]).integers(2**31, size=count).tolist()
        return seeds

    def share(self, whole: int, quick: int) -> int:
        """Of so many repetitions in all, those of this seed."""
        return max((quick if self.quick else whole) // self.seeds, 1)


@dataclass(frozen=True)
class Printed:
    """A figure of a reference text or of another's publication, and where it stands there."""

    value: float | int | str
    where: str = ""


@dataclass(frozen=True)
class Figure:
    """One number that was measured.

    better : "lower", "higher", or "" where neither is. data : whether the data that judges it took part in any
    choice ("tuned on", "left out", "simulated"; "model left out": what is trained was trained without it, but it was
    looked at when parameters were set by hand). samples : what the number is a mean, share or median of.
    """

    value: float
    unit: str = ""
    better: str = ""
    data: str = ""
    samples: int | None = None
    printed: Printed | None = None


@dataclass
class Table:
    """One table; a row is a list as long as `columns`.

    columns : headings such as "error, m ↓": a unit behind the comma, an arrow where one direction is better. A
        heading of a row (its first cell) may say so too, where the rows are quantities.
    rows : cells are text, numbers (each becomes a figure), or `Printed`. The texts before the first number name a row.
    name : by which pages refer to the table; made of the title where it is empty.
    printed : columns of the reference's figures, heading -> where they stand in the text. Behind "text: " such a
        heading names the column it belongs to.
    data : what the data that judges had to do with any choice, for all rows or by the first cell of a row.
    samples : behind each number, for all rows or by the first cell of a row.
    """

    title: str
    columns: list[str]
    rows: list[list[Any]]
    note: str = ""
    name: str = ""
    printed: Mapping[str, str] = field(default_factory=dict)
    data: str | Mapping[str, str] = ""
    samples: int | Mapping[str, int] | None = None

    @property
    def key(self) -> str:
        """The table's part of its figures' keys."""
        return self.name or slug(self.title)


@dataclass
class Report:
    """The outcome of one part of an experiment; `figures` are numbers that stand in no table."""

    name: str
    tables: list[Table] = field(default_factory=list)
    figures: dict[str, float | Figure] = field(default_factory=dict)
    pictures: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(
        self,
        title: str,
        columns: list[str],
        rows: list[list[Any]],
        note: str = "",
        name: str = "",
        printed: Mapping[str, str] | None = None,
        data: str | Mapping[str, str] = "",
        samples: int | Mapping[str, int] | None = None,
    ) -> None:
        """One more table, by the fields of `Table`."""
        self.tables.append(Table(title, columns, rows, note, name, printed or {}, data, samples))

    def every_figure(self) -> dict[str, Figure]:
        """All figures by key: those of the tables (`table/row/column`) and those beside them."""
        found = {key: figure for table in self.tables for key, figure in figures_of(table)}
        beside = {slug(key): value for key, value in self.figures.items()}
        return found | {
            key: value if isinstance(value, Figure) else Figure(float(value)) for key, value in beside.items()
        }


@dataclass(frozen=True)
class Part:
    """A part of an experiment: a function that adds its tables to a report.

    random : whether it draws at random; it is then repeated over the seeds. quick_seeds : over how many of them in a
    quick run, where one repetition is long. needs : recordings it reads, as patterns
    below the folder of recordings; where they are absent the part is left out, and the report says so.
    """

    run: Callable[[RunOptions, Report], None]
    random: bool = True
    quick_seeds: int = SEEDS
    needs: tuple[str, ...] = ()


def slug(text: str) -> str:
    """Lower-case words and numbers joined by hyphens."""
    kept = text.replace("σ", "sigma").replace("θ", "theta").replace("±", "spread").replace("°", "deg")
    kept = kept.replace("µ", "u").replace("μ", "u")
    kept = kept.replace("%", "percent").replace("×", "times").replace("/", " per ")
    return re.sub(r"[^a-z0-9.]+", "-", kept.lower()).strip("-.") or "value"


def heading(text: str) -> tuple[str, str, str]:
    """A heading's name, unit and better direction: "error, m ↓" -> ("error", "m", "lower")."""
    name = text.strip()
    better = ARROWS.get(name[-1:], "")
    name = name.rstrip("↓↑ ")
    front, _, last = name.rpartition(" ")
    if last in UNITS and any(letter.isalpha() for letter in front):
        return front.rstrip(", "), last, better
    # "1 mm" is the name of a case, not a quantity in millimetres; "m" alone is one.
    return name, last if last in UNITS and not front else "", better


def is_number(cell: Any) -> bool:
    """Whether a cell is a figure, not a text, a flag or a printed one."""
    import numpy as np

    return isinstance(cell, int | float | np.number | Figure) and not isinstance(cell, bool | np.bool_)


def row_key(row: list[Any]) -> str:
    """The texts before the first number; the first cell always, whatever it is."""
    names = [str(row[0])]
    for cell in row[1:]:
        if not isinstance(cell, str) or not cell:
            break
        names.append(cell)
    return slug(" ".join(heading(name)[0] for name in names))


def figures_of(table: Table) -> Iterator[tuple[str, Figure]]:
    """Keys and figures of a table, row by row."""
    for row, cells in enumerate(keyed(table)):
        for column, key in enumerate(cells):
            if key:
                yield key, _figure(table, table.rows[row], column)


def keyed(table: Table) -> list[list[str]]:
    """For each cell the key of its figure, "" where it has none."""
    seen: dict[str, int] = {}
    keys = []
    for row in table.rows:
        if len(row) != len(table.columns):
            raise ValueError(
                f"{table.title}: row {row[0]!r} has {len(row)} cells, {len(table.columns)} expected"
            )
        name = row_key(row)
        seen[name] = seen.get(name, 0) + 1
        name = name if seen[name] == 1 else f"{name}-{seen[name]}"
        keys.append(
            [
                f"{table.key}/{name}/{slug(' '.join(heading(title)[:2]))}"
                if column and title not in table.printed and is_number(cell)
                else ""
                for column, (title, cell) in enumerate(zip(table.columns, row, strict=True))
            ]
        )
    return keys


def _figure(table: Table, row: list[Any], column: int) -> Figure:
    cell = row[column]
    if isinstance(cell, Figure):
        return cell
    name, unit, better = heading(table.columns[column])
    _, row_unit, row_better = heading(str(row[0]))
    data = table.data if isinstance(table.data, str) else table.data.get(str(row[0]), "")
    samples = table.samples.get(str(row[0])) if isinstance(table.samples, Mapping) else table.samples
    return Figure(
        float(cell), unit or row_unit, better or row_better, data, samples, _printed(table, row, name)
    )


def _printed(table: Table, row: list[Any], name: str) -> Printed | None:
    """The reference's figure beside one of ours: of the column "text: name", or of the only printed one there is."""
    for title, where in table.printed.items():
        own = heading(title.removeprefix("text: "))[0]
        if own == name or (len(table.printed) == 1 and not title.startswith("text: ")):
            cell = row[table.columns.index(title)]
            if isinstance(cell, Printed):
                return cell
            return None if cell in (None, "", "-") else Printed(cell, where)
    return None

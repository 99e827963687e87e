"""Recorded trajectories of people: Edinburgh Informatics Forum, ETH/BIWI obsmat, and tables with a header.

* Edinburgh: lines `TRACK.Rn=[[x y frame];[x y frame];...]` in pixels, `Properties.Rn=[...]`, `%` comments.
* ETH obsmat: rows of eight numbers, `frame id x z y vx vz vy`, m and m/s, 25 frames per second.
* CSV: a header with columns time (or t, stamp), label (or id, track), x and y, s and m, as `whereabouts track` writes.

All may be gzipped or bzipped. Trajectories come out in metres and seconds, in the order of the file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from whereabouts.logs.formats.text import TextSource
from whereabouts.logs.summary import Summary
from whereabouts.system.log_errors import (
    EmptyLogError,
    NothingRecognisedError,
    TrajectoryError,
    UnknownFormatError,
)

Array = NDArray[np.float64]

# The hall's camera, seen from above.
EDINBURGH_METRES = 0.0247
EDINBURGH_RATE = 9.0
ETH_RATE = 25.0
HEAD = re.compile(rb"\s*TRACK\.R(\d+)\s*=\s*\[(.*)")
ROW = re.compile(rb"\[?\s*(-?[\d.]+(?:[eE][-+]?\d+)?)\s+(\S+?)\s+(\S+?)\s*\]")
COLUMNS = {"t": ("time", "t", "stamp"), "label": ("label", "id", "track"), "x": ("x",), "y": ("y",)}


@dataclass(frozen=True)
class RecordedTrajectories:
    """`trajectories` by number, each (N, 3) x, y, t in m and s as recorded; `kind` is edinburgh, eth or csv."""

    kind: str
    trajectories: dict[int, Array]
    summary: Summary


def read_trajectories(path: Path | str) -> RecordedTrajectories:
    """Read a file of trajectories; the format is found by its content.

    Raises
    ------
    LogNotFoundError, EmptyLogError : nothing there.
    UnknownFormatError : none of the formats.
    NothingRecognisedError : no trajectory in it.
    TrajectoryError : a row of a table is not made of numbers; the message has its line.
    """
    source = TextSource(Path(path))
    summary = Summary()
    lines = list(source.lines(summary))
    text = [(number, line) for number, line in lines if line.strip()]
    if not text:
        raise EmptyLogError(path, "holds nothing")
    first = text[0][1].strip()
    if any(HEAD.match(line) for _, line in text[:20]):
        kind, found = "edinburgh", _edinburgh(text, summary)
    elif _header(first) is not None:
        kind, found = "csv", _table(Path(path), text)
    elif len(first.split()) == 8 and _numbers(first) is not None:
        kind, found = "eth", _obsmat(Path(path), text)
    else:
        problem = (
            "no Edinburgh file (TRACK.Rn=...), no ETH obsmat (8 numbers a row), no CSV with time, label, x, y"
        )
        raise UnknownFormatError(path, problem, f"line {text[0][0]}")
    if not found:
        raise NothingRecognisedError(path, "no trajectory is in it")
    return RecordedTrajectories(kind, found, summary)


def _edinburgh(lines: list[tuple[int, bytes]], summary: Summary) -> dict[int, Array]:
    found: dict[int, Array] = {}
    for number, line in lines:
        match = HEAD.match(line)
        if match is None:
            continue
        rows = [values for row in ROW.findall(match[2]) if (values := _numbers(b" ".join(row))) is not None]
        if not rows:
            summary.skip("track without points", f"line {number}")
            continue
        found[int(match[1])] = np.array(rows) * [EDINBURGH_METRES, EDINBURGH_METRES, 1.0 / EDINBURGH_RATE]
    return found


def _obsmat(path: Path, lines: list[tuple[int, bytes]]) -> dict[int, Array]:
    rows: list[tuple[float, ...]] = []
    for number, line in lines:
        values = _numbers(line)
        if values is None or len(values) != 8:
            raise TrajectoryError(path, "`frame id x z y vx vz vy` expected, eight numbers", f"line {number}")
        rows.append((values[1], values[2], values[4], values[0] / ETH_RATE))
    return _by_label(rows)


def _table(path: Path, lines: list[tuple[int, bytes]]) -> dict[int, Array]:
    columns = _header(lines[0][1].strip())
    assert columns is not None
    rows = []
    for number, line in lines[1:]:
        values = _numbers(line.replace(b",", b" "))
        if values is None or len(values) <= max(columns.values()):
            raise TrajectoryError(path, f"numbers in columns {', '.join(columns)} expected", f"line {number}")
        rows.append(tuple(values[columns[name]] for name in ("label", "x", "y", "t")))
    return _by_label(rows)


def _by_label(rows: list[tuple[float, ...]]) -> dict[int, Array]:
    found: dict[int, list[tuple[float, ...]]] = {}
    for label, *rest in rows:
        found.setdefault(int(label), []).append(tuple(rest))
    return {label: np.array(points) for label, points in found.items()}


def _header(line: bytes) -> dict[str, int] | None:
    """Column of each needed quantity, None where it is no such header."""
    names = [name.strip().lower() for name in line.decode("ascii", "replace").split(",")]
    columns = {
        key: next((names.index(name) for name in known if name in names), -1)
        for key, known in COLUMNS.items()
    }
    return columns if min(columns.values()) >= 0 else None


def _numbers(line: bytes) -> list[float] | None:
    try:
        values = [float(part) for part in line.split()]
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None

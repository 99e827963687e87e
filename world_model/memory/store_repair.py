"""Damage of a store found, and what is whole taken over into a new file.

A damaged file is never written again: a new one is made beside it from all rows that are as they were written, wherever
in the file they lie, and from snapshots what is missing; then the two change places. Runs and who is present are worked
out again where they are lost. A store of the first version, without marks, is taken over into a new file as well.
"""

from __future__ import annotations

import os
import sqlite3
import uuid
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from world_model.memory.store_format import (
    APPLICATION,
    CLOCK,
    COUNTED,
    CURRENT,
    EPOCHS,
    FIRST_VERSION,
    HISTORY,
    INDICES,
    NAMES,
    OBJECTS,
    PAGE,
    SCHEMA,
    TABLES,
    VERSION,
    Row,
    StoreClock,
    StoreTable,
    summed,
    version_of,
)
from world_model.memory.store_pages import Found, Pages

# What reading a damaged file may raise: SQLite's messages may hold bytes of the file that are no text.
READING_ERRORS = (sqlite3.Error, ValueError, OverflowError, SystemError, MemoryError)
MOST = 5  # Damages that are named one by one


def connect(path: Path | str, mode: str, timeout: float = 0.2) -> sqlite3.Connection:
    """A connection in autocommit mode; mode : ro, rw or rwc, also with `&immutable=1`. Raises sqlite3.Error."""
    quoted = str(Path(path).absolute()).replace("%", "%25").replace("?", "%3f").replace("#", "%23")
    uri = f"file:{quoted}?mode={mode}"
    return sqlite3.connect(uri, timeout=timeout, isolation_level=None, uri=True, check_same_thread=False)


# Finding.


def examine(connection: sqlite3.Connection) -> list[str]:
    """What is damaged in a store, as one state of it: a sentence each, at most `MOST`. Nothing is found whole where the
    connection's progress handler ends it."""
    before = connection.text_factory
    connection.text_factory = _text
    try:
        connection.execute("BEGIN")
        try:
            found = connection.execute(f"PRAGMA integrity_check({MOST})").fetchall()
            lines = [line for (text,) in found for line in text.splitlines()]
            problems = [line for line in lines if line != "ok" and not line.startswith("***")]
            return problems[:MOST] or _against_marks(connection)
        finally:
            if connection.in_transaction:
                connection.execute("COMMIT")
    except READING_ERRORS as error:
        return [str(error)]
    finally:
        connection.text_factory = before


def _text(raw: bytes) -> str:
    """Text as it is stored; what is none is damaged, and cannot be encoded again."""
    return raw.decode(errors="surrogateescape")


def _against_marks(connection: sqlite3.Connection) -> list[str]:
    """Rows that are not as they were written, or missing."""
    told = connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")
    if {sql for (sql,) in told} != {each.strip() for each in (SCHEMA + INDICES).split(";")} - {""}:
        return ["what the file says of its tables is damaged"]
    if not CLOCK.is_whole(connection.execute("SELECT * FROM clock").fetchone()):
        return ["the row of clock is damaged"]
    clock, total, problems = StoreClock.of(connection), 0, []
    for table, expected in zip(COUNTED, clock.counts, strict=True):
        count = 0
        for row in connection.execute(f"SELECT * FROM {table.name}"):
            count += 1
            if table.is_whole(row):
                total += row[-1]
                continue
            problems.append(f"row {row[0]} of {table.name} is damaged")
            if len(problems) >= MOST:
                return problems
        if count != expected:
            problems.append(f"{table.name} has {count} rows instead of {expected}")
    if not problems and summed([total]) != clock.total:
        problems.append("a row is not the one that was written last")
    return problems


# Putting right.


@dataclass
class Salvage:
    """What was taken over. kept, missing : rows; missing is known where the tally is whole. lost_rows : by name."""

    kept: int = 0
    missing: int | None = None
    from_snapshots: int = 0
    lost_rows: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        parts = [f"{self.kept} rows kept"]
        if self.from_snapshots:
            parts.append(f"{self.from_snapshots} of them from snapshots")
        parts.append("nothing lost" if self.missing == 0 else f"{self.missing or 'an unknown number'} lost")
        return ", ".join(parts)


def make(path: Path) -> None:
    """A new, empty store. Raises sqlite3.Error."""
    rebuild_beside(None, path, [])


def rebuild_beside(path: Path | None, made: Path, snapshots: Iterable[Path]) -> Salvage:
    """`rebuild` into a file that is never there in part."""
    part = Path(f"{made}.part")
    part.unlink(missing_ok=True)
    with closing(connect(part, "rwc")) as connection:
        salvage = rebuild(path, snapshots, connection)
    synchronised(part)
    part.replace(made)
    return salvage


def synchronised(path: Path) -> None:
    """Have a file written before anything else is done."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def rebuild(path: Path | None, snapshots: Iterable[Path], target: sqlite3.Connection) -> Salvage:
    """Take everything that is whole into an empty database."""
    salvage = Salvage()
    target.create_function("marked", -1, lambda name, *values: TABLES[name].mark(values))
    for pragma in (f"page_size = {PAGE}", "secure_delete = ON", "synchronous = OFF", "journal_mode = MEMORY"):
        target.execute(f"PRAGMA {pragma}")
    # A script commits what was begun before it; nobody sees the file before all is in it.
    target.executescript(f"BEGIN; {SCHEMA}")
    if path is not None and version_of((pages := Pages(path))[1]) == FIRST_VERSION:
        _take_over(target, path)
    elif path is not None:
        _take(target, pages.rows(), salvage)
    named = f"INSERT OR IGNORE INTO objects SELECT key, epoch, id, {_MARK[OBJECTS]} FROM names"
    target.executescript(f"BEGIN; {named}; {_NAMES}")
    found = target.execute("SELECT * FROM clock").fetchone()
    clock = StoreClock.of(target) if found else StoreClock()
    due = clock.counts if clock.runs else None
    short = _short(target, due)
    if any(short) or not found:
        for snapshot in snapshots:
            salvage.from_snapshots += _fill(target, snapshot)
    target.executescript(f"BEGIN; {_NAMES}; {_NOBODYS}; {INDICES}; {_RUNS}")
    if not found:
        clock = StoreClock.of(target) if target.execute("SELECT 1 FROM clock").fetchone() else clock
        newest = target.execute("SELECT epoch, last_stamp FROM epochs ORDER BY epoch DESC LIMIT 1").fetchone()
        clock = clock._replace(epoch=newest[0], stamp=newest[1], identity=clock.identity or uuid.uuid4().hex)
    if not found or short[3]:
        target.execute(_PRESENT, (clock.epoch,))
    salvage.missing = None if due is None else sum(_short(target, due))
    salvage.kept = _conclude(target, clock)
    return salvage


_MARK = {table: f"marked('{table.name}', {table.columns})" for table in COUNTED}
_NAMES = f"DELETE FROM names; INSERT INTO names SELECT key, epoch, id, {_MARK[NAMES]} FROM objects"
_NOBODYS = """
DELETE FROM history WHERE key NOT IN (SELECT key FROM objects);
DELETE FROM current WHERE key NOT IN (SELECT key FROM objects);
"""
# Runs from what happened in them.
_RUNS = f"""
INSERT OR IGNORE INTO epochs SELECT *, {_MARK[EPOCHS]} FROM (
  SELECT o.epoch AS epoch, min(h.stamp) AS first_stamp, max(h.stamp) AS last_stamp
  FROM objects o LEFT JOIN history h ON h.key = o.key WHERE o.epoch >= 0 GROUP BY o.epoch);
INSERT OR IGNORE INTO epochs SELECT *, {_MARK[EPOCHS]} FROM (
  SELECT 0 AS epoch, NULL AS first_stamp, NULL AS last_stamp);
"""
# Present is whose last event is not that it is gone.
_PRESENT = f"""
INSERT OR IGNORE INTO current SELECT {CURRENT.columns}, {_MARK[CURRENT]} FROM history h
WHERE key IN (SELECT key FROM objects WHERE epoch = ?) AND event != 'gone' AND row =
  (SELECT row FROM history WHERE key = h.key ORDER BY stamp DESC, row DESC LIMIT 1)
"""


def _take_over(target: sqlite3.Connection, path: Path) -> None:
    """All rows of a file of the first version, which is left alone where SQLite does not read it: no release wrote it,
    and its rows have no marks."""
    with closing(connect(path, "ro")) as old:
        for table in (EPOCHS, OBJECTS, CURRENT, HISTORY):
            rows = old.execute(f"SELECT {table.columns} FROM {table.name}")
            target.executemany(table.insert, map(table.marked, rows))
        epoch, stamp = old.execute("SELECT epoch, stamp FROM clock").fetchone()
        target.execute(CLOCK.insert, StoreClock(epoch, stamp, uuid.uuid4().hex).row)


def _take(target: sqlite3.Connection, rows: Iterable[tuple[str, Found]], salvage: Salvage) -> None:
    """Of two rows with one key the one that was written later; of two objects with one name the first."""
    small: dict[StoreTable, list[Row]] = {table: [] for table in TABLES.values()}
    later = {CLOCK: 4, EPOCHS: 2, CURRENT: 4}

    def past() -> Iterator[Row]:
        for where, (table, row) in rows:
            if table is None:
                salvage.lost_rows.append(f"{where}, key {row[0]}: not as it was written")
            elif table is HISTORY:
                yield row
            else:
                small[table].append(row)

    target.executemany(HISTORY.insert, past())
    for table, found in small.items():
        found.sort(key=lambda row: (row[later[table]] or 0.0) if table in later else -row[0])
        target.executemany(table.insert, found)


def _short(target: sqlite3.Connection, due: Iterable[int] | None) -> list[int]:
    """How many rows of each of `COUNTED` are missing, as far as is known."""
    counts = [target.execute(f"SELECT count(*) FROM {table.name}").fetchone()[0] for table in COUNTED]
    return [max(expected - count, 0) for expected, count in zip(due or counts, counts, strict=True)]


def _fill(target: sqlite3.Connection, snapshot: Path) -> int:
    """Take what is missing from a snapshot, if it is of the same store; returns how many rows were."""
    before = target.total_changes
    identity = target.execute("SELECT identity FROM clock").fetchone()
    try:
        with closing(connect(snapshot, "ro")) as connection:
            if identity in (None, (StoreClock.of(connection).identity,)):
                for table in (CLOCK, EPOCHS, OBJECTS, HISTORY):
                    rows = filter(table.is_whole, connection.execute(f"SELECT * FROM {table.name}"))
                    target.executemany(table.insert.replace("REPLACE", "IGNORE"), rows)
    except (*READING_ERRORS, TypeError):
        pass
    return target.total_changes - before


def _conclude(target: sqlite3.Connection, clock: StoreClock) -> int:
    """Write the tally; returns how many rows there are."""
    marks = [[mark for (mark,) in target.execute(f"SELECT mark FROM {table.name}")] for table in COUNTED]
    runs, names, _, present, past = map(len, marks)
    clock = clock._replace(runs=runs, names=names, present=present, past=past, sequence=clock.sequence + 1)
    clock = clock._replace(total=summed(map(sum, marks)))
    target.execute(CLOCK.insert, clock.row)
    target.execute("COMMIT")
    target.execute(f"PRAGMA application_id = {APPLICATION}")
    target.execute(f"PRAGMA user_version = {VERSION}")
    return sum(map(len, marks))

"""Damage of a store found, and what is whole taken over into a new file.

A damaged file is never written again: a new one is made beside it from all rows that are as they were written, wherever
in the file they lie, and from snapshots what is missing; then the two change places. Runs and who is present are worked
out again where they are lost. Stores of the first version, without marks, go the same way.
"""

from __future__ import annotations

import itertools
import os
import sqlite3
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

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
    VERSION,
    StoreClock,
    StoreTable,
    summed,
)
from world_model.memory.store_pages import Pages
from world_model.memory.store_rows import COLUMNS, decode

Row = tuple[Any, ...]
TABLES = (*COUNTED, CLOCK)
# What reading a damaged file may raise: SQLite's messages may hold bytes of the file that are no text.
READING_ERRORS = (sqlite3.Error, ValueError, OverflowError, SystemError, MemoryError)
MOST = 5  # Damages that are named one by one
SLICE = 500


@dataclass
class Salvage:
    """What was taken over. why : the damages found. kept, missing : rows; missing is known where the tally is whole."""

    why: list[str]
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


def connect(path: Path | str, mode: str, timeout: float = 0.2) -> sqlite3.Connection:
    """A connection in autocommit mode; mode : ro, rw or rwc, also with `&immutable=1`. Raises sqlite3.Error."""
    quoted = str(Path(path).absolute()).replace("%", "%25").replace("?", "%3f").replace("#", "%23")
    uri = f"file:{quoted}?mode={mode}"
    return sqlite3.connect(uri, timeout=timeout, isolation_level=None, uri=True, check_same_thread=False)


@dataclass
class Examined:
    """What is damaged in a store.

    problems : a sentence each, at most `MOST`. rows : (table, key) of rows that are not as they were written.
    readable : whether SQLite reads all the others, and all are there.
    """

    problems: list[str] = field(default_factory=list)
    rows: list[tuple[StoreTable, int]] = field(default_factory=list)
    readable: bool = False


def examine(connection: sqlite3.Connection, go_on: Callable[[], bool] = lambda: True) -> Examined:
    """What is damaged in a store, as one state of it; nothing where all is as it was written.

    go_on : asked every few rows, may wait; where it says no, nothing more is looked at.
    """
    before = connection.text_factory
    connection.text_factory = bytes
    try:
        connection.execute("BEGIN")
        try:
            found = connection.execute(f"PRAGMA integrity_check({MOST})").fetchall()
            lines = [line for row in found for line in _text(row[0]).splitlines()]
            problems = [line for line in lines if line != "ok" and not line.startswith("***")]
            return Examined(problems[:MOST]) if problems else _unmarked(connection, go_on)
        finally:
            if connection.in_transaction:
                connection.execute("COMMIT")
    except READING_ERRORS as error:
        return Examined([str(error)])
    finally:
        connection.text_factory = before


def _unmarked(connection: sqlite3.Connection, go_on: Callable[[], bool]) -> Examined:
    """Rows that are not as they were written, or missing."""
    told = connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    if {_text(sql) for (sql,) in told} != set(_statements(SCHEMA + INDICES)):
        return Examined(["what the file says of its tables is damaged"])
    rows = connection.execute("SELECT * FROM clock").fetchall()
    if len(rows) != 1 or not CLOCK.is_whole(rows[0]) or connection.execute(CLOCK.mistyped).fetchall():
        return Examined(["the row of clock is damaged"])
    clock, counts, sums = StoreClock.of(rows[0]), [], []
    damaged: list[tuple[StoreTable, int]] = []
    mistyped: list[tuple[StoreTable, int]] = []
    for table in COUNTED:
        count = 0
        for row in connection.execute(f"SELECT * FROM {table.name}"):
            count += 1
            if count % SLICE == 0 and not go_on():
                return Examined()
            if table.is_whole(row):
                sums.append(row[-1])
                continue
            damaged.append((table, row[0]))
            if len(damaged) >= MOST:
                return Examined(_named(damaged))
        counts.append(count)
        mistyped += [(table, key) for (key,) in connection.execute(table.mistyped).fetchmany(MOST)]
    missing = [
        f"{table.name} has {count} rows instead of {expected}"
        for table, count, expected in zip(COUNTED, counts, clock.counts, strict=True)
        if count != expected
    ]
    problems = _named(damaged + mistyped) + missing
    if not problems and summed(sums) != clock.total:
        return Examined(["a row is not the one that was written last"])
    # What has bytes for text is whole but for that, and read as such from its page.
    return Examined(problems, damaged, readable=not mistyped and not missing)


def _named(rows: list[tuple[StoreTable, int]]) -> list[str]:
    return [f"row {key} of {table.name} is damaged" for table, key in rows]


def version_of(pages: Pages) -> int:
    """Version that the head of a file names; 0 where it is no store's."""
    head = pages[1]
    if head[68:72] != APPLICATION.to_bytes(4, "big"):
        return 0
    return int.from_bytes(head[60:64], "big")


def has_our_rows(pages: Pages) -> bool:
    """Whether a file holds a row of this version, whatever its head says."""
    return any(_table_of(row) is not None for _, rows in pages.rows() for row in rows)


def make(path: Path) -> None:
    """A new, empty store. Raises sqlite3.Error."""
    part = Path(f"{path}.part")
    part.unlink(missing_ok=True)
    with closing(connect(part, "rwc")) as connection:
        _Rebuilt(connection, Salvage([])).finish([])
    synchronised(part)
    part.replace(path)


def rebuild(path: Path, why: Examined, snapshots: Iterable[Path], target: sqlite3.Connection) -> Salvage:
    """Take everything that is whole into an empty database."""
    salvage = Salvage([*why.problems])
    made = _Rebuilt(target, salvage)
    if why.readable:
        made.take_all_but(path, why.rows)
    elif version_of(pages := Pages(path)) == FIRST_VERSION:
        made.take_first_version(path)
    else:
        made.take(pages)
    made.finish(snapshots)
    return salvage


def rebuild_beside(path: Path, why: Examined, snapshots: Iterable[Path]) -> tuple[Path, Salvage]:
    """A whole new file beside a damaged one, and what is in it."""
    part, made = Path(f"{path}.part"), Path(f"{path}.rebuilt")
    part.unlink(missing_ok=True)
    with closing(connect(part, "rwc")) as connection:
        salvage = rebuild(path, why, snapshots, connection)
    synchronised(part)
    part.replace(made)
    return made, salvage


def synchronised(path: Path) -> None:
    """Have a file written before anything else is done."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


class _Rebuilt:
    """A new store that rows are put into."""

    def __init__(self, target: sqlite3.Connection, salvage: Salvage) -> None:
        self._target = target
        self._small: dict[str, dict[int, Row]] = {table.name: {} for table in TABLES}
        self._salvage = salvage
        for pragma in (
            f"page_size = {PAGE}",
            "secure_delete = ON",
            "synchronous = OFF",
            "journal_mode = MEMORY",
        ):
            target.execute(f"PRAGMA {pragma}")
        target.execute("BEGIN")
        self._run(SCHEMA)

    def _run(self, script: str) -> None:
        # Not `executescript`, which ends the transaction.
        for statement in _statements(script):
            self._target.execute(statement)

    def take(self, pages: Pages) -> None:
        """All rows of a file that are whole."""
        past: list[Row] = []
        for number, rows in pages.rows():
            for row in rows:
                table = _table_of(row)
                if table is HISTORY:
                    past.append(_texts(row, table))
                elif table is not None:
                    self._keep(table, _texts(row, table))
                elif any(len(row) == len(other.kinds) + 1 for other in TABLES):
                    self._salvage.lost_rows.append(f"page {number}, key {row[0]}: not as it was written")
            if len(past) > 1000:
                self._put(past)
        self._put(past)

    def take_all_but(self, path: Path, damaged: list[tuple[StoreTable, int]]) -> None:
        """All rows of a file that SQLite reads, which were found whole, but for these."""
        without = {table: [key for other, key in damaged if other is table] for table in COUNTED}
        with closing(connect(path, "ro")) as old:
            marks = ", ".join("?" * len(without[HISTORY]))
            rows = old.execute(f"SELECT * FROM history WHERE row NOT IN ({marks})", without[HISTORY])
            self._target.executemany(HISTORY.insert, rows)
            # What is damaged may be no text.
            old.text_factory = bytes
            for table in (CLOCK, *COUNTED[:4]):
                for row in old.execute(f"SELECT * FROM {table.name}"):
                    if row[0] not in without.get(table, ()):
                        self._keep(table, _texts(row, table))

    def _put(self, past: list[Row]) -> None:
        self._target.executemany(HISTORY.insert, past)
        past.clear()

    def _keep(self, table: StoreTable, row: Row) -> None:
        """Of two rows with one key the one that was written later."""
        rows = self._small[table.name]
        known = rows.get(row[0])
        later = {CLOCK: 4, EPOCHS: 2, CURRENT: 4}.get(table)
        if known is None or later is None or (known[later] or 0.0) <= (row[later] or 0.0):
            rows[row[0]] = row

    def take_first_version(self, path: Path) -> None:
        """Rows of a file without marks, as far as SQLite reads them and they have a meaning."""
        with closing(connect(path, "ro")) as old:
            old.text_factory = bytes
            for _, epoch, stamp in _readable(old, "clock", "one, epoch, stamp"):
                self._keep(CLOCK, StoreClock(int(epoch), stamp, uuid.uuid4().hex).row)
            for table in (EPOCHS, OBJECTS, CURRENT, HISTORY):
                for values in _readable(old, table.name, table.columns):
                    self._adopt(table, values)

    def _adopt(self, table: StoreTable, values: Row) -> None:
        try:
            text = _texts(values, table)
            if table in (CURRENT, HISTORY):
                decode("", text[-8:])
            row = _marked(table, text)
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
            self._salvage.lost_rows.append(f"{table.name}, key {values[0]}: {error}")
            return
        if table is HISTORY:
            self._target.execute(HISTORY.insert, row)
        else:
            self._keep(table, row)

    def finish(self, snapshots: Iterable[Path]) -> None:
        """Work out what follows, write tally and indices."""
        small, old = self._small, self._small["clock"].get(1)
        before = None if old is None or not old[5] else StoreClock.of(old)
        for table, other in ((OBJECTS, NAMES), (NAMES, OBJECTS)):
            rows, others = small[table.name], small[other.name]
            for key in others.keys() - rows.keys():
                rows[key] = _marked(table, others[key][:-1])
        lacks = [int(old is None)] * len(COUNTED) if before is None else self._lacks(before)
        identity = StoreClock.of(old).identity if old is not None else ""
        if any(lacks):
            self._fill(snapshots, identity)
        self._run(INDICES)
        self._work_out(old, lacks[3] > 0)
        self._write()
        self._salvage.missing = None if before is None else sum(self._lacks(before))

    def _lacks(self, before: StoreClock) -> list[int]:
        """How many rows of each table are missing."""
        past = self._target.execute("SELECT count(*) FROM history").fetchone()[0]
        now = (*(len(self._small[table.name]) for table in COUNTED[:4]), past)
        return [max(due - count, 0) for due, count in zip(before.counts, now, strict=True)]

    def _fill(self, snapshots: Iterable[Path], identity: str) -> None:
        """What is missing, from snapshots of the same store."""
        for path in snapshots:
            try:
                with closing(connect(path, "ro")) as connection:
                    clock = connection.execute("SELECT * FROM clock").fetchone()
                    if CLOCK.is_whole(clock) and identity in ("", clock[3]):
                        self._fill_from(connection)
                        identity = clock[3]
            except (*READING_ERRORS, TypeError):
                continue

    def _fill_from(self, connection: sqlite3.Connection) -> None:
        for table in (CLOCK, EPOCHS, OBJECTS, NAMES):
            known = self._small[table.name]
            for row in connection.execute(f"SELECT * FROM {table.name}"):
                if row[0] not in known and table.is_whole(row):
                    known[row[0]] = row
                    self._salvage.from_snapshots += 1
        known_rows = {row for (row,) in self._target.execute("SELECT row FROM history")}
        rows = (
            row
            for row in connection.execute("SELECT * FROM history")
            if row[0] not in known_rows and HISTORY.is_whole(row)
        )
        before = self._target.total_changes
        self._target.executemany(HISTORY.insert.replace("REPLACE", "IGNORE"), rows)
        self._salvage.from_snapshots += self._target.total_changes - before

    def _work_out(self, old: Row | None, present: bool) -> None:
        """Runs from what happened in them, names once each, and, where asked, who is present."""
        small = self._small
        taken: dict[tuple[int, str], int] = {}
        for key, (_, epoch, name, _) in sorted(small["objects"].items()):
            if taken.setdefault((epoch, name), key) != key:
                small["objects"].pop(key)
                small["names"].pop(key, None)
        runs = {row[1] for row in small["objects"].values() if row[1] >= 0}
        for epoch in {0, *runs} - small["epochs"].keys():
            keys = [key for key, row in small["objects"].items() if row[1] == epoch]
            spans = [self._span(key) for key in keys]
            first = min((span[0] for span in spans if span[0] is not None), default=None)
            last = max((span[1] for span in spans if span[1] is not None), default=None)
            self._keep(EPOCHS, _marked(EPOCHS, (epoch, first, last)))
        if old is None:
            row = small["clock"].pop(1, None)
            known = StoreClock.of(row) if row else StoreClock(identity=uuid.uuid4().hex)
            newest = max(small["epochs"])
            self._keep(CLOCK, replace(known, epoch=newest, stamp=small["epochs"][newest][2]).row)
        if present or old is None:
            self._work_out_present(StoreClock.of(small["clock"][1]).epoch)

    def _span(self, key: int) -> Row:
        span = "SELECT min(stamp), max(stamp) FROM history WHERE key = ?"
        return tuple(self._target.execute(span, (key,)).fetchone())

    def _work_out_present(self, epoch: int) -> None:
        """Whose last event is not that it is gone."""
        for key, row in self._small["objects"].items():
            if row[1] != epoch or key in self._small["current"]:
                continue
            newest = self._target.execute(
                f"SELECT event, {COLUMNS} FROM history WHERE key = ? ORDER BY stamp DESC, row DESC LIMIT 1",
                (key,),
            ).fetchone()
            if newest is not None and newest[0] != "gone":
                self._small["current"][key] = _marked(CURRENT, (key, *newest[1:]))

    def _write(self) -> None:
        small, target = self._small, self._target
        target.executemany(OBJECTS.insert, small["objects"].values())
        # Rows without a name are nobody's.
        target.execute("DELETE FROM history WHERE key NOT IN (SELECT key FROM objects)")
        for key in small["current"].keys() - small["objects"].keys():
            del small["current"][key]
        for table in (EPOCHS, NAMES, CURRENT):
            target.executemany(table.insert, small[table.name].values())
        marks = [[mark for (mark,) in target.execute(f"SELECT mark FROM {table.name}")] for table in COUNTED]
        runs, names, _, present, past = map(len, marks)
        self._salvage.kept = sum(map(len, marks))
        clock = replace(StoreClock.of(small["clock"][1]), runs=runs, names=names, present=present, past=past)
        total = summed(itertools.chain.from_iterable(marks))
        clock = replace(clock, total=total, sequence=clock.sequence + 1)
        target.execute(CLOCK.insert, clock.row)
        target.execute("COMMIT")
        target.execute(f"PRAGMA application_id = {APPLICATION}")
        target.execute(f"PRAGMA user_version = {VERSION}")


def _marked(table: StoreTable, values: Row) -> Row:
    return (*values, table.mark(values))


def _statements(script: str) -> list[str]:
    return [statement.strip() for statement in script.split(";") if statement.strip()]


def _table_of(row: Row) -> StoreTable | None:
    for table in TABLES:
        if len(row) == len(table.kinds) + 1 and table.is_whole(row):
            return table
    return None


def _texts(row: Row, table: StoreTable) -> Row:
    """Text as text. Raises UnicodeDecodeError."""
    made = list(row)
    for index in table.texts:
        value = made[index]
        if isinstance(value, bytes):
            made[index] = value.decode()
    return tuple(made)


def _readable(connection: sqlite3.Connection, table: str, columns: str) -> Iterator[Row]:
    """Rows up to a damage, and those behind it from the other end."""
    seen: set[int] = set()
    for order in ("ASC", "DESC"):
        try:
            for row in connection.execute(f"SELECT {columns} FROM {table} ORDER BY rowid {order}"):
                if row[0] in seen:
                    break
                seen.add(row[0])
                yield tuple(row)
            else:
                return
        except READING_ERRORS:
            continue


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)

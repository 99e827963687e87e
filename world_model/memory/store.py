"""Memory of the world model: every change of the most probable world, in one SQLite file.

One transaction per message in write-ahead mode: a crash loses at most the message that was being written. StoreTable
`current` always has the newest state of every object, for the restart; `history` has a row per event, for questions
about the past, and is thinned out when it exceeds a limit: what is old, and no event, first.
"""

from __future__ import annotations

import errno
import sqlite3
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from estimation.checks import require_count
from estimation.geometry.places import Places
from world_model.memory.store_file import Keeper, StoreError, StoreFile, copy_store
from world_model.memory.store_format import (
    CLOCK,
    COUNTED,
    CURRENT,
    EPOCHS,
    HISTORY,
    NAMES,
    OBJECTS,
    Row,
    StoreClock,
    StoreTable,
    summed,
)
from world_model.memory.store_records import HistoryEntry, Memory, Records
from world_model.memory.store_rows import (
    EVENT,
    KEPT,
    NAME,
    RUN,
    Written,
    decode,
    encode,
    event,
    is_drift,
    places_row,
    places_text,
)
from world_model.state import WorldObject, WorldState

__all__ = ["HistoryEntry", "Memory", "Store", "StoreError"]

LIMIT = 100_000
EVENT_LEVEL = 30
"""Rows with a higher level are kept longer; events have this one, others the ruler sequence of their number."""
EVENTS = ("appeared", "gone", "lost", "found", "returned", "renamed")
DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
INSTANTS = 3  # Failures in a row after which a write is tried again once a second only
RETRY = 1.0  # s of the time that passes: stamps may stand still, or be of a replay
PERIOD = 600.0  # s between two looks for damage, each with a snapshot where something was written since


class Transaction:
    """What is written at once: rows, how many there are more in each table, and the sum of their marks."""

    def __init__(self, connection: sqlite3.Connection, next_row: int) -> None:
        self._execute = connection.execute
        self.next_row = next_row
        self.more: Counter[str] = Counter()
        self.marks = 0

    def applied(self, clock: StoreClock, epoch: int, stamp: float | None) -> StoreClock:
        """The row of `clock` after it."""
        runs, names, _, present, past = (
            count + self.more[table.name] for table, count in zip(COUNTED, clock.counts, strict=True)
        )
        sequence, total = clock.sequence + 1, summed((clock.total, self.marks))
        return StoreClock(epoch, stamp, clock.identity, sequence, runs, names, present, past, total)

    def put(self, table: StoreTable, *values: object, instead: int | None = None) -> int:
        """Write a row, in place of the one with the same key, which had the mark `instead`; returns its mark."""
        mark = table.mark(values)
        self._execute(table.insert, (*values, mark))
        if instead is None:
            self.more[table.name] += 1
        self.marks += mark - (instead or 0)
        return mark

    def delete(self, table: StoreTable, where: str, *values: object) -> int:
        """Rows go; returns how many did."""
        marks = self._execute(f"DELETE FROM {table.name} WHERE {where} RETURNING mark", values).fetchall()
        self.more[table.name] -= len(marks)
        self.marks -= sum(mark for (mark,) in marks)
        return len(marks)

    def key(self, object_id: str, run: int) -> tuple[int, int]:
        """Key of an object of a run, and how many rows of history it has."""
        rows = "(SELECT count(*) FROM history h WHERE h.key = o.key)"
        found = self._execute(
            f"SELECT key, {rows} FROM objects o WHERE epoch = ? AND id = ?", (run, object_id)
        ).fetchone()
        if found is None:
            found = self._execute("SELECT 1 + ifnull(max(key), 0), 0 FROM objects").fetchone()
            for table in (OBJECTS, NAMES):
                self.put(table, found[0], run, object_id)
        return found[0], found[1]

    def happen(self, key: int, stamp: float, event: str, level: int, values: Row) -> None:
        """A row of history."""
        self.put(HISTORY, self.next_row, key, stamp, event, level, *values)
        self.next_row += 1

    def note(self, key: int, stamp: float, happened: str, number: int, item: WorldObject) -> None:
        """What happened to an object that has `number` rows. Every other row has level 0, every fourth level 1 and so
        on: the ruler sequence."""
        number += 1
        level = EVENT_LEVEL if happened in EVENTS else (number & -number).bit_length() - 1
        self.happen(key, stamp, happened, level, encode(item, 4))

    def thin(self, count: int, limit: int) -> None:
        """Delete up to `count` rows of history, of which `limit` are kept: the older half, those of low level first."""
        if count <= 0:
            return
        newest = self._execute("SELECT max(row) FROM history").fetchone()[0] or 0
        old = "row IN (SELECT row FROM history WHERE level = ? AND row <= ? ORDER BY row LIMIT ?)"
        for level in range(EVENT_LEVEL + 1):
            count -= self.delete(HISTORY, old, level, newest - limit // 2, count)
            if count <= 0:
                break


class Store(Records):
    """A world model's memory in a file.

    path : of the file; its folder is made. limit : rows of history that are kept. read_only : only ask questions, also
    while another process writes. A damaged file is set aside under a name of its own (`set_aside`), and all that is
    whole in it is in the new one; `damages` : what was found, a sentence each. `problem` : why the last write failed,
    or what was damaged when it was opened, "" while all is well; a write is tried again, and the model goes on.
    Raises StoreError where the file cannot be opened, StoreVersionError where it is of another version.
    """

    def __init__(self, path: str | Path, limit: int = LIMIT, read_only: bool = False) -> None:
        self.path = Path(path)
        self.limit = require_count("limit", limit, 100)
        self.read_only = read_only
        self.set_aside: Path | None = None
        self.problem = ""
        self.damages: list[str] = []
        self.failures = 0
        self.keeper: Keeper | None = None
        self._retry_at = -float("inf")
        self._failed_in_a_row = 0
        self._waiting: WorldState | None = None  # the last state, where it could not be written
        self._places = self._kept_places = ""
        self.recalled: object = None  # what questions have read of it
        self._run: tuple[int, float | None, float | None]
        self._next_row: int
        self._open()

    @property
    def rows(self) -> int:
        """Rows of history."""
        return self._clock.past

    def watch(self, period: float = PERIOD) -> None:
        """From now on look for damage and keep snapshots, beside what is written, every `period` s."""
        self.keeper = Keeper(self._file, period)

    # Writing.

    def keep_places(self, places: Places) -> None:
        """Rooms and furniture from now on; written with the next state, where they differ from those that are kept."""
        self._places = places_text(places) if places else ""

    def record(self, state: WorldState) -> None:
        """Write what has changed since the last state, in one transaction. Does not raise: see `problem`."""
        self._waiting = state
        if self._failed_in_a_row >= INSTANTS and time.monotonic() < self._retry_at:
            return
        with self._trying():
            if self._file.replaced:
                self._reopen()
                self.problem = f"{self.path}: the file was moved or removed; begun anew"
            elif self.keeper is not None and self.keeper.found:
                self._reopen()
            self._record(state)
            self._waiting = None
            if self._failed_in_a_row:
                self._failed_in_a_row, self.problem = 0, ""

    def retry(self) -> None:
        """Write the last state if that failed, where no further one comes. Does not raise: see `problem`."""
        if self._waiting is not None:
            self.record(self._waiting)

    def begin(self, epoch: int) -> None:
        """A new run: its world is empty. Does not raise: see `problem`."""
        self._waiting = None
        with self._trying():
            self._begin(epoch)

    def rename(self, object_id: str, new_object_id: str) -> None:
        """An object has a new symbol; its history goes with it. Does not raise: see `problem`."""
        if object_id not in self._written:
            return
        with self._trying(), self._transaction() as change:
            known = self._written[new_object_id] = self._written.pop(object_id)
            for table in (OBJECTS, NAMES):
                before = table.mark((known.key, self._clock.epoch, object_id))
                change.put(table, known.key, self._clock.epoch, new_object_id, instead=before)

    def _record(self, state: WorldState) -> None:
        if state.epoch != self._clock.epoch:
            self._begin(state.epoch)
        written = self._written
        changed = [
            item
            for item in state.objects
            if (known := written.get(item.id)) is None or known.latest is not item
        ]
        with self._transaction(stamp=state.stamp) as change:
            for item in changed:
                written[item.id] = self._write(item, state.stamp, change)
            if len(written) > len(state.objects):
                for object_id in sorted(written.keys() - {item.id for item in state.objects}):
                    known = written.pop(object_id)
                    change.delete(CURRENT, "key = ?", known.key)
                    change.note(known.key, state.stamp, "gone", known.rows, known.latest)
            if self._places and self._places != self._kept_places:
                key, _ = change.key(NAME, RUN)
                change.happen(key, state.stamp, EVENT, KEPT, places_row(self._places, state.stamp))
                self._kept_places = self._places
            run = (state.epoch, state.stamp if self._run[1] is None else self._run[1], state.stamp)
            change.put(EPOCHS, *run, instead=EPOCHS.mark(self._run))
            self._run = run
            past = change.more["history"]
            change.thin(min(4 * past + 16, self.rows + past - self.limit), self.limit)

    def _write(self, item: WorldObject, stamp: float, change: Transaction) -> Written:
        """Rows of one object that is new or another version; what to remember of it."""
        known, text = self._written.get(item.id), ""
        if known is None:
            key, rows = change.key(item.id, self._clock.epoch)
            happened = "returned" if rows else "appeared"
        elif is_drift(known.row, item):
            return replace(known, latest=item)
        else:
            key, rows = known.key, known.rows
            happened = event(known.noted, known.noted_at, item, stamp)
            text = known.text if known.row.attributes == item.attributes else ""
        row = encode(item, text=text)
        mark = change.put(CURRENT, key, *row, instead=None if known is None else known.mark)
        if known is not None and not happened:
            return replace(known, latest=item, row=item, text=row[5], mark=mark)
        change.note(key, stamp, happened, rows, item)
        return Written(key, item, item, item, stamp, rows + 1, row[5], mark)

    def _begin(self, epoch: int) -> None:
        known = self._execute(f"SELECT {EPOCHS.columns} FROM epochs WHERE epoch = ?", epoch).fetchone()
        with self._transaction(epoch) as change:
            change.delete(CURRENT, "1")
            self._run, self._written = known or (epoch, None, None), {}
            if known is None:
                change.put(EPOCHS, *self._run)

    # The file.

    def save(self, path: str | Path | None = None) -> Path:
        """Write everything to the file itself, or a complete copy to another one, read back. Raises StoreError.

        A copy replaces an older copy, and nothing else.
        """
        if path is not None and Path(path) != self.path:
            copy_store(self._file.connection, Path(path))
            return Path(path)
        try:
            self._execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        except (sqlite3.Error, OSError) as error:
            raise StoreError(f"{self.path}: cannot be written: {error}") from error
        return self.path

    def compact(self, limit: int | None = None) -> int:
        """Thin history out to `limit` rows and give the space back; returns how many rows went. Raises StoreError."""
        if limit is not None:
            self.limit = require_count("limit", limit, 100)
        before = self.rows
        try:
            with self._transaction(stamp=self._clock.stamp) as change:
                change.thin(self.rows - self.limit, self.limit)
            self._execute("VACUUM")
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: cannot be compacted: {error}") from error
        self.save()
        return before - self.rows

    def close(self) -> None:
        """Close the file; everything recorded stays."""
        if self.keeper is not None:
            self.keeper.end()
        self._file.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @contextmanager
    def _trying(self) -> Iterator[None]:
        """What fails is told of, and not raised."""
        try:
            yield
        except (sqlite3.Error, OSError, StoreError) as error:
            self._fail(error)

    @contextmanager
    def _transaction(self, epoch: int | None = None, stamp: float | None = None) -> Iterator[Transaction]:
        """All or nothing, with the row of `clock` and what is remembered of it. stamp : None where a run begins."""
        connection = self._file.connection
        before = dict(self._written), self._run, self._kept_places
        change = Transaction(connection, self._next_row)
        connection.execute("BEGIN IMMEDIATE")
        try:
            yield change
            clock = change.applied(self._clock, self._clock.epoch if epoch is None else epoch, stamp)
            connection.execute(CLOCK.insert, clock.row)
            connection.execute("COMMIT")
        except BaseException:
            self._written, self._run, self._kept_places = before
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        self._clock, self._next_row = clock, change.next_row
        self._file.note(clock)

    def _open(self) -> None:
        """Open the file, put right what is damaged, and take over what it has."""
        self._file = StoreFile(self.path, self.read_only)
        self.set_aside = self._file.aside or self.set_aside
        self.damages += self._file.found
        self.problem = self._file.found[0] if self._file.found else self.problem
        try:
            self._resume()
        except (sqlite3.Error, ValueError, TypeError, KeyError) as error:
            self._file.close()
            raise StoreError(f"{self.path}: cannot be read: {error}") from error

    def _resume(self) -> None:
        self._clock = StoreClock.of(self._file.connection)
        self._run = self._execute(
            f"SELECT {EPOCHS.columns} FROM epochs WHERE epoch = ?", self._clock.epoch
        ).fetchone()
        self._next_row = 1 + self._newest_row()
        self._kept_places = self._places_row()
        self._written = {}
        if self.read_only:
            return
        rows = self._execute(
            "SELECT o.id, (SELECT count(*) FROM history WHERE key = c.key), c.*, h.* FROM current c "
            "JOIN objects o ON o.key = c.key "
            "LEFT JOIN history h ON h.row = (SELECT max(row) FROM history WHERE key = c.key) ORDER BY c.key"
        )
        width = len(CURRENT.kinds) + 1
        for name, count, *values in rows:
            (key, *current, mark), (row, _, noted_at, _, _, *past, _) = values[:width], values[width:]
            item = decode(name, tuple(current))
            noted = item if row is None else decode(name, tuple(past))
            noted_at = self._clock.stamp or 0.0 if row is None else noted_at
            self._written[name] = Written(key, item, item, noted, noted_at, count, current[5], mark)

    def _fail(self, error: BaseException) -> None:
        self.failures += 1
        self._failed_in_a_row += 1
        # A full disk answers at once, and what waits for room is nowhere but in this process: it does not wait longer.
        code = (getattr(error, "sqlite_errorcode", None) or 0) & 0xFF
        full = code == sqlite3.SQLITE_FULL or getattr(error, "errno", None) == errno.ENOSPC
        self._retry_at = -float("inf") if full else time.monotonic() + RETRY
        self.problem = f"{self.path}: not written: {error}"
        if code in DAMAGED:
            try:
                self._reopen()
            except (sqlite3.Error, OSError, StoreError) as second:
                self.problem = f"{self.path}: damaged, and cannot be put right: {second}"

    def _reopen(self) -> None:
        """Close and open: what is damaged is put right, and what the file lacks is written with the next state."""
        watched = self.keeper
        if watched is not None:
            watched.end()
        self._file.close()
        self._open()
        if watched is not None:
            self.watch(watched.period)

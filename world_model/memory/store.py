"""Memory of the world model: every change of the most probable world, in one SQLite file.

One transaction per message in write-ahead mode: a crash loses at most the message that was being written. StoreTable
`current` always has the newest state of every object, for the restart; `history` has a row per event, for questions
about the past, and is thinned out when it exceeds a limit: what is old, and no event, first.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

from estimation.checks import require_count
from estimation.geometry.places import Places
from world_model.memory.store_file import StoreError, StoreFile, copy_store, is_damage, is_full
from world_model.memory.store_format import (
    CLOCK,
    CURRENT,
    EPOCHS,
    HISTORY,
    NAMES,
    OBJECTS,
    StoreClock,
    StoreTable,
    summed,
)
from world_model.memory.store_keeper import Keeper
from world_model.memory.store_places import EVENT, KEPT, NAME, RUN, places_row, places_text
from world_model.memory.store_records import HistoryEntry, Memory, Records
from world_model.memory.store_rows import COLUMNS, Written, attributes_text, decode, encode, event, is_drift
from world_model.state import WorldObject, WorldState

__all__ = ["HistoryEntry", "Memory", "Store", "StoreError"]

LIMIT = 100_000
EVENT_LEVEL = 30
"""Rows with a higher level are kept longer; events have this one, others the ruler sequence of their number."""
EVENTS = ("appeared", "gone", "lost", "found", "returned", "renamed")
INSTANTS = 3  # Failures in a row after which a write is tried again once a second only
RETRY = 1.0  # s of the time that passes: stamps may stand still, or be of a replay
_Run = tuple[int, float | None, float | None]

PERIOD = 600.0  # s between two looks for damage, each with a snapshot where something was written since


@dataclass
class _Change:
    """What a transaction does to the row of `clock`: rows more, and their marks."""

    epoch: int
    stamp: float | None
    runs: int = 0
    names: int = 0
    present: int = 0
    past: int = 0
    marks: int = 0

    def applied(self, clock: StoreClock) -> StoreClock:
        return StoreClock(
            self.epoch,
            self.stamp,
            clock.identity,
            clock.sequence + 1,
            clock.runs + self.runs,
            clock.names + self.names,
            clock.present + self.present,
            clock.past + self.past,
            summed((clock.total, self.marks)),
        )


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
        self._run: _Run
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
        try:
            if self._file.replaced:
                self._reopen()
                self.problem = f"{self.path}: the file was moved or removed; begun anew"
            elif self.keeper is not None and self.keeper.found:
                self._reopen()
            self._record(state)
        except (sqlite3.Error, OSError, StoreError) as error:
            self._fail(error)
            return
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
        try:
            self._begin(epoch)
        except (sqlite3.Error, OSError) as error:
            self._fail(error)

    def rename(self, object_id: str, new_object_id: str) -> None:
        """An object has a new symbol; its history goes with it. Does not raise: see `problem`."""
        known = self._written.get(object_id)
        if known is None:
            return
        try:
            with self._transaction() as change:
                for table in (OBJECTS, NAMES):
                    change.marks -= table.mark((known.key, self._epoch, object_id))
                    change.marks += self._put(table, known.key, self._epoch, new_object_id)
            self._written[new_object_id] = self._written.pop(object_id)
        except (sqlite3.Error, OSError) as error:
            self._fail(error)

    def _record(self, state: WorldState) -> None:
        if state.epoch != self._epoch:
            self._begin(state.epoch)
        changed = [
            item
            for item in state.objects
            if (known := self._written.get(item.id)) is None or known.latest is not item
        ]
        gone: list[str] = []
        if len(state.objects) - sum(item.id not in self._written for item in changed) < len(self._written):
            gone = list(self._written.keys() - {item.id for item in state.objects})
        after: list[tuple[str, Written | None]] = []
        with self._transaction(stamp=state.stamp) as change:
            for item in changed:
                after.append((item.id, self._write(item, state.stamp, change)))
            for object_id in gone:
                self._remove(object_id, state.stamp, change)
                after.append((object_id, None))
            if self._places and self._places != self._kept_places:
                self._write_places(state.stamp, change)
            run: _Run = (state.epoch, state.stamp if self._run[1] is None else self._run[1], state.stamp)
            change.marks += self._put(EPOCHS, *run) - EPOCHS.mark(self._run)
            most = min(4 * change.past + 16, self.rows + change.past - self.limit)
            self._thin(most, change)
        self._run = run
        self._kept_places = self._places or self._kept_places
        for object_id, written_now in after:
            if written_now is None:
                del self._written[object_id]
            else:
                self._written[object_id] = written_now

    def _write(self, item: WorldObject, stamp: float, change: _Change) -> Written:
        """Rows of one object that is new or another version; what to remember of it."""
        known = self._written.get(item.id)
        if known is not None and is_drift(known.row, item):
            return replace(known, latest=item)
        if known is not None and known.row.attributes == item.attributes:
            text = known.text
        else:
            text = attributes_text(item.attributes)
        if known is None:
            key, rows = self._key(item.id, change)
            happened = "returned" if rows else "appeared"
            change.present += 1
        else:
            key, rows = known.key, known.rows
            happened = event(known.noted, known.noted_at, item, stamp)
            change.marks -= known.mark
        mark = self._put(CURRENT, key, *encode(item, text))
        change.marks += mark
        if not happened:
            assert known is not None
            return replace(known, latest=item, row=item, text=text, mark=mark)
        self._note(key, stamp, happened, rows, item, change)
        return Written(key, item, item, item, stamp, rows + 1, text, mark)

    def _write_places(self, stamp: float, change: _Change) -> None:
        key, _ = self._key(NAME, change, RUN)
        values = places_row(self._places, stamp)
        change.marks += self._put(HISTORY, self._next_row, key, stamp, EVENT, KEPT, *values)
        change.past += 1
        self._next_row += 1

    def _remove(self, object_id: str, stamp: float, change: _Change) -> None:
        known = self._written[object_id]
        self._execute("DELETE FROM current WHERE key = ?", known.key)
        change.present -= 1
        change.marks -= known.mark
        self._note(known.key, stamp, "gone", known.rows, known.latest, change)

    def _note(
        self, key: int, stamp: float, happened: str, number: int, item: WorldObject, change: _Change
    ) -> None:
        """A row of history. Every other row has level 0, every fourth level 1 and so on: the ruler sequence."""
        number += 1
        level = EVENT_LEVEL if happened in EVENTS else (number & -number).bit_length() - 1
        values = encode(item, attributes_text(item.attributes, 4))
        change.marks += self._put(HISTORY, self._next_row, key, stamp, happened, level, *values)
        change.past += 1
        self._next_row += 1

    def _key(self, object_id: str, change: _Change, run: int | None = None) -> tuple[int, int]:
        """Key of an object of this run (or of `run`), and how many rows of history it has."""
        epoch = self._epoch if run is None else run
        found = self._execute(
            "SELECT key FROM objects WHERE epoch = ? AND id = ?", epoch, object_id
        ).fetchone()
        if found is None:
            key = 1 + (self._execute("SELECT max(key) FROM objects").fetchone()[0] or 0)
            for table in (OBJECTS, NAMES):
                change.marks += self._put(table, key, epoch, object_id)
            change.names += 1
            return key, 0
        rows = self._execute("SELECT count(*) FROM history WHERE key = ?", found[0]).fetchone()[0]
        return int(found[0]), int(rows)

    def _put(self, table: StoreTable, *values: object) -> int:
        """Write a row, in place of the one with the same key; returns its mark."""
        mark = table.mark(values)
        self._file.connection.execute(table.insert, (*values, mark))
        return mark

    def _begin(self, epoch: int) -> None:
        known = self._execute(
            "SELECT epoch, first_stamp, last_stamp FROM epochs WHERE epoch = ?", epoch
        ).fetchone()
        run: _Run = known or (epoch, None, None)
        with self._transaction(epoch) as change:
            self._execute("DELETE FROM current")
            change.present -= len(self._written)
            change.marks -= sum(written.mark for written in self._written.values())
            if known is None:
                change.marks += self._put(EPOCHS, *run)
                change.runs += 1
        self._run, self._written = run, {}

    def _thin(self, count: int, change: _Change) -> int:
        """Delete up to `count` rows of the older half of history, those of low level first."""
        if count <= 0:
            return 0
        newest = self._newest_row()
        deleted = 0
        for level in range(EVENT_LEVEL + 1):
            marks = self._execute(
                "DELETE FROM history WHERE row IN "
                "(SELECT row FROM history WHERE level = ? AND row <= ? ORDER BY row LIMIT ?) RETURNING mark",
                level,
                newest - self.limit // 2,
                count - deleted,
            ).fetchall()
            deleted += len(marks)
            change.marks -= sum(mark for (mark,) in marks)
            if deleted >= count:
                break
        change.past -= deleted
        return deleted

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
            while self.rows > self.limit:
                with self._transaction(stamp=self._clock.stamp) as change:
                    done = self._thin(min(self.rows - self.limit, 10_000), change)
                if done == 0:
                    break
            self._execute("VACUUM")
            self._execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: cannot be compacted: {error}") from error
        return before - self.rows

    def close(self) -> None:
        """Close the file; everything recorded stays."""
        if self.keeper is not None:
            self.keeper.end()
        self._file.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @contextmanager
    def _transaction(self, epoch: int | None = None, stamp: float | None = None) -> Iterator[_Change]:
        """All or nothing, with the row of `clock`. stamp : None where a run begins."""
        connection = self._file.connection
        change = _Change(self._epoch if epoch is None else epoch, stamp)
        connection.execute("BEGIN IMMEDIATE")
        try:
            yield change
            clock = change.applied(self._clock)
            connection.execute(CLOCK.insert, clock.row)
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        self._clock = clock
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
        self._clock = StoreClock.of(self._execute("SELECT * FROM clock").fetchone())
        epoch, run = self._epoch, "SELECT epoch, first_stamp, last_stamp FROM epochs WHERE epoch = ?"
        self._run = self._execute(run, epoch).fetchone()
        self._next_row = 1 + self._newest_row()
        self._kept_places = self._places_row()
        self._written = {}
        if self.read_only:
            return
        rows = self._execute(
            f"SELECT c.key, o.id, c.mark, {COLUMNS} FROM current c JOIN objects o ON o.key = c.key ORDER BY c.key"
        ).fetchall()
        for key, name, mark, *values in rows:
            item = decode(name, tuple(values))
            count, last = self._execute(
                "SELECT count(*), max(row) FROM history WHERE key = ?", key
            ).fetchone()
            noted, noted_at = item, self._stamp or 0.0
            if last is not None:
                noted_at, *old = self._execute(
                    f"SELECT stamp, {COLUMNS} FROM history WHERE row = ?", last
                ).fetchone()
                noted = decode(name, tuple(old))
            self._written[name] = Written(key, item, item, noted, noted_at, count, values[5], mark)

    def _fail(self, error: BaseException) -> None:
        self.failures += 1
        self._failed_in_a_row += 1
        # A full disk answers at once, and what waits for room is nowhere but in this process: it does not wait longer.
        self._retry_at = -float("inf") if is_full(error) else time.monotonic() + RETRY
        self.problem = f"{self.path}: not written: {error}"
        if is_damage(error):
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

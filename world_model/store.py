"""Memory of the world model: every change of the most probable world, in one SQLite file.

One transaction per message in write-ahead mode: a crash loses at most the message that was being written. Table
`current` always has the newest state of every object, for the restart; `history` has a row per event, for questions
about the past, and is thinned out when it exceeds a limit: what is old, and no event, first.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from estimation.checks import require_count
from world_model.state import WorldObject, WorldState
from world_model.store_file import DamagedError, StoreError, StoreFile, is_damage, set_aside
from world_model.store_records import HistoryEntry, Memory, Records
from world_model.store_rows import COLUMNS, Written, attributes_text, decode, encode, event, is_drift

__all__ = ["HistoryEntry", "Memory", "Store", "StoreError"]

LIMIT = 100_000
EVENT_LEVEL = 30
"""Rows with a higher level are kept longer; events have this one, others the ruler sequence of their number."""
EVENTS = ("appeared", "gone", "lost", "found", "returned", "renamed")
INSTANTS = 3
"""Failures in a row after which a write is tried again once a second only."""
RETRY = 1.0
PLACEHOLDERS = ", ".join("?" * len(COLUMNS.split(",")))


class Store(Records):
    """A world model's memory in a file.

    path : of the file; its folder is made. limit : rows of history that are kept. read_only : only ask questions, also
    while another process writes. A damaged file is set aside under a name of its own (`set_aside`), and a new one
    begun. `problem` : why the last write failed, "" while all is well; it is tried again, and the model goes on.
    Raises StoreError where the file cannot be opened, StoreVersionError where it is of another version.
    """

    def __init__(self, path: str | Path, limit: int = LIMIT, read_only: bool = False) -> None:
        self.path = Path(path)
        self.limit = require_count("limit", limit, 100)
        self.read_only = read_only
        self.set_aside: Path | None = None
        self.problem = ""
        self.rows = 0
        self.failures = 0
        self._retry_at = -float("inf")
        self._failed_in_a_row = 0
        self._written: dict[str, Written] = {}
        try:
            self._open()
        except DamagedError as error:
            if read_only:
                raise
            self._replace(str(error))

    # Writing.

    def record(self, state: WorldState) -> None:
        """Write what has changed since the last state, in one transaction. Does not raise: see `problem`."""
        if self._failed_in_a_row >= INSTANTS and abs(state.stamp - self._retry_at) < RETRY:
            return
        try:
            if self._file.replaced:
                self._reopen("the file was moved or removed")
            self._record(state)
        except (sqlite3.Error, OSError, StoreError) as error:
            self._fail(error, state.stamp)
            return
        if self._failed_in_a_row:
            self._failed_in_a_row, self.problem = 0, ""

    def begin(self, epoch: int) -> None:
        """A new run: its world is empty. Does not raise: see `problem`."""
        try:
            self._transaction([lambda: self._begin(epoch)])
        except (sqlite3.Error, OSError) as error:
            self._fail(error, float("inf"))

    def rename(self, object_id: str, new_object_id: str) -> None:
        """An object has a new symbol; its history goes with it. Does not raise: see `problem`."""
        known = self._written.get(object_id)
        if known is None:
            return
        try:
            self._transaction(
                [lambda: self._execute("UPDATE objects SET id = ? WHERE key = ?", new_object_id, known.key)]
            )
            self._written[new_object_id] = self._written.pop(object_id)
        except (sqlite3.Error, OSError) as error:
            self._fail(error, float("inf"))

    def _record(self, state: WorldState) -> None:
        if state.epoch != self._epoch:
            self._transaction([lambda: self._begin(state.epoch)])
        changed = [
            item
            for item in state.objects
            if (known := self._written.get(item.id)) is None or known.latest is not item
        ]
        gone: list[str] = []
        if len(state.objects) - sum(item.id not in self._written for item in changed) < len(self._written):
            gone = list(self._written.keys() - {item.id for item in state.objects})
        after: list[tuple[str, Written | None]] = []
        connection = self._file.connection
        connection.execute("BEGIN IMMEDIATE")
        try:
            inserted = 0
            for item in changed:
                written, rows = self._write(item, state.stamp)
                after.append((item.id, written))
                inserted += rows
            for object_id in gone:
                inserted += self._remove(object_id, state.stamp)
                after.append((object_id, None))
            self._execute("UPDATE clock SET stamp = ? WHERE one = 1", state.stamp)
            self._execute(
                "UPDATE epochs SET first_stamp = ifnull(first_stamp, ?), last_stamp = ? WHERE epoch = ?",
                state.stamp,
                state.stamp,
                state.epoch,
            )
            deleted = self._thin(min(4 * inserted + 16, self.rows + inserted - self.limit))
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        self.rows += inserted - deleted
        self._stamp = state.stamp
        for object_id, written_now in after:
            if written_now is None:
                del self._written[object_id]
            else:
                self._written[object_id] = written_now

    def _write(self, item: WorldObject, stamp: float) -> tuple[Written, int]:
        """Rows of one object that is new or another version; what to remember of it, and the rows of history."""
        known = self._written.get(item.id)
        if known is not None and is_drift(known.row, item):
            return replace(known, latest=item), 0
        if known is not None and known.row.attributes == item.attributes:
            text = known.text
        else:
            text = attributes_text(item.attributes)
        if known is None:
            key, rows = self._key(item.id)
            happened = "returned" if rows else "appeared"
        else:
            key, rows = known.key, known.rows
            happened = event(known.noted, known.noted_at, item, stamp)
        values = encode(item, text)
        self._execute(f"INSERT OR REPLACE INTO current VALUES (?, {PLACEHOLDERS})", key, *values)
        if not happened:
            assert known is not None
            return replace(known, latest=item, row=item, text=text), 0
        self._note(key, stamp, happened, rows, item)
        return Written(key, item, item, item, stamp, rows + 1, text), 1

    def _remove(self, object_id: str, stamp: float) -> int:
        known = self._written[object_id]
        self._execute("DELETE FROM current WHERE key = ?", known.key)
        self._note(known.key, stamp, "gone", known.rows, known.latest)
        return 1

    def _note(self, key: int, stamp: float, happened: str, number: int, item: WorldObject) -> None:
        """A row of history. Every other row has level 0, every fourth level 1 and so on: the ruler sequence."""
        number += 1
        level = EVENT_LEVEL if happened in EVENTS else (number & -number).bit_length() - 1
        text = attributes_text(item.attributes, 4)
        self._execute(
            f"INSERT INTO history (key, stamp, event, level, {COLUMNS}) VALUES (?, ?, ?, ?, {PLACEHOLDERS})",
            key,
            stamp,
            happened,
            level,
            *encode(item, text),
        )

    def _key(self, object_id: str) -> tuple[int, int]:
        """Key of an object of this run, and how many rows of history it has."""
        found = self._execute(
            "SELECT key FROM objects WHERE epoch = ? AND id = ?", self._epoch, object_id
        ).fetchone()
        if found is None:
            made = self._execute("INSERT INTO objects (epoch, id) VALUES (?, ?)", self._epoch, object_id)
            return int(made.lastrowid or 0), 0
        rows = self._execute("SELECT count(*) FROM history WHERE key = ?", found[0]).fetchone()[0]
        return int(found[0]), int(rows)

    def _begin(self, epoch: int) -> None:
        self._execute("DELETE FROM current")
        self._execute("INSERT OR IGNORE INTO epochs (epoch) VALUES (?)", epoch)
        self._execute("UPDATE clock SET epoch = ?, stamp = NULL WHERE one = 1", epoch)
        self._epoch, self._stamp = epoch, None
        self._written = {}

    def _thin(self, count: int) -> int:
        """Delete up to `count` rows of the older half of history, those of low level first."""
        if count <= 0:
            return 0
        newest = self._execute("SELECT max(row) FROM history").fetchone()[0] or 0
        deleted = 0
        for level in range(EVENT_LEVEL + 1):
            deleted += self._execute(
                "DELETE FROM history WHERE row IN "
                "(SELECT row FROM history WHERE level = ? AND row <= ? ORDER BY row LIMIT ?)",
                level,
                newest - self.limit // 2,
                count - deleted,
            ).rowcount
            if deleted >= count:
                break
        return deleted

    # The file.

    def save(self, path: str | Path | None = None) -> Path:
        """Write everything to the file itself, or a complete copy to another one. Raises StoreError.

        A copy replaces an older copy, and nothing else.
        """
        try:
            if path is None or Path(path) == self.path:
                self._execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
                return self.path
            target = Path(path)
            if target.exists():
                StoreFile(target, read_only=True).close()
            temporary = target.with_name(target.name + ".part")
            temporary.unlink(missing_ok=True)
            self._execute("VACUUM INTO ?", str(temporary))
            temporary.replace(target)
        except (sqlite3.Error, OSError) as error:
            raise StoreError(f"{path or self.path}: cannot be written: {error}") from error
        return target

    def compact(self, limit: int | None = None) -> int:
        """Thin history out to `limit` rows and give the space back; returns how many rows went. Raises StoreError."""
        if limit is not None:
            self.limit = require_count("limit", limit, 100)
        went = 0
        try:
            while self.rows > self.limit:
                done = self._thin(min(self.rows - self.limit, 10_000))
                if done == 0:
                    break
                went, self.rows = went + done, self.rows - done
            self._execute("VACUUM")
            self._execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: cannot be compacted: {error}") from error
        return went

    def close(self) -> None:
        """Close the file; everything recorded stays."""
        self._file.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _transaction(self, steps: Iterable[Any]) -> None:
        connection = self._file.connection
        connection.execute("BEGIN IMMEDIATE")
        try:
            for step in steps:
                step()
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise

    def _open(self) -> None:
        """Open the file and take over what it has."""
        self._file = StoreFile(self.path, self.read_only)
        try:
            self._resume()
        except (sqlite3.Error, ValueError, TypeError, KeyError) as error:
            self._file.close()
            if isinstance(error, sqlite3.Error) and not is_damage(error):
                raise StoreError(f"{self.path}: cannot be read: {error}") from error
            raise DamagedError(f"{self.path}: is damaged: {error}") from error

    def _resume(self) -> None:
        epoch, stamp = self._execute("SELECT epoch, stamp FROM clock").fetchone()
        self._epoch = int(epoch)
        self._stamp = stamp
        self.rows = int(self._execute("SELECT count(*) FROM history").fetchone()[0])
        self._written = {}
        rows = self._execute(
            f"SELECT c.key, o.id, {COLUMNS} FROM current c JOIN objects o ON o.key = c.key ORDER BY c.key"
        ).fetchall()
        for key, name, *values in rows:
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
            self._written[name] = Written(key, item, item, noted, noted_at, count, values[5])

    def _fail(self, error: BaseException, stamp: float) -> None:
        self.failures += 1
        self._failed_in_a_row += 1
        self._retry_at = stamp
        self.problem = f"{self.path}: not written: {error}"
        if is_damage(error):
            try:
                self._file.close()
                self._replace(self.problem)
            except (sqlite3.Error, OSError, StoreError) as second:
                self.problem = f"{self.path}: damaged, and no new file: {second}"

    def _reopen(self, why: str) -> None:
        self._file.close()
        self._open()
        self.problem = f"{self.path}: {why}; begun anew"

    def _replace(self, why: str) -> None:
        """Set the damaged file aside and begin a new one."""
        self.set_aside = set_aside(self.path)
        self._open()
        self.problem = f"{why}; it was set aside as {self.set_aside.name}, and a new one begun"

"""The file of the store: opened, checked, locked against a second writer, and set aside where it is damaged."""

from __future__ import annotations

import fcntl
import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from estimation.errors import WhereaboutsError

VERSION = 1
APPLICATION = 0x77686272
"""Marks the file as a world model's among all that SQLite may have written."""
BUSY = 0.2
"""s that a write waits for another process."""
DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
COMPANIONS = ("", "-wal", "-shm")

SCHEMA = """
CREATE TABLE clock (one INTEGER PRIMARY KEY CHECK (one = 1), epoch INTEGER NOT NULL, stamp REAL);
CREATE TABLE epochs (epoch INTEGER PRIMARY KEY, first_stamp REAL, last_stamp REAL);
CREATE TABLE objects (key INTEGER PRIMARY KEY, epoch INTEGER NOT NULL, id TEXT NOT NULL, UNIQUE (epoch, id));
CREATE TABLE current (key INTEGER PRIMARY KEY, numbers BLOB NOT NULL, existence REAL NOT NULL, lost INTEGER NOT NULL,
  last_seen REAL NOT NULL, first_seen REAL NOT NULL, attributes TEXT NOT NULL, behaviors TEXT NOT NULL, region TEXT);
CREATE TABLE history (row INTEGER PRIMARY KEY, key INTEGER NOT NULL, stamp REAL NOT NULL, event TEXT NOT NULL,
  level INTEGER NOT NULL, numbers BLOB NOT NULL, existence REAL NOT NULL, lost INTEGER NOT NULL,
  last_seen REAL NOT NULL, first_seen REAL NOT NULL, attributes TEXT NOT NULL, behaviors TEXT NOT NULL, region TEXT);
CREATE INDEX history_by_object ON history (key, stamp);
CREATE INDEX history_by_level ON history (level, row);
INSERT INTO clock VALUES (1, 0, NULL);
INSERT INTO epochs (epoch) VALUES (0);
"""


class StoreError(WhereaboutsError):
    """The store cannot be used; the message says which file and why."""


class StoreVersionError(StoreError):
    """The file is another version's, or no world model's at all; it is left as it is."""


class DamagedError(StoreError):
    """The file is damaged."""


class StoreFile:
    """One open file. `connection` is in autocommit mode; transactions are explicit.

    Raises StoreVersionError, DamagedError or StoreError, naming the file.
    """

    def __init__(self, path: Path, read_only: bool = False) -> None:
        self.path = path
        self._lock: int | None = None
        if read_only and not path.is_file():
            raise StoreError(f"{path}: there is no such store")
        if not read_only:
            self._lock = _locked(path)
        try:
            self.connection = _opened(path, read_only)
        except BaseException:
            self._unlock()
            raise
        self._identity = _identity(path)

    @property
    def replaced(self) -> bool:
        """Whether somebody has moved or removed the file."""
        return _identity(self.path) != self._identity

    def close(self) -> None:
        """Close; committed data stay."""
        self.connection.close()
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def is_store(path: Path) -> bool:
    """Whether a file says of itself that it is a world model's store, of whatever version."""
    try:
        with path.open("rb") as file:
            head = file.read(72)
    except OSError:
        return False
    if head[:16] != b"SQLite format 3\0":
        return False
    if head[68:72] == APPLICATION.to_bytes(4, "big"):
        return True
    # While a node has it open, or after one was killed, the mark may still be in the companion file.
    if not Path(f"{path}-wal").exists():
        return False
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as connection:
            return bool(connection.execute("PRAGMA application_id").fetchone()[0] == APPLICATION)
    except sqlite3.Error:
        return False


def set_aside(path: Path) -> Path:
    """Rename a damaged file and what belongs to it, so that nothing is overwritten; returns the new name."""
    number = 1
    while any(Path(f"{path}.damaged-{number}{suffix}").exists() for suffix in COMPANIONS):
        number += 1
    aside = Path(f"{path}.damaged-{number}")
    for suffix in COMPANIONS:
        source = Path(f"{path}{suffix}")
        if source.exists():
            source.rename(f"{aside}{suffix}")
    return aside


def is_damage(error: BaseException) -> bool:
    """Whether an error of SQLite says that the file itself is damaged."""
    code = getattr(error, "sqlite_errorcode", 0) or 0
    return isinstance(error, sqlite3.DatabaseError) and (code & 0xFF) in DAMAGED


def _opened(path: Path, read_only: bool) -> sqlite3.Connection:
    try:
        mode = "ro" if read_only else "rwc"
        uri = f"file:{_quoted(path)}?mode={mode}"
        connection = sqlite3.connect(uri, timeout=BUSY, isolation_level=None, uri=True)
    except sqlite3.Error as error:
        raise StoreError(f"{path}: cannot be opened: {error}") from error
    try:
        _prepare(connection, path, read_only)
    except sqlite3.Error as error:
        connection.close()
        if is_damage(error):
            raise DamagedError(f"{path}: is damaged: {error}") from error
        raise StoreError(f"{path}: cannot be used: {error}") from error
    except BaseException:
        connection.close()
        raise
    return connection


def _prepare(connection: sqlite3.Connection, path: Path, read_only: bool) -> None:
    def pragma(name: str) -> Any:
        return connection.execute(f"PRAGMA {name}").fetchone()[0]

    application, version = pragma("application_id"), pragma("user_version")
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    fresh = tables == 0 and application == 0 and not read_only
    if not fresh:
        if application != APPLICATION:
            raise StoreVersionError(f"{path}: is a database, but not a world model's")
        if version != VERSION:
            raise StoreVersionError(
                f"{path}: is of version {version}, this program reads version {VERSION}; it was left as it is"
            )
        problem = pragma("quick_check(1)")
        if problem != "ok":
            raise DamagedError(f"{path}: is damaged: {problem}")
    if read_only:
        return
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")
    connection.execute("PRAGMA wal_autocheckpoint = 1000")
    if fresh:
        connection.executescript(
            f"BEGIN; {SCHEMA} PRAGMA application_id = {APPLICATION}; PRAGMA user_version = {VERSION}; COMMIT;"
        )


def _locked(path: Path) -> int:
    """A lock that ends with this process, however it ends."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StoreError(f"{path}: cannot be opened: {error}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise StoreError(f"{path}: another process writes to it") from error
    return lock


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        about = os.stat(path)
    except OSError:
        return None
    return about.st_dev, about.st_ino


def _quoted(path: Path) -> str:
    """A path for a SQLite URI."""
    return str(path.absolute()).replace("%", "%25").replace("?", "%3f").replace("#", "%23")

"""The file of the store: opened, checked, locked against a second writer, and put right where it is damaged."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import sqlite3
import struct
import threading
import time
import zlib
from contextlib import closing, suppress
from pathlib import Path

from estimation.errors import WhereaboutsError
from world_model.memory.store_format import (
    APPLICATION,
    FIRST_VERSION,
    MAGIC,
    VERSION,
    StoreClock,
    header_problem,
)
from world_model.memory.store_pages import Pages
from world_model.memory.store_repair import (
    READING_ERRORS,
    Examined,
    connect,
    examine,
    has_our_rows,
    make,
    rebuild,
    rebuild_beside,
    synchronised,
    version_of,
)

DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
COMPANIONS = ("", "-wal", "-shm")
SNAPSHOTS = 2
SPACE = 3.0  # Times the size of a file that has to be free for a new one beside it
CLOSING = 1.0  # s for which a writer that ends looks at what it leaves
_TIP = struct.Struct("<QII")
_WHOLE = 32  # Where in the file beside the store the digest of what was found whole lies, after the tip


class StoreError(WhereaboutsError):
    """The store cannot be used; the message says which file and why."""


class StoreVersionError(StoreError):
    """The file is another version's, or no world model's at all; it is left as it is."""


class StoreFile:
    """One open file. `connection` is in autocommit mode; transactions are explicit.

    `found` : what was damaged or missing when it was opened, a sentence each; `aside` : where the damaged file is now.
    A read-only store is not put right: what is whole is answered from memory.

    Raises StoreVersionError or StoreError, naming the file.
    """

    def __init__(self, path: Path, read_only: bool = False) -> None:
        self.path = path
        self.found: list[str] = []
        self.aside: Path | None = None
        self._lock: int | None = None
        if read_only:
            if not path.is_file():
                raise StoreError(f"{path}: there is no such store")
            self.connection = self._for_reading()
        else:
            self._lock = locked(path)
            try:
                self.connection = self._for_writing()
            except BaseException:
                self._unlock()
                raise
        self._identity = _identity(path)

    @property
    def replaced(self) -> bool:
        """Whether somebody has moved or removed the file."""
        return _identity(self.path) != self._identity

    @property
    def snapshots(self) -> list[Path]:
        """Where snapshots are kept, the newest first."""
        return [Path(f"{self.path}.snapshot-{number + 1}") for number in range(SNAPSHOTS)]

    def note(self, clock: StoreClock) -> None:
        """Remember beside the file how far it has been written: what a log lost is then known."""
        if self._lock is not None:
            name = zlib.crc32(clock.identity.encode())
            os.pwrite(self._lock, _tip(clock.sequence, name), 0)

    def close(self) -> None:
        """Close; committed data stay."""
        self.connection.close()
        if self._lock is not None:
            self._look_at_the_end()
        self._unlock()

    def _look_at_the_end(self) -> None:
        """Whether what is left behind is whole, as far as there is time: who opens it next need not ask again."""
        until = time.monotonic() + CLOSING
        try:
            pages = Pages(self.path)
            if self._known(pages) or pages.log_size:
                return
            # As nobody writes now, without a log of its own, which would stay behind.
            with closing(connect(self.path, "ro&immutable=1")) as connection:
                found = examine(connection, lambda: time.monotonic() < until)
                if not found.problems and time.monotonic() < until and not self._judged(pages):
                    self._note_whole(pages)
        except (*READING_ERRORS, OSError, WhereaboutsError):
            return  # whoever opens it next says what is wrong

    def _known(self, pages: Pages) -> bool:
        """Whether exactly this was found whole before."""
        try:
            digest = pages.digest  # now, so that `_is_still` can tell whether the file has changed since
            with Path(f"{self.path}.lock").open("rb") as beside:
                beside.seek(_WHOLE)
                return beside.read() == digest
        except OSError:
            return False

    def _is_still(self, pages: Pages) -> bool:
        """Whether this is the file yet: while a reader looked another process may have begun to write."""
        return self._lock is not None or Pages(self.path).digest == pages.digest

    def _note_whole(self, pages: Pages) -> None:
        """Remember beside the file that it is whole as it is; not where that cannot be written."""
        with suppress(OSError):
            beside = os.open(f"{self.path}.lock", os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                os.pwrite(beside, pages.digest, _WHOLE)
            finally:
                os.close(beside)

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _for_writing(self) -> sqlite3.Connection:
        path = self.path
        try:
            self._finish_exchange()
            if not path.exists():
                self._clear_companions()
                make(path)
            connection, why = self._checked()
            if connection is None:
                self._put_right(why)
                connection = connect(path, "rw")
            for pragma in ("journal_mode = WAL", "synchronous = NORMAL", "secure_delete = ON"):
                connection.execute(f"PRAGMA {pragma}").fetchall()
            connection.execute("PRAGMA wal_autocheckpoint = 1000").fetchall()
            clock = StoreClock.of(connection.execute("SELECT * FROM clock").fetchone())
            self._compare_tip(clock)
            return connection
        except (sqlite3.Error, OSError) as error:
            raise StoreError(f"{path}: cannot be opened for writing: {_reason(error)}") from error

    def _for_reading(self) -> sqlite3.Connection:
        path = self.path
        try:
            connection, why = self._checked()
            if connection is None:
                connection = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
                salvage = rebuild(path, why, self.snapshots, connection)
                if why.problems != [_OLD]:
                    self.found.append(
                        f"{path}: is damaged: {_first(why.problems)}; answered from what is whole: {salvage}"
                    )
            return connection
        except (sqlite3.Error, OSError) as error:
            raise StoreError(f"{path}: cannot be read: {_reason(error)}") from error

    def _judged(self, pages: Pages) -> list[str]:
        """What shows before SQLite touches the file. Raises StoreVersionError for one that is not to be touched."""
        if pages.count == 0:
            return ["it is empty"]
        head = pages[1]
        problem, version = header_problem(head), version_of(pages)
        known = version in (VERSION, FIRST_VERSION)
        if not known and head[:16] == MAGIC and not self._is_one_bit(head, pages):
            if not version and not _is_database(self.path):
                return ["is no database", *pages.problems]
            if not version:
                raise StoreVersionError(f"{self.path}: is a database, but not a world model's")
            raise StoreVersionError(
                f"{self.path}: is of version {version}, this program reads version {VERSION}; it was left as it is"
            )
        if problem or not known:
            return [problem or "the head of the file is not as it was written", *pages.problems]
        return [_OLD] if version == FIRST_VERSION else pages.problems

    def _is_one_bit(self, head: bytes, pages: Pages) -> bool:
        """Whether the numbers in the head are damaged rather than somebody else's."""
        if version_of(pages) and (int.from_bytes(head[60:64], "big") ^ VERSION).bit_count() > 1:
            return False
        return has_our_rows(pages)

    def _checked(self) -> tuple[sqlite3.Connection | None, Examined]:
        """A connection to a file that is whole, or what is damaged."""
        pages = Pages(self.path)
        # While another process writes, the log changes as it is read; SQLite's own view is then the whole one.
        rests = self._lock is not None or not _is_being_written(self.path)
        found, connection = Examined(self._judged(pages) if rests else []), None
        if found.problems:
            return None, found
        try:
            connection = connect(self.path, "ro" if self._lock is None else "rw")
            connection.execute("PRAGMA secure_delete = ON").fetchall()
            if rests and self._known(pages):
                return connection, found
            found = examine(connection)
        except READING_ERRORS as error:
            found = Examined([str(error)])
        if not found.problems and rests and self._is_still(pages):
            self._note_whole(pages)
        if found.problems and connection is not None:
            connection.close()
            connection = None
        return connection, found

    def _put_right(self, why: Examined) -> None:
        """Exchange the file for one of everything that is whole."""
        path = self.path
        made, salvage = rebuild_beside(path, why, self.snapshots)
        old = why.problems == [_OLD]
        self.aside = set_aside(path, "version-1" if old else "damaged")
        made.replace(path)
        if old and not salvage.lost_rows:
            self.aside = None
            return
        self.found.append(
            f"{path}: is damaged: {_first(why.problems)}; {salvage}; it was set aside as {self.aside.name}"
        )
        lines = [*self.found[-1:], *salvage.why, *salvage.lost_rows]
        Path(f"{self.aside}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def _finish_exchange(self) -> None:
        """A process that ended between making the new file and exchanging the two left it beside."""
        made = Path(f"{self.path}.rebuilt")
        if made.exists():
            self.aside = set_aside(self.path, "damaged")
            made.replace(self.path)
            self.found.append(f"{self.path}: was damaged, and is set aside as {self.aside.name}")

    def _clear_companions(self) -> None:
        """A log without its file would be taken for the new one's."""
        if any(Path(f"{self.path}{suffix}").exists() for suffix in COMPANIONS[1:]):
            self.aside = set_aside(self.path, "damaged")
            self.found.append(f"{self.path}: only its log was there; it was set aside as {self.aside.name}")

    def _compare_tip(self, clock: StoreClock) -> None:
        assert self._lock is not None
        sequence, name, check = _TIP.unpack(os.pread(self._lock, _TIP.size, 0).ljust(_TIP.size, b"\0"))
        mine = name == zlib.crc32(clock.identity.encode()) and _tip(sequence, name)[-4:] == struct.pack(
            "<I", check
        )
        if mine and sequence > clock.sequence and not self.found:
            self.found.append(f"{self.path}: the last {sequence - clock.sequence} messages are missing in it")
        self.note(clock)


_OLD = "an older version"


def _first(why: list[str]) -> str:
    return why[0] if len(why) == 1 else f"{why[0]}, and {len(why) - 1} more"


def _tip(sequence: int, name: int) -> bytes:
    return _TIP.pack(sequence, name, zlib.crc32(struct.pack("<QI", sequence, name)))


def _reason(error: sqlite3.Error | OSError) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)


def is_store(path: Path) -> bool:
    """Whether a file says of itself that it is a world model's store, of whatever version."""
    try:
        with path.open("rb") as file:
            head = file.read(72)
    except OSError:
        return False
    if head[:16] != MAGIC:
        return False
    if head[68:72] == APPLICATION.to_bytes(4, "big"):
        return True
    # While a node has it open, or after one was killed, the mark may still be in the companion file.
    if not Path(f"{path}-wal").exists():
        return False
    try:
        with closing(connect(path, "ro")) as connection:
            return bool(connection.execute("PRAGMA application_id").fetchone()[0] == APPLICATION)
    except sqlite3.Error:
        return False


def _is_database(path: Path) -> bool:
    try:
        with closing(connect(path, "ro")) as connection:
            return connection.execute("SELECT count(*) FROM sqlite_master").fetchone() is not None
    except READING_ERRORS:
        return False


def set_aside(path: Path, why: str = "damaged") -> Path:
    """Rename a file and what belongs to it, so that nothing is overwritten; returns the new name."""
    number = 1
    while any(Path(f"{path}.{why}-{number}{suffix}").exists() for suffix in COMPANIONS):
        number += 1
    aside = Path(f"{path}.{why}-{number}")
    for suffix in COMPANIONS:
        source = Path(f"{path}{suffix}")
        if source.exists():
            source.rename(f"{aside}{suffix}")
    return aside


def copy_store(connection: sqlite3.Connection, target: Path) -> None:
    """A complete copy, read back and compared before it takes the place of an older copy; nothing else is replaced.

    Raises StoreError.
    """
    if target.exists() and not is_store(target):
        raise StoreError(f"{target}: is not a world model's store; it was not overwritten")
    lock = locked(target)
    part = Path(f"{target}.part")
    try:
        part.unlink(missing_ok=True)
        connection.execute("VACUUM INTO ?", (str(part),))
        expected = connection.execute("SELECT * FROM clock").fetchone()
        _compare(part, expected)
        synchronised(part)
        for suffix in COMPANIONS[1:]:
            Path(f"{target}{suffix}").unlink(missing_ok=True)
        part.replace(target)
        _compare(target, expected)
    except (sqlite3.Error, OSError) as error:
        raise StoreError(f"{target}: cannot be written: {_reason(error)}") from error
    finally:
        part.unlink(missing_ok=True)
        os.close(lock)


def _compare(path: Path, expected: tuple[object, ...]) -> None:
    with closing(connect(path, "ro")) as copy:
        problems = examine(copy).problems
        if not problems and copy.execute("SELECT * FROM clock").fetchone() != expected:
            problems = ["holds something else than was written"]
    if problems:
        raise StoreError(f"{path}: was written, but reading it back shows: {problems[0]}")


def is_damage(error: BaseException) -> bool:
    """Whether an error of SQLite says that the file itself is damaged."""
    return isinstance(error, sqlite3.DatabaseError) and _code(error) in DAMAGED


def is_full(error: BaseException) -> bool:
    """Whether there was no room for a write."""
    return _code(error) == sqlite3.SQLITE_FULL or getattr(error, "errno", None) == errno.ENOSPC


def _code(error: BaseException) -> int:
    return (getattr(error, "sqlite_errorcode", 0) or 0) & 0xFF


def has_space(path: Path) -> bool:
    """Whether there is room for another file of the size."""
    try:
        return shutil.disk_usage(path.parent).free > SPACE * path.stat().st_size
    except OSError:
        return False


def locked(path: Path) -> int:
    """A lock that ends with this process, however it ends. Raises StoreError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StoreError(f"{path}: cannot be opened for writing: {_reason(error)}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise StoreError(f"{path}: another process writes to it") from error
    return lock


def _is_being_written(path: Path) -> bool:
    try:
        lock = os.open(f"{path}.lock", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    except OSError:
        return True
    finally:
        os.close(lock)


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        about = os.stat(path)
    except OSError:
        return None
    return about.st_dev, about.st_ino


class Keeper:
    """A thread with connections of its own, which only read.

    found : damages of the file that the writer has still to put right. problem : why there is no new snapshot. checks,
    snapshots : how many there were. period : s between two.
    """

    def __init__(self, file: StoreFile, period: float) -> None:
        self._path, self._snapshots = file.path, file.snapshots
        self.period = period
        self._kept = -1
        self.found: list[str] = []
        self.problem = ""
        self.checks = 0
        self.snapshots = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="store keeper", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop; a check that is running ends first."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(self.period):
            try:
                self.look()
            except (sqlite3.Error, OSError) as error:
                self.problem = f"{self._path}: no snapshot: {error}"

    def look(self) -> None:
        """One check, and a snapshot where something has been written since the last. Raises sqlite3.Error, OSError."""
        with closing(connect(self._path, "ro", timeout=5.0)) as connection:
            found = examine(connection, self._pause).problems
            self.checks += 1
            if found:
                self.found = found
            elif not self._ended.is_set():
                self._keep(connection)

    def _pause(self) -> bool:
        """Leave the processor to others; whether to go on."""
        return not self._ended.wait(0.002)

    def _keep(self, connection: sqlite3.Connection) -> None:
        clock = StoreClock.of(connection.execute("SELECT * FROM clock").fetchone())
        if clock.sequence == self._kept:
            return
        if not has_space(self._path):
            raise OSError("too little space")
        part = Path(f"{self._path}.snapshot.part")
        part.unlink(missing_ok=True)
        connection.execute("VACUUM INTO ?", (str(part),))
        with closing(connect(part, "ro")) as copy:
            found = examine(copy, self._pause).problems
        if found:
            part.unlink()
            raise OSError(found[0])
        synchronised(part)
        for newer, older in zip(self._snapshots[-2::-1], self._snapshots[::-1], strict=False):
            if newer.exists():
                newer.replace(older)
        part.replace(self._snapshots[0])
        self._kept, self.problem = clock.sequence, ""
        self.snapshots += 1

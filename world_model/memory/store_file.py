"""The file of the store: opened, checked, locked against a second writer, and put right where it is damaged."""

from __future__ import annotations

import fcntl
import os
import shutil
import sqlite3
import struct
import threading
import time
import zlib
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

from estimation.errors import WhereaboutsError
from world_model.memory.store_format import (
    APPLICATION,
    FIRST_VERSION,
    HEAD,
    MAGIC,
    VERSION,
    StoreClock,
    version_of,
)
from world_model.memory.store_pages import Pages
from world_model.memory.store_repair import (
    READING_ERRORS,
    connect,
    examine,
    make,
    rebuild,
    rebuild_beside,
    synchronised,
)

COMPANIONS = ("", "-wal", "-shm")
SNAPSHOTS = 2
SPACE = 3.0  # Times the size of a file that has to be free for a new one beside it
STEPS = 10_000  # Of SQLite's, between two pauses of who looks through a file: some hundred rows
CLOSING = 1.0  # s for which a writer that ends looks at what it leaves
WRITING = ("journal_mode = WAL", "synchronous = NORMAL", "secure_delete = ON", "wal_autocheckpoint = 1000")
_TIP_SIZE = 16
_WHOLE = 32  # Where in the file beside the store the digest of what was found whole lies, after the tip
_OLD = "an older version"


class StoreError(WhereaboutsError):
    """The store cannot be used; the message says which file and why."""


class StoreVersionError(StoreError):
    """The file is another version's, or no world model's at all; it is left as it is."""


class StoreFile:
    """One open file. `connection` is in autocommit mode; transactions are explicit.

    `found` : what was damaged or missing when it was opened, a sentence each; `aside` : where the damaged file is now.
    A read-only store is not put right: what is whole is answered from memory, and where nothing is that is an error.

    Raises StoreVersionError or StoreError, naming the file.
    """

    def __init__(self, path: Path, read_only: bool = False) -> None:
        self.path = path
        self.found: list[str] = []
        self.aside: Path | None = None
        self._lock: int | None = None
        if read_only and not path.is_file():
            raise StoreError(f"{path}: there is no such store")
        with ExitStack() as failing:
            failing.callback(self._unlock)
            try:
                self._lock = None if read_only else locked(path)
                self.connection = self._for_reading() if read_only else self._for_writing()
            except (sqlite3.Error, OSError) as error:
                what = "read" if read_only else "opened for writing"
                raise StoreError(f"{path}: cannot be {what}: {_reason(error)}") from error
            failing.pop_all()
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
            os.pwrite(self._lock, _tip(clock), 0)

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
            if self._known(pages) or pages.log:
                return
            # As nobody writes now, without a log of its own, which would stay behind.
            with closing(connect(self.path, "ro&immutable=1")) as connection:
                connection.set_progress_handler(lambda: time.monotonic() > until, STEPS)
                if not examine(connection) and not self._judged(pages):
                    self._note_whole(pages)
        except (*READING_ERRORS, OSError, WhereaboutsError):
            return  # whoever opens it next says what is wrong

    def _known(self, pages: Pages) -> bool:
        """Whether exactly this was found whole before."""
        try:
            digest = pages.digest  # now, so that it shows whether the file has changed since
            with Path(f"{self.path}.lock").open("rb") as beside:
                beside.seek(_WHOLE)
                return beside.read() == digest
        except OSError:
            return False

    def _note_whole(self, pages: Pages) -> None:
        """Remember beside the file that it is whole as it is; not where that cannot be written."""
        with suppress(OSError):
            beside = Path(f"{self.path}.lock")
            beside.touch()
            with beside.open("rb+") as file:
                file.seek(_WHOLE)
                file.write(pages.digest)

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _for_writing(self) -> sqlite3.Connection:
        self._finish_exchange()
        if not self.path.exists():
            make(self.path)
        connection, problems = self._checked()
        if connection is None:
            self._put_right(problems)
            connection = connect(self.path, "rw")
        for pragma in WRITING:
            connection.execute(f"PRAGMA {pragma}").fetchall()
        self._compare_tip(StoreClock.of(connection))
        return connection

    def _for_reading(self) -> sqlite3.Connection:
        connection, problems = self._checked()
        if connection is None:
            connection = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
            salvage = rebuild(self.path, self.snapshots, connection)
            if problems != [_OLD]:
                if salvage.missing != 0 and not connection.execute("SELECT 1 FROM objects").fetchone():
                    raise StoreError(
                        f"{self.path}: is no world model's store, or nothing in it is whole: {_first(problems)}; put a "
                        "copy in its place, or move it away"
                    )
                self.found.append(
                    f"{self.path}: is damaged: {_first(problems)}; answered from what is whole: {salvage}; "
                    "a node that writes to it puts it right"
                )
        return connection

    def _judged(self, pages: Pages) -> list[str]:
        """What shows before SQLite touches the file. Raises StoreVersionError for one that is not to be touched."""
        if pages.count == 0:
            return ["it is empty"]
        head = pages[1]
        version = version_of(head)
        known, problem = version in (VERSION, FIRST_VERSION), ""
        if head[:16] != MAGIC:
            problem = "does not begin as a database does"
        elif not known or not HEAD.match(head):
            problem = "the head of the file is not as it was written"
        # Numbers in the head may be damaged rather than somebody else's.
        one_bit = not version or (version ^ VERSION).bit_count() == 1
        if not known and head[:16] == MAGIC and not (one_bit and any(found[0] for _, found in pages.rows())):
            if version:
                raise StoreVersionError(
                    f"{self.path}: is of version {version}, this program reads version {VERSION}; "
                    "it was left as it is"
                )
            if _asked(self.path, "SELECT count(*) FROM sqlite_master") is not None:
                raise StoreVersionError(f"{self.path}: is a database, but not a world model's")
            problem = "is no database"
        if problem:
            return [problem, *pages.problems]
        return [_OLD] if version == FIRST_VERSION else pages.problems

    def _checked(self) -> tuple[sqlite3.Connection | None, list[str]]:
        """A connection to a file that is whole, or what is damaged."""
        pages = Pages(self.path)
        # While another process writes, the log changes as it is read; SQLite's own view is then the whole one.
        rests = self._lock is not None or not _is_being_written(self.path)
        if problems := self._judged(pages) if rests else []:
            return None, problems
        try:
            connection = connect(self.path, "ro" if self._lock is None else "rw")
            connection.execute("PRAGMA secure_delete = ON").fetchall()
            if rests and self._known(pages):
                return connection, []
            problems = examine(connection)
        except READING_ERRORS as error:
            return None, [str(error)]
        if problems:
            connection.close()
            return None, problems
        # While a reader looked another process may have begun to write.
        if rests and (self._lock is not None or Pages(self.path).digest == pages.digest):
            self._note_whole(pages)
        return connection, []

    def _put_right(self, problems: list[str]) -> None:
        """Exchange the file for one of everything that is whole."""
        path, made = self.path, Path(f"{self.path}.rebuilt")
        salvage = rebuild_beside(path, made, self.snapshots)
        old = problems == [_OLD]
        self.aside = set_aside(path, "version-1" if old else "damaged")
        made.replace(path)
        if old:
            self.aside = None
            return
        self.found.append(
            f"{path}: is damaged: {_first(problems)}; {salvage}; it was set aside as {self.aside.name}"
        )
        lines = [*self.found[-1:], *problems, *salvage.lost_rows]
        Path(f"{self.aside}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def _finish_exchange(self) -> None:
        """What a process left that ended between making a new file and exchanging the two, and a log without its file,
        which would be taken for the new one's."""
        made = Path(f"{self.path}.rebuilt")
        orphans = not self.path.exists() and any(
            Path(f"{self.path}{suffix}").exists() for suffix in COMPANIONS
        )
        if made.exists() or orphans:
            self.aside = set_aside(self.path, "damaged")
            what = "was damaged, and is" if made.exists() else "only its log was there; it was"
            self.found.append(f"{self.path}: {what} set aside as {self.aside.name}")
        if made.exists():
            made.replace(self.path)

    def _compare_tip(self, clock: StoreClock) -> None:
        assert self._lock is not None
        told = os.pread(self._lock, _TIP_SIZE, 0)
        sequence = int.from_bytes(told[:8], "little")
        mine = sequence > clock.sequence and told == _tip(clock._replace(sequence=sequence))
        if mine and not self.found:
            self.found.append(f"{self.path}: the last {sequence - clock.sequence} messages are missing in it")
        self.note(clock)


def _tip(clock: StoreClock) -> bytes:
    """How far a store was written, and which, with a checksum."""
    tip = struct.pack("<QI", clock.sequence, zlib.crc32(clock.identity.encode()))
    return tip + struct.pack("<I", zlib.crc32(tip))


def _first(problems: list[str]) -> str:
    return problems[0] if len(problems) == 1 else f"{problems[0]}, and {len(problems) - 1} more"


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
    # While a node has it open, or after one was killed, the mark may still be in the companion file.
    beside = Path(f"{path}-wal").exists()
    named = head[68:72] == APPLICATION.to_bytes(4, "big")
    return named or (beside and _asked(path, "PRAGMA application_id") == APPLICATION)


def _asked(path: Path, question: str) -> Any:
    """What a database answers; None where it is none."""
    try:
        with closing(connect(path, "ro")) as connection:
            return connection.execute(question).fetchone()[0]
    except READING_ERRORS:
        return None


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
    """A complete copy, read back before it takes the place of an older copy; nothing else is replaced.

    Raises StoreError.
    """
    if target.exists() and not is_store(target):
        raise StoreError(f"{target}: is not a world model's store; it was not overwritten")
    lock = locked(target)
    try:
        part = _copied(connection, target)
        for suffix in COMPANIONS[1:]:
            Path(f"{target}{suffix}").unlink(missing_ok=True)
        part.replace(target)
    except (sqlite3.Error, OSError) as error:
        raise StoreError(f"{target}: cannot be written: {_reason(error)}") from error
    finally:
        os.close(lock)


def _copied(connection: sqlite3.Connection, target: Path, pause: Callable[[], bool] | None = None) -> Path:
    """A complete copy that was read back, beside where it is to be. Raises StoreError, sqlite3.Error, OSError.

    pause : asked now and then, may wait; where it says so, there is none.
    """
    part = Path(f"{target}.part")
    with ExitStack() as failing:
        failing.callback(part.unlink, missing_ok=True)
        part.unlink(missing_ok=True)
        connection.execute("VACUUM INTO ?", (str(part),))
        with closing(connect(part, "ro")) as copy:
            copy.set_progress_handler(pause, STEPS)
            problems = examine(copy)
        if problems:
            raise StoreError(f"{part}: was written, but reading it back shows: {problems[0]}")
        synchronised(part)
        failing.pop_all()
    return part


def locked(path: Path) -> int:
    """A lock that ends with this process, however it ends. Raises StoreError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise StoreError(f"{path}: another process writes to it") from error
    except OSError as error:
        raise StoreError(f"{path}: cannot be opened for writing: {_reason(error)}") from error
    return lock


def _is_being_written(path: Path) -> bool:
    try:
        with Path(f"{path}.lock").open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


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
        """Stop; a check that is running is broken off."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(self.period):
            try:
                self.look()
            except (sqlite3.Error, OSError, StoreError) as error:
                self.problem = f"{self._path}: no snapshot: {error}"

    def look(self) -> None:
        """One check, and a snapshot where something has been written since the last. Raises sqlite3.Error, OSError."""
        with closing(connect(self._path, "ro", timeout=5.0)) as connection:
            connection.set_progress_handler(self._pause, STEPS)
            found = examine(connection)
            if self._ended.is_set():
                return
            self.checks += 1
            self.found = found
            if not found:
                self._keep(connection)

    def _pause(self) -> bool:
        """Leave the processor to others; whether to end."""
        return self._ended.wait(0.002)

    def _keep(self, connection: sqlite3.Connection) -> None:
        clock = StoreClock.of(connection)
        if clock.sequence == self._kept:
            return
        if shutil.disk_usage(self._path.parent).free <= SPACE * self._path.stat().st_size:
            raise OSError("too little space")
        part = _copied(connection, Path(f"{self._path}.snapshot"), self._pause)
        for newer, older in zip(self._snapshots[-2::-1], self._snapshots[::-1], strict=False):
            if newer.exists():
                newer.replace(older)
        part.replace(self._snapshots[0])
        self._kept, self.problem = clock.sequence, ""
        self.snapshots += 1

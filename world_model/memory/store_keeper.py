"""What looks after a store while it is written: finds damage now and then, and keeps snapshots that were read back."""

from __future__ import annotations

import os
import sqlite3
import threading
from contextlib import closing
from pathlib import Path

from world_model.memory.store_file import StoreFile, has_space
from world_model.memory.store_format import StoreClock
from world_model.memory.store_repair import connect, examine


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
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        for newer, older in zip(self._snapshots[-2::-1], self._snapshots[::-1], strict=False):
            if newer.exists():
                newer.replace(older)
        part.replace(self._snapshots[0])
        self._kept, self.problem = clock.sequence, ""
        self.snapshots += 1

"""Shared memory of the middleware that nobody uses any more.

Fast DDS gives every process a segment under /dev/shm and a lock that it holds for as long as it lives. A process that
is killed leaves both behind, eight megabytes each time.
"""

from __future__ import annotations

import fcntl
import re
import time
from pathlib import Path

FOLDER = Path("/dev/shm")
LOCK = re.compile(r"(fastrtps_[0-9a-f]{16})_el")
# One that is younger may belong to a process that is about to take its lock.
YOUNG = 5.0


def remove_orphans(folder: Path = FOLDER) -> int:
    """Remove segments whose owners are gone; returns how many there were."""
    removed = 0
    try:
        locks = [path for path in folder.iterdir() if LOCK.fullmatch(path.name)]
    except OSError:
        return 0
    for lock in locks:
        try:
            removed += _remove_if_orphan(lock)
        except OSError:
            # Somebody else's, or gone meanwhile.
            continue
    return removed


def _remove_if_orphan(lock: Path) -> bool:
    if time.time() - lock.stat().st_mtime < YOUNG:
        return False
    with lock.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        lock.with_name(lock.name.removesuffix("_el")).unlink(missing_ok=True)
        lock.unlink()
    return True

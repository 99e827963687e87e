"""A DDS domain that no other run on this machine uses."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path
from typing import IO

# Domains 1 to 100 leave their ports free of the ones Linux gives to outgoing connections.
LAST = 100
_held: dict[int, IO[bytes]] = {}


def free_domain() -> int:
    """A domain id from 1 to 100 that stays this process's own for as long as it lives.

    Should all be taken, one that is shared with another run.
    """
    folder = Path(tempfile.gettempdir())
    first = os.getpid() % LAST
    for step in range(LAST):
        domain = 1 + (first + step) % LAST
        if domain not in _held and _take(folder / f"whereabouts-domain-{domain}", domain):
            return domain
    return 1 + first


def release_domain(domain: int) -> None:
    if domain in _held:
        _held.pop(domain).close()


def _take(path: Path, domain: int) -> bool:
    try:
        file = path.open("ab")
    except OSError:
        # Another user's.
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return False
    _held[domain] = file
    return True

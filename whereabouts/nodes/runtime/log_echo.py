"""What nodes warn of in their logs, told on the terminal while they run."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from pathlib import Path

PERIOD = 0.5  # s between looks
LINE = re.compile(rb"^\[(?:WARN|ERROR|FATAL)\] \[[\d.]+\] \[([^\]]+)\]: (.*)$", re.MULTILINE)
MOST = 1 << 16  # bytes of one log in one look; what a node writes faster than that is in its log only


class LogEcho:
    """Follows the logs of nodes, which say one thing again only after a while.

    tell : called with "NODE: what it warns of".
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._read: dict[Path, int] = {}
        self._looked = -PERIOD

    def look(self, logs: Iterable[Path], now: bool = False) -> None:
        """Tell what is new, if a while has passed since the last look. now : whatever has passed."""
        if not now and time.monotonic() - self._looked < PERIOD:
            return
        self._looked = time.monotonic()
        for path in logs:
            try:
                self._follow(path)
            except OSError:  # a node that has written nothing yet
                continue

    def _follow(self, path: Path) -> None:
        at = self._read.get(path, 0)
        with path.open("rb") as file:
            size = file.seek(0, 2)
            if size < at:  # begun anew
                at = 0
            file.seek(max(at, size - MOST))
            text = file.read()
        whole = text.rfind(b"\n") + 1  # the rest of a line comes later
        self._read[path] = size - len(text) + whole
        for name, said in LINE.findall(text[:whole]):
            self._tell(f"{name.decode(errors='replace')}: {said.decode(errors='replace')}")

"""What processes cost: resident memory and processor time, from the kernel's own account (Linux)."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Usage:
    """Of one process and those that it made for itself.

    resident, proportional : most MiB, shared pages counted in full, and by share. seconds : of processor.
    """

    resident: float = 0.0
    proportional: float = 0.0
    seconds: float = 0.0


@dataclass
class UsageMeter:
    """Follows processes by name; `period` s between two looks at them, as the kernel counts pages one by one.

    A process that is started again under its name goes on where the one before ended.
    """

    period: float = 15.0
    usage: dict[str, Usage] = field(default_factory=dict)
    _before: dict[tuple[str, int], float] = field(default_factory=dict)
    _next: float = 0.0

    def look(self, processes: Mapping[str, int]) -> None:
        """Take a reading, unless one was taken within the period. processes : process id by name."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + self.period
        for name, process in processes.items():
            try:
                seconds = processor_seconds(process)
                resident, proportional = memory(process)
            except OSError:
                continue
            entry = self.usage.setdefault(name, Usage())
            entry.seconds += seconds - self._before.get((name, process), seconds)
            self._before[name, process] = seconds
            entry.resident = max(entry.resident, resident)
            entry.proportional = max(entry.proportional, proportional)


def family(process: int) -> list[int]:
    """A process and its children. Raises OSError where it has ended."""
    tasks = Path(f"/proc/{process}/task").iterdir()
    return [process, *(int(child) for task in tasks for child in (task / "children").read_text().split())]


def processor_seconds(process: int) -> float:
    """User and system time of a process and its children, all their threads. Raises OSError where it has ended."""
    return sum(map(_own_seconds, family(process)))


def memory(process: int) -> tuple[float, float]:
    """Resident and proportional set size of a process and its children, MiB. Raises OSError where it has ended."""
    sizes = [own_memory(one) for one in family(process)]
    return sum(size[0] for size in sizes), sum(size[1] for size in sizes)


def _own_seconds(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))


def own_memory(process: int) -> tuple[float, float]:
    """As `memory`, without children."""
    text = Path(f"/proc/{process}/smaps_rollup").read_text()
    sizes = {
        name: int(size) / 1024.0 for name, size in re.findall(r"^(Rss|Pss):\s+(\d+) kB", text, re.MULTILINE)
    }
    return sizes.get("Rss", 0.0), sizes.get("Pss", 0.0)

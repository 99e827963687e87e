"""Progress of long work, on standard error: a bar on a terminal, elsewhere a line now and then."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

T = TypeVar("T")
LINE_PERIOD = 20.0  # s between two lines in a log file
_silenced = False


class _Lines(Progress):
    """A bar that nobody would see, told as lines: `mapping drive.mcap: 40 %`."""

    _told: float = -1.0

    def update(self, task_id: TaskID, **given: Any) -> None:
        super().update(task_id, **given)
        self._tell(task_id)

    def advance(self, task_id: TaskID, advance: float = 1.0) -> None:
        super().advance(task_id, advance)
        self._tell(task_id)

    def _tell(self, task_id: TaskID) -> None:
        now = time.monotonic()
        # Work that is soon done is not worth a line.
        self._told = now if self._told < 0.0 else self._told
        task = next((task for task in self.tasks if task.id == task_id), None)
        if _silenced or task is None or not task.total or now < self._told + LINE_PERIOD:
            return
        self._told = now
        self.console.print(f"{task.description}: {task.percentage:.0f} %", soft_wrap=True, highlight=False)


def progress_bar() -> Progress:
    """A rich progress bar on standard error that vanishes when done; off a terminal a line every `LINE_PERIOD`."""
    console = Console(stderr=True)
    kind = Progress if console.is_terminal else _Lines
    return kind(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=_silenced or not console.is_terminal,
    )


@contextmanager
def share_bar(description: str) -> Iterator[Callable[[float], None]]:
    """A progress bar for one piece of work, moved by telling it the share that is done, 0 to 1."""
    with progress_bar() as bar:
        task = bar.add_task(description, total=100)
        yield lambda share: bar.update(task, completed=round(100 * share))


def silence() -> None:
    """Show no progress from here on: for processes that share a terminal."""
    global _silenced
    _silenced = True


def track(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """Iterate over `items` with a progress bar; `total` where `items` has no length."""
    with progress_bar() as bar:
        yield from bar.track(items, description=description, total=total)

"""Progress of long work, on standard error, only where somebody is watching."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

T = TypeVar("T")
_silenced = False


def progress_bar() -> Progress:
    """A rich progress bar on standard error that vanishes when done and is silent off a terminal."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=_silenced or not console.is_terminal,
    )


def silence() -> None:
    """Show no progress from here on: for processes that share a terminal."""
    global _silenced
    _silenced = True


def track(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """Iterate over `items` with a progress bar; `total` where `items` has no length."""
    with progress_bar() as bar:
        yield from bar.track(items, description=description, total=total)

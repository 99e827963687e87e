"""Programs that can be interrupted wherever they were started."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


def listen_to_interrupts() -> None:
    """Let SIGINT raise KeyboardInterrupt again: a shell's background job inherits that it is ignored."""
    if (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    ):
        signal.signal(signal.SIGINT, signal.default_int_handler)


def raise_if_interrupt(error: Exception) -> None:
    """Raise the KeyboardInterrupt of which compiled code has made a SystemError, as pybind11 does."""
    if isinstance(error, SystemError) and isinstance(error.__cause__, KeyboardInterrupt):
        raise error.__cause__ from None


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """Let Ctrl-C leave the block as KeyboardInterrupt, also where it comes inside compiled code."""
    try:
        yield
    except SystemError as error:
        raise_if_interrupt(error)
        raise

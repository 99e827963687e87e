"""Programs that can be interrupted wherever they were started."""

from __future__ import annotations

import os
import re
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

AGAIN = 0.002
"""s after which an interrupt that came at a bad moment comes again."""

# Modules that Numba calls for arguments and results, and rclpy for messages. Where these raise, the one ends the
# process, the other says that it could not convert them.
CALLED = re.compile(r"numba\.core\.serialize$|namedtuple_|\w+\.(msg|srv|action)\._")


def listen_to_interrupts() -> None:
    """Let SIGINT raise KeyboardInterrupt, but where compiled code would break.

    A shell's background job inherits that it is ignored.
    """
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) in (
        signal.SIG_IGN,
        signal.default_int_handler,
    ):
        signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if CALLED.match(str(frame.f_globals.get("__name__"))):
            threading.Timer(AGAIN, os.kill, (os.getpid(), number)).start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt


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

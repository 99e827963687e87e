"""Programs that can be interrupted wherever they were started."""

from __future__ import annotations

import signal
import threading


def listen_to_interrupts() -> None:
    """Let SIGINT raise KeyboardInterrupt again: a shell's background job inherits that it is ignored."""
    if (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    ):
        signal.signal(signal.SIGINT, signal.default_int_handler)

"""The console at a port of its own, as a viewer reaches it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn

from whereabouts.console.console_server import Console


@contextmanager
def served(console: Console, port: int = 0) -> Iterator[int]:
    """Serve it on this machine until the block ends; the port. port : 0 takes a free one."""
    config = uvicorn.Config(console.app(), port=port, log_level="error", timeout_graceful_shutdown=1)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        while not server.started:
            thread.join(0.01)
        yield server.servers[0].sockets[0].getsockname()[1]
    finally:
        server.should_exit = True
        thread.join()

"""`whereabouts console`: one page that shows what the suite knows, live or from a store."""

from __future__ import annotations

import secrets
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from whereabouts.cli.common import Namespace, option

if TYPE_CHECKING:
    from whereabouts.console.sources import Source

HERE = ("127.0.0.1", "localhost", "::1")


def console(
    store: Annotated[
        Path | None,
        option(
            "--store",
            "The world model's memory: for questions and the past. Without --live only the store is shown.",
            metavar="world.sqlite",
        ),
    ] = None,
    port: Annotated[int, option("--port", "Port of the page.", min=1, max=65535)] = 8090,
    host: Annotated[
        str, option("--host", "Address to serve at. 0.0.0.0 lets other devices look, with the token only.")
    ] = "127.0.0.1",
    live: Annotated[
        bool | None,
        option("--live/--no-live", "Listen to the running suite.", show_default="yes, without --store"),
    ] = None,
    namespace: Namespace = "",
    token: Annotated[str, option("--token", "What a page needs to act.", show_default="a new one")] = "",
) -> None:
    """Serve a page with map, robot, people, things and a box to ask; until Ctrl-C.

    It needs nothing from the internet. Whoever has the address with the token may save the map and search for things.
    """
    from urllib.parse import quote

    import uvicorn

    from estimation.errors import InputError
    from whereabouts.console.console_server import Console

    token = token or secrets.token_urlsafe(16)
    is_live = store is None if live is None else live
    if not is_live and store is None:
        raise InputError("--no-live needs --store FILE: there is nothing to show")
    with ExitStack() as stack:
        app = Console(_source(stack, store, is_live, namespace), token, host in HERE).app()
        shown = "localhost" if host in HERE else _address(host)
        config = uvicorn.Config(
            app,
            host=host,
            port=port,
            log_level="error",
            ws_max_size=65536,
            # On a robot the processor is scarcer than the network.
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
        require_free(host, port)
        print(
            f"console: open http://{shown}:{port}/#token={quote(token, safe='')}\nconsole: Ctrl-C ends it",
            flush=True,
        )
        uvicorn.Server(config).run()


def _source(stack: ExitStack, store: Path | None, live: bool, namespace: str) -> Source:
    from whereabouts.console.sources import StoreSource

    if not live:
        assert store is not None
        source = StoreSource(store)
        stack.callback(source.close)
        return source
    from whereabouts.nodes.live.console_source import LiveSource
    from whereabouts.nodes.runtime.suite_run import prepare_environment

    prepare_environment()
    return stack.enter_context(LiveSource(namespace, store))


def require_free(host: str, port: int) -> None:
    """Raises InputError where nothing can be served at an address."""
    import socket

    from estimation.errors import InputError

    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise InputError(f"{host}, port {port}: cannot be served: {error.strerror}") from error


def _address(host: str) -> str:
    """A name under which others reach this machine."""
    import socket

    return socket.gethostname() if host in ("0.0.0.0", "::") else host

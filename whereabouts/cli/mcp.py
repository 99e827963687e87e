"""`whereabouts mcp`: the suite's knowledge as tools of the Model Context Protocol."""

from __future__ import annotations

import os
import secrets
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any

from whereabouts.cli.ask import StoreFile
from whereabouts.cli.common import Namespace, option
from whereabouts.cli.console import require_free

if TYPE_CHECKING:
    from whereabouts.agents.knowledge import Knowledge

TOKEN = "WHEREABOUTS_TOKEN"
HOST = "127.0.0.1"


def mcp(
    store: StoreFile = None,
    http: Annotated[
        int | None,
        option(
            "--http",
            f"Streamable HTTP on {HOST}; default: stdio. The token is that of {TOKEN}, or a new one that is said.",
            metavar="PORT",
            min=1,
            max=65535,
        ),
    ] = None,
    allow: Annotated[
        list[str] | None,
        option(
            "--allow",
            "Let find_object, verify_object, forget or relabel act. Can be repeated.",
            metavar="TOOL",
        ),
    ] = None,
    namespace: Namespace = "",
) -> None:
    """Serve what the suite knows to agents: where things are and were, what changed, who was where.

    Answers from a store, or from the running suite. All tools are listed always; those that act say what to start or
    allow unless they are allowed.
    """
    from estimation.errors import InputError

    try:
        import mcp as protocol  # noqa: F401
    except ImportError as error:
        raise InputError("`whereabouts mcp` needs the package mcp: pip install mcp") from error
    from whereabouts.agents.knowledge import Knowledge

    with Knowledge(store, tuple(allow or ()), namespace) as knowledge, suppress(KeyboardInterrupt):
        if http is not None:
            _http(knowledge, http)
            return
        from whereabouts.agents.mcp_server import server_of

        server_of(knowledge).run("stdio")


def _http(knowledge: Knowledge, port: int) -> None:
    import uvicorn

    require_free(HOST, port)
    token = os.environ.get(TOKEN, "")
    if not token:
        token = secrets.token_urlsafe(24)
        print(f"token: {token}", file=sys.stderr)
    print(f"serving http://{HOST}:{port}/mcp", file=sys.stderr, flush=True)
    uvicorn.run(guarded(knowledge, token), host=HOST, port=port, log_level="warning")


def guarded(knowledge: Knowledge, token: str) -> Any:
    """The application of the server, for those who have the token."""
    from whereabouts.agents.mcp_server import server_of

    inner = server_of(knowledge).streamable_http_app(host=HOST)
    expected = f"Bearer {token}".encode()

    async def application(scope: Any, receive: Any, send: Any) -> None:
        given = dict(scope.get("headers") or ()).get(b"authorization", b"")
        if scope["type"] == "http" and not secrets.compare_digest(given, expected):
            body = (
                b'{"error": "send the header Authorization: Bearer TOKEN; the server says it when it starts"}'
            )
            headers = [(b"content-type", b"application/json"), (b"www-authenticate", b"Bearer")]
            await send({"type": "http.response.start", "status": 401, "headers": headers})
            await send({"type": "http.response.body", "body": body})
            return
        await inner(scope, receive, send)

    return application

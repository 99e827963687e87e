"""The console's server: one page, its data as JSON, and a socket that says what is new."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from estimation.errors import WhereaboutsError
from whereabouts.console.sources import ConsoleError, Source

PERIOD = 0.2
"""s between two worlds that a page is sent."""
STALLED = 5.0
"""s after which a page that takes nothing is given up; it connects again by itself."""
LONGEST_QUESTION = 300
ACTIONS = ("find", "cancel", "save_map")
LOCAL_HOSTS = ("127.0.0.1", "localhost", "[::1]", "testserver")
_CSP = "default-src 'self'; style-src 'self' 'unsafe-inline'; script-src 'self' 'unsafe-inline'; img-src 'self' data:"


class Console:
    """Answers the page.

    token : what a page needs to change anything. open_to_all : whether others may look without it. viewers : who look.
    """

    def __init__(self, source: Source, token: str, open_to_all: bool = True) -> None:
        self._source = source
        self._token = token
        self._open = open_to_all
        self._said: tuple[int, str] = (-1, "")
        self.viewers = 0
        self._news: asyncio.Event
        self._page = (files("whereabouts.console") / "page.html").read_text(encoding="utf-8")

    def app(self) -> Starlette:
        """The application for an ASGI server."""
        routes = [
            Route("/", self._show),
            Route("/api/state", self._guarded(self._state)),
            Route("/api/map.png", self._guarded(self._map)),
            Route("/api/ask", self._guarded(self._ask)),
            Route("/api/{action}", self._act, methods=["POST"]),
            WebSocketRoute("/api/live", self._live),
        ]
        middleware = [Middleware(GZipMiddleware, minimum_size=2000)]
        if self._open:
            # Else a page of somebody else's could ask under a name that leads here.
            middleware.append(Middleware(TrustedHostMiddleware, allowed_hosts=list(LOCAL_HOSTS)))
        # Also for an address or a method that there is not.
        errors = {HTTPException: _refused}
        return Starlette(
            routes=routes, middleware=middleware, exception_handlers=errors, lifespan=self._telling
        )

    async def _show(self, request: Request) -> Response:
        return HTMLResponse(self._page, headers={"Content-Security-Policy": _CSP, "X-Frame-Options": "DENY"})

    def _knows(self, connection: HTTPConnection) -> bool:
        given = connection.headers.get("authorization", "").removeprefix("Bearer ")
        given = given or connection.query_params.get("token", "")
        return hmac.compare_digest(given.encode(), self._token.encode())

    def _guarded(self, handler: Callable[[Request], Any]) -> Callable[[Request], Any]:
        """What everybody at this machine may see, and others with the token."""

        async def handle(request: Request) -> Response:
            if not (self._open or self._knows(request)):
                return _refusal("this page needs the address with the token that the console printed", 403)
            return await _answered(handler(request))

        return handle

    async def _state(self, request: Request) -> Response:
        given = request.query_params.get("at")
        if given is None:
            return Response(await run_in_threadpool(self._newest), media_type="application/json")
        try:
            stamp = float(given)
        except ValueError:
            stamp = math.nan
        if not math.isfinite(stamp):
            raise ConsoleError(f"at: {given!r} is no time in seconds since 1970")
        then = await run_in_threadpool(self._source.world_at, stamp)
        return Response(_json(then), media_type="application/json")

    async def _map(self, request: Request) -> Response:
        picture = await run_in_threadpool(self._source.picture)
        if picture is None:
            return _refusal("there is no map yet", 404)
        return Response(picture, media_type="image/png", headers={"Cache-Control": "no-store"})

    async def _ask(self, request: Request) -> Response:
        question = request.query_params.get("q", "").strip()
        if not question or len(question) > LONGEST_QUESTION:
            raise ConsoleError(f"ask a question of up to {LONGEST_QUESTION} letters")
        answer = await run_in_threadpool(self._source.ask, question)
        return Response(_json(answer), media_type="application/json")

    async def _act(self, request: Request) -> Response:
        name = request.path_params["action"]
        if name not in ACTIONS:
            return _refusal(f"{name!r} is nothing that can be done; {', '.join(ACTIONS)} are", 404)
        # Only the header counts here: a form of another page cannot set it.
        if not request.headers.get("authorization") or not self._knows(request):
            return _refusal("to act, open the address with the token that the console printed", 403)
        return await _answered(self._done(name, await request.body()))

    async def _done(self, name: str, body: bytes) -> Response:
        try:
            arguments = json.loads(body or b"{}")
        except ValueError:
            arguments = None
        if not isinstance(arguments, dict):
            raise ConsoleError("the request's body must be a JSON object")
        return JSONResponse({"sentence": await run_in_threadpool(self._source.act, name, arguments)})

    def _newest(self) -> str:
        """The newest world as JSON, made once for all who look."""
        version = self._source.version
        if version != self._said[0]:
            span = self._source.span()
            self._said = version, _json({**self._source.world(), "live": self._source.live, "span": span})
        return self._said[1]

    @asynccontextmanager
    async def _telling(self, _: Starlette) -> AsyncIterator[None]:
        """While the server runs: those who look are woken up when there is something new."""

        async def tell() -> None:
            while True:
                await asyncio.sleep(PERIOD)
                before = self._said[1]
                if self.viewers and await run_in_threadpool(self._newest) is not before:
                    waiting, self._news = self._news, asyncio.Event()
                    waiting.set()

        self._news = asyncio.Event()
        teller = asyncio.ensure_future(tell())
        yield
        teller.cancel()

    async def _live(self, socket: WebSocket) -> None:
        origin = urlsplit(socket.headers.get("origin", "")).netloc
        if (origin and origin != socket.headers.get("host")) or not (self._open or self._knows(socket)):
            await socket.close(code=1008)
            return
        await socket.accept()
        ended = asyncio.ensure_future(_until_closed(socket))
        self.viewers += 1
        try:
            said = await run_in_threadpool(self._newest)
            while not ended.done():
                news = asyncio.ensure_future(self._news.wait())
                await asyncio.wait_for(socket.send_text(said), STALLED)
                await asyncio.wait({ended, news}, return_when=asyncio.FIRST_COMPLETED)
                news.cancel()
                said = self._said[1]
        except (WebSocketDisconnect, TimeoutError, RuntimeError):
            pass
        finally:
            self.viewers -= 1
            ended.cancel()
            with contextlib.suppress(Exception):
                await socket.close()


async def _until_closed(socket: WebSocket) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.receive_text()


async def _answered(answer: Any) -> Response:
    try:
        response: Response = await answer
    except WhereaboutsError as error:
        return _refusal(str(error), 400)
    return response


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return _refusal(f"{request.method} {request.url.path}: {error.detail}", error.status_code)


def _refusal(sentence: str, status: int) -> Response:
    return JSONResponse({"error": sentence}, status_code=status)


def _json(value: Any) -> str:
    """As text. What is not finite becomes null, which takes longer and is rare."""
    try:
        return json.dumps(value, separators=(",", ":"), allow_nan=False)
    except ValueError:
        return json.dumps(_finite(value), separators=(",", ":"))


def _finite(value: Any) -> Any:
    """JSON has no number for what is unknown or without end."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value

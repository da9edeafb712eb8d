"""The page's addresses, all of them for reading.

======================  ==============================================================================
``/``                   the page
``/api/state``          :class:`flora_dashboard.board.View` as JSON
``/api/events``         the same, anew at each change, as server-sent events
``/api/history?from=N`` rows of the run from number N on, :class:`flora_dashboard.history.Row` as lists
``/photographs/SHA256`` a photograph
======================  ==============================================================================
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, MutableMapping
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from flora_dashboard.photographs import NotThere, Photographs

PAGE: Final = Path(__file__).parent / "page"
KINDS: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
SIGN_OF_LIFE_S: Final = 10.0
"""So often something is sent, so that a page, and whatever lies between, sees that the line is alive."""
PIECE_BYTES: Final = 1 << 16
HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]


class Latest:
    """The newest view, for whoever waits for it. Only for the loop that serves the page."""

    def __init__(self) -> None:
        self.view = b"{}"
        self.number = 0
        self.is_over = False
        self.viewers = 0
        self._changed = asyncio.Event()

    def put(self, view: bytes) -> None:
        self.view = view
        self.number += 1
        self._wake()

    def end(self) -> None:
        """Nothing more will come."""
        self.is_over = True
        self._wake()

    def _wake(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()

    async def after(self, number: int, within_s: float) -> bool:
        """Wait for a view that is newer than this one; whether there is one."""
        if self.number == number and not self.is_over:
            try:
                await asyncio.wait_for(self._changed.wait(), within_s)
            except TimeoutError:
                return False
        return self.number != number


class _WithHeaders:
    """Adds :data:`HEADERS` to every answer."""

    def __init__(self, app: Any) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def sending(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [
                    *message.get("headers", []),
                    *((name.lower().encode(), value.encode()) for name, value in HEADERS.items()),
                ]
            await send(message)

        await self._app(scope, receive, sending)


def make_app(latest: Latest, photographs: Photographs, rows_since: Callable[[int], bytes], *, most_viewers: int) -> Any:
    """The page as an ASGI application.

    Args:
        latest: what is shown.
        photographs: those that may be asked for.
        rows_since: rows of the history from a number on, as JSON; called in the loop that serves the page.
        most_viewers: of ``/api/events`` at a time.
    """
    files = {path.name: (path.read_bytes(), KINDS[path.suffix]) for path in PAGE.iterdir() if path.suffix in KINDS}

    async def state(_: Request) -> Response:
        return _json(latest.view)

    async def history(request: Request) -> Response:
        asked = request.query_params.get("from", "0")
        if not asked.isdecimal() or len(asked) > 12:
            return PlainTextResponse("from= must be the number of a row, 0 or more\n", 400)
        return _json(rows_since(int(asked)))

    async def events(_: Request) -> Response:
        if latest.viewers >= most_viewers:
            text = f"{most_viewers} pages are open, no more are kept up to date ([dashboard] viewers)\n"
            return PlainTextResponse(text, 503, headers={"Retry-After": "30"})
        # Counted here, not in the stream: that begins later, and too many might be let in until then.
        latest.viewers += 1
        return _Stream(latest)

    async def photograph(request: Request) -> Response:
        try:
            # Off the loop: a card may take its time.
            data = await run_in_threadpool(photographs.read, request.path_params["sha256"])
        except NotThere as problem:
            return PlainTextResponse(f"{problem}\n", 404)
        headers = {"Cache-Control": "private, max-age=86400, immutable", "Content-Length": str(len(data))}
        return StreamingResponse(_pieces(data), media_type="image/jpeg", headers=headers)

    routes = [
        Route("/api/state", state),
        Route("/api/history", history),
        Route("/api/events", events),
        Route("/photographs/{sha256}", photograph),
        *(Route("/" if name == "index.html" else f"/{name}", _file(*file)) for name, file in files.items()),
    ]
    return _WithHeaders(Starlette(routes=routes))


async def _pieces(data: bytes) -> AsyncIterator[bytes]:
    """A piece when the one before has gone out: what a slow browser has not taken yet is not copied for it."""
    for start in range(0, len(data), PIECE_BYTES):
        yield data[start : start + PIECE_BYTES]
        await asyncio.sleep(0)  # else nobody would notice that the browser has hung up, and each piece be a line of log


def _file(content: bytes, kind: str) -> Callable[[Request], Awaitable[Response]]:
    async def answer(_: Request) -> Response:
        return Response(content, media_type=kind, headers={"Cache-Control": "no-cache"})

    return answer


def _json(content: bytes) -> Response:
    return Response(content, media_type="application/json", headers={"Cache-Control": "no-store"})


class _Stream(StreamingResponse):
    """Each view that is new when the one before has been taken: a slow page misses some, and none are queued for it."""

    def __init__(self, latest: Latest) -> None:
        self._latest = latest
        super().__init__(self._views(), media_type="text/event-stream", headers={"Cache-Control": "no-store"})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._latest.viewers -= 1

    async def _views(self) -> AsyncIterator[bytes]:
        seen = -1
        while not self._latest.is_over:
            if await self._latest.after(seen, SIGN_OF_LIFE_S):
                seen = self._latest.number
                yield b"data: " + self._latest.view + b"\n\n"
            else:
                yield b": alive\n\n"

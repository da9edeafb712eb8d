"""The web server in a thread of its own: the service's loop hands it views and never waits for a browser."""

from __future__ import annotations

import asyncio
import errno
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, Final

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from flora_common.counted import counted
from flora_common.errors import ConfigError
from flora_dashboard.web import Latest

BACKLOG: Final = 64
LOOK_EVERY_S: Final = 0.01
STARTED_WITHIN_LOOKS: Final = 2000
ENDED_WITHIN_S: Final = 5.0
SILENT_CHECKS: Final = 6
"""So often in a row asked in vain, it hangs. Asked, not waited: whoever asks, and the thread with it, may have stood
still, on a machine that slept or is busy."""
REQUEST_WITHIN_S: Final = 20.0
"""Connections that ask for nothing are closed: whoever opens a thousand of them must not shut out those who look."""
_TOO_MANY: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


class ImpatientProtocol(H11Protocol):
    """uvicorn's, which waits for ever for a connection's first request, and for the rest of a later one."""

    _request_due: asyncio.TimerHandle | None = None
    """Runs while a request is waited for; between two of them uvicorn's own, shorter patience counts."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._wait_no_more()

    def _wait(self) -> None:
        request = self.cycle  # None before the first one
        if request is not None and not request.response_complete:
            self._wait_no_more()
        elif self._request_due is None:
            self._request_due = self.loop.call_later(REQUEST_WITHIN_S, self.transport.close)

    def _wait_no_more(self) -> None:
        if self._request_due is not None:
            self._request_due.cancel()
            self._request_due = None


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens.

    Raises:
        ConfigError: there is no such address, or somebody else is there.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as problem:
        raise ConfigError(f"[dashboard] host {host}: no address of this machine ({problem.strerror})") from problem
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError as problem:
        listener.close()
        raise ConfigError(
            f"[dashboard] cannot listen at {host} port {port} ({problem.strerror}); name another host or port"
        ) from problem
    return listener


def url_of(listener: socket.socket) -> str:
    """Where a browser finds it; on this machine, where it listens at every address."""
    host, port = listener.getsockname()[:2]
    shown = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{shown}:{port}/"


class PageServer:
    """Serves the page from a socket.

    Args:
        listener: it listens already.
        make_app: called in the server's own thread; makes the ASGI application.
    """

    def __init__(self, listener: socket.socket, make_app: Callable[[Latest], Any]) -> None:
        self._listener = listener
        self._make_app = make_app
        self._latest: Latest | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._server: uvicorn.Server | None = None
        self._unanswered = 0
        self._refused = 0
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def start(self) -> None:
        """Start, and wait until it serves.

        Raises:
            RuntimeError: it does not.
        """
        self._thread.start()
        for _ in range(STARTED_WITHIN_LOOKS):
            if self._server is not None and self._server.started:
                return
            if not self._thread.is_alive():
                break
            time.sleep(LOOK_EVERY_S)
        raise RuntimeError("the page's server does not start")

    def tell(self, view: bytes) -> None:
        """A new view, for all pages that are open."""
        if self._loop is not None and self._latest is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._latest.put, view)

    def check(self) -> str:
        """Ask for a sign of life; one of the answers to the last times must be there.

        Returns:
            What is wrong for the moment, in a sentence; empty where nothing is.

        Raises:
            RuntimeError: the thread has ended or hangs. Nothing but a new start mends that.
        """
        if not self._thread.is_alive():
            raise RuntimeError("the page's server has ended")
        if self._unanswered >= SILENT_CHECKS:
            raise RuntimeError(f"the page's server has given no sign, asked {SILENT_CHECKS} times")
        if self._loop is not None:
            self._unanswered += 1  # before it is asked: it may answer at once
            if self._unanswered == 1:
                self._loop.call_soon_threadsafe(self._sign)
        refused, self._refused = self._refused, 0
        return f"{counted(refused, 'connection')} refused: too many are open" if refused else ""

    def _sign(self) -> None:
        self._unanswered = 0

    def _failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """asyncio tells of each connection that it has no descriptor for, many times a second."""
        problem = context.get("exception")
        if isinstance(problem, OSError) and problem.errno in _TOO_MANY:
            self._refused += 1
        else:
            loop.default_exception_handler(context)

    def stop(self) -> None:
        """Say goodbye to every page, and end; a second is waited for those that do not listen."""
        if self._server is not None and self._loop is not None and self._latest is not None:
            self._server.should_exit = True
            if self._thread.is_alive():
                self._loop.call_soon_threadsafe(self._latest.end)
        self._thread.join(ENDED_WITHIN_S)
        self._listener.close()

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        latest = Latest()
        config = uvicorn.Config(
            self._make_app(latest),
            loop="asyncio",
            http=ImpatientProtocol,
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            backlog=BACKLOG,
            timeout_graceful_shutdown=1,
        )
        self._latest, self._loop = latest, asyncio.get_running_loop()
        self._loop.set_exception_handler(self._failed)
        self._server = uvicorn.Server(config)
        await self._server.serve(sockets=[self._listener])

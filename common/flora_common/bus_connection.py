"""A participant's connection to the bus: what it needs over TCP, whether the bus lets us in, and the next try.

ZeroMQ says nothing of a connection that does not come about, and after some refusals it does not try again. Measured
with libzmq 4.3.5: a machine that the bus does not know, and one without keys, are refused once and for ever; with a
wrong key of the bus it tries for ever and hears nothing.
"""

from __future__ import annotations

import os
import struct
import time
from typing import Any, Final

import zmq

from flora_common.bus_keys import AUTHORIZED, ClientKeys, is_tcp, protect_client
from flora_common.errors import ConfigError

FAR_RECONNECT_MS: Final = 250
"""Over TCP: whoever is turned away at each try must not keep the bus busy."""

HEARTBEAT_MS: Final = 5000
"""Over TCP: after three of these without an answer the line is dead, and a new one is tried."""

RETRY_S: Final = 2.0
"""Real seconds from a refusal to the next try."""

SILENT_TIMES: Final = 3
"""Broken off without a word so often in a row, it is no bus that was just being stopped."""

NO_BUS_AFTER_S: Final = 2.0
STILL_AFTER_S: Final = 10.0
"""Seconds that whoever looks for the bus waits where nobody listens, and where somebody does who says nothing yet: on a
busy machine the bus may stand still for some seconds."""

_IN_MACHINE: Final = "ipc:///"
_IN_PROCESS: Final = "inproc:"
_EVENT: Final = struct.Struct("=hi")
_REFUSED: Final = zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
_LIFE: Final = zmq.EVENT_CONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_DISCONNECTED
_WATCHED: Final = _REFUSED | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL | _LIFE


def prepare_to_connect(socket: zmq.Socket[bytes], endpoint: str, keys: ClientKeys | None) -> None:
    """What a participant's socket needs for this endpoint; before it connects.

    Args:
        socket: any type.
        endpoint: where the bus is.
        keys: shown over TCP, and nowhere else.
    """
    far = is_tcp(endpoint)
    socket.setsockopt(zmq.RECONNECT_IVL, FAR_RECONNECT_MS if far else 20)
    socket.setsockopt(zmq.RECONNECT_IVL_MAX, 4 * FAR_RECONNECT_MS if far else 500)
    if not far:
        return
    socket.setsockopt(zmq.IPV6, int("[" in endpoint))
    # A network goes away without a word: without this a subscriber would wait for ever on a line that is dead.
    socket.setsockopt(zmq.HEARTBEAT_IVL, HEARTBEAT_MS)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 3 * HEARTBEAT_MS)
    socket.setsockopt(zmq.HEARTBEAT_TTL, 3 * HEARTBEAT_MS)
    if keys is not None:
        protect_client(socket, keys)


def connect(socket: zmq.Socket[bytes], endpoint: str) -> None:
    """Look for the bus from now on, whether it is there or not.

    Raises:
        ConfigError: no bus can be there, such as at a ``tcp://`` without a port.
    """
    try:
        socket.connect(endpoint)
    except zmq.ZMQError as problem:
        raise ConfigError(
            f"{endpoint}: nothing can be looked for there ({zmq.strerror(problem.errno or 0)}); tcp://HOST:PORT or ipc:///FILE"
        ) from problem


def closed_to_us(endpoint: str) -> str:
    """Why this user may not connect to a socket of this machine, in a sentence; empty where it may, or there is none.

    ZeroMQ tries for ever and says nothing, as where nobody listens.
    """
    if not endpoint.startswith(_IN_MACHINE):
        return ""
    path = endpoint.removeprefix("ipc://")
    try:
        os.stat(path)  # noqa: PTH116 - a path of a configuration may be of any form
    except PermissionError:
        pass
    except (OSError, ValueError):
        return ""
    else:
        if os.access(path, os.W_OK):
            return ""
    return f"{endpoint} may not be opened by this user: use sudo, or `sudo usermod -aG flora NAME` once and log in anew"


class _Watched:
    """One socket that connects to one endpoint.

    Attributes:
        endpoint: where it connects to.
        is_met: somebody listens there, whether or not a word was said yet.
        is_up: whether it is connected; ZeroMQ itself keeps what waits for a bus that has gone, and says nothing of it.
        problem: why the bus does not let us in.
    """

    def __init__(self, socket: zmq.Socket[bytes], endpoint: str, *, has_keys: bool) -> None:
        self._socket = socket
        self.endpoint = endpoint
        self._has_keys = has_keys
        self._silences = 0
        self._retry_at_s: float | None = None
        # Within a machine nobody is refused.
        self.monitor: zmq.Socket[Any] = socket.get_monitor_socket(_WATCHED if is_tcp(endpoint) else _LIFE)
        self.is_met = False
        self.is_up = False
        self.problem = ""

    def tend(self, now_s: float) -> None:
        while True:
            try:
                parts = self.monitor.recv_multipart(zmq.DONTWAIT)
            except zmq.Again:
                break
            self._take(_EVENT.unpack(parts[0])[0], now_s)
        if self._retry_at_s is not None and now_s >= self._retry_at_s:
            self._retry_at_s = None
            self._socket.disconnect(self.endpoint)
            self._socket.connect(self.endpoint)

    def close(self) -> None:
        self._socket.disable_monitor()
        self.monitor.close(linger=0)

    def _take(self, event: int, now_s: float) -> None:
        self.is_met = event in (zmq.EVENT_CONNECTED, zmq.EVENT_HANDSHAKE_SUCCEEDED)
        if event == zmq.EVENT_CONNECTED:
            return
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self.problem, self._silences, self.is_up = "", 0, True
        elif event == zmq.EVENT_DISCONNECTED:
            self.is_up = False
        elif event == zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL:
            self._silences += 1
            if self._silences >= SILENT_TIMES:
                self.problem = f"what listens at {self.endpoint} breaks off: {self._why_silent()}"
        else:
            self._retry_at_s, self._silences = now_s + RETRY_S, 0
            is_unknown = event == zmq.EVENT_HANDSHAKE_FAILED_AUTH
            why = f"put its client.pub into {AUTHORIZED}/ there" if is_unknown else self._why_unlike()
            whom = "does not know this machine" if is_unknown else "speaks otherwise"
            self.problem = f"the bus at {self.endpoint} {whom}: {why}"

    def _why_silent(self) -> str:
        # Who wants other keys may have hung up before we read what it wants.
        if self._has_keys:
            return "its key is not that of bus.pub here, or it has none, or it is no flora-bus"
        return "it has keys, and [rig] bus_keys is not set here, or it is no flora-bus"

    def _why_unlike(self) -> str:
        if self._has_keys:
            return "it has no keys, and [rig] bus_keys is set here"
        return "it has keys, and [rig] bus_keys is not set here"


class Handshakes:
    """The connections of one participant to the bus: the life of each, and how those over TCP are received.

    Args:
        connections: sockets that are about to connect, and where to.
        keys: what they show.
    """

    def __init__(self, connections: list[tuple[zmq.Socket[bytes], str]], keys: ClientKeys | None) -> None:
        first = connections[0][1]
        self._has_life = not first.startswith(_IN_PROCESS)
        self._watched = [
            _Watched(socket, endpoint, has_keys=keys is not None)
            for socket, endpoint in connections
            if not endpoint.startswith(_IN_PROCESS)
        ]

    @property
    def is_up(self) -> bool:
        """Whether the first one is connected, by what was read until now; always where bus and we are one process."""
        return not self._has_life or (bool(self._watched) and self._watched[0].is_up)

    @property
    def monitors(self) -> list[zmq.Socket[Any]]:
        """Readable when there is something to :meth:`tend` to; none where bus and we are one process."""
        return [watched.monitor for watched in self._watched]

    @property
    def problem(self) -> str:
        """Why the bus does not let us in, in a sentence; empty where it does, or where nobody is there."""
        return next((watched.problem for watched in self._watched if watched.problem), "")

    @property
    def patience_s(self) -> float:
        """Seconds from the start for which an answer is to be waited for, as things look now."""
        return STILL_AFTER_S if self._is_met and not self.problem else NO_BUS_AFTER_S

    @property
    def hindrance(self) -> str:
        """Why a bus that may be there has not answered, in a sentence; empty where nobody listens."""
        if self.problem:
            return self.problem
        if not self._is_met:
            return next(filter(None, (closed_to_us(watched.endpoint) for watched in self._watched)), "")
        there = self._watched[0].endpoint
        return f"the bus at {there} does not answer: it hangs, or its machine is too busy; look again in a minute"

    @property
    def _is_met(self) -> bool:
        return bool(self._watched) and all(watched.is_met for watched in self._watched)

    def tend(self) -> None:
        """Read what is told, and try again where a refusal was long enough ago; never waits."""
        now_s = time.monotonic()
        for watched in self._watched:
            watched.tend(now_s)

    def close(self) -> None:
        """Look no further; before the sockets are closed. Once more does nothing."""
        while self._watched:
            self._watched.pop().close()

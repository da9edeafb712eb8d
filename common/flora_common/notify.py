"""Telling systemd: ready, alive, in a sentence. The protocol is one datagram (sd_notify(3))."""

from __future__ import annotations

import contextlib
import os
import re
import socket
from collections.abc import Mapping
from typing import Final

NO_TEXT: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
"""Control characters and line separators: each line of the datagram is an order, and none must come from a status."""


def _status(text: str) -> str:
    """The line that tells a status."""
    return f"STATUS={NO_TEXT.sub(' ', text)}"


class Notifier:
    """Sends to the socket that systemd names; does nothing where there is none.

    Attributes:
        watchdog_s: the interval within which systemd wants a sign of life, or None.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ, *, pid: int | None = None) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None
        if self._socket is not None:
            # A manager that does not read must never hold up the service.
            self._socket.setblocking(False)
        meant_for = environment.get("WATCHDOG_PID")
        is_ours = meant_for is None or meant_for == str(pid or os.getpid())
        usec = environment.get("WATCHDOG_USEC", "")
        self.watchdog_s = int(usec) / 1e6 if usec.isdigit() and int(usec) > 0 and is_ours else None

    def _send(self, text: str) -> None:
        if self._socket is None:
            return
        # While the manager restarts nobody listens: the next sign of life gets through, and no service must die of it.
        with contextlib.suppress(OSError):
            self._socket.sendto(text.encode(errors="replace"), self._address)

    def ready(self, status: str) -> None:
        self._send(f"READY=1\n{_status(status)}")

    def status(self, status: str) -> None:
        self._send(_status(status))

    def alive(self) -> None:
        self._send("WATCHDOG=1")

    def stopping(self, status: str) -> None:
        self._send(f"STOPPING=1\n{_status(status)}")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()

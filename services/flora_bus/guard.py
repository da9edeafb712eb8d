"""Who may come in over TCP: the machines whose public keys lie in ``authorized/``, and nobody else.

ZeroMQ does the encryption and asks, once for each connection, whether a key may take part: by a message, which this
answers from the bus's own loop (the protocol is ZAP, rfc.zeromq.org/spec/27). The folder is looked at anew each time,
so that a machine is added without a restart. One that is taken out keeps the connections that it has.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import zmq
from zmq.utils import z85

from flora_common.bus import bound, receive_frames, send_frames
from flora_common.bus_keys import AUTHORIZED, BUS, read_authorized, read_pair
from flora_common.errors import BusUnreachable, ConfigError

ASKED_AT: Final = "inproc://zeromq.zap.01"
"""Where libzmq asks, one place for a context."""

VERSION: Final = b"1.0"
KEY_BYTES: Final = 32
DOMAIN: Final = b"flora-bus"
QUESTION_PARTS: Final = 9
"""Who asks, a blank, version, number of the question, domain, address, identity, mechanism, key."""


@dataclass(slots=True)
class Refused:
    """Connections that were turned away because of their key, and the last of them."""

    count: int = 0
    address: str = ""
    key: str = ""


class Guard:
    """Keeps those away who have no key, or an unknown one.

    Args:
        folder: with ``bus.key`` and ``authorized/``.

    Attributes:
        refused: who was turned away.
        problem: why ``authorized/`` could not be read when it was last looked at; those hold that were there before.

    Raises:
        ConfigError: the keys cannot be used.
        BusUnreachable: there is a guard in this context already.
    """

    def __init__(self, folder: Path, *, context: zmq.Context[Any] | None = None) -> None:
        self._pair = read_pair(folder, BUS)
        self._authorized = folder / AUTHORIZED
        self._admitted = read_authorized(self._authorized)
        self.refused = Refused()
        self.problem = ""
        self.questions = (context or zmq.Context.instance()).socket(zmq.ROUTER)
        bound(self.questions, linger_ms=0)
        try:
            self.questions.bind(ASKED_AT)
        except zmq.ZMQError as problem:
            self.questions.close()
            raise BusUnreachable(
                f"another bus of this process already guards its keys: {problem.strerror}"
            ) from problem

    def protect(self, socket: zmq.Socket[bytes]) -> None:
        """Ask for keys at what the socket binds to from now on; earlier endpoints stay as they are."""
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._pair.secret)
        socket.setsockopt(zmq.ZAP_DOMAIN, DOMAIN)
        # Without this libzmq lets everyone in for whom nobody answers its question.
        socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)

    def answer(self) -> None:
        """Say of each key that is asked about whether it may come in; call when ``questions`` is readable."""
        while True:
            try:
                parts = receive_frames(self.questions)
            except zmq.Again:
                return
            self.read()
            self._answer(parts)

    def read(self) -> None:
        """Who may come in, by what is in ``authorized/`` now; see :attr:`problem`."""
        try:
            self._admitted, self.problem = read_authorized(self._authorized), ""
        except ConfigError as problem:
            self.problem = str(problem)

    def _answer(self, parts: list[bytes]) -> None:
        if len(parts) < 4:
            return  # not from libzmq, and nothing to answer to
        is_admitted = len(parts) == QUESTION_PARTS and parts[7] == b"CURVE" and parts[8] in self._admitted
        if not is_admitted:
            self.refused.count += 1
            self.refused.address = parts[5].decode("utf-8", "replace") if len(parts) > 5 else ""
            has_key = len(parts) == QUESTION_PARTS and len(parts[8]) == KEY_BYTES
            self.refused.key = z85.encode(parts[8]).decode("ascii") if has_key else ""
        code, text = (b"200", b"OK") if is_admitted else (b"400", b"unknown key")
        send_frames(self.questions, [parts[0], b"", VERSION, parts[3], code, text, b"", b""])

    def close(self) -> None:
        self.questions.close()

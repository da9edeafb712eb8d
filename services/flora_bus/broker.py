"""The proxy: what is published goes to all who subscribed; the last value of kept topics waits for late joiners.

Everything is in one thread, so a subscription and the values kept for it cannot cross. The bus looks at the form of a
message, not at its content: receivers check that, each for itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import msgspec
import zmq

from flora_bus.guard import Guard
from flora_common.bus import (
    HELLO_PREFIX,
    BusAddress,
    bound,
    kept_kinds,
    receive_frames,
    send_frames,
)
from flora_common.bus_keys import is_tcp
from flora_common.messages import MAX_PAYLOAD_BYTES
from flora_common.messages.wire import MAX_TOPIC_BYTES, TOPIC_PATTERN

BATCH: Final = 512
"""Messages moved before subscriptions and timers get their turn."""

MAX_KEPT: Final = 4096
MAX_KEPT_BYTES: Final = 4 << 20
"""Last values kept, in number and bytes; more come only from a faulty or hostile publisher. A rig has about twenty."""

MAX_TIME_BYTES: Final = 64
"""Of the frames after the payload, all together: queues are bounded in messages, so that messages must be bounded."""
HANDSHAKE_WITHIN_MS: Final = 10_000
"""Real time after which whoever came over TCP and does not say who it is is hung up on."""
SUBSCRIBE: Final = b"\x01"


class _Source(msgspec.Struct):
    source: str


_SOURCE: Final = msgspec.msgpack.Decoder(_Source)


@dataclass(slots=True)
class BrokerCounters:
    """Messages passed on, and refused by their form."""

    passed: int = 0
    malformed: int = 0


class LastValues:
    """The last message of every kept topic, oldest first. When there is no more room, the oldest goes."""

    def __init__(self) -> None:
        self._kinds = kept_kinds()
        self._kept: dict[tuple[bytes, str], list[bytes]] = {}
        self._bytes = 0  # of payloads; topics are short

    def keep(self, parts: list[bytes]) -> None:
        """Remember a message of the right form if its kind is kept."""
        per_source = self._kinds.get(parts[0].rpartition(b"/")[2])
        if per_source is None:
            return
        source = ""
        if per_source:
            try:
                source = _SOURCE.decode(parts[1]).source
            except (ValueError, RecursionError):
                return  # receivers will count it as bad
        key = (parts[0], source)
        before = self._kept.pop(key, None)
        if before is not None:
            self._bytes -= len(before[1])
        self._kept[key] = parts[:3]
        self._bytes += len(parts[1])
        while len(self._kept) > MAX_KEPT or self._bytes > MAX_KEPT_BYTES:
            self._bytes -= len(self._kept.pop(next(iter(self._kept)))[1])

    def matching(self, prefix: bytes) -> list[list[bytes]]:
        """Kept messages whose topic starts with ``prefix``."""
        return [parts for (topic, _), parts in self._kept.items() if topic.startswith(prefix)]


class Broker:
    """XSUB on one side, XPUB on the other.

    Args:
        address: endpoints to bind: services publish to the first and subscribe at the second.
        guard: asks for keys where they are over TCP; None lets everyone in.

    Raises:
        zmq.ZMQError: an endpoint is taken, or none.
    """

    def __init__(
        self,
        address: BusAddress,
        *,
        guard: Guard | None = None,
        context: zmq.Context[Any] | None = None,
    ) -> None:
        context = context or zmq.Context.instance()
        self.counters = BrokerCounters()
        self._values = LastValues()
        self.incoming = context.socket(zmq.XSUB)
        self.outgoing = context.socket(zmq.XPUB)
        for socket in (self.incoming, self.outgoing):
            bound(socket, linger_ms=0)
        # Repeated subscriptions are told as well: each late joiner gets its last values.
        self.outgoing.setsockopt(zmq.XPUB_VERBOSE, 1)
        self._network: list[tuple[zmq.Socket[bytes], bytes]] = []
        try:
            _bind(self.incoming, address.publish, guard)
            _bind(self.outgoing, address.subscribe, guard)
        except zmq.ZMQError:
            self.close()
            raise
        self.incoming.send(SUBSCRIBE)

    def open_network(self, address: BusAddress, guard: Guard | None) -> None:
        """Bind to further endpoints, for other machines: both, or none.

        Raises:
            zmq.ZMQError: one is taken, or is no address of this machine.
        """
        try:
            for socket, endpoint in ((self.incoming, address.publish), (self.outgoing, address.subscribe)):
                _bind(socket, endpoint, guard)
                self._network.append((socket, bytes(socket.getsockopt(zmq.LAST_ENDPOINT)).rstrip(b"\0")))
        except zmq.ZMQError:
            self.shut_network()
            raise

    def shut_network(self) -> None:
        """Give those endpoints up; libzmq hangs up on all who came by them."""
        while self._network:
            socket, endpoint = self._network.pop()
            socket.unbind(endpoint.decode())

    def pass_on(self) -> None:
        """Move a batch of published messages; call when ``incoming`` is readable."""
        incoming, outgoing, counters, values = self.incoming, self.outgoing, self.counters, self._values
        for _ in range(BATCH):
            try:
                parts = receive_frames(incoming)
            except zmq.Again:
                return
            if not well_formed(parts):
                counters.malformed += 1
                continue
            values.keep(parts)
            counters.passed += 1
            send_frames(outgoing, parts)

    def serve_subscriptions(self) -> None:
        """Answer new subscriptions with what is kept; call when ``outgoing`` is readable."""
        while True:
            try:
                event = self.outgoing.recv(zmq.DONTWAIT)
            except zmq.Again:
                return
            if event[:1] != SUBSCRIBE:
                continue
            prefix = event[1:]
            if prefix.startswith(HELLO_PREFIX):
                self.outgoing.send_multipart([prefix, b"\x80", b"0"])
                continue
            for parts in self._values.matching(prefix):
                self.outgoing.send_multipart(parts)

    def close(self) -> None:
        self.incoming.close()
        self.outgoing.close()


def _bind(socket: zmq.Socket[bytes], endpoint: str, guard: Guard | None) -> None:
    """What a socket is told of keys holds for what it binds to afterwards: endpoints within the machine come first.

    Raises:
        zmq.ZMQError: the endpoint is taken, or is none.
    """
    if is_tcp(endpoint):
        socket.setsockopt(zmq.IPV6, int("[" in endpoint))
        socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_WITHIN_MS)
        if guard is not None:
            guard.protect(socket)
    try:
        socket.bind(endpoint)
    except zmq.ZMQError as problem:
        raise zmq.ZMQError(problem.errno, f"{endpoint}: {zmq.strerror(problem.errno or 0)}") from problem


def well_formed(parts: list[bytes]) -> bool:
    """Three frames or more, a topic of the form ``<rig>/<kind>``, a payload that can be a message, little after it."""
    return (
        len(parts) >= 3
        and sum(map(len, parts[2:])) <= MAX_TIME_BYTES
        and len(parts[0]) <= MAX_TOPIC_BYTES
        and 0 < len(parts[1]) <= MAX_PAYLOAD_BYTES
        and TOPIC_PATTERN.match(parts[0]) is not None
    )

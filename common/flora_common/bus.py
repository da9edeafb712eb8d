"""The bus as a service sees it: publish, subscribe, count what was lost.

Why the sockets are what they are:

- publishing is an XPUB, not a PUB: its incoming subscription tells that the bus is there. Until then messages wait in
  an outbox, so that a restart of the bus costs nothing that was said meanwhile; when the bus is back, the last value
  of every kept topic is said again, because a new bus knows nothing.
- the last subscription is a name of our own, which the bus answers: then all subscriptions before it are in force. No
  sleeps, and the same answer comes after a reconnect.
- high-water marks are set on purpose: a subscriber that stands still costs the bus a bounded number of small messages.
"""

from __future__ import annotations

import os
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeVar, cast

import msgspec
import zmq

from flora_common.bus_connection import Handshakes, connect, prepare_to_connect
from flora_common.bus_keys import ClientKeys, is_tcp
from flora_common.clock import NS, Clock
from flora_common.errors import BadMessage
from flora_common.messages.envelope import CATALOGUE, Message, Period, spec_of
from flora_common.messages.wire import decode, encode, is_known, topic_of

HIGH_WATER_MARK: Final = 1000
"""Messages queued per peer and direction: about 0.5 MB of usual messages, 32 MB of the largest allowed."""

MAX_FRAME_BYTES: Final = 1 << 20
"""A longer frame ends the connection of whoever sends it, before memory is taken for it."""

OUTBOX_LIMIT: Final = 1000
MAX_STREAMS: Final = 4096
"""(rig, topic, source) whose sequence numbers are followed; more come only from a faulty or hostile publisher."""

HELLO_PREFIX: Final = b"~hello/"
COMES_AND_GOES: Final = "flora-lab"
"""Says something now and then, from another machine whose clock is its own; a rig is well without it."""

LATE_FACTOR: Final = 2.5
"""A topic is late when nothing came for this many of its periods."""

M = TypeVar("M", bound=Message)

# Plain integers: looking at an enum member costs as much as the call that it is for.
_DONTWAIT: Final = int(zmq.DONTWAIT)
_SNDMORE: Final = int(zmq.SNDMORE)
_RCVMORE: Final = int(zmq.RCVMORE)


def bound(socket: zmq.Socket[bytes], *, linger_ms: int) -> None:
    """Give a socket of the bus, at either end, the bounds that all of them have; before it binds or connects.

    Args:
        socket: any type.
        linger_ms: how long closing waits for what has not gone out.
    """
    socket.setsockopt(zmq.LINGER, linger_ms)
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.RCVHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.MAXMSGSIZE, MAX_FRAME_BYTES)


def receive_frames(socket: zmq.Socket[bytes]) -> list[bytes]:
    """One message, without waiting; pyzmq's ``recv_multipart`` takes about twice as long.

    Raises:
        zmq.Again: there is none.
    """
    receive, ask = socket.recv, socket.getsockopt
    parts = [receive(_DONTWAIT)]
    while ask(_RCVMORE):
        parts.append(receive())
    return parts


def send_frames(socket: zmq.Socket[bytes], parts: list[bytes]) -> None:
    """One message, without waiting; as ``send_multipart`` without its checks of every part's type.

    Raises:
        zmq.Again: no room. With a socket that drops instead, never.
    """
    send = socket.send
    for part in parts[:-1]:
        send(part, _SNDMORE | _DONTWAIT)
    send(parts[-1], _DONTWAIT)


@dataclass(slots=True)
class Counters:
    """What went through, and what did not."""

    sent: int = 0
    received: int = 0
    gaps: int = 0
    bad: int = 0
    unknown: int = 0
    duplicates: int = 0
    dropped: int = 0


class Arrival(msgspec.Struct, frozen=True):
    """What came over the wire, and what the checks say of it.

    Attributes:
        parts: the frames as they came.
        verdict: ``bad`` does not fit the catalogue, ``unknown`` is of no kind of the catalogue, ``repeated`` was here
            before, by its sequence number.
        rig: first part of the topic; empty where the message could not be read.
        message: the message; None where it could not be read.
        lost: messages lost just before this one.
        reason: what is wrong with a bad or unknown one.
    """

    parts: list[bytes]
    verdict: Literal["good", "bad", "unknown", "repeated"]
    rig: str = ""
    message: Message | None = None
    lost: int = 0
    reason: str = ""


class SequenceCheck:
    """Finds holes and repeats in the sequence numbers of each (rig, topic, source, session)."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, str, str], tuple[str, int]] = {}

    def check(self, rig: str, kind: str, message: Message) -> int:
        """Messages lost just before this one (0 for none), or -1 where this one was here before."""
        key = (rig, kind, message.source)
        session, last = self._last.get(key, ("", 0))
        if message.session == session and message.seq <= last:
            return -1
        if not session and len(self._last) >= MAX_STREAMS:
            del self._last[next(iter(self._last))]  # the one that was first heard longest ago
        self._last[key] = (message.session, message.seq)
        return message.seq - last - 1 if message.session == session else 0


@dataclass(slots=True)
class Heard:
    """The last message of a topic and when it was said, in rig time."""

    message: Message
    mono_ns: int


class Freshness:
    """Whether what was heard is still good, from the period that the catalogue states for its topic."""

    def __init__(self, clock: Clock, *, tick_s: float) -> None:
        self._clock = clock
        self._tick_s = tick_s
        self._heard: dict[str, Heard] = {}

    def hear(self, kind: str, message: Message) -> None:
        # Its own time, not that of its coming: what the bus has kept since yesterday is not news.
        self._heard[kind] = Heard(message, min(message.t_mono_ns, self._clock.mono_ns()))

    def last(self, type_: type[M]) -> M | None:
        """The last message of this type, however old."""
        heard = self._heard.get(spec_of(type_).kind)
        return cast(M, heard.message) if heard else None

    def age_s(self, type_: type[Message]) -> float | None:
        """Rig seconds since the last one was said; None where there was none."""
        heard = self._heard.get(spec_of(type_).kind)
        return (self._clock.mono_ns() - heard.mono_ns) / NS if heard else None

    def fresh(self, type_: type[Message]) -> bool:
        """Said within :data:`LATE_FACTOR` periods. A topic without a period is fresh once heard."""
        age_s = self.age_s(type_)
        limit_s = late_after_s(spec_of(type_).period, self._tick_s)
        return age_s is not None and (limit_s is None or age_s <= limit_s)


def late_after_s(period: Period, tick_s: float) -> float | None:
    """Seconds of silence after which a topic of this period is late; None where silence means nothing."""
    if period == "none":
        return None
    return LATE_FACTOR * (tick_s if period == "tick" else 10.0)


@dataclass(slots=True)
class BusAddress:
    """Where the bus listens: services publish to one endpoint and subscribe at the other.

    Attributes:
        publish: where the bus hears.
        subscribe: where it says.
        keys: what a participant shows at those that are ``tcp://``; None for nothing.
    """

    publish: str
    subscribe: str
    keys: ClientKeys | None = None


@dataclass(slots=True)
class _Outgoing:
    seq: dict[str, int] = field(default_factory=dict)
    kept: dict[str, list[bytes]] = field(default_factory=dict)
    outbox: deque[list[bytes]] = field(default_factory=lambda: deque(maxlen=OUTBOX_LIMIT))


class BusClient:
    """One participant on the bus.

    Args:
        address: the bus's endpoints.
        rig: first part of the topics that it publishes.
        source: its name in the envelope.
        clock: rig time, put on what is sent and moved on by what is heard.

    Raises:
        ConfigError: no bus can be at such an endpoint.
    """

    def __init__(
        self,
        address: BusAddress,
        *,
        rig: str,
        source: str,
        clock: Clock,
        context: zmq.Context[Any] | None = None,
    ) -> None:
        self.rig = rig
        self.source = source
        self.session = os.urandom(4).hex()
        self.counters = Counters()
        self._clock = clock
        self._out = _Outgoing()
        self._sequence = SequenceCheck()
        self._hello = HELLO_PREFIX + self.session.encode()
        self._bus_listens = False
        self._bus_answered = False
        context = context or zmq.Context.instance()
        self.publisher = context.socket(zmq.XPUB)
        self.subscriber = context.socket(zmq.SUB)
        for socket in (self.publisher, self.subscriber):
            bound(socket, linger_ms=500)
        prepare_to_connect(self.publisher, address.publish, address.keys)
        prepare_to_connect(self.subscriber, address.subscribe, address.keys)
        self._handshakes = Handshakes(
            [(self.publisher, address.publish), (self.subscriber, address.subscribe)], address.keys
        )
        # A reconnect keeps the old subscriptions alive on our side: without this the new bus would not be noticed.
        self.publisher.setsockopt(zmq.XPUB_VERBOSE, 1)
        connect(self.publisher, address.publish)
        self._address = address
        self._subscribed: list[bytes] = []

    def subscribe(self, *types: type[Message], rig: str | None = None) -> None:
        """Hear these message types of one rig (its own unless named)."""
        self.subscribe_prefixes(*(topic_of(rig or self.rig, type_).encode() for type_ in types))

    def subscribe_prefixes(self, *prefixes: bytes) -> None:
        """Hear every topic that starts with one of these bytes."""
        self._subscribed += prefixes

    def connect(self) -> None:
        """Open the subscriptions. Our own name comes last: its echo proves that all before it are in force."""
        for prefix in [*self._subscribed, self._hello]:
            self.subscriber.setsockopt(zmq.SUBSCRIBE, prefix)
        connect(self.subscriber, self._address.subscribe)

    @property
    def connected(self) -> bool:
        """The bus is there, takes what we say, and has answered our subscriptions."""
        return self._bus_listens and self._bus_answered and self._handshakes.is_up

    @property
    def is_far(self) -> bool:
        """Whether the bus is reached over TCP, where it may refuse us."""
        return is_tcp(self._address.publish) or is_tcp(self._address.subscribe)

    @property
    def monitors(self) -> list[zmq.Socket[Any]]:
        """Further sockets to call :meth:`handle_publisher` for; none where the bus is within this process."""
        return self._handshakes.monitors

    @property
    def refusal(self) -> str:
        """Why a bus over TCP does not let us in, in a sentence; empty where it does, or where nobody is there."""
        return self._handshakes.problem

    @property
    def patience_s(self) -> float:
        """Seconds from the start for which the bus's answer is to be waited for, as things look now."""
        return self._handshakes.patience_s

    @property
    def hindrance(self) -> str:
        """Why the bus has not answered, or does not let us in, in a sentence; empty where nobody listens."""
        return self.refusal if self.connected else self._handshakes.hindrance

    def publish(self, message: Message) -> None:
        """Fill in the envelope, pack, and only then send: a message that cannot be packed leaves no half behind."""
        spec = spec_of(type(message))
        seq = self._out.seq.get(spec.kind, 0) + 1
        stamped = msgspec.structs.replace(
            message,
            schema=spec.version,
            source=self.source,
            session=self.session,
            seq=seq,
            t_utc_ns=self._clock.utc_ns(),
            t_mono_ns=self._clock.mono_ns(),
        )
        parts = encode(self.rig, stamped)
        decode(parts)  # what others would refuse is a bug here: it must not travel
        self._out.seq[spec.kind] = seq
        if spec.keep:
            self._out.kept[spec.kind] = parts
        self.counters.sent += 1
        if self._bus_listens:
            self._send(parts)
        else:
            if len(self._out.outbox) == OUTBOX_LIMIT:
                self.counters.dropped += 1  # the oldest makes room
            self._out.outbox.append(parts)

    def _send(self, parts: list[bytes]) -> None:
        try:
            send_frames(self.publisher, parts)
        except zmq.Again:
            self.counters.dropped += 1

    def handle_publisher(self) -> None:
        """Take notice of the bus coming, going or refusing us; call when ``publisher`` is readable.

        Where there are ``monitors``, also when one of them is; where the bus is far, now and then too: it tries again
        after a refusal.
        """
        self._handshakes.tend()
        while True:
            try:
                event = self.publisher.recv(zmq.DONTWAIT)
            except zmq.Again:
                return
            self._bus_listens = event[:1] == b"\x01"
            if self._bus_listens:
                waiting = list(self._out.outbox)
                self._out.outbox.clear()
                for parts in [*(p for p in self._out.kept.values() if p not in waiting), *waiting]:
                    self._send(parts)

    def receive(self, limit: int = 256) -> list[tuple[str, Message]]:
        """Up to ``limit`` (rig, message) that have arrived; never waits. Bad and repeated ones are only counted."""
        return [(a.rig, a.message) for a in self.receive_all(limit) if a.verdict == "good" and a.message is not None]

    def receive_all(self, limit: int = 256) -> list[Arrival]:
        """Up to ``limit`` arrivals of any kind, bad and repeated ones too; never waits. All are counted."""
        arrivals: list[Arrival] = []
        for _ in range(limit):
            try:
                parts = receive_frames(self.subscriber)
            except zmq.Again:
                break
            if parts[0].startswith(HELLO_PREFIX):
                # Somebody else's is heard by those who subscribe to everything.
                self._bus_answered = self._bus_answered or parts[0] == self._hello
                continue
            arrivals.append(self._check(parts))
        return arrivals

    def _check(self, parts: list[bytes]) -> Arrival:
        try:
            rig, message = decode(parts)
        except BadMessage as problem:
            if len(parts) >= 3 and not is_known(parts[0]):
                self.counters.unknown += 1
                return Arrival(parts, "unknown", reason=str(problem))
            self.counters.bad += 1
            return Arrival(parts, "bad", reason=str(problem))
        lost = self._sequence.check(rig, spec_of(type(message)).kind, message)
        if lost < 0:
            self.counters.duplicates += 1
            return Arrival(parts, "repeated", rig, message)
        self.counters.gaps += lost
        self.counters.received += 1
        if rig == self.rig and message.source != COMES_AND_GOES:
            self._clock.observe(message.t_mono_ns, message.t_utc_ns)
        return Arrival(parts, "good", rig, message, lost)

    def close(self) -> None:
        """Send what is left, for half a second at most, and close."""
        self._handshakes.close()
        self.publisher.close()
        self.subscriber.close()


def kept_kinds() -> dict[bytes, bool]:
    """Kinds whose last value the bus keeps, and whether it keeps one per source."""
    return {kind.encode(): spec.per_source for kind, spec in CATALOGUE.items() if spec.keep}

"""Recordings by hand: play one to the bus again, and read one back to see whether it is whole."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import msgspec
import zmq

from flora_common.bus import BusAddress, SequenceCheck, bound
from flora_common.bus_connection import Handshakes, connect, prepare_to_connect
from flora_common.clock import NS, unix_seconds
from flora_common.errors import BadMessage, BusUnreachable
from flora_common.files import shown
from flora_common.messages import decode, split_topic
from flora_common.recording_reader import Recorded, RecordingReader
from flora_monitor.stats import matches

POLL_MS: Final = 100
FLUSH_TIMEOUT_MS: Final = 10_000
LONGEST_PAUSE_S: Final = 1800.0
"""Real seconds that are waited for at most between two messages, or hurried after one that is late; what is longer is
passed over."""


@dataclass(slots=True)
class Played:
    """What a replay has done."""

    sent: int = 0
    unreadable: int = 0
    left_out: int = 0
    problem: str = ""


class Player:
    """Says recorded messages again, payload bytes as they were: sequence numbers, sessions and times are the recorded.

    Args:
        address: the bus.
        rig: new first part of the topics; None keeps the recorded one.
        only: glob on ``<rig>/<kind>`` or kind, as recorded.

    Raises:
        BusUnreachable: nobody listens.
    """

    def __init__(self, address: BusAddress, *, rig: str | None = None, only: str = "*") -> None:
        self._rig = rig
        self._only = only
        self._socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.XPUB)
        # A full queue makes the sender wait: nothing of a recording is dropped on the way to the bus.
        self._socket.setsockopt(zmq.XPUB_NODROP, 1)
        bound(self._socket, linger_ms=FLUSH_TIMEOUT_MS)
        prepare_to_connect(self._socket, address.publish, address.keys)
        handshakes = Handshakes([(self._socket, address.publish)], address.keys)
        connect(self._socket, address.publish)
        # In pieces: while this process itself stood still, stopped or on a busy machine, nobody was waited for.
        waited_s = 0.0
        while not (is_there := bool(self._socket.poll(POLL_MS))) and waited_s < handshakes.patience_s:
            waited_s += POLL_MS / 1000
            handshakes.tend()
        hindrance = handshakes.hindrance or f"no bus answers at {address.publish}; is flora-bus running?"
        handshakes.close()
        if not is_there:
            self._socket.close(linger=0)
            raise BusUnreachable(hindrance)

    def play(
        self,
        reader: RecordingReader,
        played: Played,
        *,
        rate: float | None,
        sleep: Callable[[float], None] = time.sleep,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Play to the end; ``played`` is kept up to date, so that it holds after an interruption too.

        Args:
            reader: the recording.
            played: is filled in.
            rate: recorded seconds per second; None for as fast as the bus takes them.
            sleep: waits real seconds.
            now: real, monotonic seconds.
        """
        began_s = now()
        first_ns: int | None = None
        for recorded in reader:
            if not matches(self._only, recorded.topic):
                played.left_out += 1
                continue
            if not recorded.is_readable:
                played.unreadable += 1
                continue
            first_ns = recorded.log_time_ns if first_ns is None else first_ns
            if rate is not None:
                due_s = began_s + (recorded.log_time_ns - first_ns) / NS / rate
                if abs(due_s - now()) > LONGEST_PAUSE_S:  # the wall clock was set: a Pi that has been told the time
                    began_s -= due_s - now()
                elif due_s > now():
                    sleep(due_s - now())
            self._socket.send_multipart(self._frames(recorded))
            played.sent += 1
        played.problem = reader.problem

    def _frames(self, recorded: Recorded) -> list[bytes]:
        topic = recorded.topic
        if self._rig is not None:
            topic = f"{self._rig}/{topic.rpartition('/')[2]}"
        return [topic.encode(), recorded.payload, unix_seconds(recorded.log_time_ns)]

    def close(self) -> None:
        """Closes when all has gone to the bus, or after ten seconds."""
        self._socket.close()


@dataclass(slots=True)
class TopicCheck:
    """One topic of a recording."""

    topic: str
    messages: int = 0
    lost: int = 0
    repeated: int = 0
    bad: int = 0
    first_ns: int = 0
    last_ns: int = 0


@dataclass(slots=True)
class Checked:
    """A recording read back.

    Attributes:
        topics: by name.
        problem: what is wrong with the end of the file; empty where it is whole.
        metadata: what the recording says of itself.
    """

    topics: dict[str, TopicCheck] = field(default_factory=dict)
    problem: str = ""
    metadata: dict[str, str] = field(default_factory=dict)

    @property
    def messages(self) -> int:
        return sum(topic.messages for topic in self.topics.values())

    @property
    def span_s(self) -> float:
        """Seconds from the first message to the last, by their own times."""
        times = [t for topic in self.topics.values() if topic.messages for t in (topic.first_ns, topic.last_ns)]
        return (max(times) - min(times)) / NS if times else 0.0


def check(path: Path) -> Checked:
    """Read a recording from end to end, every payload too.

    Raises:
        BadInput: no such file, or not an MCAP file.
    """
    reader = RecordingReader(path)
    checked = Checked()
    sequence = SequenceCheck()
    for recorded in reader:
        topic = checked.topics.setdefault(recorded.topic, TopicCheck(recorded.topic, first_ns=recorded.log_time_ns))
        topic.messages += 1
        topic.first_ns = min(topic.first_ns, recorded.log_time_ns)
        topic.last_ns = max(topic.last_ns, recorded.log_time_ns)
        if not recorded.is_readable:
            topic.bad += 1
            continue
        try:
            rig, message = decode([recorded.topic.encode(), recorded.payload, b""])
        except BadMessage:
            topic.bad += 1
            continue
        lost = sequence.check(rig, split_topic(recorded.topic.encode())[1], message)
        topic.lost += max(0, lost)
        topic.repeated += lost < 0
    checked.problem = reader.problem
    checked.metadata = reader.metadata
    return checked


def check_lines(checked: Checked) -> Iterator[str]:
    """A table of plain text."""
    yield f"{'topic':<28} {'messages':>9} {'lost':>6} {'repeated':>9} {'bad':>6}"
    for name in sorted(checked.topics):
        topic = checked.topics[name]
        escaped = name.encode("unicode_escape").decode()
        yield f"{escaped:<28} {topic.messages:>9} {topic.lost:>6} {topic.repeated:>9} {topic.bad:>6}"


def to_json(path: Path, checked: Checked) -> str:
    """The whole check as one JSON object."""
    topics = [checked.topics[name] for name in sorted(checked.topics)]
    whole = {
        "file": shown(path),
        "messages": checked.messages,
        "whole": not checked.problem,
        "problem": checked.problem,
    }
    return msgspec.json.encode(whole | {"metadata": checked.metadata, "topics": topics}).decode()

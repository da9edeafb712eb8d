"""What came, how often, how evenly, what is missing: counted per topic, with time handed in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Final

from flora_common.bus import COMES_AND_GOES, LATE_FACTOR, Arrival
from flora_common.clock import NS
from flora_common.errors import BadInput, BadMessage
from flora_common.messages import CATALOGUE, Period, spec_of, split_topic

MAX_STREAMS: Final = 4096
OTHERS: Final = "(others)"
"""Where topics beyond :data:`MAX_STREAMS` are counted together."""


def topic_text(arrival: Arrival) -> str:
    """The topic as text, whatever its bytes are."""
    return arrival.parts[0].decode("utf-8", "backslashreplace")[:200]


def rig_of(arrival: Arrival) -> str:
    """The rig that a topic names, also one whose message cannot be read; empty where it names none."""
    try:
        return split_topic(arrival.parts[0])[0]
    except BadMessage:
        return ""


def checked_pattern(pattern: str) -> str:
    """A glob as it was given.

    Raises:
        BadInput: a ``[`` without its ``]``, which would fit nothing.
    """
    at = pattern.find("[")
    while at >= 0:
        # As in the shell: a `]` right after `[` or `[!` is one of the characters.
        first = at + 2 if pattern[at + 1 : at + 2] == "!" else at + 1
        end = pattern.find("]", first + 1)
        if end < 0:
            raise BadInput(f"pattern {pattern!r}: `[` without `]`; no topic fits it")
        at = pattern.find("[", end + 1)
    return pattern


def matches(pattern: str, topic: str) -> bool:
    """Whether a glob fits ``<rig>/<kind>``, or the kind alone."""
    return fnmatchcase(topic, pattern) or fnmatchcase(topic.rpartition("/")[2], pattern)


@dataclass(slots=True)
class Spread:
    """Mean and standard deviation as they come (Welford 1962)."""

    count: int = 0
    mean: float = 0.0
    _squares: float = 0.0

    def add(self, value: float) -> None:
        self.count += 1
        step = value - self.mean
        self.mean += step / self.count
        self._squares += step * (value - self.mean)

    @property
    def deviation(self) -> float:
        """Standard deviation; 0 for fewer than two values."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else 0.0


@dataclass(slots=True)
class Stream:
    """One topic, or one source of a topic that every service says."""

    topic: str
    source: str
    rig: str = ""
    period: Period = "none"
    count: int = 0
    lost: int = 0
    repeated: int = 0
    bad: int = 0
    first_real_s: float = 0.0
    last_real_s: float = 0.0
    last_mono_ns: int = 0
    session: str = ""
    is_elsewhere: bool = False
    interval: Spread = field(default_factory=Spread)


@dataclass(frozen=True, slots=True)
class Row:
    """A stream at one moment.

    Attributes:
        topic: of the messages.
        source: which service says them.
        count: messages that could be read.
        rate_hz: messages per real second; None for fewer than two.
        period_s: mean interval, in rig time for ticks and real time for health; None for fewer than two.
        jitter_s: its standard deviation.
        lost, repeated: messages by the gaps in their numbers, and by numbers that came before.
        bad: messages that could not be read.
        age_s: since the last one, in the same time; None where nothing readable came.
        late: silent for longer than the catalogue's period allows.
    """

    topic: str
    source: str
    count: int
    rate_hz: float | None
    period_s: float | None
    jitter_s: float | None
    lost: int
    repeated: int
    bad: int
    age_s: float | None
    late: bool


class Board:
    """Counts arrivals.

    Args:
        tick_s: seconds of rig time between ticks.
        health_s: real seconds between health messages.
        is_lock_step: rig time stands still between messages, so silence of all is no lateness of one.
    """

    def __init__(self, *, tick_s: float, health_s: float, is_lock_step: bool) -> None:
        self.messages = 0
        self.lost = 0
        self.bad = 0
        self.repeated = 0
        self._tick_s = tick_s
        self._health_s = health_s
        self._is_lock_step = is_lock_step
        self._streams: dict[tuple[str, str], Stream] = {}
        self._newest: dict[str, tuple[int, float]] = {}

    def hear(self, arrival: Arrival, real_s: float) -> float | None:
        """Count one arrival; returns the seconds since the one before on its topic, None for the first."""
        message = arrival.message
        if message is None:
            self.bad += 1
            self._stream(topic_text(arrival), "").bad += 1
            return None
        spec = spec_of(type(message))
        stream = self._stream(f"{arrival.rig}/{spec.kind}", message.source if spec.per_source else "")
        if arrival.verdict == "repeated":
            self.repeated += 1
            stream.repeated += 1
            return None
        stream.rig, stream.period = arrival.rig, spec.period
        self.messages += 1
        self.lost += arrival.lost
        stream.lost += arrival.lost
        since_s: float | None = None
        # Another session whose time is less: the rig's machine was started anew, and counts from nought.
        is_booted = stream.count > 0 and message.session != stream.session and message.t_mono_ns < stream.last_mono_ns
        stream.session = message.session
        if stream.count == 0:
            stream.first_real_s = real_s
        elif stream.period == "10 s":
            since_s = real_s - stream.last_real_s
        elif not is_booted:
            since_s = (message.t_mono_ns - stream.last_mono_ns) / NS
        if since_s is not None:
            stream.interval.add(since_s)
        stream.count += 1
        stream.last_real_s, stream.last_mono_ns = real_s, message.t_mono_ns
        stream.is_elsewhere = message.source == COMES_AND_GOES
        if not stream.is_elsewhere and (is_booted or message.t_mono_ns >= self._newest.get(arrival.rig, (0, 0.0))[0]):
            self._newest[arrival.rig] = (message.t_mono_ns, real_s)
        return since_s

    def _stream(self, topic: str, source: str) -> Stream:
        key = (topic, source)
        if key not in self._streams and len(self._streams) >= MAX_STREAMS:
            key = (OTHERS, "")
        return self._streams.setdefault(key, Stream(*key))

    def rows(self, real_s: float) -> list[Row]:
        """All streams, by topic and source."""
        return [self._row(self._streams[key], real_s) for key in sorted(self._streams)]

    def _row(self, stream: Stream, real_s: float) -> Row:
        span_s = stream.last_real_s - stream.first_real_s
        has_interval = stream.interval.count > 0
        age_s = self._age_s(stream, real_s) if stream.count else None
        limit_s = {"tick": self._tick_s, "10 s": self._health_s, "none": math.inf}[stream.period] * LATE_FACTOR
        return Row(
            topic=stream.topic,
            source=stream.source,
            count=stream.count,
            rate_hz=(stream.count - 1) / span_s if span_s > 0 else None,
            period_s=stream.interval.mean if has_interval else None,
            jitter_s=stream.interval.deviation if has_interval else None,
            lost=stream.lost,
            repeated=stream.repeated,
            bad=stream.bad,
            age_s=age_s,
            late=age_s is not None and age_s > limit_s,
        )

    def _age_s(self, stream: Stream, real_s: float) -> float:
        """Health comes in real time; all else is measured against the newest rig time that anybody told."""
        if stream.period == "10 s" or stream.is_elsewhere:
            return real_s - stream.last_real_s
        newest_ns, heard_s = self._newest[stream.rig]
        since_newest_s = 0.0 if self._is_lock_step else real_s - heard_s
        return max(0.0, (newest_ns - stream.last_mono_ns) / NS + since_newest_s)


@dataclass(slots=True)
class Topic:
    """One kind of message: the catalogue's line, and on which topics it was heard."""

    kind: str
    owner: str
    every: str
    kept: bool
    heard: list[str]
    messages: int


def topic_lines(rows: Sequence[Row], pattern: str, only_rig: str | None) -> list[Topic]:
    """The catalogue's kinds that fit the pattern, then what was heard that is not in the catalogue."""
    by_kind: dict[str, list[Row]] = {}
    for row in rows:
        by_kind.setdefault(row.topic.rpartition("/")[2], []).append(row)

    def line(kind: str, owner: str, every: str, *, kept: bool) -> Topic:
        heard = by_kind.pop(kind, [])
        return Topic(kind, owner, every, kept, sorted({row.topic for row in heard}), sum(row.count for row in heard))

    known = [
        line(spec.kind, spec.owner, spec.period, kept=spec.keep)
        for spec in CATALOGUE.values()
        if spec.kind in by_kind or matches(pattern, f"{only_rig or '*'}/{spec.kind}")
    ]
    return known + [line(kind, "not in the catalogue", "", kept=False) for kind in sorted(by_kind)]

"""What every message carries, and the table of topics.

Physical numbers are bounded by their type, which is also what keeps NaN and infinity out: msgspec refuses both where a
bound is stated, and accepts them where none is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Final, Literal, TypeVar

import msgspec

from flora_common.shapes import FARTHEST_CM

LONGEST_SENTENCE: Final = 500
"""Characters of a :data:`Sentence`; longer ones are clipped by :func:`as_sentence` before they are sent."""

# Named, so that each is made once: an annotation written out in a message is evaluated anew for each schema, and
# typing may then give back an equal one that somebody made with whole numbers.
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
Milliseconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
Microseconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
Cm = Annotated[float, msgspec.Meta(ge=-FARTHEST_CM, le=FARTHEST_CM)]
Millimetres = Annotated[float, msgspec.Meta(ge=-10_000.0, le=10_000.0)]
MillimetresSd = Annotated[float, msgspec.Meta(ge=0.0, le=10_000.0)]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Ampere = Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]
Gain = Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]
Fitness = Annotated[float, msgspec.Meta(ge=-1000.0, le=1.0)]
Count = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Nanoseconds = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
# `$` alone lets a line feed through at the end in Python; `$(?!\n)` does not, and means the same in JSON Schema.
Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$(?!\n)", max_length=64)]
OptionalName = Annotated[str, msgspec.Meta(pattern=r"^([A-Za-z0-9][A-Za-z0-9._-]*)?$(?!\n)", max_length=64)]
Sentence = Annotated[str, msgspec.Meta(max_length=LONGEST_SENTENCE)]
RelativePath = Annotated[str, msgspec.Meta(max_length=255, pattern=r"^(?!/)(?!.*\.\.)[^\x00-\x1f\x7f]+$(?!\n)")]
Sha256 = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$(?!\n)", max_length=64)]
OptionalSha256 = Annotated[str, msgspec.Meta(pattern=r"^([0-9a-f]{64})?$(?!\n)", max_length=64)]
Session = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{8}$(?!\n)", max_length=8)]
Point = tuple[Cm, Cm]

NO_TICK: Final = 0
"""``tick`` of a message that belongs to no tick; ticks count from 1."""

Period = Literal["tick", "10 s", "none"]
"""How often a topic is expected: once per tick of the beat (rig time), every ten seconds (real time), or when
something happens."""


class Message(msgspec.Struct, kw_only=True, frozen=True):
    """The envelope. Filled in by the bus client on sending; a core only says what it has to say, and the tick."""

    schema: Annotated[int, msgspec.Meta(ge=1, le=1000, description="version of this message type")] = 1
    source: Annotated[Name, msgspec.Meta(description="who sent it, a service's name")] = "nobody"
    session: Annotated[Session, msgspec.Meta(description="drawn anew at each start of the source")] = "00000000"
    seq: Annotated[Count, msgspec.Meta(description="1, 2, 3 … per topic and session; a hole is a lost message")] = 0
    t_utc_ns: Annotated[Nanoseconds, msgspec.Meta(description="wall clock at sending, ns since 1970")] = 0
    t_mono_ns: Annotated[Nanoseconds, msgspec.Meta(description="rig time at sending, ns; never set back")] = 0
    tick: Annotated[Count, msgspec.Meta(description="the beat that it belongs to, from 1; 0 for none")] = NO_TICK


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """One line of the catalogue.

    Attributes:
        kind: last part of the topic ``<rig>/<kind>``.
        type: the message type.
        owner: the service that says it.
        version: written to ``schema``; only ever raised, fields are only ever added.
        period: see :data:`Period`.
        keep: the bus keeps the last one for late joiners.
        per_source: the bus keeps one per ``source``, not one per topic.
    """

    kind: str
    type: type[Message]
    owner: str
    version: int
    period: Period
    keep: bool
    per_source: bool


def as_sentence(text: str) -> str:
    """As much of a text as a :data:`Sentence` holds."""
    return text[:LONGEST_SENTENCE]


CATALOGUE: dict[str, TopicSpec] = {}
"""Kind to its line, in the order of a tick."""

_BY_TYPE: dict[type[Message], TopicSpec] = {}

M = TypeVar("M", bound=Message)


def message(
    kind: str,
    *,
    owner: str,
    period: Period,
    keep: bool = True,
    per_source: bool = False,
    version: int = 1,
) -> Callable[[type[M]], type[M]]:
    """Enter a message type in the catalogue."""

    def enter(type_: type[M]) -> type[M]:
        if kind in CATALOGUE:
            raise ValueError(f"message kind {kind!r} is in the catalogue twice")
        spec = TopicSpec(kind, type_, owner, version, period, keep, per_source)
        CATALOGUE[kind] = spec
        _BY_TYPE[type_] = spec
        return type_

    return enter


def spec_of(type_: type[Message]) -> TopicSpec:
    """The catalogue line of a message type."""
    return _BY_TYPE[type_]

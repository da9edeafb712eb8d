"""Bytes on the wire: ``[topic, one msgpack map, b"<unix seconds, decimal>"]``.

PlotJuggler's ZeroMQ plug-in reads exactly this with no adapter. Pictures never travel here: a path and a hash do.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import msgspec

from flora_common.clock import unix_seconds
from flora_common.errors import BadMessage
from flora_common.messages.envelope import CATALOGUE, Message, TopicSpec, spec_of
from flora_common.suggest import did_you_mean

MAX_PAYLOAD_BYTES: Final = 32 * 1024
"""Largest payload; the largest message of the catalogue is under 2 kB."""

MAX_TOPIC_BYTES: Final = 96

TOPIC_PATTERN: Final = re.compile(rb"^[a-z0-9][a-z0-9_-]{0,31}/[a-z][a-z0-9_]{0,47}\Z")

_ENCODER: Final = msgspec.msgpack.Encoder()
_DECODERS: Final[dict[str, msgspec.msgpack.Decoder[Message]]] = {}


def topic_of(rig: str, type_: type[Message]) -> str:
    """``<rig>/<kind>``."""
    return f"{rig}/{spec_of(type_).kind}"


def split_topic(topic: bytes) -> tuple[str, str]:
    """(rig, kind) of a topic.

    Raises:
        BadMessage: not of the form ``<rig>/<kind>``.
    """
    if len(topic) > MAX_TOPIC_BYTES or not TOPIC_PATTERN.match(topic):
        raise BadMessage(f"topic {topic[:MAX_TOPIC_BYTES]!r} is not of the form <rig>/<kind>")
    rig, _, kind = topic.decode("ascii").partition("/")
    return rig, kind


def encode(rig: str, message: Message) -> list[bytes]:
    """The three frames of a message whose envelope is filled in."""
    topic = topic_of(rig, type(message)).encode()
    return [topic, _ENCODER.encode(message), unix_seconds(message.t_utc_ns)]


def decode(parts: Sequence[bytes]) -> tuple[str, Message]:
    """(rig, message) of the frames as received; further frames are allowed and ignored.

    Raises:
        BadMessage: anything that is not a message of the catalogue within its bounds. ``kind`` unknown included:
            see :func:`is_known` to tell the two apart.
    """
    if len(parts) < 3:
        raise BadMessage(f"{len(parts)} frames instead of three")
    rig, kind = split_topic(parts[0])
    if len(parts[1]) > MAX_PAYLOAD_BYTES:
        raise BadMessage(f"{kind}: payload of {len(parts[1])} bytes, at most {MAX_PAYLOAD_BYTES} are allowed")
    spec = CATALOGUE.get(kind)
    if spec is None:
        raise BadMessage(f"unknown kind `{kind}`{did_you_mean(kind, CATALOGUE)}")
    try:
        return rig, _decoder(spec).decode(parts[1])
    except (ValueError, RecursionError) as problem:
        # ValueError is the common base: DecodeError, ValidationError, and UnicodeDecodeError, which is no MsgspecError.
        raise BadMessage(f"{kind}: {problem}") from problem


def is_known(topic: bytes) -> bool:
    """Whether the catalogue has this topic's kind."""
    return topic.rpartition(b"/")[2].decode("ascii", "replace") in CATALOGUE


def _decoder(spec: TopicSpec) -> msgspec.msgpack.Decoder[Message]:
    decoder = _DECODERS.get(spec.kind)
    if decoder is None:
        decoder = _DECODERS[spec.kind] = msgspec.msgpack.Decoder(spec.type)
    return decoder

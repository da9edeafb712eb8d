"""How a controller file travels to a rig: announced, cut into chunks, asked for again until it has arrived. Pure.

The sender leads. It says the offer, the rig answers which chunks it lacks, the sender says those, and says the offer
again when it has heard nothing for a while. Every message may be lost or come twice, on either side; neither has to
remember anything else, and a sender that dies leaves nothing behind. What is trusted is the signature inside the file,
never who said it.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Final

from flora_common.files import sha256_of_bytes
from flora_common.messages.catalogue import CHUNK_BYTES, ControllerAnswer, ControllerChunk, ControllerOffer
from flora_common.messages.envelope import Message

ASK_EVERY_S: Final = 1.0
ASK_SLOWLY_EVERY_S: Final = 10.0
"""While the rig has it and only time has to pass."""
LONGEST_NAME: Final = 100


def chunks_of(size: int) -> int:
    """How many chunks a file of so many bytes has."""
    return -(-size // CHUNK_BYTES)


def length_of_chunk(number: int, size: int) -> int:
    """Bytes of one chunk, by its number from 0, of a file of so many bytes."""
    return min(CHUNK_BYTES, size - number * CHUNK_BYTES)


def offer_of(data: bytes, *, offer: str, name: str, shadow_ticks: int) -> ControllerOffer:
    """The announcement of a file.

    Args:
        data: the whole file.
        offer: 16 hex digits, drawn anew for each offer.
        name: for people.
        shadow_ticks: in shadow before it steers.
    """
    return ControllerOffer(
        offer=offer,
        name=name[:LONGEST_NAME],
        sha256=sha256_of_bytes(data),
        bytes=len(data),
        chunks=chunks_of(len(data)),
        shadow_ticks=shadow_ticks,
    )


def chunk_of(data: bytes, *, offer: str, number: int) -> ControllerChunk:
    """One piece of a file."""
    piece = data[number * CHUNK_BYTES : (number + 1) * CHUNK_BYTES]
    return ControllerChunk(offer=offer, number=number, data=base64.b64encode(piece).decode())


class Sending:
    """One file on its way: what to say next, and what has become of it.

    Args:
        data: the whole file.
        offer: its announcement.
        wait_steering: it is not done before it steers, or never will.
        now_s: real, monotonic seconds.

    Attributes:
        answer: the rig's last one; None before the first.
        heard_at_s: when that came, or the start.
    """

    def __init__(self, data: bytes, offer: ControllerOffer, *, wait_steering: bool, now_s: float) -> None:
        self._data = data
        self.offer = offer
        self._wait_steering = wait_steering
        self._ask_at_s = now_s
        self._wanted: Sequence[int] = ()
        self.answer: ControllerAnswer | None = None
        self.heard_at_s = now_s

    @property
    def arrived(self) -> int:
        """Chunks that the rig has, by its last answer."""
        if self.answer is None:
            return 0
        return self.offer.chunks - len(self.answer.missing)

    @property
    def done(self) -> bool:
        """Nothing is left to say or to wait for."""
        if self.answer is None or self.answer.stage == "received":
            return False
        return self.answer.stage != "shadowing" or not self._wait_steering

    def hear(self, answer: ControllerAnswer, now_s: float) -> bool:
        """Take notice of an answer; False where it belongs to another offer."""
        if answer.offer != self.offer.offer:
            return False
        self.answer, self.heard_at_s = answer, now_s
        self._wanted = tuple(number for number in answer.missing if number < self.offer.chunks)
        if answer.stage != "received":
            self._ask_at_s = now_s + ASK_SLOWLY_EVERY_S
        return True

    def due(self, now_s: float) -> list[Message]:
        """What is to be said now."""
        if self.done:
            return []
        if self._wanted:
            wanted, self._wanted = self._wanted, ()
            self._ask_at_s = now_s + ASK_EVERY_S
            return [chunk_of(self._data, offer=self.offer.offer, number=number) for number in wanted]
        if now_s < self._ask_at_s:
            return []
        is_there = self.answer is not None and self.answer.stage != "received"
        self._ask_at_s = now_s + (ASK_SLOWLY_EVERY_S if is_there else ASK_EVERY_S)
        return [self.offer]

"""Bytes of an offered file, gathered from chunks in any order, each of them maybe twice or never.

Pure: time is handed in, nothing is read or written. Memory is bounded by what one offer may announce, because a chunk
has the one length that its number implies and is kept once. What comes out are bytes whose SHA-256 is the announced
one, or nothing.

One offer at a time: a later one takes the place of one that is still being gathered. Refusing it instead would let a
sender that died keep everybody else waiting.
"""

from __future__ import annotations

import base64
import binascii
from typing import Final

from flora_common.controller_file import MAX_BYTES
from flora_common.counted import counted
from flora_common.errors import BadController
from flora_common.files import sha256_of_bytes
from flora_common.messages import ControllerChunk, ControllerOffer
from flora_common.offering import chunks_of, length_of_chunk

PATIENCE_S: Final = 60.0
"""Real seconds without a new chunk after which an offer is given up; its sender asks again every second."""


class Assembly:
    """Gathers one offered file.

    Attributes:
        offer: what is being gathered; None while there is nothing.
    """

    def __init__(self) -> None:
        self.offer: ControllerOffer | None = None
        self._chunks: dict[int, bytes] = {}
        self._moved_at_s = 0.0

    @property
    def held_bytes(self) -> int:
        """What the chunks take in memory."""
        return sum(map(len, self._chunks.values()))

    @property
    def missing(self) -> tuple[int, ...]:
        """Numbers of the chunks that are still to come."""
        return () if self.offer is None else tuple(n for n in range(self.offer.chunks) if n not in self._chunks)

    def begin(self, offer: ControllerOffer, now_s: float) -> ControllerOffer | None:
        """Gather this offer; what has arrived of the very same one stays.

        Args:
            offer: as heard.
            now_s: real, monotonic seconds.

        Returns:
            The offer whose place it took, where that is another one.

        Raises:
            BadController: it contradicts itself, what was said before under its number, or the largest size.
        """
        _check(offer)
        before = self.offer
        if before is not None and before.offer == offer.offer:
            if (before.sha256, before.bytes) != (offer.sha256, offer.bytes):
                raise BadController(f"offer {offer.offer} was another file a moment ago; begin a new offer")
            self.offer = offer  # its number of shadow ticks may be another one now
            return None
        self.offer, self._chunks, self._moved_at_s = offer, {}, now_s
        return before

    def add(self, chunk: ControllerChunk, now_s: float) -> bool:
        """Keep a chunk; False where it is none of this offer's, is damaged, or is here already."""
        offer = self.offer
        if offer is None or chunk.offer != offer.offer or chunk.number >= offer.chunks or chunk.number in self._chunks:
            return False
        try:
            data = base64.b64decode(chunk.data, validate=True)
        except (binascii.Error, ValueError):
            return False
        if len(data) != length_of_chunk(chunk.number, offer.bytes):
            return False
        self._chunks[chunk.number] = data
        self._moved_at_s = now_s
        return True

    def take(self) -> bytes:
        """The whole file; nothing is kept of it.

        Raises:
            BadController: chunks are missing, or they are not the file that was announced.
        """
        offer, missing = self.offer, self.missing
        if offer is None or missing:
            raise BadController(f"{len(missing)} chunks have not arrived")
        data = b"".join(self._chunks[number] for number in range(offer.chunks))
        self.drop()
        if sha256_of_bytes(data) != offer.sha256:
            raise BadController("what arrived has another SHA-256 than what was offered; offer it again")
        return data

    def drop(self) -> None:
        """Forget what has arrived."""
        self.offer, self._chunks = None, {}

    def expire(self, now_s: float) -> ControllerOffer | None:
        """Give up an offer of which nothing has come for :data:`PATIENCE_S`; returns it."""
        offer = self.offer
        if offer is None or now_s - self._moved_at_s <= PATIENCE_S:
            return None
        self.drop()
        return offer


def _check(offer: ControllerOffer) -> None:
    if offer.bytes > MAX_BYTES:
        raise BadController(f"{offer.bytes} bytes; a controller file has at most {MAX_BYTES}")
    if offer.chunks != chunks_of(offer.bytes):
        raise BadController(f"{offer.bytes} bytes are {counted(chunks_of(offer.bytes), 'chunk')}, not {offer.chunks}")

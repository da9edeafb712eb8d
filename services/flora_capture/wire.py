"""What service and camera process say to each other: length-prefixed msgpack over the child's stdin and stdout."""

from __future__ import annotations

import struct
from typing import Annotated, Any, BinaryIO, Final, Literal

import msgspec

from flora_common.errors import CameraGone

PREFIX: Final = struct.Struct(">I")
MAX_BYTES: Final = 64 << 20
"""A longer message is a broken child: the largest sensor of a Pi makes JPEGs of about 10 MB."""

Problem = Literal["", "camera_hung", "camera_gone", "bad_picture", "film_ended"]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e8)]
ColourGain = Annotated[float, msgspec.Meta(ge=0.0, le=32.0)]


class CameraSettings(msgspec.Struct, frozen=True):
    """The first message to the child: which camera, and the exposure that it is to hold.

    Attributes:
        backend: module under ``flora_capture.backends``.
        source: device number, device file, video file, run folder, or endpoint of the virtual grow box.
        width_px, height_px: picture size.
        exposure_us, analogue_gain, colour_gains: locked; colour gains are (red, blue).
        jpeg_quality: 1 to 100, for backends that compress.
        wait_s: real seconds to wait for a picture.
    """

    backend: str
    source: str
    width_px: int
    height_px: int
    exposure_us: Positive
    analogue_gain: Positive
    colour_gains: tuple[ColourGain, ColourGain]
    jpeg_quality: int
    wait_s: float


class Request(msgspec.Struct, frozen=True):
    """Take a photograph.

    Attributes:
        number: comes back in the answer.
        index: photographs of this run taken before: what a replayed folder or film counts by.
        name: the file that it will become; the virtual grow box writes it beside the truth.
    """

    number: int
    index: int
    name: str


class Answer(msgspec.Struct, frozen=True):
    """Number 0 says that the camera is open; ``problem`` says what failed, in ``reason``."""

    number: int
    problem: Problem = ""
    reason: str = ""
    jpeg: bytes = b""
    metadata: dict[str, Any] = {}


def pack(message: msgspec.Struct) -> bytes:
    """A message with its length in front."""
    payload = msgspec.msgpack.encode(message)
    return PREFIX.pack(len(payload)) + payload


def read(stream: BinaryIO) -> bytes | None:
    """The next payload of a blocking stream; None where it has ended."""
    head = stream.read(PREFIX.size)
    if len(head) < PREFIX.size:
        return None
    length = PREFIX.unpack(head)[0]
    payload = stream.read(length)
    return payload if len(payload) == length else None


class Assembler:
    """Puts answers together from what arrives in pieces."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._decoder = msgspec.msgpack.Decoder(Answer)

    def add(self, piece: bytes) -> list[Answer]:
        """Answers that are complete now.

        Raises:
            CameraGone: the child sends something that is not an answer.
        """
        self._buffer += piece
        answers = []
        while len(self._buffer) >= PREFIX.size:
            length = PREFIX.unpack_from(self._buffer)[0]
            if length > MAX_BYTES:
                raise CameraGone(f"the camera process announced an answer of {length} bytes")
            end = PREFIX.size + length
            if len(self._buffer) < end:
                break
            try:
                answers.append(self._decoder.decode(bytes(memoryview(self._buffer)[PREFIX.size : end])))
            except (ValueError, RecursionError) as problem:
                raise CameraGone(f"the camera process sent nonsense ({problem})") from problem
            self._buffer = self._buffer[end:]
        return answers

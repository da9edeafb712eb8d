"""Whether a JPEG or PNG is whole, and how large its picture is, without decoding it.

Needs neither numpy nor OpenCV, so that what only passes pictures on stays small.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

from flora_common.errors import BadPicture

MAX_PIXELS: Final = 100_000_000
"""Largest picture that is decoded. A forged header may claim gigapixels, and a Pi has no memory for them."""

MAX_SIDE_PX: Final = 20_000

JPEG_START: Final = b"\xff\xd8\xff"
JPEG_END: Final = b"\xff\xd9"
PNG_START: Final = b"\x89PNG\r\n\x1a\n"


def picture_size(data: bytes, *, where: str) -> tuple[int, int]:
    """(width, height) in px from a JPEG's or PNG's header, after checking that the file is complete.

    Raises:
        BadPicture: another format, cut short, damaged, no pixels, or more than :data:`MAX_PIXELS`.
    """
    if data.startswith(PNG_START):
        width, height = _png_size(data, where)
    elif data.startswith(JPEG_START):
        width, height = _jpeg_size(data, where)
    else:
        raise BadPicture(f"{where}: neither JPEG nor PNG (starts with {data[:4].hex(' ')})")
    if width == 0 or height == 0:
        raise BadPicture(f"{where}: header says {width}x{height} px; no picture")
    if width * height > MAX_PIXELS or max(width, height) > MAX_SIDE_PX:
        limits = f"at most {MAX_PIXELS // 1_000_000} million px and {MAX_SIDE_PX} px a side are read"
        raise BadPicture(f"{where}: header says {width}x{height} px; {limits}")
    return width, height


def _jpeg_size(data: bytes, where: str) -> tuple[int, int]:
    """Walk the marker segments to the frame header (ITU T.81, annex B)."""
    # Some cameras fill their buffer up with zeros after the end marker.
    if not data.rstrip(b"\0").endswith(JPEG_END):
        raise BadPicture(f"{where}: JPEG is cut short ({len(data)} bytes, no end marker)")
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            raise BadPicture(f"{where}: JPEG is damaged (no marker at byte {at})")
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if marker == 0x01 or 0xD0 <= marker <= 0xD8:  # markers without a segment
            at += 2
            continue
        if marker in (0xD9, 0xDA):
            break
        (length,) = struct.unpack_from(">H", data, at + 2)
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            if at + 9 > len(data):
                break
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 2 + max(length, 2)
    raise BadPicture(f"{where}: JPEG is damaged (no frame header before the picture data)")


def _png_size(data: bytes, where: str) -> tuple[int, int]:
    """Walk the chunks, each with its own check sum, to the end (PNG specification, section 5)."""
    at, size = len(PNG_START), (0, 0)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, end = data[at + 4 : at + 8], at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(data[at + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            raise BadPicture(f"{where}: PNG is damaged (check sum of the chunk at byte {at} is wrong)")
        if at == len(PNG_START):
            if kind != b"IHDR" or length != 13:
                raise BadPicture(f"{where}: PNG is damaged (does not begin with its header)")
            size = struct.unpack_from(">II", data, at + 8)
        if kind == b"IEND":
            return size
        at = end
    raise BadPicture(f"{where}: PNG is cut short ({len(data)} bytes, no end chunk)")

"""Whether a JPEG is whole, and how large its picture is, without decoding it.

Some OpenCV versions accept torn files without a word, so this looks at the markers itself (ITU-T T.81, annex B).
"""

from __future__ import annotations

from typing import Final

from flora_common.errors import BadPicture

START: Final = b"\xff\xd8"
END: Final = b"\xff\xd9"
FRAME_MARKERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""SOF0 to SOF15; C4, C8 and CC are Huffman tables, reserved, and arithmetic conditioning."""
MAX_SIDE_PX: Final = 20_000


def picture_size(data: bytes) -> tuple[int, int]:
    """(width, height) in px.

    Raises:
        BadPicture: not a JPEG, cut off, or without a size.
    """
    if not data.startswith(START):
        raise BadPicture("not a JPEG: it does not begin with the marker FFD8")
    if not data.rstrip(b"\0").endswith(END):
        raise BadPicture(f"torn JPEG: {len(data)} bytes without the end marker FFD9")
    at = len(START)
    while at + 9 < len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if marker in FRAME_MARKERS:
            height_px, width_px = int.from_bytes(data[at + 5 : at + 7]), int.from_bytes(data[at + 7 : at + 9])
            if not (1 <= width_px <= MAX_SIDE_PX and 1 <= height_px <= MAX_SIDE_PX):
                raise BadPicture(f"JPEG of {width_px} x {height_px} px")
            return width_px, height_px
        at += 2 + int.from_bytes(data[at + 2 : at + 4])
    raise BadPicture("damaged JPEG: no frame header")

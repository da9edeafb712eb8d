"""Pictures from files or bytes, checked before they are believed.

OpenCV 4, as on Raspberry Pi OS, decodes a JPEG that was cut short and fills the rest with grey, without a word;
OpenCV 5 refuses it. So whether a file is complete is checked here, before the decoder, and both behave alike. One
flipped bit inside a JPEG's picture data is accepted by every decoder: only the SHA-256 of the announcement finds that.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from flora_common import files
from flora_common.arrays import ByteArray, FloatArray
from flora_common.errors import BadPicture
from flora_common.vision.header import JPEG_START, picture_size

Picture = npt.NDArray[np.uint8]
"""Shape (height, width, 3), channels blue, green, red, as OpenCV has them."""

Reduction = Literal[1, 2, 4, 8]
REDUCTIONS: Final[tuple[Reduction, ...]] = (1, 2, 4, 8)

PICTURE_SUFFIXES: Final = (".jpg", ".jpeg", ".png")
MAX_FILE_BYTES: Final = 256 << 20

_DECODE_FLAGS: Final[dict[int, int]] = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


def read_picture(
    path: Path,
    *,
    expected_size: tuple[int, int] | None = None,
    reduction: Reduction = 1,
    sha256: str | None = None,
) -> Picture:
    """Read and decode a picture file; arguments and errors as in :func:`decode_picture`."""
    return decode_picture(
        read_picture_bytes(path), where=str(path), expected_size=expected_size, reduction=reduction, sha256=sha256
    )


def read_picture_bytes(path: Path) -> bytes:
    """The bytes of a picture file.

    Raises:
        BadPicture: missing, not readable, not a regular file (a pipe would block for ever), or too large.
    """
    try:
        # not waiting for a writer: a named pipe in a picture's place must not stop the service
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise BadPicture(f"{path}: not a regular file")
            if status.st_size > MAX_FILE_BYTES:
                raise BadPicture(f"{path}: {status.st_size} bytes; a picture may have {MAX_FILE_BYTES}")
            return file.read()
    except OSError as problem:
        raise BadPicture(f"{path}: cannot be read ({problem.strerror})") from problem


def decode_picture(
    data: bytes,
    *,
    where: str,
    expected_size: tuple[int, int] | None = None,
    reduction: Reduction = 1,
    sha256: str | None = None,
) -> Picture:
    """Decode a JPEG or PNG.

    Args:
        data: the whole file.
        where: its name, for messages.
        expected_size: (width, height) in px of the full picture; another size is refused before decoding.
        reduction: 1, 2, 4 or 8; the picture is decoded at this fraction of its size, which for a JPEG is also faster.
        sha256: 64 hex digits that the bytes must have.

    Returns:
        Shape (height, width, 3), uint8, blue-green-red. An orientation noted in the file is not applied: positions are
        those of the sensor.

    Raises:
        BadPicture: empty, another format, cut short, damaged, of the wrong size, or not what was announced.
    """
    if reduction not in _DECODE_FLAGS:
        raise BadPicture(f"{where}: cannot be reduced {reduction} times; 1, 2, 4 or 8")
    if not data:
        raise BadPicture(f"{where}: is empty (0 bytes)")
    if sha256 is not None and (found := files.sha256_of_bytes(data)) != sha256.lower():
        raise BadPicture(
            f"{where}: SHA-256 is {found[:12]}…, announced was {sha256[:12]}…; not the picture that was taken"
        )
    width, height = picture_size(data, where=where)
    if expected_size is not None and (width, height) != tuple(expected_size):
        raise BadPicture(f"{where}: is {width}x{height} px, expected {expected_size[0]}x{expected_size[1]}")
    is_jpeg = data.startswith(JPEG_START)
    # OpenCV reduces a PNG by picking samples, which breaks thin stems; a JPEG is averaged by its decoder.
    flags = _DECODE_FLAGS[reduction if is_jpeg else 1] | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        decoded = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error as problem:
        raise BadPicture(f"{where}: cannot be decoded ({_first_line(problem)})") from problem
    if decoded is None:
        raise BadPicture(f"{where}: cannot be decoded; the file is damaged")
    picture = checked_array(np.asarray(decoded, dtype=np.uint8), where=where)
    if not is_jpeg:
        picture = reduce_picture(picture, reduction)
    if (picture.shape[1], picture.shape[0]) != reduced_size((width, height), reduction):
        raise BadPicture(f"{where}: header says {width}x{height} px, the picture data something else; it is damaged")
    return picture


def checked_array(picture: ByteArray, *, where: str) -> Picture:
    """The array itself, after a check that it is a colour picture.

    Raises:
        BadPicture: not an array of uint8 with shape (height, width, 3), or without pixels.
    """
    if not isinstance(picture, np.ndarray):
        raise BadPicture(f"{where}: not a picture but {type(picture).__name__}")
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise BadPicture(f"{where}: expected an 8-bit colour picture, got {picture.dtype} of shape {picture.shape}")
    if picture.size == 0:
        raise BadPicture(f"{where}: has no pixels")
    return picture


def reduced_size(size: tuple[int, int], reduction: int) -> tuple[int, int]:
    """(width, height) of a picture decoded at 1/reduction: libjpeg rounds up."""
    return -(-size[0] // reduction), -(-size[1] // reduction)


def full_px(places_px: FloatArray, reduction: int) -> FloatArray:
    """Places in px of a picture at 1/reduction as px of the full one; a pixel's centre is at whole numbers in both."""
    return (places_px + 0.5) * float(reduction) - 0.5


def reduce_picture(picture: Picture, reduction: Reduction) -> Picture:
    """A decoded picture at 1/reduction of its size, by averaging squares: for film frames and PNGs."""
    if reduction == 1:
        return picture
    height, width = picture.shape[:2]
    size = reduced_size((width, height), reduction)
    # Filled up to whole squares, so that each reduced pixel stands for exactly reduction x reduction full ones.
    whole = cv2.copyMakeBorder(
        picture, 0, size[1] * reduction - height, 0, size[0] * reduction - width, cv2.BORDER_REPLICATE
    )
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _first_line(problem: cv2.error) -> str:
    return str(problem).strip().splitlines()[0][:120]

"""Photographs for the page: only what flora-capture announced, and only while it is what was announced."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from flora_common.errors import FloraError
from flora_common.files import sha256_of_bytes
from flora_common.messages import Frame

MOST_BYTES: Final = 50_000_000
REMEMBERED: Final = 4
"""A page that has just been told of one may ask for it when the next is here."""


class NotThere(FloraError):
    """No such photograph, or no longer."""


class Photographs:
    """The last few that were announced. One thread announces, others read.

    Args:
        run: the run folder.
    """

    def __init__(self, run: Path) -> None:
        self._run = run
        # Replaced as a whole, so that no reader sees half a change.
        self._frames: tuple[Frame, ...] = ()

    def announce(self, frame: Frame) -> None:
        others = tuple(one for one in self._frames if one.sha256 != frame.sha256)
        self._frames = (frame, *others)[:REMEMBERED]

    def read(self, sha256: str) -> bytes:
        """The JPEG with this hash.

        Raises:
            NotThere: it was not announced of late, is gone, lies outside of the run folder, or is another file now.
        """
        frame = next((one for one in self._frames if one.sha256 == sha256), None)
        if frame is None:
            raise NotThere("no such photograph was announced of late")
        try:
            path = (self._run / frame.path).resolve(strict=True)
            if not path.is_relative_to(self._run.resolve(strict=True)):
                raise NotThere(f"{frame.path} does not lie in the run folder")
            if path.stat().st_size != frame.bytes or frame.bytes > MOST_BYTES:
                raise NotThere(f"{frame.path} is not the file that was announced")
            data = path.read_bytes()
        except OSError as problem:
            raise NotThere(f"{frame.path}: cannot be read ({problem.strerror})") from problem
        if sha256_of_bytes(data) != sha256:
            raise NotThere(f"{frame.path} is not the file that was announced")
        return data

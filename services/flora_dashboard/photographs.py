"""Photographs for the page: only what flora-capture announced, and only while it is what was announced."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Final

from flora_common.errors import FloraError
from flora_common.files import sha256_of_bytes
from flora_common.messages import Frame

MOST_BYTES: Final = 50_000_000
REMEMBERED: Final = 4
"""A page that has just been told of one may ask for it when the next is here."""


_Stamp = tuple[str, int, int, int]


class NotThere(FloraError):
    """No such photograph, or no longer."""


class Photographs:
    """The last few that were announced. One thread announces, others read.

    Args:
        run: the run folder.
    """

    def __init__(self, run: Path) -> None:
        self._run = run
        self._reading = threading.Lock()
        self._kept: tuple[_Stamp, bytes] | None = None
        # Replaced as a whole, so that no reader sees half a change.
        self._frames: tuple[Frame, ...] = ()

    def announce(self, frame: Frame) -> None:
        others = tuple(one for one in self._frames if one.sha256 != frame.sha256)
        self._frames = (frame, *others)[:REMEMBERED]

    def read(self, sha256: str) -> bytes:
        """The JPEG with this hash; the same object for all who ask for the same one.

        One at a time reads: a picture has megabytes, and a hundred browsers may ask for it at once.

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
            status = path.stat()
            if status.st_size != frame.bytes or frame.bytes > MOST_BYTES:
                raise NotThere(f"{frame.path} is not the file that was announced")
            with self._reading:
                data = self._content(path, (sha256, status.st_ino, status.st_mtime_ns, status.st_ctime_ns))
        except OSError as problem:
            raise NotThere(f"{frame.path}: cannot be read ({problem.strerror})") from problem
        if data is None:
            raise NotThere(f"{frame.path} is not the file that was announced")
        return data

    def _content(self, path: Path, stamp: _Stamp) -> bytes | None:
        """Of a file, where it has the stamp's hash."""
        if self._kept is None or self._kept[0] != stamp:
            data = path.read_bytes()
            if sha256_of_bytes(data) != stamp[0]:
                return None
            self._kept = stamp, data
        return self._kept[1]

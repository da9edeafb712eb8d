"""What a run of ``flora-lab track`` has found so far, beside the track that it will become.

``.track.csv.part`` beside ``track.csv`` holds a first line that says what the work is, then one line per frame: its
reading, and what the method remembers after it. A line is handed to the kernel as soon as its frame is done, so a
process that is killed loses at most the frame that it was at. Who starts the same work again goes on from there, and
comes to the very same track: every number is kept to its last digit. Other work is refused while readings are kept.
They also outlast bad input that shows only later, such as a contact sheet of torn photographs: a command with other
options for its pictures goes on from them.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import importlib.metadata
import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Final, NoReturn

import cv2
import msgspec
import numpy as np

import flora_common.vision
import flora_lab
from flora_common import files
from flora_common.errors import BadInput, DiskFull
from flora_lab.stopped_work import check_same_work
from flora_lab.track.readings import Reading, StoredReading

FORMAT: Final = 2
_REMEDY: Final = "--no-resume drops it, another -o leaves it there"


class PartFile:
    """The progress of one piece of work; held by one process at a time. A context manager.

    Args:
        output: the track that the work will write.
        work: what the work is, as plain values: input, settings. Other software counts as other work.
        indices: the frames of the work, in order.
        fresh: forget what there is.

    Attributes:
        path: of this file.
        readings: those that were found before, in order.
        memory: what the method remembered after the last of them.

    Raises:
        BadInput: another process is at the same output, or readings of other work are kept there.
    """

    def __init__(self, output: Path, work: dict[str, Any], indices: range, *, fresh: bool = False) -> None:
        self.path = output.parent / f".{output.name}.part"
        self.readings: list[Reading] = []
        self.memory: object = None
        self._work = {**work, "software": software_hash()}
        self._first_line = json.dumps({"format": FORMAT, "work": self._work}).encode() + b"\n"
        files.make_folder(output.parent)
        self._file = _hold(self.path)
        try:
            good = 0 if fresh else self._read(indices)
            self._file.seek(good)
            self._file.truncate()
            if good == 0:
                self._write(self._first_line)
        except BaseException:
            self._close()
            raise

    def __enter__(self) -> PartFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self.readings:
            self.remove()
        self._close()

    def add(self, reading: Reading, memory: object) -> None:
        """Keep a reading, which must be the next one."""
        self._write(msgspec.json.encode(StoredReading.of(reading, memory)) + b"\n")
        self.readings.append(reading)

    def _write(self, line: bytes) -> None:
        try:
            self._file.write(line)
            self._file.flush()
        except OSError as problem:
            if problem.errno in (errno.ENOSPC, errno.EDQUOT):
                raise DiskFull(f"{self.path}: no room on the disk; what was found before is kept") from problem
            raise

    def _close(self) -> None:
        with contextlib.suppress(OSError):  # a line that found no room is tried once more; who wrote it has said so
            self._file.close()

    def remove(self) -> None:
        """The work is done, or its readings are of no use."""
        self.path.unlink(missing_ok=True)

    def _read(self, indices: range) -> int:
        """Take in what there is; returns where the good part ends. A torn or strange line ends it."""
        first = self._file.readline()
        if first != self._first_line:
            if self._file.read(1):
                self._refuse(first)
            return 0
        decoder = msgspec.json.Decoder(StoredReading)
        good = self._file.tell()
        for expected, line in zip(indices, self._file, strict=False):
            try:
                stored = decoder.decode(line)
            except (ValueError, RecursionError):
                break
            if stored.index != expected or not line.endswith(b"\n"):
                break
            self.readings.append(stored.reading())
            self.memory = stored.memory
            good += len(line)
        return good

    def _refuse(self, first: bytes) -> NoReturn:
        """Readings are kept, and this is what the line before them says."""
        try:
            then = json.loads(first)["work"]
        except (ValueError, LookupError, TypeError) as problem:
            raise BadInput(f"{self.path}: is damaged; {_REMEDY}") from problem
        check_same_work(
            self.path, then if isinstance(then, dict) else {}, json.loads(self._first_line)["work"], _REMEDY
        )
        raise BadInput(f"{self.path}: is of another format; {_REMEDY}")


def software_hash() -> str:
    """Hash of the software that looks for stems."""
    digest = hashlib.sha256(f"{importlib.metadata.version('flora')} {cv2.__version__} {np.__version__}".encode())
    # the version says too little while the method is being worked on
    for package in (flora_common.vision, flora_lab):
        for source in sorted(Path(next(iter(package.__path__))).rglob("*.py")):
            digest.update(source.read_bytes())
    return digest.hexdigest()


def _hold(path: Path) -> BinaryIO:
    while True:
        file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644), "r+b")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.exists() and path.stat().st_ino == os.fstat(file.fileno()).st_ino:
                return file
        except BlockingIOError:
            file.close()
            raise BadInput(f"{path}: another flora-lab track is at work on this output; name another with -o") from None
        except BaseException:
            file.close()
            raise
        file.close()  # its holder was done and removed it in the meantime

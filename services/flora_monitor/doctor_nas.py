"""Looks at the folder on the NAS, in a process of its own: where its server went dark this hangs in the kernel.

Run as ``python -m flora_monitor.doctor_nas FOLDER MARKER [--touch]``; says one JSON object.
"""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

PROBE_NAME: Final = ".flora-doctor"
"""With a leading dot: nobody takes it for a file of record."""
PROBE_BYTES: Final = 65_536


class Looked(msgspec.Struct, frozen=True):
    """What was found.

    Attributes:
        problem: empty where all is well.
        free_bytes, device: of the file system; the number as ``stat`` gives it.
        is_written: a file was written, read back, compared and removed.
    """

    problem: str = ""
    free_bytes: int = 0
    device: int = 0
    is_written: bool = False


def look(folder: Path, marker: str, *, touch: bool) -> Looked:
    """Folder, marker file, room; with ``touch`` one file there and back. Without the marker nothing is written."""
    try:
        if not folder.is_dir():
            return Looked(f"{folder} is no folder: mount it, or make it")
        if marker and not (folder / marker).exists():
            return Looked(
                f"{folder} has no {marker}, as an empty mount point: mount it, or touch {folder / marker} once"
            )
        if touch:
            _there_and_back(folder / f"{PROBE_NAME}-{os.getpid()}")
        room = os.statvfs(folder)
        return Looked("", room.f_bavail * room.f_frsize, folder.stat().st_dev, touch)
    except OSError as problem:
        return Looked(f"{problem.filename or folder}: {problem.strerror}")


def _there_and_back(path: Path) -> None:
    """Random bytes, so that no answer of before can pass for them.

    Raises:
        OSError: it cannot be done, or other bytes came back.
    """
    sent = secrets.token_bytes(PROBE_BYTES)
    try:
        with path.open("xb") as file:
            file.write(sent)
            file.flush()
            os.fsync(file.fileno())
        with path.open("rb") as file:
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            if file.read() != sent:
                raise OSError(0, "other bytes came back than were sent", str(path))
    finally:
        path.unlink(missing_ok=True)


def main(argv: Sequence[str] | None = None) -> int:
    folder, marker, *further = sys.argv[1:] if argv is None else argv
    print(msgspec.json.encode(look(Path(folder), marker, touch="--touch" in further)).decode())
    return 0


if __name__ == "__main__":
    sys.exit(main())

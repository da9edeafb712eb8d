"""Room kept for the ledger: a file of nothing, given up when the disk is so full that the ledger cannot be opened.

SQLite needs a few pages for its write-ahead log before it says anything at all. Without them an uploader that starts
on a full disk could do nothing, not even delete the stored photographs that fill it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
from pathlib import Path
from typing import Final

RESERVE_BYTES: Final = 1 << 20
ROOM_TO_MAKE: Final = 8
"""It is made when the disk has room for this many: it must not be what fills the disk."""

NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT)


class Reserve:
    """The file, whether it is there or not."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def is_there(self) -> bool:
        """All of it."""
        try:
            return self.path.stat().st_size >= RESERVE_BYTES
        except OSError:
            return False

    def make(self) -> None:
        """Make it where it is missing and there is room. Where that fails there is none, as before."""
        if self.is_there:
            return
        with contextlib.suppress(OSError):
            if _room_bytes(self.path.parent) < ROOM_TO_MAKE * RESERVE_BYTES:
                return
            descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            try:
                os.posix_fallocate(descriptor, 0, RESERVE_BYTES)  # blocks of its own, not only a length
                os.fsync(descriptor)
            except OSError:
                self.path.unlink()
            finally:
                os.close(descriptor)

    def give_up(self, problem: BaseException) -> bool:
        """Delete it where a problem, or what it came from, is a disk without room. Returns whether there is more room.

        SQLite has many words for a full disk (no page, no shared memory, cannot open), so the disk itself is asked too.
        """
        try:
            if not (_is_no_room(problem) or _room_bytes(self.path.parent) < RESERVE_BYTES):
                return False
            self.path.unlink()
        except OSError:
            return False
        return True


def _is_no_room(problem: BaseException | None) -> bool:
    while problem is not None:
        if isinstance(problem, OSError) and problem.errno in NO_ROOM:
            return True
        if isinstance(problem, sqlite3.Error) and getattr(problem, "sqlite_errorcode", 0) == sqlite3.SQLITE_FULL:
            return True
        problem = problem.__cause__
    return False


def _room_bytes(folder: Path) -> int:
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize

"""Making room in the spool, and only there where it can cost nothing.

A photograph is deleted from the spool when all of this holds, checked in this order at the moment of deletion:
the disk is fuller than allowed; the ledger has it as stored; it is a picture in ``frames/``, older than a day; the
spool's file is the very one that was verified (size and time of change); the target's copy is not the same file by
another way; and the target's copy has just been read again, to the last byte, and hashes to what was stored.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Generator
from pathlib import Path
from typing import Final, Literal

from flora_common.files import fsync_folder
from flora_uploader.ledger_model import Entry, mtime_ns
from flora_uploader.policy import is_photograph
from flora_uploader.target import Target
from flora_uploader.transfer import SourceUnreadable, hash_at_target

YOUNGEST_NS: Final = 24 * 3600 * 1_000_000_000
"""Photographs stay at least a day: people and services still look at them."""

FreeResult = Literal["freed", "gone", "changed", "not_at_target", "kept"]


def disk_percent_free(folder: Path) -> float:
    """How much of the disk that a folder is on is free for those who are not root (statvfs).

    Of its room for content or of its places for files, whichever is less: one without places takes no photograph.
    """
    found = os.statvfs(folder)
    room = 100.0 * found.f_bavail / found.f_blocks if found.f_blocks else 100.0
    places = 100.0 * found.f_favail / found.f_files if found.f_files else 100.0  # FAT and btrfs do not count them
    return min(room, places)


def may_be_freed(entry: Entry, now_ns: int) -> bool:
    """What can be said without touching spool or target."""
    return (
        entry.state == "stored"
        and entry.kind == "once"
        and entry.sha256 != ""
        and entry.expected in ("", entry.sha256)
        and is_photograph(entry.path)
        and entry.mtime_ns <= now_ns - YOUNGEST_NS
    )


def free(
    entry: Entry, source: Path, destination: str, target: Target, now_ns: int
) -> Generator[None, None, FreeResult]:
    """Delete one photograph from the spool if everything holds; the target is connected.

    Returns:
        ``freed``; ``gone``: it was not there; ``changed``: the spool's file is another than the verified one;
        ``not_at_target``: the target does not have it, or has something else; ``kept``: a rule above forbids it.

    Raises:
        StoreError: the target could not be asked; nothing was deleted.
    """
    if not may_be_freed(entry, now_ns):
        return "kept"
    if (yield from hash_at_target(target, destination)) != entry.sha256:
        return "not_at_target"
    # From here on there is no giving back of control: nothing can change between the last look and the deletion.
    try:
        status = source.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return "gone"
    except OSError as problem:
        raise SourceUnreadable(f"{source}: the spool cannot be read ({problem.strerror}); check its disk") from problem
    if not stat.S_ISREG(status.st_mode) or (status.st_size, mtime_ns(status)) != (entry.size, entry.mtime_ns):
        return "changed"
    if target.size(destination) != entry.size or target.is_same_file(destination, status):
        return "kept"
    try:
        source.unlink()
        fsync_folder(source.parent)
    except OSError as problem:
        raise SourceUnreadable(f"{source}: cannot be deleted to make room ({problem.strerror})") from problem
    return "freed"

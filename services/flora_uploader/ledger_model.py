"""What the ledger holds: one entry for each file of record, its state, and the tables that keep them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Final, Literal

from flora_uploader.policy import Kind

FileState = Literal["waiting", "stored", "damaged", "freed", "vanished"]
"""
waiting: not verified at the target.    stored: read back there, and the spool has it too.
freed: stored, and deleted from the spool to make room.
damaged: the spool's file is not what the camera wrote, or the target's is not what was stored and the spool has none.
vanished: gone from the spool before it was stored.
"""

VERSION: Final = 1
"""Of the schema, in ``user_version``."""

SCHEMA: Final = """
CREATE TABLE files (
    run TEXT NOT NULL,
    path TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('once', 'table')),
    size INTEGER NOT NULL,
    mtime_ns INTEGER NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('waiting', 'stored', 'damaged', 'freed', 'vanished')),
    expected TEXT NOT NULL DEFAULT '',
    sha256 TEXT NOT NULL DEFAULT '',
    verified_ns INTEGER NOT NULL DEFAULT 0,
    turn INTEGER NOT NULL DEFAULT 0,
    reason TEXT NOT NULL DEFAULT '',
    PRIMARY KEY (run, path)
) WITHOUT ROWID;
CREATE INDEX files_queue ON files (state, kind, mtime_ns);
CREATE INDEX files_check ON files (state, turn);
CREATE TABLE facts (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
"""

COLUMNS: Final = "run, path, kind, size, mtime_ns, state, expected, sha256, verified_ns, turn, reason"
"""Of an :class:`Entry`, in its order."""


LATEST_NS: Final = 2**63 - 1


def mtime_ns(status: os.stat_result) -> int:
    """Time of a file's last change as the ledger can hold it: file systems know years after 2262."""
    return min(status.st_mtime_ns, LATEST_NS)


@dataclass(frozen=True, slots=True)
class Entry:
    """One file of record.

    Attributes:
        run: name of the run folder.
        path: inside the run folder.
        kind: ``once`` or ``table``.
        size: bytes in the spool when last looked at.
        mtime_ns: likewise.
        state: see :data:`FileState`.
        expected: SHA-256 that the camera announced, or empty.
        sha256: SHA-256 of what was last verified at the target, or empty.
        verified_ns: when that was, UTC.
        turn: number of the last look at the target; no clock, because clocks jump.
        reason: of a state that is not as it should be.
    """

    run: str
    path: str
    kind: Kind
    size: int
    mtime_ns: int
    state: FileState = "waiting"
    expected: str = ""
    sha256: str = ""
    verified_ns: int = 0
    turn: int = 0
    reason: str = ""

    @property
    def key(self) -> tuple[str, str]:
        return self.run, self.path

    @property
    def destination(self) -> str:
        """Path at the target."""
        return f"{self.run}/{self.path}"


@dataclass(frozen=True, slots=True)
class Found:
    """A file as the scan found it: path inside its run folder, size, time of the last change."""

    path: str
    kind: Kind
    size: int
    mtime_ns: int

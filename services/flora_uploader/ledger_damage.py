"""What SQLite says of the ledger: trouble that passes, or damage for good; and what becomes of a damaged one."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from flora_common.errors import StoreError
from flora_common.files import damaged_name


class LedgerProblem(StoreError):
    """The ledger cannot be read or written just now."""


class LedgerDamaged(StoreError):
    """The ledger is no database any more, which never heals: it has to be closed, and opened to be replaced."""


def is_damage(problem: sqlite3.Error) -> bool:
    """Whether the file is at fault. Locked, full, not permitted, not readable: it may be good."""
    return isinstance(problem, sqlite3.DatabaseError) and not isinstance(problem, sqlite3.OperationalError)


def damage(path: Path, problem: sqlite3.Error) -> str:
    """What to tell of it."""
    return f"{path}: the ledger is damaged ({problem})"


def put_aside(path: Path, reason: str) -> str:
    """Keep a damaged ledger for people to look at; a new one believes nothing that it has not read at the target.

    Returns:
        What to tell of it.

    Raises:
        LedgerProblem: its folder does not let it.
    """
    aside = damaged_name(path)
    try:
        path.replace(aside)
        for suffix in ("-wal", "-shm"):
            Path(f"{path}{suffix}").unlink(missing_ok=True)
    except OSError as problem:
        raise LedgerProblem(f"{reason}, and cannot be put aside ({problem.strerror})") from problem
    return f"{reason}; kept as {aside.name}, a new ledger was begun"


@contextlib.contextmanager
def told(path: Path) -> Iterator[None]:
    """What SQLite raises, as one of ours.

    Raises:
        LedgerDamaged, LedgerProblem: see there.
    """
    try:
        yield
    except sqlite3.Error as problem:
        if is_damage(problem):
            raise LedgerDamaged(damage(path, problem)) from problem
        raise LedgerProblem(
            f"the ledger cannot be read or written ({problem}); uploading rests until it can"
        ) from problem

"""What has reached the target, in SQLite: durable, small, and only ever a record of what was verified.

The ledger can be lost: files found at the target are believed only after they have been read there, so a new ledger
fills itself again. WAL with ``synchronous=FULL``: what :meth:`Ledger.stored` has returned from survives a power cut.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final

from flora_common.errors import StoreError
from flora_common.files import make_folder
from flora_common.lock import AlreadyHeld, hold
from flora_common.messages.envelope import as_sentence
from flora_uploader.ledger_damage import LedgerDamaged, LedgerProblem, damage, is_damage, put_aside, told
from flora_uploader.ledger_model import COLUMNS, SCHEMA, VERSION, Entry, FileState, Found
from flora_uploader.policy import Kind
from flora_uploader.reserve import Reserve

FILE_NAME: Final = "uploader.sqlite3"
RESERVE_NAME: Final = "uploader.reserve"


class Ledger:
    """The open ledger; one process at a time.

    Args:
        folder: the rig's state folder.
        target: where files go; under another target everything counts as waiting again.
        replaced: see there; of one that was put aside while it was open.

    Attributes:
        replaced: what is to be told of a damaged one that was replaced, or empty.
        reserve: room kept for opening it.
        gave_reserve: the disk was full, and the reserve was given up for opening it.

    Raises:
        StoreError: held by another process, made by a newer version, or not writable.
    """

    def __init__(self, folder: Path, target: str, replaced: str = "") -> None:
        self.path = folder / FILE_NAME
        self.replaced = replaced
        self.reserve = Reserve(folder / RESERVE_NAME)
        self.gave_reserve = False
        make_folder(folder)
        try:
            self._begin(target)
        except LedgerProblem as problem:
            self.gave_reserve = self.reserve.give_up(problem)
            if not self.gave_reserve:
                raise
            self._begin(target)

    def _begin(self, target: str) -> None:
        with contextlib.ExitStack() as undo:
            undo.callback(os.close, _lock(self.path.with_name(f"{FILE_NAME}.lock")))
            self._db = self._open_or_replace()
            undo.callback(self._close_database)
            try:
                self._take_up(target)
            except LedgerDamaged as problem:  # in what the look at opening leaves out
                self._db.close()
                self.replaced = put_aside(self.path, str(problem))
                self._db = self._open_or_replace()
                self._take_up(target)
            self._held = undo.pop_all()

    def _take_up(self, target: str) -> None:
        with told(self.path):
            self.id = self._fact("id", os.urandom(4).hex())
            if self._fact("target", target) != target:
                with self._transaction():
                    self._db.execute("UPDATE files SET state = 'waiting', sha256 = '' WHERE state = 'stored'")
                    self._db.execute("UPDATE facts SET value = ? WHERE name = 'target'", (target,))
            # What was damaged may have been put right by hand: look once more at each start.
            self._db.execute("UPDATE files SET state = 'waiting' WHERE state = 'damaged'")
            self._turn = int(self._db.execute("SELECT coalesce(max(turn), 0) FROM files").fetchone()[0])
            self.counts = Counter(dict(self._db.execute("SELECT state, count(*) FROM files GROUP BY state")))

    def _open_or_replace(self) -> sqlite3.Connection:
        try:
            return self._open()
        except sqlite3.DatabaseError as problem:
            if not is_damage(problem):
                raise LedgerProblem(f"{self.path}: the ledger cannot be opened ({problem})") from problem
            self.replaced = put_aside(self.path, damage(self.path, problem))
        with told(self.path):
            return self._open()

    def _open(self) -> sqlite3.Connection:
        db = sqlite3.connect(self.path, isolation_level=None, timeout=5.0)
        try:
            db.execute("PRAGMA journal_mode = WAL")
            db.execute("PRAGMA synchronous = FULL")
            db.execute("PRAGMA cache_size = -512")
            version = int(db.execute("PRAGMA user_version").fetchone()[0])
            if version > VERSION:
                raise StoreError(
                    f"{self.path}: made by a newer flora-uploader (version {version}, this one knows {VERSION});"
                    f" update this machine, or move the file away: it will be made anew from what is at the target"
                )
            if version == 0:
                db.executescript(f"BEGIN IMMEDIATE; {SCHEMA} PRAGMA user_version = {VERSION}; COMMIT;")
            said = str(db.execute("PRAGMA quick_check(1)").fetchone()[0])
            if said != "ok":
                raise sqlite3.DatabaseError(said)
        except BaseException:
            db.close()
            raise
        return db

    def _fact(self, name: str, first: str) -> str:
        self._db.execute("INSERT OR IGNORE INTO facts VALUES (?, ?)", (name, first))
        return str(self._db.execute("SELECT value FROM facts WHERE name = ?", (name,)).fetchone()[0])

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._db.execute("COMMIT")
        except BaseException:
            if self._db.in_transaction:
                with contextlib.suppress(sqlite3.Error):  # of a damaged one not even that; the first error says why
                    self._db.execute("ROLLBACK")
            raise

    # what the scan and the bus tell

    def see(self, run: str, found: Iterable[Found]) -> list[str]:
        """Take note of files in the spool: new and changed ones wait. Returns their paths."""
        changed: list[tuple[Found, str | None]] = []
        with told(self.path):
            for file in found:
                row = self._db.execute(
                    "SELECT size, mtime_ns, state FROM files WHERE run = ? AND path = ?", (run, file.path)
                ).fetchone()
                if row is None:
                    changed.append((file, None))
                elif (row[0], row[1]) != (file.size, file.mtime_ns) or row[2] in ("vanished", "freed"):
                    changed.append((file, row[2]))
            if changed:
                with self._transaction():
                    self._db.executemany(
                        "INSERT INTO files (run, path, kind, size, mtime_ns, state) VALUES (?, ?, ?, ?, ?, 'waiting')"
                        " ON CONFLICT DO UPDATE SET size = excluded.size, mtime_ns = excluded.mtime_ns,"
                        " state = 'waiting', reason = ''",
                        [(run, f.path, f.kind, f.size, f.mtime_ns) for f, _ in changed],
                    )
        for _, before in changed:
            self._count(before, "waiting")
        return [file.path for file, _ in changed]

    def expect(self, run: str, sha256_of: dict[str, str]) -> None:
        """What the camera wrote, by path. A file that was stored with another content waits to be looked at again."""
        news: list[tuple[str, str, str, str]] = []
        reopened: list[str] = []
        with told(self.path):
            for path, sha256 in sha256_of.items():
                row = self._db.execute(
                    "SELECT expected, sha256, state FROM files WHERE run = ? AND path = ?", (run, path)
                ).fetchone()
                if row is None or row[0] == sha256:
                    continue
                state = row[2]
                if state == "damaged" or (state == "stored" and row[1] != sha256):
                    reopened.append(state)
                    state = "waiting"
                news.append((sha256, state, run, path))
            if news:
                with self._transaction():
                    self._db.executemany("UPDATE files SET expected = ?, state = ? WHERE run = ? AND path = ?", news)
        for before in reopened:
            self._count(before, "waiting")

    # what to do next

    def next_waiting(self, kind: Kind, may: Callable[[Entry], bool]) -> Entry | None:
        """The oldest waiting file of a kind that may be tried now."""
        return self._first("state = 'waiting' AND kind = ? ORDER BY mtime_ns, run, path", (kind,), may)

    def next_to_check(self, may: Callable[[Entry], bool]) -> Entry | None:
        """The file at the target that has not been read for the longest time."""
        return self._first("state IN ('stored', 'freed') ORDER BY turn, run, path", (), may)

    def next_to_free(self, before_ns: int, may: Callable[[Entry], bool]) -> Entry | None:
        """The oldest stored file of the spool that was last changed before a time (UTC)."""
        return self._first(
            "state = 'stored' AND kind = 'once' AND mtime_ns < ? ORDER BY mtime_ns, run, path", (before_ns,), may
        )

    def _first(self, where: str, values: tuple[object, ...], may: Callable[[Entry], bool]) -> Entry | None:
        with told(self.path):
            for row in self._db.execute(f"SELECT {COLUMNS} FROM files WHERE {where}", values):
                entry = Entry(*row)
                if may(entry):
                    return entry
        return None

    def waiting_by_run(self) -> dict[str, int]:
        """How many files wait, by run."""
        with told(self.path):
            return dict(self._db.execute("SELECT run, count(*) FROM files WHERE state = 'waiting' GROUP BY run"))

    def get(self, run: str, path: str) -> Entry | None:
        """One file, or None."""
        return self._first("run = ? AND path = ?", (run, path), lambda _: True)

    # what has happened

    def stored(self, entry: Entry, sha256: str, size: int, mtime_ns: int, now_ns: int) -> bool:
        """Verified at the target; durable when this returns. A spool file that has changed since then waits again.

        Returns:
            False where the camera has meanwhile announced another hash: the file then waits to be looked at again.
        """
        now = self.get(*entry.key)
        if now is not None and now.kind == "once" and now.expected not in ("", sha256):
            return False
        self._write(
            entry,
            "stored",
            "UPDATE files SET state = 'stored', sha256 = ?, size = ?, mtime_ns = ?, verified_ns = ?, turn = ?,"
            " reason = '' WHERE run = ? AND path = ?",
            (sha256, size, mtime_ns, now_ns, self._next_turn(), *entry.key),
        )
        return True

    def checked(self, entry: Entry) -> None:
        """Read at the target, and good."""
        with told(self.path):
            self._db.execute("UPDATE files SET turn = ? WHERE run = ? AND path = ?", (self._next_turn(), *entry.key))

    def mark(self, entry: Entry, state: FileState, reason: str = "") -> None:
        """Another state, and why."""
        self._write(
            entry,
            state,
            "UPDATE files SET state = ?, reason = ? WHERE run = ? AND path = ?",
            (state, as_sentence(reason), *entry.key),
        )

    def mark_run_vanished(self, run: str, reason: str) -> None:
        """All that waits in a run folder that is no longer there."""
        with told(self.path):
            count = self._db.execute(
                "UPDATE files SET state = 'vanished', reason = ? WHERE run = ? AND state = 'waiting'",
                (as_sentence(reason), run),
            ).rowcount
        self.counts["waiting"] -= count
        self.counts["vanished"] += count

    def _next_turn(self) -> int:
        self._turn += 1
        return self._turn

    def forget(self, entry: Entry) -> None:
        """A growing file that nobody has any more."""
        self._write(entry, None, "DELETE FROM files WHERE run = ? AND path = ?", entry.key)

    def _write(self, entry: Entry, state: FileState | None, statement: str, values: tuple[object, ...]) -> None:
        with told(self.path):
            row = self._db.execute("SELECT state FROM files WHERE run = ? AND path = ?", entry.key).fetchone()
            self._db.execute(statement, values)
        if row is not None:
            self._count(row[0], state)

    def _count(self, before: str | None, after: str | None) -> None:
        # Kept by hand: counting a hundred thousand rows after each file would take longer than the file.
        if before is not None:
            self.counts[before] -= 1
        if after is not None:
            self.counts[after] += 1

    def _close_database(self) -> None:
        self._db.close()

    def close(self) -> None:
        """Let go of it; once more does nothing."""
        self._held.close()

    def close_damaged(self, problem: LedgerDamaged) -> str:
        """Put it aside and let go of it, so that the next one that is opened is new whatever a look at it finds.

        Returns:
            What the next one has to tell; empty where it could not be put aside, and the next one looks for itself.
        """
        self._db.close()
        try:
            return put_aside(self.path, str(problem))
        except LedgerProblem:
            return ""
        finally:
            self.close()


def read_only(folder: Path) -> sqlite3.Connection:
    """The ledger for looking at, also while the service runs.

    Raises:
        StoreError: there is none, or it cannot be read.
    """
    path = folder / FILE_NAME
    if not path.exists():
        raise StoreError(f"{path}: no ledger yet; flora-uploader makes it at its first start")
    try:
        db = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5.0)
        db.execute("SELECT run FROM files LIMIT 1").fetchone()
    except sqlite3.Error as problem:
        raise StoreError(f"{path}: the ledger cannot be read ({problem})") from problem
    return db


def _lock(path: Path) -> int:
    """Hold the ledger for this process; returns the lock's descriptor."""
    try:
        return hold(path)
    except OSError as problem:
        raise LedgerProblem(f"{path}: cannot be written ({problem.strerror})") from problem
    except AlreadyHeld as by:
        raise StoreError(
            f"{path.with_suffix('')}: a flora-uploader works with this ledger already (pid {by.pid});"
            " it uploads by itself"
        ) from None

"""The uploader itself: what to do next, what became of it, and how things stand.

Time, chance, disk and target are handed in. :meth:`Uploader.step` does a small piece of work and says when it wants to
be called again; nothing here waits. All durable facts are in the ledger, so that the process may end at any line.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from flora_common.errors import DiskFull, NasDamaged, NasRefused, NasUnreachable, StoreError
from flora_uploader import retention, scan
from flora_uploader.conditions import Conditions
from flora_uploader.ledger import Entry, Ledger, LedgerProblem
from flora_uploader.policy import Backoff, disk_alert, is_of_record, is_photograph
from flora_uploader.target import Target
from flora_uploader.transfer import (
    Order,
    SourceDamaged,
    SourceGone,
    SpoolIsTarget,
    hash_at_target,
    is_temporary_name,
    transfer,
)

SLICE_S: Final = 0.03
"""A step ends when it has worked this long; the smallest piece of work is a megabyte, or one flush."""

SCAN_ALL_EVERY_S: Final = 3600.0
TELL_WAITING_EVERY_S: Final = 600.0
DISK_EVERY_S: Final = 10.0
LONGEST_IDLE_S: Final = 60.0
MOST_WAITING_FILES: Final = 10_000
"""Files with a waiting time of their own that are remembered; beyond that the oldest are simply tried again."""

TARGET_PROBLEMS: Final = (NasUnreachable, NasRefused, DiskFull, LedgerProblem, SpoolIsTarget)
"""Problems of the whole target (or ledger): all rests for a while. Others are one file's own, and the next is tried."""

Work = Generator[None, None, None]
Stage = Literal["waiting", "stored", "refused"]


@dataclass(frozen=True, slots=True)
class Event:
    """Something to tell: a file stored or refused, or that all waits."""

    stage: Stage
    run: str = ""
    path: str = ""
    sha256: str = ""
    bytes: int = 0
    destination: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Settings:
    """Behaviour; see ``[uploader]``."""

    table_every_s: float = 600.0
    scan_every_s: float = 30.0
    keep_percent_free: float = 10.0
    recheck_per_hour: float = 120.0


@dataclass(frozen=True, slots=True)
class World:
    """What is handed in.

    Attributes:
        now_s: real, monotonic seconds.
        utc_ns: wall clock.
        percent_free: of the spool's disk.
        uniform: chance, for the jitter.
        say: where events go.
    """

    now_s: Callable[[], float]
    utc_ns: Callable[[], int]
    percent_free: Callable[[], float]
    say: Callable[[Event], None]
    uniform: Callable[[float, float], float] = random.uniform


@dataclass(slots=True)
class _Own:
    """A file's own waiting time after a failure of its own."""

    backoff: Backoff
    until_s: float = 0.0


@dataclass(slots=True)
class Totals:
    """What this process did."""

    files: int = 0
    bytes: int = 0
    found_there: int = 0
    freed: int = 0
    rechecked: int = 0
    found_damaged: int = 0
    last_problem: str = field(default="")


class Uploader:
    """Moves every file of record from the spool to the target.

    Args:
        runs_dir: folder with run folders.
        run_dir: the rig's present run folder.
        target: where files go.
        ledger: what has been verified.
        settings: behaviour.
        world: clocks, chance, disk.
    """

    def __init__(
        self, runs_dir: Path, run_dir: Path, target: Target, ledger: Ledger, settings: Settings, world: World
    ) -> None:
        self._runs_dir = runs_dir
        self._run_dir = run_dir
        self._target = target
        self._ledger = ledger
        self._settings = settings
        self._world = world
        self.conditions = Conditions()
        self.totals = Totals()
        self._runs: dict[str, Path] = {}
        self._logs_seen: dict[str, tuple[int, int]] = {}
        self._job: Work | None = None
        self._backoff = Backoff(world.uniform)
        self._paused_until_s = 0.0
        self._scan_at_s = 0.0
        self._scan_all_at_s = 0.0
        self._disk_at_s = 0.0
        self._recheck_at_s = 0.0
        self._told_waiting_at_s: float | None = None
        self._clean_due = True
        self._closing = False
        self._may_free = True
        self._own: dict[tuple[str, str], _Own] = {}
        self._table_sent_s: dict[tuple[str, str], float] = {}
        if ledger.replaced:
            self.conditions.set("ledger_replaced", ledger.replaced, serious=False)

    # what others tell

    def hear(self, run: str, path: str, sha256: str) -> None:
        """A photograph was announced: it goes at once.

        Raises:
            StoreError: the ledger cannot be written; the next scan finds the file.
        """
        folder = self._runs.get(run)
        if folder is None:
            folder = self._run_dir.resolve()
            if run not in (folder.name, self._run_dir.name) or not scan.is_run_folder(folder):
                return
            self._runs[folder.name] = folder
        found = scan.look_at(folder, path)
        if found is None or not all(is_of_record(part) for part in Path(path).parts):
            return
        self._ledger.see(folder.name, [found])
        if is_photograph(path):
            self._ledger.expect(folder.name, {path: sha256})

    # the work

    @property
    def waiting(self) -> int:
        """Files of record that are not verified at the target."""
        return self._ledger.counts["waiting"] + self._ledger.counts["damaged"]

    @property
    def stored(self) -> int:
        """Files verified at the target."""
        return self._ledger.counts["stored"] + self._ledger.counts["freed"]

    def step(self) -> float:
        """Work for about :data:`SLICE_S`; returns the seconds until the next call is wanted, 0 where there is more."""
        began_s = self._world.now_s()
        while True:
            if self._job is None:
                self._look_at_disk(began_s)
                try:
                    self._job = self._next_job(began_s)
                except LedgerProblem as problem:
                    self._pause(problem)
            if self._job is None:
                return self._idle_s(began_s)
            try:
                next(self._job)
            except StopIteration:
                self._job = None
            except LedgerProblem as problem:
                self._job = None
                self._pause(problem)
            if self._world.now_s() - began_s >= SLICE_S:
                return 0.0

    def abandon(self) -> None:
        """Drop what is being done; its temporary file is removed."""
        if self._job is not None:
            self._job.close()
            self._job = None
        self._target.disconnect()

    def begin_closing(self) -> None:
        """The service ends: look once more, send the growing tables first, then what is left. ``step`` until idle."""
        self.abandon()
        self._closing = True
        self._scan_at_s = self._world.now_s()

    @property
    def is_idle(self) -> bool:
        """Nothing is being done and nothing can be done now."""
        now_s = self._world.now_s()
        return self._job is None and self._next_job(now_s, peek=True) is None

    def _next_job(self, now_s: float, *, peek: bool = False) -> Work | None:
        if now_s >= self._scan_at_s:
            return self._scan(everything=now_s >= self._scan_all_at_s)
        if now_s < self._paused_until_s:
            return None
        if self._clean_due:
            return self._clean()
        entry = self._next_upload(now_s)
        if entry is not None:
            return self._upload(entry)
        if not peek and "target" in self.conditions:
            self._works()  # it answers, and nothing is left that it could refuse
        if self._closing:
            return None
        wanted_room = self._settings.keep_percent_free
        if self._may_free and wanted_room > 0 and self._world.percent_free() < wanted_room:
            now_ns = self._world.utc_ns()
            oldest = self._ledger.next_to_free(
                now_ns - retention.YOUNGEST_NS,
                lambda e: e.run in self._runs and retention.may_be_freed(e, now_ns) and self._may_try(e.key, now_s),
            )
            if oldest is not None:
                return self._free(oldest)
        if self._settings.recheck_per_hour > 0 and now_s >= self._recheck_at_s:
            checked = self._ledger.next_to_check(lambda e: self._may_try(e.key, now_s))
            if checked is not None:
                return self._recheck(checked)
        return None

    def _next_upload(self, now_s: float) -> Entry | None:
        def may(entry: Entry) -> bool:
            return entry.run in self._runs and self._may_try(entry.key, now_s)

        def is_due(entry: Entry) -> bool:
            sent_s = self._table_sent_s.get(entry.key)
            return may(entry) and (self._closing or sent_s is None or now_s >= sent_s + self._settings.table_every_s)

        pictures = lambda: self._ledger.next_waiting("once", may)  # noqa: E731 - two orders of two looks
        tables = lambda: self._ledger.next_waiting("table", is_due)  # noqa: E731
        return (tables() or pictures()) if self._closing else (pictures() or tables())

    def _idle_s(self, now_s: float) -> float:
        wake_s = [self._scan_at_s, self._disk_at_s, now_s + LONGEST_IDLE_S]
        if now_s < self._paused_until_s:
            wake_s.append(self._paused_until_s)
        else:
            wake_s += [own.until_s for own in self._own.values() if own.until_s > now_s]
            if self._settings.recheck_per_hour > 0 and self.stored:
                wake_s.append(max(self._recheck_at_s, now_s + 1.0))
        return max(0.01, min(wake_s) - now_s)

    # jobs: each runs to its end or to a pause, and leaves the ledger true at every step

    def _scan(self, *, everything: bool) -> Work:
        now_s = self._world.now_s()
        self._scan_at_s = now_s + self._settings.scan_every_s
        unnameable: list[str] = []
        try:
            self._runs = scan.run_folders(self._runs_dir, self._run_dir)
            yield
            present = self._run_dir.resolve().name
            for name, folder in sorted(self._runs.items(), key=lambda item: item[0] != present):
                if everything or name == present:
                    yield from self._scan_run(name, folder, unnameable)
        except scan.SpoolUnreadable as problem:
            self.conditions.set("spool", str(problem))
            return
        self.conditions.clear("spool")
        if everything:
            self._scan_all_at_s = now_s + SCAN_ALL_EVERY_S
        self.conditions.set(
            "unnameable",
            f"{len(unnameable)} files have names that are not UTF-8 text and stay where they are: {unnameable[0]}"
            if unnameable
            else "",
        )

    def _scan_run(self, name: str, folder: Path, unnameable: list[str]) -> Work:
        has_new = False
        for batch in scan.files_of_record(folder, unnameable):
            changed = self._ledger.see(name, batch)
            has_new = has_new or any(is_photograph(path) for path in changed)
            yield
        log = folder / "frames.jsonl"
        seen = scan.look_at(folder, log.name)
        stamp = (seen.size, seen.mtime_ns) if seen else (0, 0)
        if has_new or self._logs_seen.get(name) != stamp:
            self._ledger.expect(name, scan.announced_hashes(log))
            self._logs_seen[name] = stamp

    def _clean(self) -> Work:
        """Ask the target whether it is there, and take away what a killed process left behind."""
        with self._connected() as connected:
            if not connected:
                return
            for run, path in sorted(self._runs.items()):
                folders = [run, *(f"{run}/{inner}" for inner in _folders(path))]
                for folder in folders:
                    yield
                    for name in self._target.names(folder):
                        if is_temporary_name(name, self._ledger.id):
                            self._target.remove(f"{folder}/{name}")
            self._clean_due = False

    def _upload(self, entry: Entry) -> Work:
        source = self._runs[entry.run] / entry.path
        destination = _destination(entry)
        order = Order(source, destination, entry.kind, entry.expected, self._ledger.id)
        with self._connected(entry) as connected:
            if not connected:
                return
            try:
                done = yield from transfer(order, self._target)
            except SourceGone as problem:
                yield from self._source_gone(entry, destination, str(problem))
                return
            except SourceDamaged as problem:
                self._ledger.mark(entry, "damaged", str(problem))
                self._refused(entry, str(problem))
                return
            self._ledger.stored(entry, done.sha256, done.size, done.mtime_ns, self._world.utc_ns())
            self._own.pop(entry.key, None)
            self._table_sent_s[entry.key] = self._world.now_s()
            self.totals.files += done.copied
            self.totals.found_there += not done.copied
            self.totals.bytes += done.size if done.copied else 0
            self.conditions.clear(f"file {entry.run}/{entry.path}")
            self._works()
            aside = f"another file of that name was there and is kept as {done.moved_aside}" if done.moved_aside else ""
            self._say("stored", entry, sha256=done.sha256, bytes=done.size, reason=aside)

    def _source_gone(self, entry: Entry, destination: str, reason: str) -> Work:
        run = self._runs[entry.run]
        if not scan.is_run_folder(run):
            self._runs.pop(entry.run)
            self.conditions.set(f"run {entry.run}", f"{run}: the run folder is gone, with files that were not stored")
            return
        if entry.sha256 and (yield from hash_at_target(self._target, destination)) == entry.sha256:
            self._ledger.mark(entry, "freed")
        elif entry.kind == "table" and not entry.sha256:
            self._ledger.forget(entry)
        elif entry.sha256:
            self._ledger.mark(entry, "damaged", "the copy at the target is damaged, and the spool has none any more")
            self._refused(entry, f"{destination}: damaged at the target, and the spool has none any more")
        else:
            self._ledger.mark(entry, "vanished", reason)
            self._refused(entry, reason)

    def _recheck(self, entry: Entry) -> Work:
        self._recheck_at_s = self._world.now_s() + 3600.0 / self._settings.recheck_per_hour
        with self._connected(entry) as connected:
            if not connected:
                return
            found = yield from hash_at_target(self._target, _destination(entry))
            self.totals.rechecked += 1
            if found == entry.sha256:
                self._ledger.checked(entry, self._world.utc_ns())
                return
            self.totals.found_damaged += 1
            what = "is missing" if found is None else "is not what was stored there"
            reason = f"{self._target.name}/{_destination(entry)}: {what}; it is sent again"
            self._ledger.mark(entry, "waiting", reason)
            self._table_sent_s.pop(entry.key, None)
            self._say("waiting", entry, reason=reason)

    def _free(self, entry: Entry) -> Work:
        with self._connected(entry) as connected:
            if not connected:
                return
            source = self._runs[entry.run] / entry.path
            now_ns = self._world.utc_ns()
            result = yield from retention.free(entry, source, _destination(entry), self._target, now_ns)
            if result in ("freed", "gone"):
                self._ledger.mark(entry, "freed")
                self.totals.freed += result == "freed"
            elif result in ("changed", "not_at_target"):
                self._ledger.mark(entry, "waiting", "looked at again before making room")
            else:
                self._postpone(entry.key)

    # failures and how things stand

    @contextmanager
    def _connected(self, entry: Entry | None = None) -> Iterator[bool]:
        """The target, or False after a problem; what goes wrong inside ends the job and is told."""
        try:
            try:
                self._target.connect()
            except StoreError as problem:
                self._failed(problem, entry)
                yield False
                return
            yield True
        except StoreError as problem:
            self._failed(problem, entry)
        finally:
            self._target.disconnect()

    def _failed(self, problem: StoreError, entry: Entry | None) -> None:
        self.totals.last_problem = str(problem)
        if entry is not None:
            self._postpone(entry.key)
        if isinstance(problem, TARGET_PROBLEMS) or entry is None:
            self._pause(problem)
        else:
            self._refused(entry, str(problem))

    def _pause(self, problem: StoreError) -> None:
        now_s = self._world.now_s()
        self._paused_until_s = now_s + self._backoff.failed()
        self._clean_due = self._clean_due or not isinstance(problem, LedgerProblem)
        is_news = self.conditions.set("target", str(problem))
        self.totals.last_problem = str(problem)
        is_long_ago = self._told_waiting_at_s is None or now_s >= self._told_waiting_at_s + TELL_WAITING_EVERY_S
        if is_news or is_long_ago:
            self._told_waiting_at_s = now_s
            self._world.say(Event("waiting", destination=self._target.name, reason=str(problem)))

    def _works(self) -> None:
        self._backoff.worked()
        self._told_waiting_at_s = None
        self.conditions.clear("target")

    def _postpone(self, key: tuple[str, str]) -> None:
        own = self._own.setdefault(key, _Own(Backoff(self._world.uniform)))
        own.until_s = self._world.now_s() + own.backoff.failed()
        while len(self._own) > MOST_WAITING_FILES:
            self._own.pop(next(iter(self._own)))

    def _may_try(self, key: tuple[str, str], now_s: float) -> bool:
        own = self._own.get(key)
        return own is None or now_s >= own.until_s

    def _refused(self, entry: Entry, reason: str) -> None:
        self.totals.last_problem = reason
        if self.conditions.set(f"file {entry.run}/{entry.path}", reason):
            self._say("refused", entry, reason=reason)

    def _say(self, stage: Stage, entry: Entry, *, sha256: str = "", bytes: int = 0, reason: str = "") -> None:  # noqa: A002
        destination = f"{self._target.name}/{_destination(entry)}"
        self._world.say(Event(stage, entry.run, entry.path, sha256, bytes, destination, reason))

    def _look_at_disk(self, now_s: float) -> None:
        if now_s < self._disk_at_s:
            return
        self._disk_at_s = now_s + DISK_EVERY_S
        alert = disk_alert(100.0 - self._world.percent_free(), self.conditions.disk)
        self.conditions.disk = alert
        self.conditions.set(
            "disk",
            f"the spool's disk is more than {alert.percent} % full" if alert else "",
            serious=alert is not None and alert.is_serious,
        )


def _destination(entry: Entry) -> str:
    return f"{entry.run}/{entry.path}"


def _folders(run: Path) -> list[str]:
    """Folders of a run, each once, as far as files of record lie in them."""
    found: set[str] = set()
    for batch in scan.files_of_record(run, []):
        found.update(str(Path(file.path).parent) for file in batch)
    return sorted(found - {"."})

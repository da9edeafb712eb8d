"""The uploader itself: what to do next, what became of it, and how things stand.

Time, chance, disk and target are handed in. :meth:`Uploader.step` does a small piece of work and says when it wants to
be called again; nothing here waits. All durable facts are in the ledger, so that the process may end at any line.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from flora_common.errors import DiskFull, NasRefused, NasUnreachable, StoreError
from flora_uploader import retention, scan
from flora_uploader.conditions import Conditions
from flora_uploader.ledger import Entry, Ledger, LedgerProblem
from flora_uploader.model import Event, Settings, Stage, Totals, World
from flora_uploader.policy import Backoff, Waits, disk_alert, is_of_record, is_photograph
from flora_uploader.target import Target
from flora_uploader.transfer import (
    Order,
    SourceChanged,
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

TARGET_PROBLEMS: Final = (NasUnreachable, NasRefused, DiskFull, LedgerProblem, SpoolIsTarget)
"""Problems of the whole target (or ledger): all rests for a while. Others are one file's own, and the next is tried."""

Work = Generator[None, None, None]


class Uploader:
    """Moves every file of record from the spool to the target.

    Args:
        runs_dir: folder with run folders.
        run_dir: the rig's present run folder.
        target: where files go.
        ledger: what has been verified.
        settings: behaviour.
        world: clocks, chance, disk.
        may_free: whether it may make room in the spool at all.
    """

    def __init__(
        self,
        runs_dir: Path,
        run_dir: Path,
        target: Target,
        ledger: Ledger,
        settings: Settings,
        world: World,
        *,
        may_free: bool = True,
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
        self._may_free = may_free
        self._waits = Waits(world.uniform)
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
            folder = scan.real_path(self._run_dir)
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
                lambda e: (
                    e.run in self._runs and retention.may_be_freed(e, now_ns) and self._waits.is_over(e.key, now_s)
                ),
            )
            if oldest is not None:
                return self._free(oldest)
        if self._settings.recheck_per_hour > 0 and now_s >= self._recheck_at_s:
            checked = self._ledger.next_to_check(lambda e: self._waits.is_over(e.key, now_s))
            if checked is not None:
                return self._recheck(checked)
        return None

    def _next_upload(self, now_s: float) -> Entry | None:
        def may(entry: Entry) -> bool:
            return entry.run in self._runs and self._waits.is_over(entry.key, now_s)

        def is_due(entry: Entry) -> bool:
            sent_s = self._table_sent_s.get(entry.key)
            return may(entry) and (self._closing or sent_s is None or now_s >= sent_s + self._settings.table_every_s)

        if self._closing:
            return self._ledger.next_waiting("table", is_due) or self._ledger.next_waiting("once", may)
        return self._ledger.next_waiting("once", may) or self._ledger.next_waiting("table", is_due)

    def _idle_s(self, now_s: float) -> float:
        wake_s = [self._scan_at_s, self._disk_at_s, now_s + LONGEST_IDLE_S]
        if now_s < self._paused_until_s:
            wake_s.append(self._paused_until_s)
        else:
            wake_s += self._waits.ends_after(now_s)
            if self._settings.recheck_per_hour > 0 and self.stored:
                wake_s.append(max(self._recheck_at_s, now_s + 1.0))
        return max(0.01, min(wake_s) - now_s)

    # jobs: each runs to its end or to a pause, and leaves the ledger true at every step

    def _scan(self, *, everything: bool) -> Work:
        now_s = self._world.now_s()
        self._scan_at_s = now_s + self._settings.scan_every_s
        unnameable: list[str] = []
        try:
            self._runs, clashes = scan.run_folders(self._runs_dir, self._run_dir)
            self.conditions.set(
                "clashes", f"two run folders have one name, rename one: {clashes[0]}" if clashes else ""
            )
            yield
            present = scan.real_path(self._run_dir).name
            for name, folder in sorted(self._runs.items(), key=lambda item: item[0] != present):
                if everything or name == present:
                    yield from self._scan_run(name, folder, unnameable)
        except scan.SpoolUnreadable as problem:
            self.conditions.set("spool", str(problem))
            return
        self.conditions.clear("spool")
        if everything:
            self._scan_all_at_s = now_s + SCAN_ALL_EVERY_S
            self._give_up_on_runs_that_are_gone()
        self.conditions.set(
            "unnameable",
            f"{len(unnameable)} files have names that are not UTF-8 text and stay where they are: {unnameable[0]}"
            if unnameable
            else "",
        )

    def _give_up_on_runs_that_are_gone(self) -> None:
        for run, count in self._ledger.waiting_by_run().items():
            if run not in self._runs:
                reason = f"{self._runs_dir / run}: the run folder is gone, with {count} files that were not stored"
                self._ledger.mark_run_vanished(run, reason)  # should it come back, its files wait again
                self.conditions.set(f"run {run}", reason)
                self._world.say(Event("refused", run, reason=reason))

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
                folders = [run, *(f"{run}/{inner}" for inner in scan.folders_of_record(path))]
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
            if not self._ledger.stored(entry, done.sha256, done.size, done.mtime_ns, self._world.utc_ns()):
                return  # announced meanwhile with another hash: looked at again
            self._waits.forget(entry.key)
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
            self._scan_all_at_s = 0.0  # the next scan tells what is missing
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
                self._waits.begin(entry.key, self._world.now_s())

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
        if entry is not None:
            self._waits.begin(entry.key, self._world.now_s())
        if isinstance(problem, TARGET_PROBLEMS) or entry is None:
            self._pause(problem)
        elif not isinstance(problem, SourceChanged):  # still being written: no news, it is tried again
            self._refused(entry, str(problem))

    def _pause(self, problem: StoreError) -> None:
        now_s = self._world.now_s()
        self._paused_until_s = now_s + self._backoff.failed()
        self._clean_due = self._clean_due or not isinstance(problem, LedgerProblem)
        is_news = self.conditions.set("target", str(problem))
        is_long_ago = self._told_waiting_at_s is None or now_s >= self._told_waiting_at_s + TELL_WAITING_EVERY_S
        if is_news or is_long_ago:
            self._told_waiting_at_s = now_s
            self._world.say(Event("waiting", destination=self._target.name, reason=str(problem)))

    def _works(self) -> None:
        self._backoff.worked()
        self._told_waiting_at_s = None
        self.conditions.clear("target")

    def _refused(self, entry: Entry, reason: str) -> None:
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

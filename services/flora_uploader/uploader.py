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
from flora_uploader.config import UploaderSection
from flora_uploader.ledger import Ledger
from flora_uploader.ledger_damage import LedgerDamaged, LedgerProblem
from flora_uploader.ledger_model import Entry
from flora_uploader.model import Event, Stage, Totals, World
from flora_uploader.owner import Owners
from flora_uploader.policy import Pause, Waits
from flora_uploader.spool import Spool
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
DISK_EVERY_S: Final = 10.0
"""The spool's disk is looked at so often, also while uploading is switched off."""

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
        owners: whose run folders are there.
        ledger: what has been verified.
        config: how often, and how much room.
        world: clocks, chance, disk.
        may_free: whether it may make room in the spool at all.
    """

    def __init__(
        self,
        runs_dir: Path,
        run_dir: Path,
        target: Target,
        owners: Owners,
        ledger: Ledger,
        config: UploaderSection,
        world: World,
        *,
        may_free: bool = True,
    ) -> None:
        self._target = target
        self._owners = owners
        self._ledger = ledger
        self._config = config
        self._world = world
        self.conditions = Conditions()
        self.totals = Totals()
        self._spool = Spool(runs_dir, run_dir, ledger, self.conditions, world.say)
        self._job: Work | None = None
        self._pause = Pause(world.uniform)
        self._scan_at_s = 0.0
        self._scan_all_at_s = 0.0
        self._disk_at_s = 0.0
        self._recheck_at_s = 0.0
        self._clean_due = True
        self._was_gone = False
        self._closing = False
        self._may_free = may_free
        self._waits = Waits(world.uniform)
        self._table_sent_s: dict[tuple[str, str], float] = {}
        if ledger.replaced:
            self.conditions.set("ledger_replaced", ledger.replaced, serious=False)

    # what others tell

    def hear(self, run: str, path: str, sha256: str) -> None:
        """A photograph was announced: ``step`` sends it without waiting for the next scan.

        Raises:
            LedgerDamaged: as for :meth:`step`.
            StoreError: the spool cannot be read or the ledger not written; the next scan finds the file.
        """
        self._spool.hear(run, path, sha256)

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
        """Work for about :data:`SLICE_S`; returns the seconds until the next call is wanted, 0 where there is more.

        Raises:
            LedgerDamaged: nothing can be done any more with this ledger, nor by this uploader.
        """
        began_s = self._world.now_s()
        while True:
            if self._job is None:
                self._look_at_disk(began_s)
                try:
                    self._job = self._next_job(began_s)
                except LedgerProblem as problem:
                    self._rest(problem)
            if self._job is None:
                return self._idle_s(began_s)
            try:
                next(self._job)
            except StopIteration:
                self._job = None
            except LedgerProblem as problem:
                self._job = None
                self._rest(problem)
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
        """Nothing is being done and nothing can be done now.

        Raises:
            LedgerDamaged: as for :meth:`step`.
        """
        try:
            return self._job is None and self._next_job(self._world.now_s(), peek=True) is None
        except LedgerProblem:
            return True

    def _next_job(self, now_s: float, *, peek: bool = False) -> Work | None:
        if now_s >= self._scan_at_s:
            return self._scan(everything=now_s >= self._scan_all_at_s)
        if now_s < self._pause.until_s:
            return None
        if self._clean_due:
            return self._clean()
        entry = self._next_upload(now_s)
        if entry is not None:
            return self._upload(entry)
        if not peek and "target" in self.conditions and self._ledger.counts["waiting"] == 0:
            self._works()  # nothing is left that it could refuse
        if self._closing:
            return None
        wanted_room = self._config.keep_percent_free
        if self._may_free and wanted_room > 0 and self._world.percent_free() < wanted_room:
            now_ns = self._world.utc_ns()
            oldest = self._ledger.next_to_free(
                now_ns - retention.YOUNGEST_NS,
                lambda e: e.run in self._spool.runs and retention.may_be_freed(e, now_ns) and self._is_over(e, now_s),
            )
            if oldest is not None:
                return self._free(oldest)
        if self._config.recheck_per_hour > 0 and now_s >= self._recheck_at_s:
            checked = self._ledger.next_to_check(lambda e: self._is_over(e, now_s))
            if checked is not None:
                return self._recheck(checked)
        return None

    def _next_upload(self, now_s: float) -> Entry | None:
        def may(entry: Entry) -> bool:
            return entry.run in self._spool.runs and self._is_over(entry, now_s)

        def is_due(entry: Entry) -> bool:
            sent_s = self._table_sent_s.get(entry.key)
            return may(entry) and (self._closing or sent_s is None or now_s >= sent_s + self._config.table_every_s)

        if self._closing:
            return self._ledger.next_waiting("table", is_due) or self._ledger.next_waiting("once", may)
        return self._ledger.next_waiting("once", may) or self._ledger.next_waiting("table", is_due)

    def _is_over(self, entry: Entry, now_s: float) -> bool:
        return all(self._waits.is_over(key, now_s) for key in (entry.key, (entry.run, "")))

    def _idle_s(self, now_s: float) -> float:
        wake_s = [self._scan_at_s, self._disk_at_s, now_s + LONGEST_IDLE_S]
        if now_s < self._pause.until_s:
            wake_s.append(self._pause.until_s)
        else:
            wake_s += self._waits.ends_after(now_s)
            if self._config.recheck_per_hour > 0 and self.stored:
                wake_s.append(max(self._recheck_at_s, now_s + 1.0))
        return max(0.01, min(wake_s) - now_s)

    # jobs: each runs to its end or to a pause, and leaves the ledger true at every step

    def _scan(self, *, everything: bool) -> Work:
        now_s = self._world.now_s()
        self._scan_at_s = now_s + self._config.scan_every_s
        whole = yield from self._spool.look_through(everything=everything)
        if whole and everything:
            self._scan_all_at_s = now_s + SCAN_ALL_EVERY_S

    def _clean(self) -> Work:
        """Ask the target whether it is there, and take away what a killed process left behind."""
        with self._connected() as connected:
            if not connected:
                return
            for run, path in sorted(self._spool.runs.items()):
                try:
                    inside = scan.folders_of_record(path)
                except scan.SpoolUnreadable:
                    continue  # the scan tells of it; what was left behind there goes the next time
                for folder in (run, *(f"{run}/{inner}" for inner in inside)):
                    yield
                    for name in self._target.names(folder):
                        if is_temporary_name(name, self._ledger.id):
                            self._target.remove(f"{folder}/{name}")
            self._clean_due = False

    def _upload(self, entry: Entry) -> Work:
        source = self._spool.runs[entry.run] / entry.path
        order = Order(source, entry.destination, entry.kind, entry.expected, self._ledger.id)
        with self._connected(entry) as connected:
            if not (connected and self._is_ours(entry.run)):
                return
            try:
                done = yield from transfer(order, self._target)
            except SourceGone as problem:
                yield from self._source_gone(entry, str(problem))
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
            self.conditions.clear(_trouble_with(entry))
            self._works()
            aside = f"another file of that name was there and is kept as {done.moved_aside}" if done.moved_aside else ""
            self._say("stored", entry, sha256=done.sha256, bytes=done.size, reason=aside)

    def _source_gone(self, entry: Entry, reason: str) -> Work:
        if not self._spool.is_there(entry.run):
            self._spool.runs.pop(entry.run)
            self._scan_all_at_s = 0.0  # the next scan tells what is missing
            return
        if entry.sha256 and (yield from hash_at_target(self._target, entry.destination)) == entry.sha256:
            self._ledger.mark(entry, "freed")
            self.conditions.clear(_trouble_with(entry))
        elif entry.kind == "table" and not entry.sha256:
            self._ledger.forget(entry)
            self.conditions.clear(_trouble_with(entry))
        elif entry.sha256:
            self._ledger.mark(entry, "damaged", "the copy at the target is damaged, and the spool has none any more")
            self._refused(entry, f"{entry.destination}: damaged at the target, and the spool has none any more")
        else:
            self._ledger.mark(entry, "vanished", reason)
            self._refused(entry, reason)

    def _recheck(self, entry: Entry) -> Work:
        self._recheck_at_s = self._world.now_s() + 3600.0 / self._config.recheck_per_hour
        with self._connected(entry) as connected:
            if not (connected and self._is_ours(entry.run)):
                return
            found = yield from hash_at_target(self._target, entry.destination)
            self.totals.rechecked += 1
            if found == entry.sha256:
                self._ledger.checked(entry)
                return
            self.totals.found_damaged += 1
            what = "is missing" if found is None else "is not what was stored there"
            reason = f"{self._target.name}/{entry.destination}: {what}; it is sent again"
            self._ledger.mark(entry, "waiting", reason)
            self._table_sent_s.pop(entry.key, None)
            self._say("waiting", entry, reason=reason)

    def _free(self, entry: Entry) -> Work:
        with self._connected(entry) as connected:
            if not (connected and self._is_ours(entry.run)):
                return
            source = self._spool.runs[entry.run] / entry.path
            result = yield from retention.free(entry, source, entry.destination, self._target, self._world.utc_ns())
            if result in ("freed", "gone"):
                self._ledger.mark(entry, "freed")
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
                self._was_gone = True
                self._failed(problem, entry)
                yield False
                return
            if self._was_gone:
                self._was_gone = False
                self._works()
            yield True
        except LedgerDamaged:
            raise
        except StoreError as problem:
            self._failed(problem, entry)
        finally:
            self._target.disconnect()

    def _is_ours(self, run: str) -> bool:
        is_there = run in self._spool.runs and self._spool.is_there(run)
        other = self._owners.other(run, self._spool.runs[run]) if is_there else ""
        if self.conditions.set(f"owner {run}", other):
            self._world.say(Event("refused", run, destination=f"{self._target.name}/{run}", reason=other))
        if not other:
            self._waits.forget((run, ""))
            return True
        self._waits.begin((run, ""), self._world.now_s())
        return False

    def _failed(self, problem: StoreError, entry: Entry | None) -> None:
        if entry is not None:
            self._waits.begin(entry.key, self._world.now_s())
        if isinstance(problem, TARGET_PROBLEMS) or entry is None:
            self._rest(problem)
        elif not isinstance(problem, SourceChanged):  # still being written: no news, it is tried again
            self._refused(entry, str(problem))

    def _rest(self, problem: StoreError) -> None:
        self._clean_due = self._clean_due or not isinstance(problem, LedgerProblem)
        is_news = self.conditions.set("target", str(problem))
        if self._pause.begin(self._world.now_s(), is_news=is_news):
            self._world.say(Event("waiting", destination=self._target.name, reason=str(problem)))

    def _works(self) -> None:
        self._pause.over()
        self.conditions.clear("target")

    def _refused(self, entry: Entry, reason: str) -> None:
        if self.conditions.set(_trouble_with(entry), reason):
            self._say("refused", entry, reason=reason)

    def _say(self, stage: Stage, entry: Entry, *, sha256: str = "", bytes: int = 0, reason: str = "") -> None:  # noqa: A002
        destination = f"{self._target.name}/{entry.destination}"
        self._world.say(Event(stage, entry.run, entry.path, sha256, bytes, destination, reason))

    def _look_at_disk(self, now_s: float) -> None:
        if now_s < self._disk_at_s:
            return
        self._disk_at_s = now_s + DISK_EVERY_S
        self.conditions.disk_is(self._world.percent_free())


def _trouble_with(entry: Entry) -> str:
    """Name of the condition that a file is in."""
    return f"file {entry.run}/{entry.path}"

"""The jobs of a lab, in the order in which they were asked for: written whole at each change, so that none is lost."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec

from flora_common import files
from flora_common.errors import BadInput, StoreError
from flora_common.messages import Job, JobProgress
from flora_common.messages.catalogue import JobStage
from flora_common.messages.envelope import as_sentence
from flora_lab.jobs import rules

BOOK_FILE: Final = "jobs.json"
MOST_WAITING: Final = 100
MOST_KEPT: Final = 200
"""Jobs that are over; older ones are forgotten."""
MOST_KILLED: Final = 3
"""So often a lab may be killed while it is at work on a job, which then has failed: it may be what kills it."""


class Entry(msgspec.Struct):
    """One job.

    Attributes:
        job: its number.
        work, arguments: what is to be done.
        stage: see :class:`flora_common.messages.JobProgress`.
        text: why it failed, or what it said last.
        attempts: how often it was begun; a lab that is stopped begins it again.
        asked, began, ended: UTC, empty before.
        took_s: of the last attempt.
        killed: how often the lab was killed while it was at work.
    """

    job: str
    work: str
    arguments: list[str]
    stage: JobStage = "waiting"
    text: str = ""
    attempts: int = 0
    asked: str = ""
    began: str = ""
    ended: str = ""
    took_s: float = 0.0
    killed: int = 0

    @property
    def is_over(self) -> bool:
        return self.stage in rules.OVER

    def command(self, folder: Path) -> list[str]:
        """Arguments of ``flora-lab``, in the folder of all jobs."""
        goes_on = self.attempts > 1 and self.work in rules.GO_ON and rules.RESUME not in self.arguments
        return [self.work, *rules.spelled_out(self.arguments, folder), *([rules.RESUME] if goes_on else [])]


class _File(msgspec.Struct):
    jobs: list[Entry]
    format: int = 1


class Book:
    """All jobs, oldest first. Times are handed in.

    Args:
        folder: of all jobs.

    Raises:
        StoreError: what is there is no book of jobs.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / BOOK_FILE
        self.jobs: list[Entry] = []
        if self.path.exists():
            try:
                self.jobs = msgspec.json.decode(self.path.read_bytes(), type=_File).jobs
            except (ValueError, RecursionError) as problem:
                raise StoreError(f"{self.path}: not the jobs of a lab ({problem}); move it away") from problem
        for entry in self.jobs:
            if entry.stage == "working":  # whoever worked at it is gone
                entry.killed += 1
                entry.stage = "waiting" if entry.killed < MOST_KILLED else "failed"
                if entry.is_over:
                    entry.text = f"the lab was killed {entry.killed} times while it was at work; has it enough memory?"

    def ask(self, asked: Job, utc: str) -> Entry:
        """A job that somebody asks for: as it is, if it is known; else it waits, or is refused.

        Raises:
            DiskFull: no room to note it: it is not taken.
        """
        known = self.find(asked.job)
        if known is not None:
            return known
        entry = Entry(asked.job, asked.work, list(asked.arguments), asked=utc)
        try:
            if asked.stop or asked.work == rules.KNOWN:
                raise BadInput("no such job is known here")
            if sum(not one.is_over for one in self.jobs) >= MOST_WAITING:
                raise BadInput(f"{MOST_WAITING} jobs are waiting already; ask again when some are done")
            rules.check(asked.work, asked.arguments)
            rules.check_outputs(entry.command(self.path.parent), self.path.parent)
        except BadInput as problem:
            # Not noted: whoever asks for nonsense a thousand times must not push out what was done.
            entry.stage, entry.text = "refused", as_sentence(str(problem))
            return entry
        self.jobs.append(entry)
        try:
            self.save()
        except BaseException:
            self.jobs.remove(entry)
            raise
        return entry

    def find(self, job: str) -> Entry | None:
        """The job with this number."""
        return next((one for one in self.jobs if one.job == job), None)

    def next(self) -> Entry | None:
        """The one that has waited longest."""
        return next((one for one in self.jobs if one.stage == "waiting"), None)

    def begins(self, entry: Entry, utc: str) -> None:
        """It is worked at from now on.

        Raises:
            DiskFull: no room to note it: it waits on.
        """
        entry.stage, entry.began, entry.ended, entry.text = "working", utc, "", ""
        entry.attempts += 1
        try:
            self.save()
        except BaseException:
            entry.stage = "waiting"
            entry.attempts -= 1
            raise

    def begins_later(self, entry: Entry) -> None:
        """The lab ends before it: it waits, at its place."""
        entry.stage = "waiting"
        self.save()

    def ends(self, entry: Entry, stage: JobStage, text: str, *, utc: str, took_s: float) -> None:
        """It is over."""
        entry.stage, entry.text, entry.ended, entry.took_s = stage, as_sentence(" ".join(text.split())), utc, took_s
        over = [one for one in self.jobs if one.is_over]
        for old in over[: max(0, len(over) - MOST_KEPT)]:
            self.jobs.remove(old)
        self.save()

    def progress(self, entry: Entry, *, text: str = "", share: float | None = None, took_s: float = 0.0) -> JobProgress:
        """What the bus is told of it.

        Args:
            entry: the job.
            text, share: of one that is worked at.
            took_s: of that.
        """
        waits = entry.stage == "waiting"
        before = sum(not one.is_over for one in self.jobs[: self.jobs.index(entry)]) if waits else 0
        is_over = entry.is_over
        return JobProgress(
            job=entry.job,
            work=entry.work,
            stage=entry.stage,
            share=1.0 if entry.stage == "done" else None if is_over else share,
            text=as_sentence(entry.text if is_over else text),
            before=before,
            took_s=entry.took_s if is_over else took_s,
        )

    def save(self) -> None:
        """Write it whole.

        Raises:
            DiskFull: no room; the old one stands.
        """
        files.write_bytes(self.path, msgspec.json.format(msgspec.json.encode(_File(self.jobs)), indent=1) + b"\n")

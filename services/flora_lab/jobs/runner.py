"""The lab's side: takes jobs from the bus, works at one after the other, says how far each is."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from flora_common import files, lock
from flora_common.app import App
from flora_common.errors import BadInput, StoreError
from flora_common.messages import Job
from flora_common.messages.catalogue import JobStage
from flora_lab.bars import ENVIRONMENT, Told, read_told
from flora_lab.jobs import rules
from flora_lab.jobs.book import Book, Entry
from flora_lab.serve.child import Child

LOCK_FILE: Final = ".jobs.lock"
PROGRESS_FILE: Final = ".progress.json"
LOOK_EVERY_S: Final = 1.0
SAY_EVERY_S: Final = 10.0
"""At the latest; a change is said when it is seen."""
PATIENCE_S: Final = 60.0
"""A job that was asked to end has so long to write what it has."""
WELL: Final = 0


class Runner:
    """Works at jobs.

    Args:
        app: the service.
        folder: of all jobs; they see no other.
        utc: this moment, for the book.

    Raises:
        StoreError: the folder cannot be written, or its book is none.
    """

    def __init__(self, app: App[Any], folder: Path, utc: Callable[[], str]) -> None:
        self._app = app
        self._folder = folder
        self._utc = utc
        try:
            files.make_folder(folder)
        except OSError as problem:
            raise StoreError(f"[lab] jobs_dir {folder}: cannot be written ({problem.strerror})") from problem
        self._book = Book(folder)
        self._at: tuple[Child, Entry] | None = None
        self._stopped_s: float | None = None
        self._told: Told | None = None
        self._said_s = 0.0
        app.on(Job, self.hear)
        app.every(LOOK_EVERY_S, self.look)
        app.on_ready(self.look)
        app.on_exit(self.finish)

    def hear(self, asked: Job) -> None:
        """Somebody asks for a job, or how it is, or to end it."""
        entry = self._book.ask(asked, self._utc())
        if asked.stop and entry.stage == "waiting":
            self._book.ends(entry, "stopped", "before it was begun", utc=self._utc(), took_s=0.0)
        elif asked.stop and self._at is not None and self._at[1] is entry:
            self._stop(self._at[0])
        self._say(entry)
        self.look()

    def _stop(self, child: Child) -> None:
        """Ask it to end; who asks for it again a good while later wants it gone."""
        now_s = time.monotonic()
        if self._stopped_s is None:
            # Not waited for: a job that writes what it has may take its time, and the loop has other work.
            self._stopped_s = now_s
            child.ask_to_end()
        elif now_s - self._stopped_s > PATIENCE_S:
            child.end()

    def look(self) -> None:
        """Begin with the next job, or say how far the present one is."""
        if self._at is None:
            entry = self._book.next()
            if entry is not None:
                self._begin(entry)
            return
        told = read_told(self._folder / PROGRESS_FILE)
        if told != self._told or time.monotonic() - self._said_s >= SAY_EVERY_S:
            self._told = told
            self._say(self._at[1])

    def _begin(self, entry: Entry) -> None:
        try:
            held = lock.hold(self._folder / LOCK_FILE)
        except lock.AlreadyHeld as by:
            # Of a service that was killed: its folder is not to be worked in twice.
            self._app.trouble("jobs", f"a job that was begun before (process {by.pid}) is still at work")
            return
        self._app.trouble("jobs", "")
        (self._folder / PROGRESS_FILE).unlink(missing_ok=True)
        try:
            # links may have been made since it was asked for
            rules.check_outputs(entry.command(self._folder), self._folder)
            self._book.begins(entry, self._utc())
        except BadInput as problem:
            os.close(held)
            self._book.ends(entry, "refused", str(problem), utc=self._utc(), took_s=0.0)
            self._say(entry)
            self.look()
            return
        except BaseException:
            os.close(held)
            raise
        environment = {ENVIRONMENT: str((self._folder / PROGRESS_FILE).resolve())}
        child = Child(entry.command(self._folder), held, folder=self._folder, environment=environment)
        self._at, self._stopped_s, self._told = (child, entry), None, None
        self._app.on_readable(child.ends_fd, self._ended)
        self._app.log.event("job_begins", job=entry.job, work=entry.work, attempt=entry.attempts)
        self._say(entry)

    def _ended(self) -> None:
        assert self._at is not None
        child, entry = self._at
        ended = child.ended()
        if ended is None:
            return
        self._app.forget_readable(child.ends_fd)
        took_s = time.monotonic() - child.began_s
        child.close()
        self._at = None
        stage: JobStage = "done" if ended.status == WELL else "failed" if self._stopped_s is None else "stopped"
        text = ended.reason if stage == "failed" else ended.said
        self._book.ends(entry, stage, text, utc=self._utc(), took_s=took_s)
        self._app.log.event("job_ends", job=entry.job, work=entry.work, stage=stage, text=text)
        self._say(entry)
        self.look()

    def _say(self, entry: Entry) -> None:
        self._said_s = time.monotonic()
        if self._at is None or self._at[1] is not entry:
            self._app.publish(self._book.progress(entry))
            return
        told = self._told
        self._app.publish(
            self._book.progress(
                entry,
                text=told.text if told else "",
                share=told.share if told else None,
                took_s=time.monotonic() - self._at[0].began_s,
            )
        )

    def finish(self) -> None:
        """The service ends: the job is begun again at the next start, and goes on where it can."""
        if self._at is None:
            return
        child, entry = self._at
        self._at = None
        child.end()
        ended = child.ended()
        took_s = time.monotonic() - child.began_s
        child.close()
        with contextlib.suppress(StoreError):  # without room the book says `working`, which means the same
            if ended is not None and ended.status == WELL:
                self._book.ends(entry, "done", ended.said, utc=self._utc(), took_s=took_s)
            else:
                self._book.begins_later(entry)

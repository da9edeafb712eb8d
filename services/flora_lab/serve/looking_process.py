"""The process that does the mathematics, as the service sees it: one task at a time, answered when it is done."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from flora_common.app import App
from flora_common.errors import FloraError
from flora_common.runs import LampsSection
from flora_lab.serve.section import LabSection
from flora_lab.serve.tasks import LearnTask, LookTask, work
from flora_lab.serve.watching import Look, Looked
from flora_lab.worker_process import Worker, WorkerLost, start_workers

EVERY_S: Final = 1.0
"""Real seconds between looks whether there is something to do."""
_AGAIN_S: Final = 60.0
"""After which a task that failed is given again."""


class LookingProcess:
    """Started with its first task, and anew where it was lost."""

    def __init__(self, app: App[LabSection]) -> None:
        self._app = app
        self._worker: Worker | None = None
        self._answer: Callable[[Any], None] | None = None
        self._rests = False

    @property
    def is_busy(self) -> bool:
        """Whether it is at something, or rests after a failure."""
        return self._answer is not None or self._rests

    def learn(self, reference: Path, output: Path, answer: Callable[[Path | FloraError], None]) -> None:
        """Learn a simulator; ``answer`` gets its folder, or what was wrong."""

        def learned(result: Path | FloraError) -> None:
            if isinstance(result, FloraError):
                self._rest()
            answer(result)

        self._give(LearnTask(reference, output), learned)

    def look(
        self,
        look: Look,
        lamps: LampsSection | None,
        simulator: Path,
        false_alarms: float,
        answer: Callable[[Looked | FloraError], None],
    ) -> None:
        """Look at a run; ``answer`` gets what was found, or what was wrong."""
        self._give(LookTask(look.run, look.rows, lamps, simulator, look.watched, false_alarms), answer)

    def end(self) -> None:
        """End it, whatever it is at."""
        if self._worker is not None:
            self._app.forget_readable(self._worker.pipe.fileno())
            self._worker.end()
            self._worker = None

    def _give(self, task: object, answer: Callable[[Any], None]) -> None:
        try:
            if self._worker is None:
                started: list[Worker] = []
                start_workers(started, 1, _nothing)
                self._worker = started[0]
                self._app.on_readable(self._worker.pipe.fileno(), self._answered)
                self._worker.employ(work)
            self._worker.send(task)
        except WorkerLost as problem:
            self._lost(problem)
            return
        self._answer = answer

    def _answered(self) -> None:
        assert self._worker is not None
        answer, self._answer = self._answer, None
        try:
            is_done, result = self._worker.receive()
        except WorkerLost as problem:
            self._lost(problem)
            return
        self._app.trouble("worker", "")
        if not is_done and not isinstance(result, FloraError):
            # A bug, or numbers that no matrix stands: one run must not take all others, and all diagnoses, with it.
            self._app.log.problem("worker", "".join(traceback.format_exception(result)))
            result = FloraError(f"{type(result).__name__}: {result}")
        if answer is not None:
            answer(result)

    def _lost(self, problem: WorkerLost) -> None:
        self.end()
        self._answer = None
        self._app.trouble("worker", f"not looking at plants: {problem}")
        self._rest()

    def _rest(self) -> None:
        self._rests = True
        self._app.after(_AGAIN_S, self._rested)

    def _rested(self) -> None:
        self._rests = False


def _nothing() -> None:
    """A worker needs no preparing."""

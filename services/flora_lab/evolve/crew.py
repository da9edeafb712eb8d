"""Who does the work of an evolution: slices of runs, each a piece of work that anybody can do, and do again.

A slice is a run's data and comes back as the data of the same run some generations later. So a worker that is lost
costs a slice, which another one does anew with the same result.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import connection
from types import TracebackType
from typing import Any, Final, Protocol, Self

from flora_lab.evolve import one_run
from flora_lab.evolve.evaluate import evaluate
from flora_lab.evolve.plan import Plan
from flora_lab.threads import one_blas_thread
from flora_lab.worker_process import Worker, WorkerLost, start_workers

SLICE_S: Final = 2.0
"""How long a slice takes: as often the screen is told something new, and as much is lost with a worker."""
TRIES: Final = 3
"""How many workers may be lost over the same slice."""


@dataclass(frozen=True, slots=True)
class Slice:
    """A run that is to go on.

    Attributes:
        number: of the run.
        state: of :func:`flora_lab.evolve.one_run.encode`.
    """

    number: int
    state: bytes


@dataclass(frozen=True, slots=True)
class SliceDone:
    """A run that has gone on.

    Attributes:
        number: of the run.
        state: as in :class:`Slice`.
        generations: done so far.
        best_fitness: so far.
        median_fitness, species: of the last generation.
        nodes: hidden ones of the last generation's best genome.
    """

    number: int
    state: bytes
    generations: int
    best_fitness: float
    median_fitness: float
    species: int
    nodes: int


def told(state: one_run.RunState) -> SliceDone:
    """What is to be known of a run that has at least one generation behind it."""
    last = state.history[-1]
    best = max(row.best_fitness for row in state.history)
    return SliceDone(
        state.number, one_run.encode(state), len(state.history), best, last.median_fitness, last.species, last.nodes
    )


@dataclass(frozen=True, slots=True)
class SliceWork:
    """Does slices of one plan. Can be pickled.

    Attributes:
        plan: what the evolution is.
        seconds: of a slice.
        clock: seconds that only go forward.
        evaluate: finds the fitness of a generation.
    """

    plan: Plan
    seconds: float = SLICE_S
    clock: Callable[[], float] = time.monotonic
    evaluate: one_run.Evaluate = evaluate

    def __call__(self, part: Slice) -> SliceDone:
        state = one_run.decode(part.state)
        with one_blas_thread():
            return told(
                one_run.advance(self.plan, state, seconds=self.seconds, clock=self.clock, evaluate=self.evaluate)
            )


class Crew(Protocol):
    """Workers, wherever they are. A context manager, at whose end they are gone."""

    @property
    def room(self) -> int:
        """How many slices more would be begun at once."""

    def send(self, part: Slice) -> None:
        """Have a slice done."""

    def receive(self) -> Sequence[SliceDone]:
        """Wait for at least one of the slices that were sent.

        Raises:
            WorkerLost: workers were lost, and again with those who took over.
            BadInput: what the work itself raised.
        """

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class LocalCrew:
    """Processes on this machine.

    Args:
        jobs: how many; with 1 the work is done in this one.
        work: on slices.
    """

    def __init__(self, jobs: int, work: SliceWork) -> None:
        self._work = work
        self._jobs = jobs
        self._workers: list[Worker] = []
        self._idle: list[Worker] = []
        self._busy: dict[Any, tuple[Worker, Slice]] = {}
        self._lost: dict[int, int] = {}
        self._waiting: list[Slice] = []

    def __enter__(self) -> Self:
        if self._jobs > 1:
            start_workers(self._workers, self._jobs, _nothing)
            for worker in self._workers:
                worker.employ(self._work)
            self._idle = list(self._workers)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    @property
    def room(self) -> int:
        return len(self._idle) if self._jobs > 1 else 1 - len(self._waiting)

    def send(self, part: Slice) -> None:
        if self._jobs == 1:
            self._waiting.append(part)
            return
        worker = self._idle.pop()
        self._busy[worker.pipe] = worker, part
        try:
            worker.send(part)
        except WorkerLost as problem:
            self._replace(worker, part, problem)

    def receive(self) -> Sequence[SliceDone]:
        if self._jobs == 1:
            return [self._work(self._waiting.pop())]
        done: list[SliceDone] = []
        while not done:
            for pipe in connection.wait(list(self._busy)):
                worker, part = self._busy[pipe]
                try:
                    fine, result = worker.receive()
                except WorkerLost as problem:
                    self._replace(worker, part, problem)
                    continue
                del self._busy[pipe]
                self._idle.append(worker)
                if not fine:
                    raise result
                self._lost.pop(part.number, None)
                done.append(result)
        return done

    def _replace(self, lost: Worker, part: Slice, problem: WorkerLost) -> None:
        del self._busy[lost.pipe]
        self._workers.remove(lost)
        lost.end()
        self._lost[part.number] = self._lost.get(part.number, 0) + 1
        if self._lost[part.number] >= TRIES:
            raise problem
        start_workers(self._workers, 1, _nothing)
        worker = self._workers[-1]
        worker.employ(self._work)
        self._idle.append(worker)
        self.send(part)


def _nothing() -> None:
    """Workers need no preparation."""

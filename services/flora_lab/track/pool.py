"""Work on many pictures in several processes, with the results in order.

Only a bounded number of results waits for its turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from multiprocessing import connection
from types import TracebackType
from typing import Any, Final, TypeVar

from flora_lab.threads import on_one_core, one_core
from flora_lab.worker_process import Worker, start_workers

Task = TypeVar("Task")
Result = TypeVar("Result")

WAITING_PER_WORKER: Final = 3
"""Tasks handed out and results not yet taken, per worker."""


class Pool:
    """Maps work over tasks; a context manager, at whose end the workers are gone.

    Args:
        jobs: how many processes; with 1 the work is done in this one.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._workers: list[Worker] = []

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def map(self, work: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """``work(task)`` for each task, in the order of the tasks, which are taken as they are needed.

        Args:
            work: can be pickled; every worker gets one copy.
            tasks: can be pickled.

        Raises:
            WorkerLost: a worker is gone. What ``work`` raises is raised here too.
        """
        if self.jobs == 1:
            with on_one_core():
                yield from map(work, tasks)
            return
        if not self._workers:
            start_workers(self._workers, self.jobs, one_core)
        for worker in self._workers:
            worker.employ(work)
        yield from self._in_order(iter(tasks))

    def _in_order(self, tasks: Iterator[Any]) -> Iterator[Any]:
        most = WAITING_PER_WORKER * self.jobs
        idle = list(self._workers)
        busy: dict[object, tuple[Worker, int]] = {}
        done: dict[int, tuple[bool, Any]] = {}
        handed_out = taken = 0
        more = True
        while True:
            while more and idle and handed_out - taken < most:
                try:
                    task = next(tasks)
                except StopIteration:
                    more = False
                    break
                worker = idle.pop()
                worker.send(task)
                busy[worker.pipe] = worker, handed_out
                handed_out += 1
            if not busy and taken == handed_out:
                return
            # where a result can go out, those that are ready are taken in first, so that nobody waits for work
            ready = (
                connection.wait([worker.pipe for worker, _ in busy.values()], 0 if taken in done else None)
                if busy
                else []
            )
            for pipe in ready:
                worker, number = busy.pop(pipe)
                done[number] = worker.receive()
                idle.append(worker)
            if taken in done and (not more or not idle or handed_out - taken >= most):
                fine, result = done.pop(taken)
                if not fine:
                    raise result
                taken += 1
                yield result

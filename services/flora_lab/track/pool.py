"""Work on many pictures in several processes, with the results in order.

Workers are fresh interpreters (spawn), not forks: OpenCV keeps threads, and a forked copy of a process with threads
may hang. Each has one task at a time, so that neither side can block the other with a full pipe, and only a bounded
number of results waits for its turn. Workers end with their pipe: also when this process is killed.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import connection, resource_tracker
from types import TracebackType
from typing import Any, Final, TypeVar

import cv2

from flora_common.errors import FloraError

Task = TypeVar("Task")
Result = TypeVar("Result")

WAITING_PER_WORKER: Final = 3
"""Tasks handed out and results not yet taken, per worker."""
_SECONDS_TO_END: Final = 5.0


class Pool:
    """Maps work over tasks; a context manager, at whose end the workers are gone.

    Args:
        jobs: how many processes; with 1 the work is done in this one.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._workers: list[_Worker] = []

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
            FloraError: a worker is gone. What ``work`` raises is raised here too.
        """
        if self.jobs == 1:
            with _one_thread():
                yield from map(work, tasks)
            return
        if not self._workers:
            self._start()
        parcel = pickle.dumps(work, protocol=pickle.HIGHEST_PROTOCOL)
        for worker in self._workers:
            worker.send_bytes(parcel)
        yield from self._in_order(iter(tasks))

    def _in_order(self, tasks: Iterator[Any]) -> Iterator[Any]:
        most = WAITING_PER_WORKER * self.jobs
        idle = list(self._workers)
        busy: dict[object, tuple[_Worker, int]] = {}
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

    def _start(self) -> None:
        # the tracker would unblock signals, were it first started in between
        resource_tracker.ensure_running()
        with _interrupts_held():
            for _ in range(self.jobs):
                self._workers.append(_Worker())


class _Worker:
    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()

    def send_bytes(self, parcel: bytes) -> None:
        self._still_there(lambda: self.pipe.send_bytes(parcel))

    def send(self, task: object) -> None:
        self._still_there(lambda: self.pipe.send((task,)))

    def receive(self) -> tuple[bool, Any]:
        """Whether the work was done, and its result or the exception."""
        answer: tuple[bool, Any] = self._still_there(self.pipe.recv)
        return answer

    def end(self) -> None:
        self.pipe.close()
        self._process.terminate()
        self._process.join(_SECONDS_TO_END)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def _still_there(self, exchange: Callable[[], Any]) -> Any:
        try:
            return exchange()
        except (EOFError, ConnectionError) as problem:
            self._process.join(_SECONDS_TO_END)
            raise FloraError(
                f"a worker process ended with status {self._process.exitcode}; if memory ran out, use fewer --jobs"
            ) from problem


def _serve(pipe: connection.Connection) -> None:
    """What a worker does: a tuple is a task, anything else the work to do from now on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    work: Callable[[Any], Any] | None = None
    # the other end has gone: nobody wants the result
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            message = pipe.recv()
            if not isinstance(message, tuple):
                work = message
                continue
            assert work is not None
            try:
                answer = (True, work(message[0]))
            except Exception as problem:  # noqa: BLE001 - raised again in the process that waits for the result
                if not isinstance(problem, FloraError):
                    problem.add_note("In a worker process:\n" + "".join(traceback.format_exception(problem)))
                answer = (False, problem)
            pipe.send(answer)


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C goes to every process of a terminal, but only this one is to answer it, when the block has ended.

    Processes that are started inside never hear it: a signal that is blocked stays blocked in them. Here blocking is
    not enough, for a thread of some library may take the signal; so the handler waits too.
    """
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
    if came:
        raise KeyboardInterrupt


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """One core, as in a worker."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)

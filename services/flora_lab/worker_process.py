"""A process of its own that does one piece of work after the other.

Workers are fresh interpreters (spawn), not forks: OpenCV and numba keep threads, and a forked copy of a process with
threads may hang. Each has one task at a time, so that neither side can block the other with a full pipe. Workers end
with their pipe: also when this process is killed.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Callable, Iterator
from multiprocessing import connection, resource_tracker
from typing import Any, Final

from flora_common.errors import FloraError

_SECONDS_TO_END: Final = 5.0


class WorkerLost(FloraError):
    """A worker process is gone, and what it was at with it."""


class Worker:
    """One process.

    Args:
        prepare: called there first; can be pickled.

    Attributes:
        pipe: readable when the worker has answered, or is gone.
    """

    def __init__(self, prepare: Callable[[], None]) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, prepare), daemon=True)
        self._process.start()
        theirs.close()

    def employ(self, work: Callable[[Any], Any]) -> None:
        """What it does with tasks from now on; ``work`` can be pickled.

        Raises:
            WorkerLost: it is gone.
        """
        parcel = pickle.dumps(work, protocol=pickle.HIGHEST_PROTOCOL)
        self._still_there(lambda: self.pipe.send_bytes(parcel))

    def send(self, task: object) -> None:
        """Hand it a task, which can be pickled.

        Raises:
            WorkerLost: it is gone.
        """
        self._still_there(lambda: self.pipe.send((task,)))

    def receive(self) -> tuple[bool, Any]:
        """Whether the work was done, and its result or the exception.

        Raises:
            WorkerLost: it is gone.
        """
        answer: tuple[bool, Any] = self._still_there(self.pipe.recv)
        return answer

    def end(self) -> None:
        """End it, whatever it is doing."""
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
            raise WorkerLost(
                f"a worker process ended with status {self._process.exitcode}; if memory ran out, use fewer --jobs"
            ) from problem


def start_workers(workers: list[Worker], count: int, prepare: Callable[[], None]) -> None:
    """So many workers more, none of which hears Ctrl-C.

    Args:
        workers: those that were started are added, also when an error ends it; whoever has the list ends them.
        count: how many.
        prepare: see :class:`Worker`.

    Raises:
        KeyboardInterrupt: it came meanwhile.
    """
    # the tracker would unblock signals, were it first started in between
    resource_tracker.ensure_running()
    with _interrupts_held():
        for _ in range(count):
            workers.append(Worker(prepare))


def outcome(work: Callable[[Any], Any], task: Any) -> tuple[bool, Any]:
    """Whether the work was done, and its result or the exception, for the process that waits for it to raise again."""
    try:
        return True, work(task)
    except Exception as problem:  # noqa: BLE001 - raised again in the process that waits for the result
        if not isinstance(problem, FloraError):
            problem.add_note("In a worker process:\n" + "".join(traceback.format_exception(problem)))
        return False, problem


def _serve(pipe: connection.Connection, prepare: Callable[[], None]) -> None:
    """What a worker does: a tuple is a task, anything else the work to do from now on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    prepare()
    work: Callable[[Any], Any] | None = None
    # the other end has gone: nobody wants the result
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            message = pipe.recv()
            if not isinstance(message, tuple):
                work = message
                continue
            assert work is not None
            pipe.send(outcome(work, message[0]))


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

"""Work on many pictures in several threads, with the results in order.

Threads, not processes: OpenCV and numpy let others go on while they work, and what a photograph shows is ten megabytes,
which take longer through a pipe than to be found. Only a bounded number of results waits for its turn.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Final, TypeVar

from flora_lab.threads import on_one_core

Task = TypeVar("Task")
Result = TypeVar("Result")

WAITING: Final = 2
"""Results that may wait for their turn, besides a task in each thread: each is a picture with all that was found."""


class Pool:
    """Maps work over tasks; a context manager, at whose end the threads are gone.

    Args:
        jobs: how many threads; with 1 the work is done in the caller's. OpenCV and products of matrices use one core in
            each, and in the caller's too.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._threads: ThreadPoolExecutor | None = None
        self._held = contextlib.ExitStack()

    def __enter__(self) -> Pool:
        with contextlib.ExitStack() as held:
            held.enter_context(on_one_core())
            if self.jobs > 1:
                self._threads = ThreadPoolExecutor(self.jobs, thread_name_prefix="look")
                held.callback(self._threads.shutdown, cancel_futures=True)
            self._held = held.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._held.close()
        self._threads = None

    def map(self, work: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """``work(task)`` for each task, in the order of the tasks, which are taken as they are needed.

        What ``work`` raises is raised here too.

        Args:
            work: may be called in several threads at once.
            tasks: what it is called with.
        """
        if self._threads is None:
            yield from map(work, tasks)
            return
        waiting: deque[Future[Result]] = deque()
        try:
            for task in tasks:
                waiting.append(self._threads.submit(work, task))
                if len(waiting) >= self.jobs + WAITING:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:  # nobody takes what is left
            for one in waiting:
                one.cancel()

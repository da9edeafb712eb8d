"""A process that does one piece of work after the other: it raises what the work raises, and is told to be lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from flora_common.errors import BadPicture
from flora_lab.worker_process import Worker, WorkerLost, start_workers

START = """
import os, signal, sys
from flora_lab import worker_process

start = worker_process.Worker.__init__

def start_and_interrupt(self, prepare):
    start(self, prepare)
    os.killpg(0, signal.SIGINT)

worker_process.Worker.__init__ = start_and_interrupt
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    workers = []
    try:
        worker_process.start_workers(workers, 2, os.getpid)
    except KeyboardInterrupt:
        print(len(workers), "started", flush=True)
    for worker in workers:
        worker.employ(abs)
        worker.send(-7)
        print(*worker.receive())
        worker.end()
"""


def nothing() -> None:
    """What these workers begin with."""


def picky(number: int) -> int:
    if number == 3:
        raise BadPicture("three is torn")
    if number == 4:
        raise ZeroDivisionError("four")
    if number == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_what_work_raises_comes_back_and_a_worker_that_is_killed_is_lost() -> None:
    workers: list[Worker] = []
    start_workers(workers, 1, nothing)
    (worker,) = workers
    worker.employ(picky)
    answers = []
    for number in (1, 3, 4):
        worker.send(number)
        answers.append(worker.receive())
    assert answers[0] == (True, 1)
    assert [fine for fine, _ in answers] == [True, False, False]
    torn, foreign = answers[1][1], answers[2][1]
    assert isinstance(torn, BadPicture)
    assert not hasattr(torn, "__notes__")
    assert isinstance(foreign, ZeroDivisionError)
    assert "in picky" in "".join(foreign.__notes__)
    worker.send(5)
    with pytest.raises(WorkerLost, match=r"ended with status -9; .*fewer --jobs"):
        worker.receive()
    worker.end()


def test_ctrl_c_while_workers_start_is_heard_afterwards_and_by_none_of_them() -> None:
    command = [sys.executable, "-c", START]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, start_new_session=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "2 started\nTrue 7\nTrue 7\n", "")

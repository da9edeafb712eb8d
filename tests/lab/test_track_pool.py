"""Work in several processes: in order, bounded, and gone when it should be."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from functools import partial

import cv2
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from flora_common.errors import BadPicture, FloraError
from flora_lab.track.pool import WAITING_PER_WORKER, Pool


def slow_square(number: int) -> int:
    time.sleep(0.02 * (number % 3))  # so that results come back out of order
    return number * number


def picky(number: int) -> int:
    if number == 3:
        raise BadPicture("three is torn")
    if number == 4:
        raise ZeroDivisionError("four")
    return number


def blas_threads(_: int) -> int:
    return max(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas")


def cv2_threads(_: int) -> int:
    return cv2.getNumThreads()


def deadly(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_results_come_in_order_and_few_wait() -> None:
    taken = 0

    def tasks() -> Iterator[int]:
        nonlocal taken
        for number in range(40):
            taken += 1
            yield number

    with Pool(2) as pool:
        for given, result in enumerate(pool.map(slow_square, tasks())):
            assert result == given * given
            assert taken - given <= WAITING_PER_WORKER * 2
        assert taken == 40
        assert list(pool.map(partial(pow, 2), range(10))) == [2**n for n in range(10)]  # other work, same workers
        assert list(pool.map(slow_square, [])) == []


def test_what_work_raises_is_raised_here() -> None:
    for jobs in (1, 2):
        with Pool(jobs) as pool:
            results = pool.map(picky, range(5))
            assert [next(results) for _ in range(3)] == [0, 1, 2]
            with pytest.raises(BadPicture, match="three is torn"):
                next(results)
    with Pool(2) as pool, pytest.raises(ZeroDivisionError) as raised:
        list(pool.map(picky, [4, 4]))
    assert "in picky" in "".join(raised.value.__notes__)


def test_a_worker_that_is_killed_is_told() -> None:
    with Pool(2) as pool, pytest.raises(FloraError, match=r"ended with status -9; .*fewer --jobs"):
        list(pool.map(deadly, range(5)))


@pytest.mark.parametrize("jobs", [1, 2])
def test_each_process_takes_one_core(jobs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with threadpool_limits(limits=2, user_api="blas"), Pool(jobs) as pool:
        assert list(pool.map(blas_threads, range(3))) == [1, 1, 1]
        assert set(pool.map(cv2_threads, range(3))) == {1}

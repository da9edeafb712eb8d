"""Work in several threads: in order, bounded, at the same time, and over when it should be."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from functools import partial

import cv2
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from flora_common.errors import BadPicture
from flora_lab.track.pool import WAITING, Pool


def slow_square(number: int) -> int:
    time.sleep(0.02 * (number % 3))  # so that results come back out of order
    return number * number


def picky(number: int) -> int:
    if number == 3:
        raise BadPicture("three is torn")
    return number


def blas_threads(_: int) -> int:
    return max(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas")


def cv2_threads(_: int) -> int:
    return cv2.getNumThreads()


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
            assert taken - given <= 2 + WAITING
        assert taken == 40
        assert list(pool.map(partial(pow, 2), range(10))) == [2**n for n in range(10)]  # other work, same threads
        assert list(pool.map(slow_square, [])) == []


def test_as_many_pictures_are_looked_at_at_once_as_there_are_threads() -> None:
    met = threading.Barrier(3, timeout=10.0)
    with Pool(3) as pool:
        assert sorted(pool.map(lambda _: met.wait(), range(3))) == [0, 1, 2]
    with Pool(1) as pool:
        assert list(pool.map(lambda _: threading.current_thread(), [0])) == [threading.main_thread()]


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_work_raises_is_raised_here(jobs: int) -> None:
    with Pool(jobs) as pool:
        results = pool.map(picky, range(5))
        assert [next(results) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(BadPicture, match="three is torn"):
            next(results)


def test_what_nobody_takes_is_not_begun_and_no_thread_is_left() -> None:
    begun: list[int] = []
    may_go_on = threading.Event()

    def work(number: int) -> int:
        begun.append(number)
        if number > 0:
            may_go_on.wait(10.0)
        return number

    before = threading.active_count()
    with Pool(2) as pool:
        results = pool.map(work, range(100))
        assert next(results) == 0
        results.close()
        may_go_on.set()
        assert list(pool.map(abs, [-1, -2])) == [1, 2]
    assert threading.active_count() == before
    assert set(begun) <= {0, 1, 2}


@pytest.mark.parametrize("jobs", [1, 2])
def test_each_thread_takes_one_core(jobs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    before = cv2.getNumThreads()
    with threadpool_limits(limits=2, user_api="blas"):
        with Pool(jobs) as pool:
            assert list(pool.map(blas_threads, range(3))) == [1, 1, 1]
            assert set(pool.map(cv2_threads, range(3))) == {1}
        assert blas_threads(0) == 2
    assert cv2.getNumThreads() == before

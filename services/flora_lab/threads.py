"""How many threads the mathematics libraries may use."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import cv2
from threadpoolctl import threadpool_limits


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Matrices of a few hundred rows are multiplied ten times faster in one thread than in two that wait for each
    other; and sums are then the same on any machine."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@contextlib.contextmanager
def on_one_core() -> Iterator[None]:
    """OpenCV and products of matrices use one for a while: those who work side by side share the others out among
    themselves. Is a decorator, too."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with one_blas_thread():
            yield
    finally:
        cv2.setNumThreads(before)

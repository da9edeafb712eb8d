"""Whether the wall clock is to be believed is asked of the kernel, and nothing is set on the way."""

from __future__ import annotations

import ctypes
import time
from types import SimpleNamespace

import pytest

from flora_common import clock_sync
from flora_common.clock_sync import is_right, is_synchronised
from flora_common.config import ClockSection


@pytest.mark.parametrize(("answer", "believed"), [(0, True), (1, True), (4, True), (5, False), (-1, False)])
def test_only_a_kernel_that_was_told_the_time_is_believed(
    monkeypatch: pytest.MonkeyPatch, answer: int, believed: bool
) -> None:
    asked: list[bytes] = []

    def adjtimex(timex: ctypes.Array[ctypes.c_char]) -> int:
        asked.append(timex.raw)
        return answer

    monkeypatch.setattr(ctypes, "CDLL", lambda _: SimpleNamespace(adjtimex=adjtimex))

    assert is_synchronised() is believed
    assert len(asked) == 1
    assert set(asked[0]) == {0}  # no modes: nothing is set


def test_a_system_that_cannot_be_asked_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda _: SimpleNamespace())

    assert not is_synchronised()


@pytest.mark.parametrize(("kind", "believed"), [("system", False), ("twin", True)])
def test_the_kernel_is_asked_about_the_machines_clock_and_not_about_the_grow_boxs(
    monkeypatch: pytest.MonkeyPatch, kind: str, believed: bool
) -> None:
    monkeypatch.setattr(clock_sync, "is_synchronised", lambda: False)
    assert is_right(ClockSection(kind=kind, twin="ipc:///tmp/box")) is believed  # type: ignore[arg-type]


def test_asking_this_machine_leaves_its_clock_alone() -> None:
    before = time.time() - time.monotonic()

    assert is_synchronised() in (True, False)
    assert abs(time.time() - time.monotonic() - before) < 1.0

"""Playing a recording again: at what time each message is said."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from flora_common.clock import NS
from flora_common.recording_reader import RecordingReader
from flora_monitor.tape import LONGEST_PAUSE_S, Played, Player


def said_at(log_times_s: list[float], rate: float) -> list[float]:
    """Real seconds at which messages of these log times are said."""
    now_s, said = [0.0], []
    player = object.__new__(Player)  # without a bus
    player._rig, player._only = None, "*"
    player._socket = cast(Any, SimpleNamespace(send_multipart=lambda _: said.append(now_s[0])))
    recorded = [
        SimpleNamespace(topic="a/tick", is_readable=True, log_time_ns=round(t * NS), payload=b"") for t in log_times_s
    ]

    class Reader:
        problem = ""

        def __iter__(self) -> Any:
            return iter(recorded)

    def sleep(seconds: float) -> None:
        now_s[0] += seconds

    played = Played()
    player.play(cast(RecordingReader, Reader()), played, rate=rate, sleep=sleep, now=lambda: now_s[0])
    assert played.sent == len(log_times_s)
    return said


def test_messages_come_as_they_were_recorded() -> None:
    assert said_at([1000.0, 1300.0, 1301.0], 10.0) == pytest.approx([0.0, 30.0, 30.1])


def test_nobody_waits_for_years_where_the_wall_clock_was_set() -> None:
    """A Pi that has no clock of its own begins in its past, and is told the time a minute later."""
    assert said_at([0.0, 60.0, 1.8e9, 1.8e9 + 5.0], 1.0) == pytest.approx([0.0, 60.0, 60.0, 65.0])
    assert said_at([0.0, LONGEST_PAUSE_S - 1.0], 1.0) == pytest.approx([0.0, LONGEST_PAUSE_S - 1.0])


def test_nobody_hurries_for_hours_where_the_wall_clock_was_set_back() -> None:
    assert said_at([9000.0, 9060.0, 60.0, 120.0], 1.0) == pytest.approx([0.0, 60.0, 60.0, 120.0])
    old_kept_value = [9000.0, 60.0, 9001.0, 9002.0]
    assert said_at(old_kept_value, 1.0) == pytest.approx([0.0, 0.0, 0.0, 1.0])

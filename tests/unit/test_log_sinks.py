"""Log lines: to a journal in the journal's place, to a terminal, and never twice for one lasting problem."""

from __future__ import annotations

import errno
import io
import logging
import sys
import types
from typing import Any

import pytest

from flora_common.log import PRIORITIES, SAME_KIND_S, Log, choose_sink, journal_sink, terminal_sink

Line = tuple[int, str, str, dict[str, Any]]


def collect(**options: Any) -> tuple[Log, list[Line]]:
    lines: list[Line] = []
    return Log("flora-led", lambda *line: lines.append(line), **options), lines


def test_priorities_are_syslogs() -> None:
    assert PRIORITIES == {
        logging.DEBUG: 7,
        logging.INFO: 6,
        logging.WARNING: 4,
        logging.ERROR: 3,
        logging.CRITICAL: 2,
    }


def test_levels_and_common_fields() -> None:
    log, lines = collect(common={"run": "bean-07"})
    log.debug("hidden")
    log.event("frame_saved", tick=3)
    log.error("gone", reason="x")
    assert lines == [
        (logging.INFO, "flora-led", "frame_saved", {"run": "bean-07", "tick": 3}),
        (logging.ERROR, "flora-led", "gone", {"run": "bean-07", "reason": "x"}),
    ]


def test_a_lasting_problem_is_told_when_it_begins_changes_and_ends() -> None:
    log, lines = collect()
    for reason in ("no NAS", "no NAS", "no NAS", "read-only", "read-only"):
        log.problem("nas", reason)
    log.solved("nas")
    log.solved("nas")
    assert [(text, fields.get("reason")) for _, _, text, fields in lines] == [
        ("nas", "no NAS"),
        ("nas", "read-only"),
        ("nas_solved", None),
    ]


def test_a_text_that_changes_with_each_tick_is_told_every_ten_minutes() -> None:
    now_s = 0.0
    log, lines = collect(now_s=lambda: now_s)
    for tick in range(1, 26):
        log.problem("degraded", f"no photograph for tick {tick}", kind="camera")
        now_s += 60.0
    assert [fields["reason"] for _, _, _, fields in lines] == [f"no photograph for tick {tick}" for tick in (1, 11, 21)]


def test_another_kind_a_solved_one_and_one_of_no_kind_are_told_at_once() -> None:
    log, lines = collect(now_s=lambda: 0.0)
    log.problem("degraded", "tick 1", kind="camera")
    log.problem("degraded", "tick 2; full", kind="camera, disk")
    log.problem("degraded", "tick 3", kind="camera")
    log.solved("degraded")
    log.problem("degraded", "tick 4", kind="camera")
    log.problem("degraded", "tick 5")
    log.problem("degraded", "tick 6")
    said = [fields.get("reason") or text for _, _, text, fields in lines]
    assert said == ["tick 1", "tick 2; full", "tick 3", "degraded_solved", "tick 4", "tick 5", "tick 6"]


def test_the_same_text_is_not_told_again_however_long_it_lasts() -> None:
    now_s = 0.0
    log, lines = collect(now_s=lambda: now_s)
    for _ in range(5):
        log.problem("degraded", "no NAS", kind="target")
        now_s += SAME_KIND_S
    assert len(lines) == 1


def test_terminal_line(capsys: pytest.CaptureFixture[str]) -> None:
    terminal_sink(logging.WARNING, "flora-led", "capped", {"run": "bean", "share": 0.123456789, "why": "too much"})
    assert capsys.readouterr().err == "W flora-led capped share=0.123457 why='too much'\n"


class FakeJournal:
    """systemd.journal, as far as we use it."""

    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []
        self.is_gone = False

    def send(self, message: str, **fields: Any) -> None:
        if self.is_gone:
            raise ConnectionRefusedError("no journal")
        self.sent.append({"MESSAGE": message, **fields})


@pytest.fixture
def journal(monkeypatch: pytest.MonkeyPatch) -> FakeJournal:
    fake = FakeJournal()
    module = types.ModuleType("systemd")
    module.journal = fake  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "systemd", module)
    return fake


def test_journal_lines_are_structured(journal: FakeJournal) -> None:
    log = Log("flora-capture", journal_sink(), common={"run": "bean-07"})
    log.warning("camera_hung", tick=3, after_s=25.0)
    assert journal.sent == [
        {
            "MESSAGE": "camera_hung run=bean-07 tick=3 after_s=25",
            "PRIORITY": 4,
            "SYSLOG_IDENTIFIER": "flora-capture",
            "FLORA_EVENT": "camera_hung",
            "FLORA_RUN": "bean-07",
            "FLORA_TICK": "3",
            "FLORA_AFTER_S": "25.0",
        }
    ]


def test_a_journal_that_is_gone_stops_no_work(journal: FakeJournal, capsys: pytest.CaptureFixture[str]) -> None:
    journal.is_gone = True
    Log("flora-led", journal_sink()).event("lit")
    assert capsys.readouterr().err == "flora-led: journal not reachable (no journal): lit \n"


def test_the_journal_is_chosen_under_systemd_only(journal: FakeJournal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    assert choose_sink() is terminal_sink
    monkeypatch.setenv("JOURNAL_STREAM", "8:12345")
    choose_sink()(logging.INFO, "flora-led", "lit", {})
    assert journal.sent[0]["FLORA_EVENT"] == "lit"
    monkeypatch.setitem(sys.modules, "systemd", None)
    assert choose_sink() is terminal_sink


class FullDisk(io.StringIO):
    """What a file on a disk without room says to a line."""

    def write(self, _: str) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_line_that_finds_no_room_does_not_end_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", FullDisk())
    log = Log("flora-led", terminal_sink)
    log.warning("capped", share=0.5)
    log.problem("strips", "gone")

"""Progress that is told to who waits from afar."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.progress import TaskID

from flora_lab import bars
from flora_lab.bars import ENVIRONMENT, Bars, Teller, Told, read_told
from flora_lab.diagnose import command
from flora_lab.paper.screen import Screen


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(ENVIRONMENT, str(tmp_path / "told.json"))
    return tmp_path / "told.json"


def test_a_bar_that_nobody_sees_is_told_all_the_same(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bars, "EVERY_S", 0.0)
    with Bars(console=Console(), disable=True) as shown:
        task = shown.add_task("reading", total=None)
        assert read_told(file) == Told("reading")
        shown.update(task, description="epochs", total=4, completed=1)
        assert read_told(file) == Told("epochs", 0.25)
        shown.advance(task)
        assert read_told(file) == Told("epochs", 0.5)
        shown.update(task, completed=9)
        assert read_told(file) == Told("epochs", 1.0)
        shown.update(task, visible=False, description="hidden")
        assert read_told(file) == Told("epochs", 1.0)
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_a_stage_of_a_diagnosis_that_begins_anew_has_one_bar(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    added: list[str] = []

    def add_task(self: Bars, name: str, **fields: Any) -> TaskID:
        added.append(name)
        return real(self, name, **fields)

    real = Bars.add_task
    monkeypatch.setattr(Bars, "add_task", add_task)
    monkeypatch.setattr(bars, "EVERY_S", 0.0)
    with command._progress(silent=True) as (stage, _):
        for total in (4, 2):
            step = stage("looking for causes", total)
            step()
            assert read_told(file) == Told("looking for causes", 1.0 / total)
            for _more in range(total - 1):
                step()
            assert read_told(file) == Told("looking for causes", 1.0)
    assert added == ["looking for causes"]


def test_it_is_told_now_and_then_and_at_once_where_the_work_is_another(file: Path) -> None:
    teller = Teller()
    teller.tell("one", 0, 10)
    teller.tell("one", 5, 10)
    assert read_told(file) == Told("one", 0.0)
    teller.tell("two", 1, 10)
    assert read_told(file) == Told("two", 0.1)


def test_the_paper_tells_its_steps(file: Path) -> None:
    Screen(4, is_silent=True).heading(3, "evolution")
    assert read_told(file) == Told("evolution", 0.5)


def test_who_cannot_be_told_ends_no_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ENVIRONMENT, str(tmp_path / "no" / "folder" / "told.json"))
    Teller().tell("one", 1, 2)
    monkeypatch.delenv(ENVIRONMENT)
    Teller().tell("one", 1, 2)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_progress_is_none(tmp_path: Path) -> None:
    assert read_told(tmp_path / "missing") is None
    (tmp_path / "torn").write_text('{"text": "ep')
    assert read_told(tmp_path / "torn") is None

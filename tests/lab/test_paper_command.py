"""``flora-lab paper``: what is refused, how a failing step ends it, and the whole of it at its smallest."""

from __future__ import annotations

import json
import os
import re
import time
from pathlib import Path

import pytest

from flora_common.installed import command
from flora_common.lock import hold
from flora_lab.dataset.store import read_dataset
from flora_lab.main import main
from flora_lab.paper import work
from flora_lab.paper.children import run_child
from flora_lab.paper.ledger import read_ledger
from flora_lab.paper.page import NUMBERS_FILE, REPORT_FILE
from flora_lab.paper.pipeline import DATA, LAB_COMMAND, RUNS, steps_of
from flora_lab.paper.published import PUBLISHED
from flora_lab.paper.scales import SCALES, SMOKE, Asked
from flora_lab.paper.screen import Screen
from flora_lab.paper.steps import do_all, keys
from flora_lab.stopped_work import WITHIN
from flora_twin.main import main as twin_main


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    assert main(["paper", *map(str, arguments)]) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    return said


def test_a_scale_that_does_not_exist_is_told_with_the_nearest(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert "did you mean `small`" in refused(capsys, "--scale", "smal", "-o", tmp_path / "p")
    assert not (tmp_path / "p").exists()


def test_a_missing_output_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert "-o is missing" in refused(capsys)


def test_a_folder_with_other_files_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")

    assert "holds other files" in refused(capsys, "-o", tmp_path)


def test_a_folder_in_which_another_process_works_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    descriptor = hold(tmp_path / work.LOCK_FILE)

    assert f"process {os.getpid()}" in refused(capsys, "-o", tmp_path)

    os.close(descriptor)


@pytest.mark.parametrize("status", [1, 2])
def test_a_failing_command_ends_it_with_its_line_and_status(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, status: int
) -> None:
    program = tmp_path / "fails"
    program.write_text(f"#!/bin/sh\necho 'flora-twin: no room for <plants>' >&2\nexit {status}\n")
    program.chmod(0o755)
    monkeypatch.setattr(work, "command", lambda name: str(program))

    assert main(["paper", "--scale", "smoke", "-o", str(tmp_path / "p"), "--quiet"]) == status

    said = capsys.readouterr().err.strip()
    assert re.fullmatch(
        r"flora-lab: step 1 of \d+, the dataset experiments[^:]*: flora-twin: no room for <plants> "
        rf"\(status {status}\); what is finished is kept, and the same command goes on",
        said,
    )
    entry = read_ledger(tmp_path / "p").get(RUNS)
    assert entry is not None
    assert not entry.is_finished


@pytest.mark.parametrize("within", [None, "flora-lab something"])
def test_who_stops_it_is_told_that_it_goes_on_where_nobody_else_began_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], within: str | None
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("flora_lab.paper.work.do_all", stopped)
    monkeypatch.delenv(WITHIN, raising=False)
    if within is not None:
        monkeypatch.setenv(WITHIN, within)
    assert main(["paper", "--scale", "smoke", "-o", str(tmp_path / "out")]) == 130
    assert ("what is finished is kept; the same command goes on" in capsys.readouterr().err) == (within is None)


def test_how_many_processes_work_changes_no_step_and_the_seed_changes_all() -> None:
    def of(asked: Asked, *, is_silent: bool = False) -> dict[str, str]:
        return keys(steps_of(asked, is_silent=is_silent), "flora 1")

    one = of(Asked(SMOKE, 1))

    assert one == of(Asked(SMOKE, 1, jobs=7), is_silent=True)
    assert not set(one.values()) & set(of(Asked(SMOKE, 2)).values())


@pytest.mark.parametrize("scale", SCALES)
def test_every_command_has_the_options_that_steps_give_it(
    scale: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERMINAL_WIDTH", "200")
    for step in steps_of(Asked(SCALES[scale], 1, jobs=2), is_silent=True):
        given = step.arguments(tmp_path, is_begun=False) + step.arguments(tmp_path, is_begun=True)
        program = main if step.program == LAB_COMMAND else twin_main
        capsys.readouterr()
        assert program([given[0], "--help"]) == 0
        told = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", capsys.readouterr().out))
        assert {text for text in given if text.startswith("-")} <= told, step.name


@pytest.mark.parametrize("scale", ["small", "full"])
def test_the_papers_recipe_keeps_the_settings_nearest_to_the_papers(scale: str) -> None:
    steps = {step.name: step.words for step in steps_of(Asked(SCALES[scale], 1), is_silent=True)}

    for task in ("left", "middle"):
        assert "--neat" not in steps[f"evolved-{task}-paper"]
        own = steps[f"evolved-{task}-own"]
        assert own[own.index("--neat") + 1] == "sparse"


def test_the_first_steps_make_runs_and_a_training_set_by_the_installed_commands(tmp_path: Path) -> None:
    steps = steps_of(Asked(SMOKE, 1), is_silent=True)[:3]

    with work.held(tmp_path / "p") as descriptor:
        do_all(
            steps,
            tmp_path / "p",
            software="flora 1",
            run=lambda step, words: run_child(command(step.program), words, held=descriptor, is_silent=True),
            watcher=Screen(len(steps), is_silent=True),
            monotonic_s=time.monotonic,
        )

    info = read_dataset(tmp_path / "p" / DATA).info
    assert sorted(run.name for run in info.run) == ["closed-1", "open-1", "open-2"]
    assert info.vectors > 5000


@pytest.mark.slow
def test_the_whole_paper_at_its_smallest_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["paper", "--scale", "smoke", "-o", str(tmp_path / "p"), "--json"]

    assert main(arguments) == 0
    numbers = json.loads(capsys.readouterr().out)

    assert [row["key"] for row in numbers["rows"]] == [one.key for one in PUBLISHED]
    assert json.loads((tmp_path / "p" / NUMBERS_FILE).read_text()) == numbers
    report = (tmp_path / "p" / REPORT_FILE).read_text()
    assert report.endswith("</html>\n")
    assert main(arguments) == 0
    assert json.loads(capsys.readouterr().out) == numbers

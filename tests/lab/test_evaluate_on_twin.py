"""``flora-lab evaluate --on twin``: runs by another program are kept, stopped and gone on with; failures are told."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import pytest
import twin_fakes
from evaluate_fakes import TIP_ONLY, check_page, only, refused, told, twin

from flora_common.lock import hold
from flora_lab.main import main


def test_finished_runs_are_not_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program, out = twin(tmp_path, monkeypatch), tmp_path / "out"
    wanted = (TIP_ONLY, "--on", "twin", "-o", out)
    first = told(capsys, *wanted, "--repeat", "1")
    assert told(capsys, *wanted, "--repeat", "1") == first
    assert len(twin_fakes.calls(program)) == 1

    more = told(capsys, *wanted, "--repeat", "2")
    assert [call[-3] for call in twin_fakes.calls(program)] == ["--seed=20001", "--seed=20002"]
    assert [trial["seed"] for trial in more["trials"]] == [20001, 20002]
    assert more["trials"][0] == first["trials"][0]

    shutil.rmtree(next((out / "runs").glob("*-20001")))
    told(capsys, *wanted, "--repeat", "2")
    assert len(twin_fakes.calls(program)) == 3


def test_photographs_are_kept_where_they_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    twin(tmp_path, monkeypatch)
    told(capsys, TIP_ONLY, "--on", "twin", "--repeat", "1", "-o", tmp_path / "out", "--keep-photographs")
    (run,) = (tmp_path / "out" / "runs").iterdir()
    assert len(list((run / twin_fakes.RUN / "frames").iterdir())) == len(twin_fakes.TIPS)
    assert not (run / "rig" / "nas").exists()


@pytest.mark.parametrize(
    ("behaviour", "said"),
    [
        ("fail", "flora-stem ended with status 1"),
        ("refuse", "the controller is refused"),
        ("silent", "flora-twin ended with status 1"),
        ("nothing", "what flora-twin wrote cannot be used"),
        ("other seed", "is of another run, seed differs"),
    ],
)
def test_a_run_that_fails_is_told_and_the_others_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], behaviour: str, said: str
) -> None:
    program, out = twin(tmp_path, monkeypatch, {"20002": behaviour}), tmp_path / "out"
    assert main(["evaluate", str(TIP_ONLY), "--on", "twin", "-o", str(out), "--json"]) == 1
    streams = capsys.readouterr()
    numbers = json.loads(streams.out)
    (line,) = streams.err.strip().splitlines()
    assert line.startswith("flora-lab: tip_only in scenario reality on plant 20002: ")
    assert said in line
    assert said in only([numbers["failed"]])["tip_only in scenario reality on plant 20002"]
    assert [trial["seed"] for trial in numbers["trials"]] == [20001, 20003]
    assert json.loads((out / "evaluation.json").read_text()) == numbers
    check_page(out / "report.html", "Failed: ", said)
    (left,) = (out / "runs").glob("*.unfinished")
    assert (left / "rig" / "logs" / "flora-stem.log").is_file()

    # mended, the same command does what is missing
    (program.parent / twin_fakes.PLAN).write_text("{}")
    assert len(told(capsys, TIP_ONLY, "--on", "twin", "-o", out)["trials"]) == 3
    assert len(twin_fakes.calls(program)) == 4
    assert not list((out / "runs").glob("*.unfinished"))


def test_where_all_runs_fail_there_is_still_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    twin(tmp_path, monkeypatch, {"20001": "fail"})
    numbers = told(capsys, TIP_ONLY, "--on", "twin", "--repeat", "1", "-o", tmp_path / "out", status=1)
    assert (numbers["trials"], numbers["summary"], numbers["gap"]) == ([], [], [])
    check_page(tmp_path / "out" / "report.html", "Failed: ")


def test_without_a_folder_nothing_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    program = twin(tmp_path, monkeypatch)
    assert len(told(capsys, TIP_ONLY, "--on", "twin", "--repeat", "1")["trials"]) == 1
    assert list((tmp_path / "temporary").iterdir()) == []
    (program.parent / twin_fakes.PLAN).write_text('{"20001": "fail"}')
    told(capsys, TIP_ONLY, "--on", "twin", "--repeat", "1", status=1)
    assert len(list((tmp_path / "temporary").glob("*/runs/*/rig/logs/*"))) == 1


def test_progress_is_told_a_line_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = twin(tmp_path, monkeypatch)
    assert main(["evaluate", str(TIP_ONLY), "--on", "twin", "--repeat", "2"]) == 0
    streams = capsys.readouterr()
    assert "run 2 of 2, tip_only in scenario reality on plant 20002: fitness 90.2 %" in streams.err
    assert re.search(r"tip_only +reality +20001 +90\.1 +3\.0 +80\.0 +95\.0 +height +4\.0 +1\.5 +1\.2", streams.out)
    assert all("--quiet" in call for call in twin_fakes.calls(program))


def test_a_photograph_that_the_strip_cannot_show_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    twin(tmp_path, monkeypatch, {"20002": "torn"})
    assert main(["evaluate", str(TIP_ONLY), "--on", "twin", "--repeat", "2"]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "left out" in line]
    assert len(told) == 1
    assert told[0].startswith("run 2 of 2, tip_only in scenario reality on plant 20002: left out of the strip: ")
    assert "2.jpg" in told[0]


@pytest.mark.parametrize("behaviour", ["SIGINT", "SIGTERM"])
def test_who_stops_it_keeps_what_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], behaviour: str
) -> None:
    program, out = twin(tmp_path, monkeypatch, {"20002": behaviour}), tmp_path / "out"
    arguments = ["evaluate", str(TIP_ONLY), "--on", "twin", "-o", str(out), "--jobs", "1"]
    if behaviour == "SIGINT":
        assert main(arguments) == 130
        said = capsys.readouterr().err
        assert "flora-lab: interrupted" in said
    else:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 128 + 15
        said = capsys.readouterr().err
    assert "what is finished is kept; the same command goes on\n" in said
    # the run was told to end, and had the time for it
    assert (program.parent / twin_fakes.ENDED).read_text() == "20002\n"
    assert [run.name[-5:] for run in (out / "runs").iterdir() if ".unfinished" not in run.name] == ["20001"]
    assert not (out / "evaluation.json").exists()

    (program.parent / twin_fakes.PLAN).write_text("{}")
    assert len(told(capsys, TIP_ONLY, "--on", "twin", "-o", out)["trials"]) == 3
    assert len(twin_fakes.calls(program)) == 4


@pytest.mark.parametrize("jobs", [(), ("--jobs", "2")])
def test_runs_go_on_at_the_same_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], jobs: tuple[str, ...]
) -> None:
    twin(tmp_path, monkeypatch, {"20001": "meet 20002", "20002": "meet 20001"})
    numbers = told(capsys, TIP_ONLY, "--on", "twin", "-o", tmp_path / "out", *jobs)
    assert [trial["seed"] for trial in numbers["trials"]] == [20001, 20002, 20003]
    assert numbers["failed"] == {}


def test_who_stops_several_at_a_time_stops_them_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = twin(tmp_path, monkeypatch, {"20001": "hang", "20002": "hang", "20003": "SIGTERM"})
    with pytest.raises(SystemExit):
        main(["evaluate", str(TIP_ONLY), "--on", "twin", "-o", str(tmp_path / "out"), "--jobs", "3"])
    ended = (program.parent / twin_fakes.ENDED).read_text().splitlines()
    assert sorted(ended) == ["20001", "20002", "20003"]


def test_two_do_not_work_in_one_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    twin(tmp_path, monkeypatch)
    out = tmp_path / "out"
    out.mkdir()
    descriptor = hold(out / ".lock")
    try:
        assert f"process {os.getpid()} works in it" in refused(capsys, TIP_ONLY, "--on", "twin", "-o", out)
    finally:
        os.close(descriptor)
    assert told(capsys, TIP_ONLY, "--on", "twin", "--repeat", "1", "-o", out)["failed"] == {}


def test_options_of_the_virtual_rig_are_refused_without_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in (("--jobs", "2"), ("--keep-photographs",)):
        said = refused(capsys, TIP_ONLY, "--on", "nowhere.simulator", "-o", tmp_path / "out", *option)
        assert f"{option[0]}: has no effect, it is of runs --on twin; leave it out" in said
    said = refused(capsys, TIP_ONLY, "--on", "twin", "--keep-photographs")
    assert "--keep-photographs: has no effect, runs are kept with -o only" in said

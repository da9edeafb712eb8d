"""The folder of a demo or an experiment: what is in it is lost to no mistake, no second command and no other one."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from flora_common.errors import BadInput
from flora_common.runs import RunFile
from flora_twin.box import camera_section
from flora_twin.main import main
from flora_twin.rig import experiment
from flora_twin.rig.layout import LOCK_FILE, MARKER, RIG_FOLDER, claimed, make_layout, remove_sockets
from flora_twin.rig.supervisor import ServiceFailed

DEMO = "flora-twin demo"
EXPERIMENT = "flora-twin experiment"


def finished(out: Path, made_by: str = DEMO) -> Path:
    """What a command has left; returns the photograph in it."""
    with claimed(out, made_by) as root:
        layout = make_layout(root, RunFile(camera=camera_section()))
        remove_sockets(layout)
    photograph = layout.run.path / "frames" / "000001.jpg"
    photograph.parent.mkdir()
    photograph.write_bytes(b"three days")
    (out / "report.html").write_text("what came of it")
    return photograph


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--controller", "waypont"], "no built-in controller `waypont`; did you mean `waypoint`?"),
        (["--controller", "torn.controller.json"], "torn.controller.json: not a controller file"),
        (["--controller", "none.controller.json"], "no such file"),
        (["--seed", str(2**32)], "--seed"),
        (["--seed=-1"], "--seed"),
        (["--hours", "nan"], "--hours"),
        (["--fault", "clock_jumps@0.1h=soon"], "name the seconds of the jump"),
    ],
)
def test_what_a_demo_cannot_use_is_told_before_the_run_before_is_removed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("torn.controller.json").write_text("{}")
    photograph = finished(tmp_path / "out")
    assert main(["demo", "--out", str(tmp_path / "out"), "--hours", "1", *arguments]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.strip().count("\n") == 0
    assert photograph.read_bytes() == b"three days"


def test_a_task_that_cannot_be_steered_to_is_told_before_the_run_before_is_removed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photograph = finished(tmp_path, EXPERIMENT)
    assert main(["experiment", "-o", str(tmp_path), "--target", "0,0"]) == 2
    said = capsys.readouterr().err
    assert said == "flora-twin: --target and --obstacle: the target lies on the anchor; there is nowhere to grow to\n"
    assert photograph.exists()


def test_a_second_one_at_a_time_is_refused_and_the_first_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photograph = finished(tmp_path)
    with claimed(tmp_path, DEMO):
        assert main(["demo", "--out", str(tmp_path), "--hours", "1"]) == 2
    said = capsys.readouterr().err
    assert f"another flora-twin (pid {os.getpid()}) is at work there" in said
    assert said.strip().count("\n") == 0
    assert photograph.exists()


def test_the_lock_outlives_the_rig_that_is_replaced_and_ends_with_its_process(tmp_path: Path) -> None:
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom flora_common.runs import RunFile\n"
        "from flora_twin.box import camera_section\nfrom flora_twin.rig.layout import claimed, make_layout\n"
        f"with claimed(Path({str(tmp_path)!r}), {DEMO!r}) as root:\n"
        "    print(make_layout(root, RunFile(camera=camera_section())).sockets, flush=True)\n    sys.stdin.read()\n"
    )
    photograph = finished(tmp_path)
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
        assert first.stdout is not None
        sockets = Path(first.stdout.readline().decode().strip())
        assert not photograph.exists()
        with pytest.raises(BadInput, match="is at work there"), claimed(tmp_path, DEMO):
            pass
        first.kill()
    sockets.rmdir()
    with claimed(tmp_path, DEMO) as root:
        assert {entry.name for entry in root.iterdir()} >= {MARKER, LOCK_FILE}


def test_of_two_demos_that_begin_at_once_each_has_a_page_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    with contextlib.ExitStack() as usual:
        monkeypatch.setattr(experiment, "DASHBOARD_PORT", 0)
        free = experiment.take_port(usual)
    monkeypatch.setattr(experiment, "DASHBOARD_PORT", free)
    with contextlib.ExitStack() as first, contextlib.ExitStack() as second:
        ports = [experiment.take_port(held) for held in (first, second)]
        assert ports[0] == free
        assert ports[1] != free
        for port in ports:
            socket.create_server(("127.0.0.1", port)).close()  # as the page does
    with contextlib.ExitStack() as third:
        assert experiment.take_port(third) == free


def test_a_folder_that_no_configuration_can_name_is_refused(tmp_path: Path) -> None:
    out = tmp_path / os.fsdecode(b"b\xff")
    with pytest.raises(BadInput, match="is not UTF-8 text"), claimed(out, DEMO):
        pass
    assert not out.exists()


def test_other_work_in_the_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "nine").mkdir()
    (tmp_path / "nine" / "track.csv").write_text("mine")
    for _ in range(2):
        with claimed(tmp_path, DEMO) as root:
            remove_sockets(make_layout(root, RunFile(camera=camera_section())))
    assert (tmp_path / "nine" / "track.csv").read_text() == "mine"


@pytest.mark.parametrize("command", [["demo", "--out"], ["experiment", "-o"]])
def test_a_folder_with_files_of_ones_own_is_refused_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    mine = tmp_path / "report.html"
    mine.write_text("years of work")
    assert main([*command, str(tmp_path), "--hours", "1"]) == 2
    assert capsys.readouterr().err == f"flora-twin: {tmp_path}: holds other files; choose an empty or a new folder\n"
    assert main([*command, str(mine), "--hours", "1"]) == 2
    assert "no folder" in capsys.readouterr().err
    assert mine.read_text() == "years of work"
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]


def test_what_the_other_command_made_is_refused(tmp_path: Path) -> None:
    photograph = finished(tmp_path, EXPERIMENT)
    refused = pytest.raises(BadInput, match="was made by `flora-twin experiment` and is not replaced")
    with refused, claimed(tmp_path, DEMO):
        pass
    assert photograph.exists()


def test_a_folder_of_a_time_when_nothing_was_said_of_the_command_may_be_replaced(tmp_path: Path) -> None:
    root = tmp_path / RIG_FOLDER
    root.mkdir()
    (root / MARKER).write_text("a virtual rig; this folder is emptied when the next one is made here\n")
    with claimed(tmp_path, DEMO) as claimed_root:
        assert claimed_root == root


@pytest.mark.parametrize("problem", [ValueError("half a line"), ServiceFailed("no tick for 180 s")])
def test_whatever_goes_wrong_on_a_full_disk_is_told_as_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], problem: Exception
) -> None:
    def fail(*_: object) -> None:
        raise problem

    monkeypatch.setattr(experiment, "_run_in", fail)
    monkeypatch.setattr(experiment, "LEAST_FREE_BYTES", 2**62)
    assert main(["demo", "--out", str(tmp_path), "--controller", "dark"]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"flora-twin: {tmp_path}: no room on the disk; free some space")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("command", "what"), [(["grow", "--hours", "1"], "a track"), (["picture", "--hours", "0"], "a picture")]
)
def test_only_what_the_same_command_made_is_replaced_and_only_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str], what: str
) -> None:
    output = tmp_path / "a.jpg"
    output.write_text("years of work")
    for asked in ([], ["--force"]):
        assert main([*command, "-o", str(output), *asked]) == 2
        assert capsys.readouterr().err == (
            f"flora-twin: {output}: is there already, is not {what} and is not replaced; name another file with -o\n"
        )
        assert output.read_text() == "years of work"
    output.unlink()
    assert main([*command, "-o", str(output)]) == 0
    made = output.read_bytes()
    output.write_bytes(made[:-1])
    capsys.readouterr()
    assert main([*command, "-o", str(output)]) == 2
    assert capsys.readouterr().err == (
        f"flora-twin: {output}: is there already; name another file with -o, or add --force\n"
    )
    assert output.read_bytes() == made[:-1]
    assert main([*command, "-o", str(output), "--force"]) == 0
    assert output.read_bytes() == made
    assert main([*command, "-o", str(tmp_path), "--force"]) == 2


@pytest.mark.parametrize("seed", ["-1", str(2**32), str(2**63)])
@pytest.mark.parametrize("command", ["grow", "picture", "runs", "serve", "demo", "experiment"])
def test_a_seed_beyond_the_range_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, seed: str
) -> None:
    outputs = {"serve": "--state-dir", "demo": "--out"}
    assert main([command, outputs.get(command, "-o"), str(tmp_path / "a.png"), f"--seed={seed}"]) == 2
    said = capsys.readouterr().err
    assert "--seed" in said
    assert said.strip().count("\n") == 0
    assert not list(tmp_path.iterdir())

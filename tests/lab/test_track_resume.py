"""``flora-lab track`` in several threads, interrupted and killed: the track is the same to the last byte."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from drawn_run import make_run
from flora_lab.main import main
from flora_lab.track import part_file
from flora_lab.track.readings import Reading
from folders import same_folders

COMMAND = """
import os, signal, sys
from flora_lab.main import main
from flora_lab.track import part_file

add = part_file.PartFile.add

def add_and_strike(self, reading, memory):
    add(self, reading, memory)
    if len(self.readings) == 15:
        {strike}

part_file.PartFile.add = add_and_strike
sys.exit(main(sys.argv[1:]))
"""
DRAWING = """
import os, signal, sys
from flora_lab.main import main
from flora_lab.track import pictures

keep = pictures.Pictures._keep

def keep_and_strike(self, kind, reading, picture):
    keep(self, kind, reading, picture)
    if reading.index == 6:
        os.kill(os.getpid(), signal.{signal_name})

pictures.Pictures._keep = keep_and_strike
sys.exit(main(sys.argv[1:]))
"""


def run_in_process(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Ends only when every process that it started has let go of stdout and stderr."""
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, start_new_session=True)


@pytest.mark.parametrize("method", ["path", "paper"])
def test_any_number_of_threads_gives_the_same(method: str, tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 24, torn=(5,))
    for jobs in ("1", "3"):
        options = ["--jobs", jobs, "--overlays", str(tmp_path / f"seen{jobs}"), "--every", "7", "--method", method]
        assert main(["track", str(run), "-o", str(tmp_path / f"{jobs}.csv"), "-q", *options]) == 0
    assert (tmp_path / "1.csv").read_bytes() == (tmp_path / "3.csv").read_bytes()
    assert same_folders(tmp_path / "seen1", tmp_path / "seen3")


@pytest.mark.parametrize("method", ["path", "paper"])
def test_killed_and_started_again_gives_the_same(
    method: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 24, background=False, torn=(5,))
    (tmp_path / "broken").mkdir()
    whole = ["track", str(run), "-o", str(tmp_path / "whole.csv"), "--method", method]
    assert main([*whole, "--overlays", str(tmp_path / "seen_whole"), "--every", "9", "-q"]) == 0
    broken = ["track", str(run), "-o", str(tmp_path / "broken" / "t.csv"), "--method", method]
    killed = run_in_process(COMMAND.format(strike="os.kill(os.getpid(), signal.SIGKILL)"), *broken, "--jobs", "2")
    assert killed.returncode == -9
    assert killed.stderr == ""
    part = tmp_path / "broken" / ".t.csv.part"
    assert [p.name for p in part.parent.iterdir()] == [part.name]
    assert len(part.read_bytes().splitlines()) == 16
    with part.open("ab") as file:
        file.write(part.read_bytes().splitlines()[-1][:100])  # a line that was torn
    assert main([*broken, "--overlays", str(tmp_path / "seen_broken"), "--every", "9"]) == 0
    assert "going on after 15 of 24 frames" in capfd.readouterr().err
    assert (tmp_path / "broken" / "t.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert same_folders(tmp_path / "seen_whole", tmp_path / "seen_broken")
    assert not part.exists()


def test_interrupted_ends_with_its_threads(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 24)
    command = ["track", str(run), "-o", str(tmp_path / "t.csv"), "--jobs", "2"]
    ended = run_in_process(COMMAND.format(strike="os.killpg(0, signal.SIGINT)"), *command)
    assert ended.returncode == 130
    kept, said = ended.stderr.split("\n", 1)
    assert kept.startswith("15 of 24 frames are kept in ")
    assert said.strip() == "flora-lab: interrupted"
    assert sorted(p.name for p in tmp_path.iterdir()) == [".t.csv.part", "run"]
    assert main(command) == 0
    assert "going on after 15 of 24 frames" in capfd.readouterr().err


def test_sigterm_ends_it_as_ctrl_c_does(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 24)
    command = ["track", str(run), "-o", str(tmp_path / "t.csv"), "--jobs", "2"]
    ended = run_in_process(COMMAND.format(strike="os.kill(os.getpid(), signal.SIGTERM)"), *command)
    assert ended.returncode == 143
    assert ended.stderr.startswith("15 of 24 frames are kept in ")
    assert ended.stderr.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == [".t.csv.part", "run"]
    assert main(command) == 0
    assert "going on after 15 of 24 frames" in capfd.readouterr().err


@pytest.mark.parametrize(("signal_name", "status", "folders"), [("SIGTERM", 143, 0), ("SIGKILL", -9, 3)])
def test_ended_while_it_draws_leaves_nothing_for_ever(
    signal_name: str, status: int, folders: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run, made = make_run(tmp_path / "run", 10), tmp_path / "made"
    pictures = ["--contact", str(made / "s.png"), "--film", str(made / "f.avi"), "--overlays", str(made / "seen")]
    command = ["track", str(run), "-o", str(made / "t.csv"), "--jobs", "1", *pictures]
    ended = run_in_process(DRAWING.format(signal_name=signal_name), *command)
    assert ended.returncode == status
    left = [path for path in made.iterdir() if path.name != ".t.csv.part"]
    assert len(left) == folders
    assert all(path.is_dir() and path.name.endswith(".part") for path in left)
    assert (made / ".t.csv.part").exists()
    assert main(command) == 0
    assert "going on after 10 of 10 frames" in capfd.readouterr().err
    assert sorted(p.name for p in made.iterdir()) == ["f.avi", "s.png", "seen", "t.csv"]


def interrupted_after(frames: int, monkeypatch: pytest.MonkeyPatch, command: list[str]) -> None:
    add = part_file.PartFile.add

    def add_and_stop(self: part_file.PartFile, reading: Reading, memory: object) -> None:
        add(self, reading, memory)
        if len(self.readings) == frames:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(part_file.PartFile, "add", add_and_stop)
        assert main(command) == 130


class _FullDisk(io.FileIO):
    def write(self, data: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_told_with_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def held(path: Path) -> io.BufferedRandom:
        path.touch()
        return io.BufferedRandom(_FullDisk(path, "r+"))

    monkeypatch.setattr(part_file, "_hold", held)
    run = make_run(tmp_path / "run", 6)
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv")]) == 1
    said = f"flora-lab: {tmp_path}/.t.csv.part: no room on the disk; what was found before is kept\n"
    assert capfd.readouterr().err == said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (["--widest-stem-cm", "0.8"], "settings.widest_stem_cm was 0.6 and is 0.8 now"),
        (["--method", "paper"], "method was path and is paper now"),
        (["--frames", "1:"], "first frame was 0 and is 1 now"),
        (["--px-per-cm", "11"], "camera.px_per_cm was 10.0 and is 11.0 now"),
    ],
)
def test_other_work_drops_nothing_unasked(
    change: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    command = ["track", str(make_run(tmp_path / "run", 8)), "-o", str(tmp_path / "t.csv")]
    interrupted_after(4, monkeypatch, command)
    part = tmp_path / ".t.csv.part"
    before = part.read_bytes()
    capfd.readouterr()
    for more in ([], ["--force"]):
        assert main([*command, *change, *more]) == 2
        told = capfd.readouterr().err
        assert said in told
        assert "; --no-resume drops it, another -o leaves it there" in told
        assert told.count("\n") == 1
        assert part.read_bytes() == before
    assert main([*command, *change, "--no-resume"]) == 0
    assert "going on" not in capfd.readouterr().err
    assert not part.exists()


def test_a_part_that_is_none_is_told_and_kept(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    command = ["track", str(make_run(tmp_path / "run", 8)), "-o", str(tmp_path / "t.csv")]
    part = tmp_path / ".t.csv.part"
    for content, said in (
        (b"mine\n1\n", "is damaged"),
        (b"[]\n1\n", "is damaged"),
        (b'{"format": 1, "work": "ab"}\n{}\n', "is of other work"),
    ):
        part.write_bytes(content)
        assert main(command) == 2
        assert f".t.csv.part: {said}" in capfd.readouterr().err
        assert part.read_bytes() == content
    part.write_bytes(b'{"format": 2, "wo')  # killed before anything was found
    assert main([*command, "-q"]) == 0


def test_other_pictures_or_software_are_other_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 8)
    command = ["track", str(run), "-o", str(tmp_path / "t.csv")]
    interrupted_after(4, monkeypatch, command)
    os.utime(run / "frames" / "0002.jpg", ns=(1, 1))
    capfd.readouterr()
    assert main(command) == 2
    assert "is of other work, input was " in capfd.readouterr().err
    interrupted_after(5, monkeypatch, [*command, "--no-resume"])
    with monkeypatch.context() as patch:
        patch.setattr(part_file.cv2, "__version__", "3.0")
        capfd.readouterr()
        assert main(command) == 2
        assert "is of other work, software was " in capfd.readouterr().err
    assert main(command) == 0
    assert "going on after 5 of 8 frames" in capfd.readouterr().err


def test_two_at_one_output_are_kept_apart(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 10)
    out = tmp_path / "t.csv"
    with part_file.PartFile(out, {}, range(10)):
        assert main(["track", str(run), "-o", str(out)]) == 2
        assert "another flora-lab track is at work on this output" in capfd.readouterr().err
    assert main(["track", str(run), "-o", str(out), "-q"]) == 0

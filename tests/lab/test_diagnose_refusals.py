"""What ``flora-lab diagnose`` refuses before it learns anything: runs, references and outputs."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose_command_runs import measured, refused, write_runs
from diagnose_runs import run_of, write_run

from flora_common.runs import TRACK_HEADER
from flora_common.shapes import STEM_POINTS


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """See :func:`diagnose_command_runs.write_runs`."""
    return write_runs(tmp_path_factory.mktemp("diagnose-runs"))


def test_an_output_that_is_there_is_left_alone(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("folder", "file", "link"):
        path = tmp_path / name
        if name == "folder":
            path.mkdir()
        elif name == "file":
            path.write_text("mine")
        else:
            path.symlink_to(tmp_path / "nowhere")
        said = refused(capsys, *measured(runs), "--reference", runs / "reference", "-o", path)
        assert f"{path}: is there already; name another folder with -o" in said
    assert (tmp_path / "file").read_text() == "mine"


def test_one_thing_to_compare_with_is_needed(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ("-o", tmp_path / "out")
    assert "give --simulator SIM or --reference RUNS_DIR" in refused(capsys, *measured(runs), *out)
    assert not (tmp_path / "out").exists()


def short(folder: Path) -> Path:
    return write_run(folder, replace(run_of(20, hours=3.0), name="short"))


def without_track(folder: Path) -> Path:
    (folder / "run").mkdir(parents=True)
    return folder / "run"


def not_numbers(folder: Path) -> Path:
    path = write_run(folder, run_of(21, hours=8.0))
    lines = path.read_text().splitlines()
    fields = lines[40].split(",")
    fields[5] = "nan"
    lines[40] = ",".join(fields)
    path.write_text("\n".join(lines) + "\n")
    return path


def no_track_at_all(folder: Path) -> Path:
    folder.mkdir()
    path = folder / "notes.csv"
    path.write_text("water the beans\n")
    return path


def frozen(folder: Path) -> Path:
    folder.mkdir()
    path = folder / "frozen.csv"
    points = ",".join(f"0.0000,{y:.4f}" for y in np.linspace(0.0, 8.0, STEM_POINTS))
    path.write_text("".join([TRACK_HEADER + "\n", *(f"{300 * row},left,{points}\n" for row in range(100))]))
    return path


def leaping(folder: Path) -> Path:
    """Its clock is set on by two months on the way."""
    path = folder / "leaping.csv"
    folder.mkdir()
    points = (
        ",".join(f"0.0000,{y:.4f}" for y in np.linspace(0.0, 8.0 + 0.01 * row, STEM_POINTS)) for row in range(100)
    )
    times_s = (300 * row + (5_184_000 if row > 50 else 0) for row in range(100))
    rows = (f"{time_s},left,{line}\n" for time_s, line in zip(times_s, points, strict=True))
    path.write_text("".join([TRACK_HEADER + "\n", *rows]))
    return path


def missing(folder: Path) -> Path:
    return folder / "gone.csv"


MEASURED: list[tuple[Callable[[Path], Path], str]] = [
    (short, "short.csv: is 3.0 h long; at least 6 h are needed"),
    (without_track, "holds no track.csv; make it with `flora-lab track"),
    (not_numbers, "plant21.csv line 41: "),
    (no_track_at_all, "notes.csv"),
    (missing, "gone.csv: no such run or track"),
    (leaping, "leaping.csv: goes on for 1,448 h; 1,000 h are compared at most"),
    (frozen, "frozen.csv: no hour of it has enough photographs of a stem that moves; leave it out"),
]


@pytest.mark.parametrize(("make", "said"), MEASURED, ids=[make.__name__ for make, _ in MEASURED])
def test_a_run_that_cannot_be_diagnosed_is_told(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], make: Callable[[Path], Path], said: str
) -> None:
    path = make(tmp_path / "bad")
    assert said in refused(capsys, path, "--reference", runs / "reference", "-o", tmp_path / "out")
    held_out = (*measured(runs), "--holdout", path)
    assert said in refused(capsys, *held_out, "--reference", runs / "reference", "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def few(folder: Path, runs: Path) -> Path:
    folder.mkdir()
    for path in sorted((runs / "reference").iterdir())[:2]:
        shutil.copy(path, folder)
    (folder / "._plant1.csv").write_bytes(b"\0\5\x16\7")  # of a Mac, no run
    return folder


def a_file(folder: Path, runs: Path) -> Path:
    del folder
    return next((runs / "reference").iterdir())


def with_a_measured_one(folder: Path, runs: Path) -> Path:
    shutil.copytree(runs / "reference", folder)
    shutil.copy(measured(runs)[1], folder / "also.csv")
    return folder


def with_one_twice(folder: Path, runs: Path) -> Path:
    shutil.copytree(runs / "reference", folder)
    shutil.copy(folder / "plant1.csv", folder / "zzz.csv")
    return folder


def with_a_short_one(folder: Path, runs: Path) -> Path:
    shutil.copytree(runs / "reference", folder)
    short(folder)
    return folder


REFERENCE: list[tuple[Callable[[Path, Path], Path], str]] = [
    (few, "holds 2 runs with a track; at least 3 are needed to tell how plants differ"),
    (a_file, "is no folder; --reference takes a folder of runs or tracks"),
    (with_a_measured_one, "also.csv: is also to be diagnosed"),
    (with_one_twice, "zzz.csv: is the same track as"),
    (with_a_short_one, "short.csv: is 3.0 h long"),
]


@pytest.mark.parametrize(("make", "said"), REFERENCE, ids=[make.__name__ for make, _ in REFERENCE])
def test_a_reference_that_tells_nothing_is_told(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], make: Callable[[Path, Path], Path], said: str
) -> None:
    reference = make(tmp_path / "reference", runs)
    assert said in refused(capsys, *measured(runs), "--reference", reference, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_same_run_twice_is_told(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = measured(runs)[0]
    twin = Path(shutil.copy(one, tmp_path / "twin.csv"))
    reference = ("--reference", runs / "reference", "-o", tmp_path / "out")
    assert "twin.csv: is the same track as" in refused(capsys, one, twin, *reference)


def test_a_run_that_is_diagnosed_cannot_be_held_out(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would judge what was fitted to it."""
    one, other = measured(runs)
    reference = ("--reference", runs / "reference", "-o", tmp_path / "out")
    assert f"{one}: is also to be diagnosed" in refused(capsys, one, other, "--holdout", one, *reference)

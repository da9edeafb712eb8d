"""``flora-twin runs --photographs``: run folders as a rig leaves them, of small pictures here."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.files import TEMPORARY_SUFFIX
from flora_common.lock import hold
from flora_common.runs import LIGHTS, RunFolder
from flora_common.tracks import read_track
from flora_lab.main import main as lab
from flora_twin import commands, photographed_folder
from flora_twin.box import PinholeCamera
from flora_twin.main import main
from flora_twin.photographed_folder import LOCK_FILE, WORK_FILE, part_folder, write_runs
from flora_twin.photographs import TRUTH_CSV, photographs_in, write_run
from flora_twin.runs import PlannedRun, grow_steered, planned_runs

SMALL = PinholeCamera(width_px=328, height_px=246)
HALF = PinholeCamera(width_px=820, height_px=616)
"""Large enough for the stem finder."""
HOURS = 1.0


def planned(seed: int = 3, closed: int = 1) -> list[PlannedRun]:
    return planned_runs(seed, open_loops=1, closed_loops=closed, hours=HOURS)


def small(path: Path, runs: list[PlannedRun], hours: float = HOURS, *, force: bool = False) -> list[str]:
    """Photograph them; what happened, in order: ``.`` for a photograph, names of runs that were there."""
    said: list[str] = []
    write_runs(
        path, runs, hours, on_photograph=lambda: said.append("."), on_kept=said.append, camera=SMALL, force=force
    )
    return said


def seen(path: Path) -> FloatArray:
    """Of a photograph, shape (height, width, 3)."""
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture.astype(np.float64)


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photographed") / "two"
    assert small(folder, planned()) == ["."] * 26
    return folder


def test_a_run_is_as_a_rig_leaves_it_but_for_its_track(two: Path) -> None:
    assert sorted(path.name for path in two.iterdir()) == ["closed-1", "open-1"]
    run = RunFolder(two / "open-1")
    told = run.read_run_file()
    assert told.plant == "virtual bean, seed 3"
    assert told.camera == SMALL.camera_section()
    rows = run.read_frames()
    assert [row.time_s for row in rows] == [300.0 * i for i in range(photographs_in(HOURS))]
    assert [row.light for row in rows] == ["dark", *["left"] * 12]
    for row in rows:
        assert seen(run.path / row.file).shape == (246, 328, 3)
    assert len(run.background_pictures()) == 2 * len(LIGHTS)
    assert not run.track_csv.exists()
    assert RunFolder(two / "closed-1").read_run_file().target is not None


def test_lamps_that_are_told_are_those_in_the_picture(two: Path) -> None:
    run = RunFolder(two / "open-1")
    empty = {path.name.split("-")[0]: seen(path) for path in run.background_pictures()}
    for row in run.read_frames():
        picture = seen(run.path / row.file)
        off = {light: np.abs(picture - other).mean() for light, other in empty.items()}
        assert min(off, key=lambda light: off[light]) == row.light


def test_the_truth_beside_it_is_the_plant_that_grows_without_pictures(two: Path) -> None:
    run = planned()[0]
    (alone,) = grow_steered([run.seed], [run.steering], HOURS)
    true = read_track(two / "open-1" / TRUTH_CSV)
    assert true.light == alone.light
    # the photographed lamp is a little weaker than a full white one
    assert np.abs(true.points_cm - alone.points_cm).max() < 0.05
    assert np.abs(true.points_cm - alone.points_cm[0]).max() > 0.1


def test_the_same_seed_gives_the_same_bytes_also_after_it_was_killed(
    two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, whole = tmp_path / "again", write_run

    def killed(path: Path, run: PlannedRun, *rest: object) -> None:
        if run.name == "closed-1":
            (path / "half").write_text("a picture")
            raise KeyboardInterrupt
        whole(path, run, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(photographed_folder, "write_run", killed)
    with pytest.raises(KeyboardInterrupt):
        small(folder, planned())
    assert not folder.exists()
    monkeypatch.undo()
    (part_folder(folder) / f".closed-1.x{TEMPORARY_SUFFIX}").mkdir()  # what a process leaves that is killed outright
    assert small(folder, planned()) == ["open-1", *["."] * 13]
    assert content(folder) == content(two)
    assert not part_folder(folder).exists()


def stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The output of a command that was stopped when its first run was there and its second had begun."""

    def first_only(path: Path, run: PlannedRun, *_rest: object) -> None:
        (path / "mark").write_text(run.name)
        if run.name != "open-1":
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(photographed_folder, "write_run", first_only)
        with pytest.raises(KeyboardInterrupt):
            small(tmp_path / "runs", planned())
    return tmp_path / "runs"


@pytest.mark.parametrize(
    ("seed", "closed", "hours", "said"),
    [
        (4, 1, HOURS, "run 1 was open-1 of seed 3 and is open-1 of seed 4 now"),
        (3, 0, HOURS, "the number of runs was 2 and is 1 now"),
        (3, 1, 2.0, "hours was 1.0 and is 2.0 now"),
    ],
)
def test_finished_runs_of_other_settings_are_kept_and_what_differs_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, closed: int, hours: float, said: str
) -> None:
    folder = stopped(tmp_path, monkeypatch)
    before = content(part_folder(folder))
    with pytest.raises(BadInput) as told:
        small(folder, planned(seed, closed), hours)
    assert str(told.value) == (
        f"{part_folder(folder)}: holds 1 finished run of other work, {said}; "
        "give the same settings to go on with it, --force to drop it, or another -o"
    )
    after = content(part_folder(folder))
    assert {name: after[name] for name in ("open-1/mark", WORK_FILE)} == {
        name: before[name] for name in ("open-1/mark", WORK_FILE)
    }


def test_the_command_drops_runs_of_other_settings_with_force_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = stopped(tmp_path, monkeypatch)
    monkeypatch.setattr(photographed_folder, "write_run", lambda path, run, *_: (path / "mark").write_text("new"))
    arguments = ["runs", "--photographs", "--open-loop", "1", "--closed-loop", "0", "--hours", "1", "-o", str(folder)]
    assert main(arguments) == 2
    told = capsys.readouterr().err
    assert "finished run of other work" in told
    assert told.count("\n") == 1
    assert main([*arguments, "--force"]) == 0
    assert content(folder) == {"open-1/mark": b"new"}


@pytest.mark.parametrize("work", ['{"runs": "of another seed"}', "[]", "torn", '{"runs": [[], 3, ["a"]]}'])
def test_runs_of_which_nobody_can_tell_the_settings_are_kept_too(tmp_path: Path, work: str) -> None:
    folder = tmp_path / "runs"
    part = part_folder(folder)
    (part / "open-1").mkdir(parents=True)
    (part / WORK_FILE).write_text(work)
    with pytest.raises(BadInput, match="holds 1 finished run of other work"):
        small(folder, planned(closed=0))
    assert (part / "open-1").exists()
    assert small(folder, planned(closed=0), force=True) == ["."] * 13
    assert (folder / "open-1" / TRUTH_CSV).exists()


def test_stopped_work_without_a_finished_run_is_begun_anew(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    part = part_folder(folder)
    (part / f".open-1.x{TEMPORARY_SUFFIX}").mkdir(parents=True)
    (part / WORK_FILE).write_text(json.dumps({"runs": "of another seed"}))
    assert small(folder, planned(closed=0)) == ["."] * 13
    assert [path.name for path in folder.iterdir()] == ["open-1"]


def test_two_processes_do_not_make_one_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = part_folder(tmp_path / "runs")
    part.mkdir()
    lock = hold(part / LOCK_FILE)
    try:
        assert main(["runs", "--photographs", "-o", str(tmp_path / "runs")]) == 2
    finally:
        os.close(lock)
    assert f"is being made by another flora-twin (pid {os.getpid()})" in capsys.readouterr().err


def test_the_command_photographs_and_the_lab_finds_the_stems(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def smaller(*arguments: object, **options: object) -> None:
        write_runs(*arguments, **options, camera=HALF)  # type: ignore[arg-type]

    monkeypatch.setattr(commands, "write_runs", smaller)
    folder = tmp_path / "one"
    arguments = ["runs", "--photographs", "--open-loop", "1", "--closed-loop", "0", "--hours", "1", "-o", str(folder)]
    assert main(arguments) == 0
    assert "photographed 1 run of 1 h" in capsys.readouterr().out
    run = folder / "open-1"
    assert lab(["track", str(run), "-o", str(tmp_path / "track.csv"), "-q"]) == 0
    found, true = read_track(tmp_path / "track.csv"), read_track(run / TRUTH_CSV)
    assert len(found.time_s) == len(true.time_s)
    off_cm = np.linalg.norm(found.points_cm[:, -1] - true.points_cm[:, -1], axis=1)
    assert np.median(off_cm) < 0.5
    assert main(arguments) == 2  # it is there


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--pixel-cm", "0.36"], "--pixel-cm"), (["--hours", "0"], "hours is 0"), (["-o", "file/runs"], "file")],
)
def test_bad_input_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("no folder")
    assert main(["runs", "--photographs", "-o", "runs", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "runs").exists()

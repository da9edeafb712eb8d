"""``flora-twin runs``: the paper's nine runs in the virtual box."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from flora_common.runs import Light, RunFolder
from flora_common.shapes import Target
from flora_common.tracks import Track, read_track
from flora_controller.steering import TipFollower, TipFollowerSection, View
from flora_twin import commands
from flora_twin.grow import grow
from flora_twin.main import main
from flora_twin.runs import DWELL_H, dataset_runs, random_schedule, tip_follower


@pytest.fixture(scope="module")
def nine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("twin") / "nine"
    assert main(["runs", "-o", str(folder), "--hours", "25", "--seed", "4"]) == 0
    return folder


def test_six_open_and_three_closed_loops_each_with_a_plant_of_its_own(nine: Path) -> None:
    names = sorted(path.name for path in nine.iterdir())
    assert names == [f"closed-{i}" for i in range(1, 4)] + [f"open-{i}" for i in range(1, 7)]
    tracks, plants = [], set()
    for name in names:
        folder = RunFolder(nine / name)
        run = folder.read_run_file()
        plants.add(run.plant)
        assert run.interval_s == 300.0
        assert (run.target is not None) == name.startswith("closed")
        track = read_track(folder.track_csv)
        tracks.append(track)
        assert track.time_s.tolist() == [300.0 * i for i in range(25 * 12 + 1)]
        assert track.light[0] == "dark"
        assert set(track.light[1:]) <= {"left", "right"}
    assert plants == {f"virtual bean, seed {i}" for i in range(4, 13)}
    for i, track in enumerate(tracks):
        assert not any(np.array_equal(track.points_cm, other.points_cm) for other in tracks[:i])


def test_open_loops_switch_every_six_hours_and_are_what_grow_grows(nine: Path) -> None:
    track = read_track(nine / "open-2" / "track.csv")
    six_hours = 72
    expected: list[Light] = ["left" if (i - 1) // six_hours % 2 == 0 else "right" for i in range(1, len(track.light))]
    assert list(track.light[1:]) == expected
    alone = grow(5, "6h", 25)
    assert track.points_cm == pytest.approx(alone.points_cm, abs=1e-4)


def decided(track: Track, target_x_cm: float) -> list[Light]:
    """What flora-controller's rule does at each row, given what shone before."""
    rule = TipFollower(Target(target_x_cm, 17.9), TipFollowerSection())
    said: list[Light] = []
    for row in range(len(track.time_s) - 1):
        light = rule.decide(View(float(track.time_s[row]), track.points_cm[row], track.light[row]), {}).light
        assert light is not None
        said.append(light)
    return said


def test_closed_loops_do_what_flora_controllers_tip_follower_does() -> None:
    runs = dataset_runs(9, open_loops=0, closed_loops=3, hours=72)
    for run in runs:
        assert run.run_file.target is not None
        assert decided(run.track, run.run_file.target.x_cm) == list(run.track.light[1:])
        assert set(run.track.light[1:]) == {"left", "right"}
    targets = [run.run_file.target.x_cm for run in runs if run.run_file.target]
    assert [np.sign(x) for x in targets] == [-1, 1, -1]
    assert all(2.0 <= abs(x) <= 7.0 for x in targets)


def test_the_tip_follower_holds_the_lamp_near_its_target() -> None:
    steer = tip_follower(3.0)
    assert steer(0.0, 5.0, "right") == "left"
    assert steer(0.0, 1.0, "left") == "right"
    assert steer(0.0, 3.4, "right") == "right"
    assert steer(0.0, 3.4, "left") == "left"
    assert steer(0.0, 3.4, "dark") == "left"


def dwells_h(track: Track) -> list[tuple[str, float]]:
    """Lamp and hours of every stretch under one lamp, from the first row on."""
    shone = track.light[1:]
    starts = [i for i in range(len(shone)) if i == 0 or shone[i] != shone[i - 1]]
    return [(shone[start], (end - start) / 12) for start, end in zip(starts, [*starts[1:], len(shone)], strict=True)]


def test_random_light_is_another_for_each_run_and_keeps_its_limits() -> None:
    runs = dataset_runs(5000, open_loops=0, closed_loops=0, random_loops=12, hours=72)
    assert [run.name for run in runs] == [f"random-{i}" for i in range(1, 13)]
    assert [run.run_file.plant for run in runs] == [f"virtual bean, seed {i}" for i in range(5000, 5012)]
    assert {run.run_file.target for run in runs} == {None}
    stretches = [dwells_h(run.track) for run in runs]
    assert all(stretches.count(own) == 1 for own in stretches)
    assert {own[0][0] for own in stretches} == {"left", "right"}
    whole = np.array([hours for own in stretches for _, hours in own[:-1]])  # the end of the run cuts the last
    shortest, longest = DWELL_H
    frame_h = 1 / 12
    assert whole.min() >= shortest - frame_h
    assert whole.max() <= longest + frame_h
    # some 160 uniform draws of deviation 2.7 h: three standard errors are 0.65 h; the end of a run favours short ones
    assert whole.mean() == pytest.approx((shortest + longest) / 2, abs=0.9)
    assert whole.max() - whole.min() > 8.0


def test_a_random_schedule_follows_from_the_individual_alone() -> None:
    assert random_schedule(7, 72.0).startswith(random_schedule(7, 10.0))
    assert random_schedule(7, 72.0) != random_schedule(8, 72.0)
    alone = dataset_runs(8, open_loops=0, closed_loops=0, random_loops=1, hours=30)[0]
    third = dataset_runs(6, open_loops=1, closed_loops=0, random_loops=2, hours=30)[2]
    assert alone.run_file == third.run_file
    assert alone.track.light == third.track.light
    assert third.track.points_cm == pytest.approx(alone.track.points_cm, abs=1e-9)


def test_random_runs_leave_the_others_as_they_are(nine: Path, tmp_path: Path) -> None:
    more = tmp_path / "more"
    assert main(["runs", "-o", str(more), "--hours", "25", "--seed", "4", "--random", "2"]) == 0
    names = {path.name for path in nine.iterdir()}
    assert {path.name for path in more.iterdir()} == names | {"random-1", "random-2"}
    for path in nine.rglob("*.*"):
        assert (more / path.relative_to(nine)).read_bytes() == path.read_bytes()
    assert RunFolder(more / "random-2").read_run_file().plant == "virtual bean, seed 14"


def test_the_same_seed_gives_the_same_files(nine: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    assert main(["runs", "-o", str(again), "--hours", "25", "--seed", "4"]) == 0
    for path in nine.rglob("*.*"):
        assert (again / path.relative_to(nine)).read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--hours", "0"], "hours is 0"),
        (["--hours", "nan"], "hours is nan"),
        (["--open-loop", "0", "--closed-loop", "0"], "no runs"),
        (["--seed", "-1"], "--seed"),
        (["--random", "-1"], "--random"),
        (["--pixel-cm", "1e-320"], "--pixel-cm: 9.99989e-321 must be 0, or lie in [0.0001, 1]"),
        (["--pixel-cm", "nan"], "--pixel-cm"),
        (["--pixel-cm", "2"], "--pixel-cm"),
        (["--force"], "--force: has no effect without --photographs"),
    ],
)
def test_bad_input_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert main(["runs", "-o", str(tmp_path / "runs"), *arguments]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_kept(nine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", "-o", str(nine)]) == 2
    assert "is there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("file/runs", "cannot be written, {there}/file is no folder; name another place with -o"),
        ("dangling", "is there already; name another folder with -o"),
        ("dangling/runs", "cannot be written, {there}/dangling is no folder"),
        ("/proc/runs", "/proc/runs: cannot be written"),
    ],
)
@pytest.mark.parametrize("more", [[], ["--photographs"]])
def test_where_no_folder_can_be_made_is_told_before_plants_are_grown(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    output: str,
    said: str,
    more: list[str],
) -> None:
    def grown(*_: object, **__: object) -> None:
        raise AssertionError("plants were grown")

    for name in ("dataset_runs", "planned_runs"):
        monkeypatch.setattr(commands, name, grown)
    # root may write anywhere
    monkeypatch.setattr(os, "access", lambda path, _mode: str(path) != "/proc")
    (tmp_path / "file").write_text("no folder")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    assert main(["runs", "-o", str(tmp_path / output), *more]) == 2
    told = capsys.readouterr().err
    assert said.format(there=tmp_path) in told
    assert told.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dangling", "file"]


@pytest.mark.parametrize("command", ["grow", "picture"])
@pytest.mark.parametrize("more", [[], ["--force"]])
def test_a_folder_in_place_of_a_file_is_told_with_force_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, more: list[str]
) -> None:
    assert main([command, "-o", str(tmp_path), *more]) == 2
    assert capsys.readouterr().err == f"flora-twin: {tmp_path}: is a folder; name a file with -o\n"


def test_a_file_is_replaced_with_force_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    track = tmp_path / "track.csv"
    assert main(["grow", "-o", str(track), "--hours", "2"]) == 0
    kept = track.read_bytes()
    assert main(["grow", "-o", str(track), "--hours", "1"]) == 2
    assert "is there already; name another file with -o, or add --force" in capsys.readouterr().err
    assert track.read_bytes() == kept
    assert main(["grow", "-o", str(track), "--hours", "1", "--force"]) == 0
    assert len(read_track(track).time_s) == 13


@pytest.mark.parametrize(
    ("command", "name", "what"), [("grow", "run.toml", "a track"), ("picture", "a.png", "a picture")]
)
def test_what_another_command_made_is_not_replaced_with_force_either(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, name: str, what: str
) -> None:
    mine = tmp_path / name
    mine.write_text("mine")
    assert main([command, "-o", str(mine), "--hours", "1", "--force"]) == 2
    assert f"{mine}: is there already, is not {what} and is not replaced" in capsys.readouterr().err
    assert mine.read_text() == "mine"

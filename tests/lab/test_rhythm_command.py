"""``flora-lab rhythm``: what it reads, writes, says, and refuses in one line."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rhythm_tracks import forgetting, swing, write_table

from flora_common.runs import TRACK_HEADER, track_text
from flora_common.shapes import STEM_POINTS
from flora_lab.main import main
from flora_lab.rhythm.judgement import cannot_tell, judge, said
from flora_lab.rhythm.tip_track import MOST_SAMPLES, read_tip
from real_photographs import STALK

PERIOD = 20
STEPS, FEW_STEPS = 200, 60


def table(path: Path, header: str = "frame,x_px,y_px", *, per_row: float = 1.0, steps: int = STEPS) -> Path:
    rng = np.random.default_rng(1)
    x = 100.0 + swing(rng, steps, PERIOD, 10.0, 0.02) + forgetting(rng, steps, 30.0)
    return write_table(path, header, np.column_stack([per_row * np.arange(steps), x, 50.0 + 0.1 * x]))


def one(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert main(["rhythm", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)["tracks"][0]


def test_frames_and_px_become_hours_and_cm_when_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(table(tmp_path / "tip.csv"))
    bare = one(capsys, path)
    assert (bare["time_unit"], bare["unit"], bare["swings"]) == ("frames", "px", True)
    assert bare["period_interval"][0] < PERIOD < bare["period_interval"][1]
    told = one(capsys, path, "--step-s", "180", "--px-per-cm", "5")
    assert (told["time_unit"], told["unit"]) == ("h", "cm")
    assert told["period"] == pytest.approx(bare["period"] / 20, rel=1e-3)
    assert told["amplitude"] == pytest.approx(bare["amplitude"] / 5, rel=1e-3)
    assert not any(line.startswith("hours:") for line in told["cannot_be_told"])


def test_what_is_said_of_times_like_hours_and_of_a_swing_that_grows_slowly(tmp_path: Path) -> None:
    rhythm = judge(read_tip(table(tmp_path / "tip.csv", "time_s,x_cm,y_cm", per_row=120.0)))
    hours = "whether its times are seconds: they are 0.0333 s apart, as hours that nobody converted"
    for step_s, told in ((120.0 / 3600.0, True), (1.0, False), (120.0, False)):
        again = replace(rhythm, track=replace(rhythm.track, step=step_s / 3600.0))
        assert (hours in cannot_tell(again)) == told
        assert any(line.startswith("whether its times") for line in cannot_tell(again)) == told
    for factor, line in ((1.004, "it grows: 1.004 times"), (0.997, "it dies away: 0.997 times"), (1.25, "grows: 1.2 ")):
        cycles = replace(rhythm.cycles, growth_per_cycle=factor, growth_interval=(factor, factor))
        assert line in "\n".join(said(replace(rhythm, cycles=cycles)))


def test_the_folder_is_written_and_the_same_each_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path / "tip.csv", "time_s,x_cm,y_cm", per_row=300.0)
    before = path.read_bytes()
    for name in ("a", "b"):
        assert main(["rhythm", str(path), "-o", str(tmp_path / name)]) == 0
    printed = capsys.readouterr().out
    assert "the tip swings along x every" in printed
    assert "cannot be told" in printed
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["rhythm.json", "rhythm.png"]
    assert cv2.imread(str(tmp_path / "a" / "rhythm.png")).shape[1] > 500
    for name in ("rhythm.json", "rhythm.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert path.read_bytes() == before


def test_several_tracks_are_counted_against_chance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [str(table(tmp_path / f"{name}.csv")) for name in "ab"]
    assert main(["rhythm", *paths]) == 0
    assert "2 of 2 tracks swing; noise alone would be called so in 0.1 of them" in capsys.readouterr().out
    assert main(["rhythm", *paths, "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_tracks_of_one_file_name_are_told_apart_by_their_folders(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [tmp_path / "may" / "box1", tmp_path / "june" / "box1", tmp_path / "june" / "box2"]
    for folder in folders:
        folder.mkdir(parents=True)
    paths = [str(table(folder / "tip.csv", steps=FEW_STEPS)) for folder in folders]
    alone = str(table(tmp_path / "stalk.csv", steps=FEW_STEPS))
    assert main(["rhythm", *paths, alone]) == 0
    headings = [line for line in capsys.readouterr().out.splitlines()[:-1] if not line.startswith(" ")]
    assert headings == ["may/box1/tip.csv", "june/box1/tip.csv", "box2/tip.csv", "stalk"]
    assert [track["name"] for track in json.loads(_json_of(capsys, *paths))["tracks"]] == headings[:3]


def _json_of(capsys: pytest.CaptureFixture[str], *paths: str) -> str:
    assert main(["rhythm", *paths, "--json"]) == 0
    return capsys.readouterr().out


def test_a_track_of_this_project_is_read_by_its_tip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(2)
    x = swing(rng, STEPS, PERIOD, 1.0, 0.0) + 0.05 * rng.standard_normal(STEPS)
    points = [[(x[k] * s, 12.0 * s) for s in np.linspace(0.0, 1.0, STEM_POINTS)] for k in range(STEPS)]
    lights = ["left" if k % 160 < 80 else "right" for k in range(STEPS)]
    path = tmp_path / "track.csv"
    path.write_text(track_text(300.0 * np.arange(STEPS), lights, points))
    assert path.read_text().startswith(TRACK_HEADER)
    for source in (path, tmp_path):
        found = one(capsys, str(source))
        assert found["swings"]
        assert found["period"] == pytest.approx(PERIOD * 300 / 3600, rel=0.05)
        assert found["lamps_amplitude"] < 0.35


def test_gaps_and_long_tracks(tmp_path: Path) -> None:
    path = table(tmp_path / "tip.csv")
    lines = path.read_text().splitlines()
    lines[40] = lines[40].split(",")[0] + ",,"
    del lines[60:65]
    path.write_text("\n".join(lines))
    track = read_tip(path)
    assert len(track.x) == STEPS
    assert np.count_nonzero(~track.known) == 6
    long = read_tip(table(tmp_path / "long.csv", steps=3 * MOST_SAMPLES))
    assert len(long.x) == MOST_SAMPLES
    assert (long.step, long.start) == (3.0, 1.0)


@pytest.mark.parametrize(
    ("header", "change", "options", "word"),
    [
        ("t,x,y", None, (), "its header is none of a tip's"),
        ("t,x,y", None, (), "or flora's own track.csv. Rename its t,x,y"),
        ("time_s,x_mm,y_mm", None, ("--px-per-cm", "9"), "is in mm; leave --px-per-cm out"),
        ("frame,x_px,y_px", ("3,", "3,abc"), (), "line 5: x_px is `abc"),
        ("frame,x_px,y_px", ("3,", "1,"), (), "line 5: frame 1 is not after 2"),
        ("time_s,x_px,y_px", None, ("--step-s", "60"), "leave --step-s out"),
        ("frame,x_cm,y_cm", None, ("--px-per-cm", "9"), "leave --px-per-cm out"),
        ("time_s,x_cm,y_cm", ("3,", "3,1e20,1\n9e9,"), (), "line 5: x_cm is 1e+20, beyond 20000"),
        ("time_s,x_cm,y_cm", ("3,", "1e300,"), (), "line 5: time_s is 1e+300, beyond 1e+12"),
        ("frame,x_px,y_px", ("3,", "1e300,"), (), "line 5: frame is 1e+300, beyond 1e+09"),
        ("frame,x_px,y_px", None, ("--px-per-cm", "1e-300"), "--px-per-cm: 1e-300 does not lie in"),
        ("frame,x_px,y_px", None, ("--step-s", "0"), "--step-s: 0 does not lie in"),
        ("frame,x_px,y_px", None, ("--px-per-cm", "nan"), "--px-per-cm: nan does not lie in"),
    ],
)
def test_bad_input_ends_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    header: str,
    change: tuple[str, str] | None,
    options: tuple[str, ...],
    word: str,
) -> None:
    path = table(tmp_path / "tip.csv", header)
    if change:
        lines = path.read_text().splitlines()
        row = next(i for i, line in enumerate(lines) if line.startswith(change[0]))
        lines[row] = lines[row].replace(*change, 1)
        path.write_text("\n".join(lines))
    assert main(["rhythm", str(path), *options, "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip()
    assert word in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_tip_is_read_however_another_program_writes_its_table(tmp_path: Path) -> None:
    plain = table(tmp_path / "plain.csv", "time_s,x_cm,y_cm")
    rows = [line.split(",") for line in plain.read_text().splitlines()]
    other = tmp_path / "other.csv"
    other.write_text(
        "".join(
            ";".join(field.replace(".", ",") for field in row) + "\r\n"
            for row in [["Time_s", "X_cm", "Y_cm"], *rows[1:]]
        )
    )
    assert read_tip(other).x.tolist() == read_tip(plain).x.tolist()


def test_a_tip_in_mm_is_the_same_tip_in_cm(tmp_path: Path) -> None:
    for at in ("time_s", "frame"):
        in_cm, in_mm = (read_tip(table(tmp_path / f"{unit}.csv", f"{at},x_{unit},y_{unit}")) for unit in ("cm", "mm"))
        assert (in_mm.unit, in_mm.is_scale_doubtful) == ("cm", False)
        assert in_mm.x * 10.0 == pytest.approx(in_cm.x)


def test_a_tip_alone_is_refused_where_whole_stems_are_needed_with_what_it_is_good_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path / "tip.csv", "time_s,x_cm,y_cm")
    assert main(["train", str(path), "-o", str(tmp_path / "a.simulator")]) == 2
    error = capsys.readouterr().err.strip()
    assert "a track of the tip alone; whole stems and lamps are needed" in error
    assert "`flora-lab rhythm`" in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("rows", "word"),
    [
        ([(k, k % 7, 0) for k in range(20)], "holds 20 places of the tip"),
        ([(k if k < 50 else k + 60, k % 7, 0) for k in range(150)], "a gap of 60 of 210 steps"),
        ([(k + (k // 2) * 3, k % 7, 0) for k in range(150)], "the tip is missing in"),
        ([(k + 10_000 * (k > 40), k % 7, 0) for k in range(80)], "too uneven"),
        ([(k, 1, 1) for k in range(80)], "the tip never moves"),
    ],
)
def test_tracks_that_hold_too_little(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rows: list[tuple[int, int, int]], word: str
) -> None:
    path = write_table(tmp_path / "tip.csv", "frame,x_px,y_px", np.array(rows))
    assert main(["rhythm", str(path)]) == 2
    assert word in capsys.readouterr().err


def test_files_that_are_no_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    binary = tmp_path / "film.mp4"
    binary.write_bytes(bytes(range(256)))
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "there").mkdir()
    table(tmp_path / "tip.csv")
    for arguments, word in (
        ([str(tmp_path / "none.csv")], "no such track"),
        ([str(binary)], "not a CSV file"),
        ([str(tmp_path / "pipe.csv")], "pipe.csv: not a regular file; write what it gives into one"),
        (["/dev/zero"], "/dev/zero: not a regular file"),
        ([str(tmp_path / "there")], "holds no track.csv"),
        ([str(tmp_path / "tip.csv"), "-o", str(tmp_path / "there")], "is there already"),
    ):
        assert main(["rhythm", *arguments]) == 2
        assert word in capsys.readouterr().err


def test_a_track_whose_name_is_no_utf_8_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    track = table(tmp_path / os.fsdecode(b"t\xefp.csv"))
    found = one(capsys, str(track), "-o", str(tmp_path / "out"))
    assert (found["name"], found["file"]) == ("t\ufffdp", f"{tmp_path}/t\ufffdp.csv")


@STALK.needed
def test_the_flower_stalk_that_others_tracked_swings(capsys: pytest.CaptureFixture[str]) -> None:
    track = str(STALK.path.parent / "circumnutation_20190712_trackpoints.csv")
    found = one(capsys, track)
    assert found["p"] < 0.05
    assert found["time_unit"] == "frames"
    assert found["period_interval"][0] < 66.0 < found["period_interval"][1]
    assert found["peaks"] == pytest.approx([118.0, 183.0, 250.0], abs=3.0)
    assert found["growth_per_cycle_interval"][0] > 1.0
    assert found["other_coordinate_period"] == pytest.approx(33.0, abs=2.0)
    assert one(capsys, track, "--step-s", "120")["period"] == pytest.approx(2.2, abs=0.1)

"""run.toml, frames.csv and track.csv: written, read back, and refused with the place and the reason."""

from __future__ import annotations

import errno
import os
import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from flora_common.errors import BadRunFolder
from flora_common.runs import (
    FRAMES_HEADER,
    TRACK_HEADER,
    CameraSection,
    ObstacleSection,
    RunFile,
    RunFolder,
    TargetSection,
    run_file_text,
)
from flora_common.tracks import read_track

POINTS = np.column_stack([np.linspace(0.0, -2.25, 10), np.linspace(0.0, 13.5, 10)])
ROW = ",".join(f"{v:.4f}" for v in POINTS.reshape(-1))


def make(folder: Path) -> RunFolder:
    run = RunFile(
        camera=CameraSection(anchor_px=(820.0, 1100.5), px_per_cm=30.25),
        rig="box1",
        plant='bean "7"',
        start=datetime(2026, 3, 1, 8, 0, tzinfo=UTC),
        target=TargetSection(x_cm=-5.12, y_cm=17.9),
        obstacle=ObstacleSection(x_cm=-6.3, y_cm=12.5),
    )
    (folder / "run.toml").write_text(run_file_text(run), encoding="utf-8")
    return RunFolder(folder)


def test_run_file_reads_back(tmp_path: Path) -> None:
    run = make(tmp_path).read_run_file()
    assert run.plant == 'bean "7"'
    assert run.start == datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
    target, obstacle = run.target_or_none(), run.obstacle_or_none()
    assert target is not None
    assert obstacle is not None
    assert (target.radius_cm, obstacle.width_cm, obstacle.left_cm) == (2.0, 7.0, pytest.approx(-9.8))


def test_a_link_that_leads_to_itself_has_a_name_and_leads_to_no_run(tmp_path: Path) -> None:
    link = tmp_path / "current"
    link.symlink_to(link)
    run = RunFolder(link)
    assert (run.place, run.name, run.names) == (link, "current", {"current"})
    with pytest.raises(BadRunFolder, match="no such run folder"):
        run.read_run_file()


def test_tables_read_back(tmp_path: Path) -> None:
    run = make(tmp_path)
    for number in (1, 2, 3):
        run.append_frame(f"frames/{number:06d}.jpg", 300.0 * number, "left")
        run.append_track(300.0 * number, "right", POINTS * number)
    frames = run.read_frames()
    assert [(f.file, f.time_s, f.light) for f in frames][2] == ("frames/000003.jpg", 900.0, "left")
    track = read_track(run.track_csv)
    assert track.points_cm.shape == (3, 10, 2)
    assert track.points_cm[1] == pytest.approx(POINTS * 2, abs=1e-4)
    assert track.light == ("right",) * 3
    assert track.time_s == pytest.approx([300.0, 600.0, 900.0])


def test_further_columns_are_covariates(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    path.write_text(f"temperature_c,{TRACK_HEADER}\n21.5,0,left,{ROW}\n22,300,dark,{ROW}\n")
    assert read_track(path).covariates["temperature_c"] == pytest.approx([21.5, 22.0])


def test_pictures_of_the_setup_come_in_name_order(tmp_path: Path) -> None:
    run = make(tmp_path)
    assert run.background_pictures() == []
    run.background.mkdir()
    for name in ("right.jpg", "left.jpg", "notes.txt"):
        (run.background / name).touch()
    assert [p.name for p in run.background_pictures()] == ["left.jpg", "right.jpg"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, ": not a run folder, it has no run.toml"),
        ("[camera", "run.toml: not valid TOML"),
        ("", "run.toml: object missing required field `camera`"),
        ("[camera]\nanchor_px = [1, 2]\npx_per_cm = 0", "run.toml: `camera.px_per_cm` expected `float` >= 1.0"),
        ("[camera]\nanchor_px = [1, 2]\npx_per_cm = 0.001", "expected `float` >= 1.0, it is 0.001"),
        ("[camera]\nanchor_px = [1, 2]\npx_per_cm = nan", "run.toml: `camera.px_per_cm` expected `float`"),
        ("[camera]\nanchor_px = [1]\npx_per_cm = 3", "run.toml: `camera.anchor_px` expected `array` of length 2"),
        ("[camera]\nanchor = [1, 2]\npx_per_cm = 3", "[camera]: unknown key `anchor`; did you mean `anchor_px`?"),
        (
            "interval = 3\n[camera]\nanchor_px = [1, 2]\npx_per_cm = 3",
            "run.toml: unknown key `interval`; did you mean `interval_s`?",
        ),
    ],
)
def test_bad_run_file(tmp_path: Path, text: str | None, said: str) -> None:
    if text is not None:
        (tmp_path / "run.toml").write_text(text)
    with pytest.raises(BadRunFolder) as caught:
        RunFolder(tmp_path).read_run_file()
    assert said in str(caught.value)


def test_keys_that_nobody_here_knows_are_told_and_not_looked_at_where_others_made_the_run(tmp_path: Path) -> None:
    told: list[str] = []
    run = RunFolder(tmp_path)
    run.run_toml.write_text(
        "seconds_between_frames = 1800\n[camera]\nanchor_px = [1, 2]\npx_per_cm = 3\n"
        "[lamps]\nleft = { x_cm = -43.0 }\nright_cm = 4\n"
    )
    assert run.read_run_file(told.append) == RunFile(CameraSection((1.0, 2.0), 3.0))
    (line,) = told
    assert (
        line
        == f"{run.run_toml}: `seconds_between_frames`, `lamps.left`, `lamps.right_cm` are unknown, and not looked at"
    )
    run.run_toml.write_text("[camera]\nanchor_px = [1, 2]\npx_per_cm = -3\nlens = 1\n")
    with pytest.raises(BadRunFolder, match=r"`camera\.px_per_cm` expected"):
        run.read_run_file(told.append)
    assert told[1:] == [f"{run.run_toml}: `camera.lens` is unknown, and not looked at"]
    for slip in ("interval = 300", "[camera]\nanchor_px = [1, 2]\npx_per_cmm = 3", "[lamps]\ndistancecm = 9"):
        run.run_toml.write_text(f"{slip}\n")
        with pytest.raises(BadRunFolder, match=r"unknown key .* did you mean"):
            run.read_run_file(told.append)


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(BadRunFolder, match="no such run folder"):
        RunFolder(tmp_path / "none").read_run_file()


def test_a_file_in_place_of_a_run_folder_is_not_said_to_be_missing(tmp_path: Path) -> None:
    track = tmp_path / "track.csv"
    track.write_text("time_s,light\n")
    with pytest.raises(BadRunFolder, match=re.escape(f"{track}: a file, not a run folder")):
        RunFolder(track).read_run_file()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"", "frames.csv: is empty; expected the header file,time_s,light,…"),
        (b"file,time_s,lights\n", "no column `light`; did you mean `lights`?"),
        (b"file,time_s,light,light\n", "a column name appears twice"),
        (b"file,time_s,light\na.jpg,0\n", "line 2: 2 values under 3 columns"),
        (b"file,time_s,light\na.jpg,soon,left\n", "line 2: time_s is `soon`, not a number"),
        (b"file,time_s,light\na.jpg,nan,left\n", "line 2: time_s is `nan`, not a finite number"),
        (b"file,time_s,light\na.jpg,0,lift\n", "line 2: light is `lift`; did you mean `left`?"),
        (b"file,time_s,light\na.jpg,0,left\nb.jpg,0,left\n", "line 3: time_s 0 is not after 0 in the line before"),
        (b"file,time_s,light\n/etc/passwd,0,left\n", "must be a relative path inside the run folder"),
        (b"file,time_s,light\nframes/../../x.jpg,0,left\n", "must be a relative path inside the run folder"),
        (b"file,time_s,light\n,0,left\n", "file `` must be a relative path"),
        (b"file,time_s,light\na.jpg,,left\n", "line 2: time_s is empty, where a number is needed"),
        (b"file,time_s,light\nframes/00\0,0,left\n", r"frames.csv line 2: file 'frames/00\x00' holds a NUL character"),
        (b"file,time_s,light\n\xff.jpg,0,left\n", "frames.csv: not UTF-8 text (byte 18)"),
        (b'file,time_s,light\n"a.jpg,0,left\n', "not a CSV file"),
        (b"file,time_s,light,co2\na.jpg,0,left,inf\n", "line 2: co2 is `inf`, not a finite number"),
        (b"file,time_s,light,co2\na.jpg,0,left,-1e300\n", "line 2: co2 is -1e+300, beyond 1e+30"),
        (b"file,time_s,light\na.jpg,1e300,left\n", "line 2: time_s is 1e+300, beyond 1e+12; time_s is in seconds"),
        (
            b"file,time_s,light\na.jpg,0,left\nb.jpg,4e7,left\n",
            "line 3: time_s 4e+07 is more than a year after the first",
        ),
        (b"file,time_s,light\n" + b"x" * 5000 + b",0,left\n", f"file `{'x' * 60}…` must be a relative path"),
        (b"file,time_s,light," + b"x" * 5000 + b"\na,0,left,b\n", f"line 2: {'x' * 60}… is `b`, not a number"),
        (b"x" * 5000 + b"\n", "no column `file`; known: " + "x" * 60 + "…"),
    ],
)
def test_bad_frames_table(tmp_path: Path, text: bytes, said: str) -> None:
    (tmp_path / "frames.csv").write_bytes(text)
    with pytest.raises(BadRunFolder) as caught:
        RunFolder(tmp_path).read_frames()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < len(str(tmp_path)) + 200


def test_of_a_frame_only_its_name_and_time_must_be_told(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    lines = ["a.jpg,0,,21.5", "b.jpg,300,left,", "c.jpg,600, ,NaN", "d.jpg,900,right,22"]
    run.frames_csv.write_text("\n".join(["file,time_s,light,temperature_c", *lines]) + "\n")
    rows = run.read_frames()
    assert [row.light for row in rows] == ["left", "left", "left", "right"]
    assert [row.covariates for row in rows] == [{"temperature_c": 21.5}, {}, {}, {"temperature_c": 22.0}]
    run.frames_csv.write_text("file,time_s,light\na.jpg,0,\nb.jpg,300,\n")
    assert [row.light for row in run.read_frames()] == [None, None]


def test_the_mark_that_some_programs_write_before_text_is_no_part_of_it(tmp_path: Path) -> None:
    run = make(tmp_path)
    run.append_frame("frames/000001.jpg", 0.0, "left")
    run.append_track(0.0, "left", POINTS, {"quality": 0.5})
    for path in (run.run_toml, run.frames_csv, run.track_csv):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert run.read_run_file().rig == "box1"
    assert run.read_frames()[0].file == "frames/000001.jpg"
    run.append_track(300.0, "left", POINTS, {"quality": 0.25, "other": 1.0})
    assert read_track(run.track_csv).covariates["quality"].tolist() == [0.5, 0.25]


def test_a_line_fits_under_columns_whose_names_are_quoted(tmp_path: Path) -> None:
    run = make(tmp_path)
    run.track_csv.write_text(f'{TRACK_HEADER},"air, inside",quality\n0,left,{ROW},21.5,0.5\n')
    run.append_track(300.0, "left", POINTS, {"quality": 0.25})
    covariates = read_track(run.track_csv).covariates
    assert covariates["air, inside"].tolist() == [21.5, 0.0]
    assert covariates["quality"].tolist() == [0.5, 0.25]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "track.csv: cannot be read (No such file or directory)"),
        (f"{TRACK_HEADER}\n", "holds no rows"),
        (f"{FRAMES_HEADER}\n", "no column `x1`"),
        (f"{TRACK_HEADER}\n0,left,{ROW.replace('13.5000', 'tip')}\n", "line 2: y10 is `tip`, not a number"),
        (f"{TRACK_HEADER}\n0,left,{ROW.replace('13.5000', '-inf')}\n", "line 2: y10 is `-inf`, not a finite number"),
        (
            f"{TRACK_HEADER}\n0,left,{ROW.replace('13.5000', '1e20')}\n",
            "line 2: y10 is 1e+20, beyond 500; y10 is in cm",
        ),
        (f"{TRACK_HEADER}\n300,left,{ROW}\n0,left,{ROW}\n", "line 3: time_s 0 is not after 300"),
    ],
)
def test_bad_track(tmp_path: Path, text: str | None, said: str) -> None:
    path = tmp_path / "track.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BadRunFolder) as caught:
        read_track(path)
    assert said in str(caught.value)


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOTCONN, errno.ESTALE])
def test_a_folder_on_a_dead_disk_or_mount_is_told_and_ends_nobody(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: int
) -> None:
    def dead(*_: object, **__: object) -> os.stat_result:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "stat", dead)
    with pytest.raises(BadRunFolder, match=f"cannot be looked at .{os.strerror(number)}.; check its disk"):
        RunFolder(tmp_path).read_run_file()

"""``flora-lab track`` from end to end on drawn runs: what it writes, what it says, how it ends."""

from __future__ import annotations

import csv
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from drawn_run import SIZE, make_run, picture, stem_cm, sway
from flora_common.runs import RunFolder
from flora_common.tracks import read_track
from flora_common.vision.lamp_states import from_background
from flora_common.vision.path.nearby import LONGEST_S
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.picture import decode_picture
from flora_lab import sources
from flora_lab.main import main

METHODS = ("path", "paper")


def tips(indices: list[int]) -> np.ndarray:
    return np.array([stem_cm(sway(i), 1.0) for i in indices])


def near(found: np.ndarray, expected: np.ndarray) -> None:
    """Loosely: how well stems are found is judged elsewhere, on better pictures."""
    off = np.hypot(*(found - expected).T)
    assert np.median(off) < 0.3
    assert off.max() < 1.0


def fingerprint(folder: Path) -> dict[str, str]:
    return {str(p): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("method", METHODS)
def test_run_folder_gives_a_track_and_is_left_untouched(
    method: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", torn=(7,))
    before = fingerprint(run)
    out = tmp_path / "out" / "track.csv"
    options = ["-o", str(out), "--overlays", str(tmp_path / "seen"), "--every", "4", "--method", method]
    assert main(["track", str(run), *options]) == 0
    said = capfd.readouterr()
    assert "12 frames, 10 readings: 10 ok, 1 no_stem, 1 bad_picture" in said.out
    assert "from 2 background pictures" in said.out
    assert said.err.startswith("left out: ")
    assert "0007.jpg: JPEG is cut short" in said.err
    assert fingerprint(run) == before
    track = read_track(out)
    kept = [i for i in range(12) if i not in (3, 7)]
    assert track.time_s.tolist() == [300.0 * i for i in kept]
    assert track.light == tuple("left" if i < 6 else "right" for i in kept)
    assert track.covariates["temperature_c"].tolist() == [20.0 + i for i in kept]
    near(track.points_cm[:, 9], tips(kept))
    names = sorted(p.name for p in (tmp_path / "seen").iterdir())
    assert names == ["00000_0000.jpg", "00004_0004.jpg", "00008_0008.jpg", "contact.png", "readings.csv"]
    assert sorted(p.name for p in out.parent.iterdir()) == ["track.csv"]


def test_path_is_the_default_and_adds_numeric_columns(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    assert main(["track", str(run), "-o", str(tmp_path / "a.csv"), "-q"]) == 0
    assert main(["track", str(run), "-o", str(tmp_path / "b.csv"), "-q", "--method", "path"]) == 0
    assert main(["track", str(run), "-o", str(tmp_path / "c.csv"), "-q", "--method", "paper"]) == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    header = (tmp_path / "a.csv").read_text().splitlines()[0].split(",")
    assert header[-5:] == ["y10", "temperature_c", "quality", "folded", "tip_uncertainty_mm"]
    covariates = read_track(tmp_path / "a.csv").covariates
    assert set(covariates["folded"]) == {0.0}
    assert np.all((covariates["quality"] > 0.3) & (covariates["quality"] <= 1.0))
    assert np.all((covariates["tip_uncertainty_mm"] > 0.0) & (covariates["tip_uncertainty_mm"] < 10.0))
    assert list(read_track(tmp_path / "c.csv").covariates) == ["temperature_c"]


@pytest.mark.parametrize("every_s", [300.0, 1500.0])
def test_a_track_is_what_the_rig_measures(every_s: float, tmp_path: Path) -> None:
    """Near where the stem was, too, which pictures that are looked at one by one do not tell; but for pictures that are
    too seldom for that, which threads may look at whole."""
    run, out = make_run(tmp_path / "run", 24), tmp_path / "track.csv"
    frames_csv = run / "frames.csv"
    head, *rows = frames_csv.read_text().splitlines()
    seldom = [row.replace(f",{300 * i},", f",{every_s * i:.0f},", 1) for i, row in enumerate(rows)]
    frames_csv.write_text("\n".join([head, *seldom]) + "\n")
    assert main(["track", str(run), "-o", str(out), "-q", "--jobs", "2"]) == 0
    track = read_track(out)
    assert track.time_s[1] == every_s

    def decoded(path: Path) -> np.ndarray:
        return decode_picture(path.read_bytes(), where=path.name)

    empty = [decoded(path) for path in sorted((run / "background").iterdir())]
    camera = RunFolder(run).read_run_file().camera
    rig, whole = (PathTracker(from_background(empty), camera) for _ in range(2))
    pictures = [decoded(path) for path in sorted((run / "frames").iterdir())]
    measured = [rig.read(picture, every_s * i).points_cm for i, picture in enumerate(pictures)]
    found = np.stack([points for points in measured if points is not None])
    assert found == pytest.approx(track.points_cm, abs=6e-5)  # a track tells micrometres
    one_by_one = [whole.follow(whole.look(picture), every_s * i).points_cm for i, picture in enumerate(pictures)]
    apart = np.abs(found - np.stack([points for points in one_by_one if points is not None])).max()
    assert (apart > 1e-3) == (every_s <= LONGEST_S)


def test_points_along_the_stem_differ_from_points_by_height(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 10)
    for points in ("y", "arc"):
        assert main(["track", str(run), "-o", str(tmp_path / f"{points}.csv"), "-q", "--points", points]) == 0
    by_y, by_arc = (read_track(tmp_path / f"{name}.csv").points_cm[-1] for name in ("y", "arc"))
    assert np.ptp(np.diff(by_y[:, 1])) < 0.001
    steps = np.hypot(*np.diff(by_arc, axis=0).T)
    assert np.ptp(steps) < 0.02
    assert np.ptp(np.diff(by_arc[:, 1])) > 0.1
    assert np.array_equal(by_y[-1], by_arc[-1])


def test_json_and_quiet_are_for_scripts(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run")
    assert main(["track", str(run), "-o", str(tmp_path / "a.csv"), "--json"]) == 0
    said = capfd.readouterr()
    summary = json.loads(said.out)
    assert said.err == ""
    assert summary["outcomes"] == {"ok": 11, "no_stem": 1}
    assert (summary["frames"], summary["readings"], summary["method"]) == (12, 11, "path")
    assert (summary["setup"], summary["setup_pictures"], summary["setup_states"]) == ("background", 2, 2)
    assert (summary["lights"], summary["lights_from"]) == ({"left": 5, "right": 6}, "frames.csv")
    assert main(["track", str(run), "-o", str(tmp_path / "b.csv"), "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_where_most_frames_gave_no_stem_it_says_what_to_try(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", torn=tuple(range(8)))
    assert main(["track", str(run), "-o", str(tmp_path / "a.csv")]) == 0
    advice = capfd.readouterr().err.splitlines()[-1]
    assert advice.startswith("most frames gave no stem: look at them with --overlays, give --hidden-base-cm")
    assert main(["track", str(run), "-o", str(tmp_path / "b.csv"), "--frames", "6:"]) == 0
    assert "most frames" not in capfd.readouterr().err


def test_where_stems_were_found_but_hardly_one_is_ok_it_says_what_to_try(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run")
    assert (
        main(["track", str(run), "-o", str(tmp_path / "a.csv"), "--window", "0,90,319,239", "--widest-stem-cm", "2"])
        == 0
    )
    said = capfd.readouterr()
    assert "0 ok" not in said.out
    assert "touches_edge" in said.out
    assert said.err.splitlines()[-1].startswith("most frames gave no stem that is ok: look at them with --overlays")


def test_existing_output_is_kept_unless_forced(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run")
    out = tmp_path / "track.csv"
    assert main(["track", str(run), "-o", str(out), "-q"]) == 0
    before = out.read_bytes()
    assert main(["track", str(run), "-o", str(out)]) == 2
    assert "is there already; name another file with -o, or add --force" in capfd.readouterr().err
    assert out.read_bytes() == before
    assert main(["track", str(run), "-o", str(out), "--force", "-q", "--frames", "1:"]) == 0
    assert len(read_track(out).time_s) == 10
    for mine in (tmp_path / "notes.txt", run / "frames.csv"):
        mine.write_text("mine\n")
        assert main(["track", str(run), "-o", str(mine), "--force"]) == 2
        assert f"{mine}: is there already, is not a track and is not replaced" in capfd.readouterr().err
        assert mine.read_text() == "mine\n"
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note").write_text("mine\n")
    assert main(["track", str(run), "-o", str(tmp_path / "c.csv"), "--overlays", str(tmp_path / "full")]) == 2
    assert not (tmp_path / "c.csv").exists()
    assert [p.name for p in (tmp_path / "full").iterdir()] == ["note"]


@pytest.mark.parametrize("method", METHODS)
def test_run_without_background_learns_from_its_frames(
    method: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 40, background=False, empty=-1)
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "--json", "--method", method]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert (summary["setup"], summary["setup_pictures"], summary["setup_states"]) == ("frames", 40, 2)
    assert summary["readings"] == 40
    track = read_track(tmp_path / "t.csv")
    assert np.corrcoef(track.points_cm[:, 9, 0], tips(list(range(40)))[:, 0])[0, 1] > 0.99


@pytest.mark.parametrize("method", METHODS)
def test_folder_of_pictures_tells_lamps_that_alternate(
    method: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 40)
    place = ["--anchor", "159.5,220", "--px-per-cm", "10"]
    base = ["track", str(run / "frames"), *place, "--interval-s", "60", "--json", "--method", method]
    found = []
    for name, rule in (("a", []), ("b", ["--light-from", "picture"]), ("c", ["--light-from", "left:0-19,right:20-39"])):
        assert main([*base, *rule, "-o", str(tmp_path / f"{name}.csv")]) == 0
        found.append(json.loads(capfd.readouterr().out))
    assert [f["lights_from"] for f in found] == ["alternation", "picture", "told"]
    assert [f["setup_states"] for f in found] == [2, 2, 2]
    first, *others = ((tmp_path / f"{name}.csv").read_bytes() for name in "abc")
    assert others == [first, first]
    track = read_track(tmp_path / "a.csv")
    assert set(track.light) == {"left", "right"}
    assert np.all(track.time_s % 60 == 0)
    assert main(base[:2]) == 2
    assert "--anchor X,Y" in capfd.readouterr().err


def test_path_needs_no_word_on_lamps_that_are_called_dark(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 20)
    base = ["track", str(run / "frames"), "--anchor", "159.5,220", "--px-per-cm", "10", "--json"]
    assert main([*base, "-o", str(tmp_path / "a.csv")]) == 0
    assert main([*base, "-o", str(tmp_path / "b.csv"), "--light-from", "dark"]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[1])["lights"].keys() == {"dark"}
    a, b = read_track(tmp_path / "a.csv"), read_track(tmp_path / "b.csv")
    assert np.array_equal(a.points_cm, b.points_cm)


def test_film_gives_what_its_pictures_give(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    film = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, SIZE)
    for i in range(50):
        film.write(picture(sway(i), "dark", number=i))
    film.release()
    monkeypatch.chdir(tmp_path)
    options = ["--anchor", "159.5,220", "--px-per-cm", "10", "--frames", "5:50", "-q"]
    assert main(["track", "film.avi", *options]) == 0
    track = read_track(tmp_path / "track.csv")  # the default output
    assert track.time_s.tolist() == [300.0 * i for i in range(5, 50)]
    assert set(track.light) == {"dark"}
    near(track.points_cm[:, 9], tips(list(range(5, 50))))


def test_a_frame_without_points_has_no_row(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 10, empty=4, torn=(8,))
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "-q", "--overlays", str(tmp_path / "seen")]) == 0
    assert read_track(tmp_path / "t.csv").time_s.tolist() == [300.0 * i for i in range(10) if i not in (4, 8)]
    with (tmp_path / "seen" / "readings.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["index"] for row in rows] == [str(i) for i in range(10)]
    assert rows[4]["outcome"] == "no_stem"
    assert rows[8]["outcome"] == "bad_picture"
    assert "cut short" in rows[8]["reason"]
    assert rows[4]["tip_x_px"] == rows[4]["uncertainty10_mm"] == rows[4]["folded"] == ""
    assert rows[5]["outcome"] == "ok"
    assert float(rows[5]["uncertainty10_mm"]) > 0.0
    assert abs(float(rows[5]["tip_y_px"]) - 70.0) < 6.0
    assert not (tmp_path / "seen" / "00008_0008.jpg").exists()


def note_what_was_taken(run: Path) -> None:
    """``frames.jsonl`` as flora-capture leaves it, its last line torn by a power cut."""
    taken = [*sorted(run.glob("background/*.jpg")), *sorted(run.glob("frames/*.jpg"))]
    lines = [
        json.dumps({"file": path.relative_to(run).as_posix(), "sha256": hashlib.sha256(path.read_bytes()).hexdigest()})
        for path in taken
    ]
    (run / "frames.jsonl").write_text("\n".join(lines) + '\n{"file":"frames/00')


def flip_a_bit(path: Path) -> None:
    """In the middle of a JPEG's picture data, which every decoder takes."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(bytes(data))


def test_a_photograph_that_is_not_what_was_taken_has_no_row(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run, out = make_run(tmp_path / "run", 10, empty=4), tmp_path / "t.csv"
    note_what_was_taken(run)
    flip_a_bit(run / "frames" / "0006.jpg")
    assert main(["track", str(run), "-o", str(out)]) == 0
    said = capfd.readouterr()
    assert "10 frames, 8 readings: 8 ok, 1 no_stem, 1 bad_picture" in said.out
    assert "0006.jpg: SHA-256 is " in said.err
    assert "not the picture that was taken" in said.err
    assert read_track(out).time_s.tolist() == [300.0 * i for i in range(10) if i not in (4, 6)]
    (run / "frames.jsonl").unlink()  # nobody knows better
    assert main(["track", str(run), "-o", str(tmp_path / "unnoted.csv"), "-q"]) == 0
    assert 1800.0 in read_track(tmp_path / "unnoted.csv").time_s


@pytest.mark.parametrize("method", METHODS)
def test_a_background_picture_that_is_not_what_was_taken_is_refused(
    method: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 10)
    note_what_was_taken(run)
    flip_a_bit(run / "background" / "left.jpg")
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "--method", method]) == 2
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    assert "background/left.jpg: SHA-256 is " in said
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_covariate_of_the_same_name_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 10)
    table = (run / "frames.csv").read_text()
    (run / "frames.csv").write_text(table.replace("temperature_c", "quality"))
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv")]) == 2
    assert "frames.csv has a column `quality`" in capfd.readouterr().err
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "--method", "paper", "-q"]) == 0


@pytest.mark.parametrize("method", METHODS)
def test_a_covariate_named_like_a_column_of_every_track_is_refused_before_any_work(
    method: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 10)
    table = (run / "frames.csv").read_text()
    (run / "frames.csv").write_text(table.replace("temperature_c", "x1"))
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "--method", method]) == 2
    told = capfd.readouterr().err
    assert told.endswith("run: frames.csv has a column `x1`, which the track needs; rename it\n")
    assert told.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_covariates_with_commas_and_quotes_in_their_names_come_back(tmp_path: Path) -> None:
    run, out = make_run(tmp_path / "run", 10), tmp_path / "t.csv"
    table = (run / "frames.csv").read_text()
    (run / "frames.csv").write_text(table.replace("temperature_c", '"air, ""inside"""'))
    assert main(["track", str(run), "-o", str(out), "-q"]) == 0
    found = read_track(out).covariates
    assert list(found) == ['air, "inside"', "quality", "folded", "tip_uncertainty_mm"]
    assert found['air, "inside"'].tolist() == [20.0 + i for i in range(10) if i != 3]
    assert main(["track", str(run), "-o", str(out), "-q", "--force"]) == 0


def test_frames_whose_lamp_or_covariate_was_not_noted_are_tracked_all_the_same(tmp_path: Path) -> None:
    run, out = make_run(tmp_path / "run", 10), tmp_path / "t.csv"
    lines = (run / "frames.csv").read_text().splitlines()
    for number in (1, 6):
        file, time_s, *_ = lines[number].split(",")
        lines[number] = f"{file},{time_s},,"
    (run / "frames.csv").write_text("\n".join(lines) + "\n")
    assert main(["track", str(run), "-o", str(out), "-q"]) == 0
    track = read_track(out)
    assert track.light[0] == lines[2].split(",")[2]
    assert np.isnan(track.covariates["temperature_c"]).sum() == 2
    assert track.covariates["temperature_c"][1] == 21.0


def test_an_error_midway_leaves_only_what_it_can_go_on_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run")
    frames = sources.RunSource.frames

    def broken(self: sources.RunSource):  # type: ignore[no-untyped-def]
        for frame in frames(self):
            if frame.index == 8:
                raise KeyboardInterrupt
            yield frame

    monkeypatch.setattr(sources.RunSource, "frames", broken)
    before = sorted(tmp_path.iterdir())
    command = ["track", str(run), "-o", str(tmp_path / "t.csv"), "--overlays", str(tmp_path / "seen"), "--jobs", "1"]
    assert main(command) == 130
    assert "8 of 12 frames are kept" in capfd.readouterr().err
    assert sorted(tmp_path.iterdir()) == sorted([*before, tmp_path / ".t.csv.part"])
    monkeypatch.undo()
    assert main(command) == 0
    assert "going on after 8 of 12 frames" in capfd.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run", "seen", "t.csv"]


def test_version_and_bare_command(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capfd.readouterr().out.startswith("flora-lab 0.")
    assert main([]) == 0
    assert "from photographs to controllers" in capfd.readouterr().out
    assert main(["trakc"]) == 2
    said = capfd.readouterr().err
    assert "Did you mean 'track'" in said
    assert said.count("\n") == 1


def test_installed_command_shows_its_help() -> None:
    command = Path(sys.executable).parent / "flora-lab"
    shown = subprocess.run([command, "track", "--help"], capture_output=True, text=True, timeout=60)
    assert shown.returncode == 0
    assert "--light-from" in shown.stdout

"""``flora-lab track`` from end to end on drawn runs: what it writes, what it says, how it ends."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from flora_common.tracks import read_track
from flora_lab import sources
from flora_lab.main import main

BAD = Path(__file__).parents[1] / "golden" / "runs_bad"
SENTENCES = tomllib.loads((BAD / "sentences.toml").read_text())
SIZE = (160, 120)  # width, height
ANCHOR = (79.5, 110.0)
RUN_TOML = """\
interval_s = 300

[camera]
anchor_px = [79.5, 110]
px_per_cm = 5.0
width_px = 160
height_px = 120

[target]
x_cm = -4
y_cm = 16

[obstacle]
x_cm = 8
y_cm = 10
"""


def picture(tip_x: float | None, light: str = "left") -> np.ndarray:
    image = np.full((SIZE[1], SIZE[0], 3), 30, dtype=np.uint8)
    if light != "dark":
        image[2:12, slice(2, 14) if light == "left" else slice(146, 158)] = 255
    if tip_x is not None:
        tip = (tip_x, 30.0)
        cv2.line(image, *[tuple(round(16 * v) for v in p) for p in (ANCHOR, tip)], (60, 230, 60), 2, cv2.LINE_AA, 4)
    return image


def sway(i: int) -> float:
    return float(79.5 + 25 * np.sin(i / 4))


def make_run(
    folder: Path, frames: int = 12, *, background: bool = True, empty: int = 3, torn: tuple[int, ...] = ()
) -> Path:
    (folder / "frames").mkdir(parents=True)
    (folder / "run.toml").write_text(RUN_TOML)
    if background:
        (folder / "background").mkdir()
        for light in ("left", "right"):
            cv2.imwrite(str(folder / "background" / f"{light}.jpg"), picture(None, light))
    lines = ["file,time_s,light,temperature_c"]
    for i in range(frames):
        light = "left" if i < frames // 2 else "right"
        path = folder / "frames" / f"{i:04d}.jpg"
        cv2.imwrite(str(path), picture(None if i == empty else sway(i), light))
        if i in torn:
            path.write_bytes(path.read_bytes()[:-50])
        lines.append(f"frames/{path.name},{300 * i},{light},{20 + i}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    return folder


def fingerprint(folder: Path) -> dict[str, str]:
    return {str(p): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_every_bad_run_has_its_sentence_and_the_other_way_round() -> None:
    assert sorted(SENTENCES) == sorted(p.name for p in BAD.iterdir() if p.name != "sentences.toml")


@pytest.mark.parametrize("name", sorted(SENTENCES))
def test_bad_run_ends_with_2_and_one_line(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out, overlays = tmp_path / "track.csv", tmp_path / "overlays"
    arguments = ["track", str(BAD / name), "-o", str(out), "--overlays", str(overlays)]
    if name == "a_text.mp4":
        arguments += ["--anchor", "1,1", "--px-per-cm", "1"]
    assert main(arguments) == 2
    said = capfd.readouterr()
    sentence = SENTENCES[name]["sentence"].replace("{path}", str(BAD / name))
    assert said.err == f"flora-lab: {sentence}\n"
    assert said.out == ""
    assert list(tmp_path.iterdir()) == []


def test_run_folder_gives_a_track_and_is_left_untouched(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", torn=(7,))
    before = fingerprint(run)
    out = tmp_path / "out" / "track.csv"
    assert main(["track", str(run), "-o", str(out), "--overlays", str(tmp_path / "seen"), "--every", "4"]) == 0
    said = capfd.readouterr()
    assert "12 frames, 10 readings: 10 ok, 1 no_stem, 1 bad_picture" in said.out
    assert said.err.startswith("left out: ")
    assert "0007.jpg: JPEG is cut short" in said.err
    assert fingerprint(run) == before
    track = read_track(out)
    kept = [i for i in range(12) if i not in (3, 7)]
    assert track.time_s.tolist() == [300.0 * i for i in kept]
    assert track.light == tuple("left" if i < 6 else "right" for i in kept)
    assert track.covariates["temperature_c"].tolist() == [20.0 + i for i in kept]
    expected = np.array([((sway(i) - 79.5) / 5.0, 16.0) for i in kept])
    assert np.abs(track.points_cm[:, 9] - expected).max() < 0.5
    assert np.abs(track.points_cm[:, 5] - expected * 5 / 9).max() < 0.15
    names = sorted(p.name for p in (tmp_path / "seen").iterdir())
    assert names == ["00000_0000.jpg", "00004_0004.jpg", "00008_0008.jpg", "contact.png", "readings.csv"]
    table = (tmp_path / "seen" / "readings.csv").read_text().splitlines()
    assert len(table) == 13
    assert table[8].split(",")[4] == "bad_picture"


def test_json_and_quiet_are_for_scripts(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run")
    assert main(["track", str(run), "-o", str(tmp_path / "a.csv"), "--json"]) == 0
    said = capfd.readouterr()
    summary = json.loads(said.out)
    assert said.err == ""
    assert summary["outcomes"] == {"ok": 11, "no_stem": 1}
    assert (summary["frames"], summary["readings"], summary["setup"]) == (12, 11, "background")
    assert main(["track", str(run), "-o", str(tmp_path / "b.csv"), "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_existing_output_is_kept_unless_forced(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run")
    out = tmp_path / "track.csv"
    out.write_text("mine\n")
    assert main(["track", str(run), "-o", str(out)]) == 2
    assert "is there already" in capfd.readouterr().err
    assert out.read_text() == "mine\n"
    assert main(["track", str(run), "-o", str(out), "--force", "-q"]) == 0
    assert len(read_track(out).time_s) == 11
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note").write_text("mine\n")
    assert main(["track", str(run), "-o", str(tmp_path / "c.csv"), "--overlays", str(tmp_path / "full")]) == 2
    assert not (tmp_path / "c.csv").exists()
    assert [p.name for p in (tmp_path / "full").iterdir()] == ["note"]


def test_run_without_background_learns_from_its_frames(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 40, background=False, empty=-1)
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "--json"]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert summary["setup"] == "frames"
    assert summary["readings"] == 40
    track = read_track(tmp_path / "t.csv")
    expected = np.array([(sway(i) - 79.5) / 5.0 for i in range(40)])
    assert np.corrcoef(track.points_cm[:, 9, 0], expected)[0, 1] > 0.99


def test_folder_of_pictures_takes_lamps_from_the_pictures(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 40)
    base = ["track", str(run / "frames"), "--anchor", "79.5,110", "--px-per-cm", "5", "--interval-s", "60", "-q"]
    assert main([*base, "--light-from", "picture", "-o", str(tmp_path / "a.csv")]) == 0
    assert main([*base, "--light-from", "left:0-19,right:20-39", "-o", str(tmp_path / "b.csv")]) == 0
    a, b = read_track(tmp_path / "a.csv"), read_track(tmp_path / "b.csv")
    assert a.light == b.light
    assert set(a.light) == {"left", "right"}
    assert np.array_equal(a.points_cm, b.points_cm)
    assert np.all(a.time_s % 60 == 0)
    capfd.readouterr()
    assert main(base[:2]) == 2
    assert "--anchor X,Y" in capfd.readouterr().err


def test_film_gives_what_its_pictures_give(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    film = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, SIZE)
    for i in range(40):
        film.write(picture(sway(i), "dark"))
    film.release()
    monkeypatch.chdir(tmp_path)
    options = ["--anchor", "79.5,110", "--px-per-cm", "5", "--frames", "10:30", "-q"]
    assert main(["track", "film.avi", *options]) == 0
    track = read_track(tmp_path / "track.csv")  # the default output
    assert track.time_s.tolist() == [300.0 * i for i in range(10, 30)]
    expected = np.array([(sway(i) - 79.5) / 5.0 for i in range(10, 30)])
    assert np.abs(track.points_cm[:, 9, 0] - expected).max() < 0.6


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--anchor", "1;2"], "--anchor: `1;2` is not 2 numbers"),
        (["--window", "1,2,3"], "--window: `1,2,3` is not 4 numbers"),
        (["--anchor", "nan,1"], "--anchor: `nan,1` is not 2 numbers"),
        (["--px-per-cm", "-3"], "--anchor or --px-per-cm: Expected `float` > 0.0"),
        (["--reduction", "3"], "settings: Invalid enum value 3"),
        (["--theta-1", "2"], "settings: Expected `float` < 1.0"),
        (["--frames", "7"], "--frames: `7` is not A:B"),
        (["--frames", "90:"], "--frames: no frame between 90:"),
        (["--light-from", "lfet"], "--light-from: `lfet`; did you mean `left`?"),
        (["--interval-s", "nan"], "--interval-s: nan is not a positive number"),
        (["--method", "magic"], "--method"),
        (["--nonsense"], "No such option: --nonsense"),
    ],
)
def test_bad_option_ends_with_2_and_one_line(
    options: list[str], said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 6)
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), *options]) == 2
    told = capfd.readouterr()
    assert said in told.err
    assert told.err.count("\n") == 1
    assert not (tmp_path / "t.csv").exists()


def test_missing_input_and_single_picture_are_told(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["track", str(tmp_path / "none")]) == 2
    assert "no such run folder, folder of pictures or film" in capfd.readouterr().err
    cv2.imwrite(str(tmp_path / "one.jpg"), picture(80))
    assert main(["track", str(tmp_path / "one.jpg")]) == 2
    assert "a single picture" in capfd.readouterr().err


def test_an_error_midway_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run(tmp_path / "run")
    frames = sources.RunSource.frames

    def broken(self: sources.RunSource):  # type: ignore[no-untyped-def]
        for frame in frames(self):
            if frame.index == 8:
                raise KeyboardInterrupt
            yield frame

    monkeypatch.setattr(sources.RunSource, "frames", broken)
    before = sorted(tmp_path.iterdir())
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "--overlays", str(tmp_path / "seen")]) == 130
    assert sorted(tmp_path.iterdir()) == before


def test_version_and_bare_command(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capfd.readouterr().out.startswith("flora-lab 0.")
    assert main([]) == 0
    assert "from photographs to controllers" in capfd.readouterr().out
    assert main(["trakc"]) == 2
    said = capfd.readouterr().err
    assert "Did you mean 'track'?" in said
    assert said.count("\n") == 1


def test_installed_command_shows_its_help() -> None:
    command = Path(sys.executable).parent / "flora-lab"
    shown = subprocess.run([command, "track", "--help"], capture_output=True, text=True, timeout=60)
    assert shown.returncode == 0
    assert "--light-from" in shown.stdout

"""What ``flora-lab track`` refuses ends with status 2 and one line, and leaves nothing: runs, options and inputs."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import pytest

from drawn_run import make_run, picture
from flora_lab.main import main

BAD = Path(__file__).parents[1] / "golden" / "runs_bad"
SENTENCES = tomllib.loads((BAD / "sentences.toml").read_text())


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


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--anchor", "1;2"], "--anchor: `1;2` is not 2 numbers"),
        (["--window", "1,2,3"], "--window: `1,2,3` is not 4 numbers"),
        (["--anchor", "nan,1"], "--anchor: `nan,1` is not 2 numbers"),
        (["--px-per-cm", "-3"], "--px-per-cm: expected a number >= 1.0, it is -3"),
        (["--px-per-cm", "nan"], "--px-per-cm: expected a number >= 1.0, it is nan"),
        (["--px-per-cm", "0.0001"], "--px-per-cm: expected a number >= 1.0, it is 0.0001"),
        (["--method", "paper", "--reduction", "3"], "--reduction: 3 is none of 1, 2, 4, 8\n"),
        (["--method", "paper", "--theta-1", "2"], "--theta-1: expected a number < 1.0"),
        (["--widest-stem-cm", "0"], "--widest-stem-cm: expected a number > 0.0"),
        (["--window", "1,2,3,90000"], "--window: expected a number <= 20000.0, it is 90000"),
        (["--theta-1", "0.2"], "--theta-1: is an option of --method paper, not of --method path"),
        (["--theta-2-px", "30"], "--theta-2-px: is an option of --method paper"),
        (["--reduction", "3"], "--reduction: 3 is none of 1, 2, 4, 8\n"),
        (["--smallest-component", "0"], "--smallest-component: is an option of --method paper"),
        (["--method", "paper", "--points", "y"], "--points: is an option of --method path, not of --method paper"),
        (["--method", "paper", "--widest-stem-cm", "1"], "--widest-stem-cm: is an option of --method path"),
        (["--method", "paper", "--hidden-base-cm", "1"], "--hidden-base-cm: is an option of --method path"),
        (["--method", "paper", "--below-anchor-cm", "1"], "--below-anchor-cm: is an option of --method path"),
        (["--points", "z"], "--points"),
        (["--jobs", "0"], "--jobs"),
        (["--film", "seen.gif"], "--film: seen.gif must end with .mp4 or .avi"),
        (["--contact", "seen.mp4"], "--contact: seen.mp4 must end with .png"),
        (["--contact", "a.png", "--overlays", "a.png"], "must name different places"),
        (["--frames", "7"], "--frames: `7` is not A:B"),
        (["--frames", "90:"], "--frames: no frame between 90:"),
        (["--light-from", "lfet"], "--light-from: `lfet`; did you mean `left`?"),
        (["--anchor", "321,1"], "--anchor: 321,1 lies outside of the picture of 320x240 px"),
        (["--anchor", "1,-1"], "--anchor: 1,-1 lies outside of the picture"),
        (["--px-per-cm", "1e300"], "--px-per-cm: expected a number <= 1000.0"),
        (["--interval-s", "60"], "/frames.csv tells the times; leave it out"),
        (["--light-from", "left"], "/frames.csv tells the lamps; leave it out"),
        (["--every", "2"], "--every: has no effect, no --overlays, --contact or --film is asked for"),
        (["--interval-s", "1e300"], "--interval-s: 1e+300 does not lie in"),
        (["--interval-s", "1e-300"], "--interval-s: 1e-300 does not lie in"),
        (["--interval-s", "nan"], "--interval-s: nan does not lie in [0.001, 86400]"),
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


@pytest.mark.parametrize("background", [True, False])
def test_a_size_that_no_picture_has_is_told_with_the_file_that_tells_it(
    background: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 12, background=background)
    about = run / "run.toml"
    about.write_text(about.read_text().replace("320", "640"))
    for method in ("path", "paper"):
        assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "--method", method]) == 2
        said = capfd.readouterr().err
        assert f".jpg: is 320x240 px, expected 640x240 by width_px and height_px in {about}" in said


def test_a_photograph_that_is_not_there_is_told_by_the_path_that_the_table_has(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 6)
    (run / "frames" / "0002.jpg").unlink()
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv")]) == 0
    assert f"left out: {run}/frames/0002.jpg: cannot be read" in capfd.readouterr().err


def test_missing_input_and_single_picture_are_told(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["track", str(tmp_path / "none")]) == 2
    assert "no such run folder, folder of pictures or film" in capfd.readouterr().err
    cv2.imwrite(str(tmp_path / "one.jpg"), picture(80))
    assert main(["track", str(tmp_path / "one.jpg")]) == 2
    assert "a single picture" in capfd.readouterr().err

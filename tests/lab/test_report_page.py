"""``flora-lab report``: the run in numbers, and the page."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from flora_common.files import write_bytes, write_text
from flora_common.runs import CameraSection, Light, ObstacleSection, RunFile, RunFolder, TargetSection, run_file_text
from flora_common.shapes import STEM_POINTS
from flora_lab.main import main
from flora_lab.report.summary import summarise

CAMERA = CameraSection(anchor_px=(80.0, 110.0), px_per_cm=5.0, width_px=160, height_px=120)


def make_run(path: Path, tips: list[tuple[float, float]], *, obstacle: bool = True, target: bool = True) -> RunFolder:
    """A run of straight stems, one photograph an hour; lamps change half way."""
    folder = RunFolder(path)
    run = RunFile(
        camera=CAMERA,
        interval_s=3600.0,
        target=TargetSection(x_cm=-5.0, y_cm=15.0) if target else None,
        obstacle=ObstacleSection(x_cm=6.0, y_cm=8.0, width_cm=4.0, height_cm=2.0) if obstacle else None,
    )
    write_text(folder.run_toml, run_file_text(run))
    picture = np.full((120, 160, 3), 40, dtype=np.uint8)
    for i, tip in enumerate(tips):
        file = f"frames/{i:06d}.jpg"
        write_bytes(folder.path / file, cv2.imencode(".jpg", picture)[1].tobytes())
        light: Light = "left" if i < len(tips) // 2 else "right"
        folder.append_frame(file, 3600.0 * i, light)
        folder.append_track(3600.0 * i, light, np.outer(np.linspace(0, 1, STEM_POINTS), tip))
    return folder


def test_fitness_target_and_stop_rule_as_the_paper_defines_them(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12), (-4, 14), (-5, 15), (-5, 21.5), (-6, 24)])
    summary = summarise(run)
    assert summary.stop_row == 4
    assert summary.stop_reason == "the tip was 21 cm high"
    # F = (x_r + y_r) / (|x*| + |y*|), by hand.
    assert summary.fitness_at_target == pytest.approx((20 - 1 - 1) / 20)
    assert summary.reached_h == 2.0
    assert summary.best_fitness == pytest.approx(1.0)
    assert summary.fitness_at_stop == pytest.approx((20 - 0 - 6.5) / 20)
    assert summary.collided_h is None
    assert summary.switches == 1


def test_a_touched_obstacle_ends_the_run(tmp_path: Path) -> None:
    summary = summarise(make_run(tmp_path / "run", [(0, 7), (8, 10), (-5, 15)]))
    assert summary.stop_reason == "the stem touched the obstacle"
    assert (summary.stop_row, summary.collided_h, summary.clearance_cm) == (1, 1.0, 0.0)


def test_the_page_stands_alone_and_is_the_same_each_time(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12), (-5, 15)])
    pages = []
    for name in ("a", "b"):
        page, strip = tmp_path / f"{name}.html", tmp_path / f"{name}.png"
        arguments = ["report", str(run.path), "-o", str(page), "--strip", str(strip), "--note", "who=<me>"]
        assert main(arguments) == 0
        assert cv2.imread(str(strip)).shape[1] > 100
        pages.append(page.read_text())
    assert pages[0] == pages[1]
    assert "http" not in pages[0].replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "https://matplotlib.org/", ""
    ).replace("http://creativecommons.org", "")
    assert "&lt;me&gt;" in pages[0]
    assert "100.0 %" in pages[0]


def test_a_page_is_replaced_only_when_asked_for_and_what_is_no_page_never(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12)])
    page, strip, mine = tmp_path / "r.html", tmp_path / "s.PNG", tmp_path / "mine.html"
    command = ["report", str(run.path), "-o", str(page), "--strip", str(strip)]
    assert main(command) == 0
    before = page.read_bytes()
    assert main([*command, "--title", "other"]) == 2
    assert "r.html: is there already; name another file with -o, or add --force" in capsys.readouterr().err
    assert page.read_bytes() == before
    assert main([*command, "--title", "other", "--force"]) == 0
    assert b"<h1>other</h1>" in page.read_bytes()
    mine.write_text("<!doctype html>mine")
    for more, said in (
        (["-o", str(mine)], "mine.html: is there already, is not the page of a run and is not replaced"),
        (["--strip", str(run.path / "frames" / "000000.jpg")], "the strip is written as PNG"),
        (["-o", str(strip), "--strip", str(strip)], "is not the page of a run"),
        (["-o", str(run.path)], "run: is a folder; name a file with -o"),
        (
            ["--strip", str(mine / "strip.png")],
            f"cannot be written, {mine} is no folder; name another place with --strip",
        ),
    ):
        capsys.readouterr()
        assert main([*command, "--force", *more]) == 2
        told = capsys.readouterr().err
        assert said in told
        assert told.count("\n") == 1
    assert mine.read_text() == "<!doctype html>mine"


def report_with_strip(run: RunFolder, page: Path) -> tuple[int, np.ndarray | None]:
    """Exit status of a report, and the strip that it wrote."""
    strip = page.with_suffix(".png")
    status = main(["report", str(run.path), "-o", str(page), "--strip", str(strip)])
    return status, cv2.imread(str(strip)) if strip.exists() else None


def tear(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-50])


def test_a_torn_photograph_is_replaced_by_the_nearest_whole_one_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", [(0, 7 + 0.1 * i) for i in range(40)])
    status, whole = report_with_strip(run, tmp_path / "whole.html")
    assert status == 0
    assert capsys.readouterr().err == ""
    tear(run.frames / "000020.jpg")
    status, mended = report_with_strip(run, tmp_path / "mended.html")
    assert status == 0
    told = capsys.readouterr().err
    assert told.startswith("left out of the strip: ")
    assert "000020.jpg: JPEG is cut short" in told
    assert told.count("\n") == 1
    assert whole is not None
    assert mended is not None
    assert mended.shape == whole.shape
    middle = whole.shape[1] // 2
    assert not np.array_equal(mended[:, :middle], whole[:, :middle])  # the panel of hour 19 says so
    assert np.array_equal(mended[:, middle:], whole[:, middle:])
    for file in run.frames.iterdir():
        tear(file)
    assert report_with_strip(run, tmp_path / "none.html") == (2, None)
    told = capsys.readouterr().err
    assert "none of the 40 photographs can be used; the first: " in told
    assert told.count("\n") == 1
    assert not (tmp_path / "none.html").exists()


def test_a_photograph_that_is_not_what_was_taken_is_not_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12), (-5, 15)])
    taken = [
        {"file": f"frames/{file.name}", "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
        for file in sorted(run.frames.iterdir())
    ]
    run.frames_log.write_text("".join(json.dumps(line) + "\n" for line in taken))
    other = np.full((120, 160, 3), 200, dtype=np.uint8)
    write_bytes(run.frames / "000002.jpg", cv2.imencode(".jpg", other)[1].tobytes())
    status, strip = report_with_strip(run, tmp_path / "r.html")
    assert status == 0
    assert strip is not None
    assert np.median(strip) < 100
    assert "000002.jpg: SHA-256 is " in capsys.readouterr().err


def test_a_photograph_of_another_size_is_not_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12), (-5, 15)])
    other = np.full((240, 320, 3), 40, dtype=np.uint8)
    write_bytes(run.frames / "000002.jpg", cv2.imencode(".jpg", other)[1].tobytes())
    assert report_with_strip(run, tmp_path / "r.html")[0] == 0
    assert "000002.jpg: is 320x240 px, expected 160x120" in capsys.readouterr().err


def test_photographs_named_without_their_folder_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12)])
    run.frames_csv.write_text(run.frames_csv.read_text().replace("frames/", ""))
    assert report_with_strip(run, tmp_path / "r.html")[0] == 0
    assert capsys.readouterr().err == ""


def test_neither_page_nor_strip_takes_the_place_of_a_file_of_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12), (-5, 15)])
    photograph = run.frames / "000001.png"
    picture = np.full((120, 160, 3), 40, dtype=np.uint8)
    for file in (photograph, run.background / "dark.png", run.path / "000002.png"):
        write_bytes(file, cv2.imencode(".png", picture)[1].tobytes())
    write_text(run.frames_csv, run.frames_csv.read_text().replace("frames/000002.jpg", "000002.png"))
    (tmp_path / "link.png").symlink_to(photograph)
    (run.frames / "empty.html").touch()
    before = {file: file.read_bytes() for file in run.path.rglob("*") if file.is_file()}
    command = ["report", str(run.path), "--force"]
    page = ["-o", str(tmp_path / "r.html")]
    for more in (
        [*page, "--strip", str(photograph)],
        [*page, "--strip", str(tmp_path / "link.png")],
        [*page, "--strip", str(run.background / "dark.png")],
        [*page, "--strip", str(run.path / "000002.png")],
        ["-o", str(run.frames / "empty.html")],
    ):
        assert main([*command, *more]) == 2
        told = capsys.readouterr().err
        assert f"{more[-1]}: belongs to the input, which stays as it is; name another file" in told
        assert told.count("\n") == 1
    assert {file: file.read_bytes() for file in run.path.rglob("*") if file.is_file()} == before
    assert not (tmp_path / "r.html").exists()
    beside = ["-o", str(run.path / "report.html"), "--strip", str(run.path / "strip.png")]
    assert main([*command, *beside]) == main([*command, *beside]) == 0


def test_numbers_for_scripts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12)], obstacle=False, target=False)
    assert main(["report", str(run.path), "-o", str(tmp_path / "r.html"), "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["frames"] == numbers["readings"] == 2
    assert numbers["fitness_at_stop"] is None
    assert numbers["clearance_cm"] is None


@pytest.mark.parametrize("missing", ["run.toml", "frames.csv", "track.csv"])
def test_an_incomplete_run_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], missing: str
) -> None:
    run = make_run(tmp_path / "run", [(0, 7), (-3, 12)])
    (run.path / missing).unlink()
    page = tmp_path / "r.html"
    assert main(["report", str(run.path), "-o", str(page)]) == 2
    said = capsys.readouterr().err
    assert missing in said
    assert said.count("\n") == 1
    assert not page.exists()

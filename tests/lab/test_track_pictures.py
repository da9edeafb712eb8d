"""Overlays, contact sheets and films of ``flora-lab track``: there when asked for, whole, and showing the plant."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from drawn_run import ANCHOR, PX_PER_CM, SIZE, make_run, picture
from flora_common.runs import CameraSection
from flora_common.vision.reading import StemReading
from flora_lab.main import main
from flora_lab.track.drawing import CropToDrawing, DrawReadings, View, caption_of, plant_view, whole
from flora_lab.track.readings import Reading

CAMERA = CameraSection(ANCHOR, PX_PER_CM, *SIZE)
LINE = np.column_stack([np.linspace(159.5, 140.0, 60), np.linspace(220.0, 120.0, 60)])


def reading(outcome: str = "ok", *, uncertainty_mm: float = 1.0) -> Reading:
    points = (LINE[np.linspace(0, 59, 10).astype(int)] - ANCHOR) * [1.0, -1.0] / PX_PER_CM
    stem = StemReading(
        outcome,
        0.9,
        points,
        (140.0, 120.0),
        "for some reason",
        uncertainty_mm=np.full(10, uncertainty_mm),
        line_px=LINE,
    )
    return Reading(3, "0003.jpg", 5400.0, "left", {}, stem)


def changed(drawn: np.ndarray, empty: np.ndarray) -> np.ndarray:
    return np.abs(drawn.astype(int) - empty).sum(axis=2) > 60


def frames_of(path: Path) -> list[np.ndarray]:
    film, frames = cv2.VideoCapture(str(path)), []
    while (got := film.read())[0]:
        frames.append(got[1])
    film.release()
    return frames


@pytest.mark.parametrize("suffix", ["mp4", "avi"])
def test_film_and_contact_sheet_alone(suffix: str, tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 10)
    film, sheet = tmp_path / "new" / f"seen.{suffix}", tmp_path / "new" / "seen.png"
    command = ["track", str(run), "-o", str(tmp_path / "t.csv"), "-q", "--film", str(film), "--contact", str(sheet)]
    assert main(command) == 0
    assert sorted(p.name for p in film.parent.iterdir()) == sorted([film.name, sheet.name])
    frames = frames_of(film)
    assert len(frames) == 10
    assert max(frames[0].shape) == 800
    tiles = cv2.imread(str(sheet))
    assert tiles is not None
    assert tiles.shape[1] % 5 == 0
    assert max(tiles.shape[0] // 2, tiles.shape[1] // 5) == 400


def test_every_thins_film_and_sheet(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 10)
    film, sheet = tmp_path / "seen.mp4", tmp_path / "seen.png"
    command = ["track", str(run), "-o", str(tmp_path / "t.csv"), "-q", "--film", str(film), "--contact", str(sheet)]
    assert main([*command, "--every", "4"]) == 0
    assert len(frames_of(film)) == 3
    tiles = cv2.imread(str(sheet))
    assert tiles is not None
    assert max(tiles.shape[0], tiles.shape[1] // 3) == 400


def test_what_is_there_is_kept_unless_forced(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 6)
    film = tmp_path / "seen.mp4"
    film.write_text("mine")
    sheet = tmp_path / "sheet.png"
    sheet.write_bytes(b"mine")
    command = ["track", str(run), "-o", str(tmp_path / "t.csv"), "-q", "--film", str(film)]
    assert main(command) == 2
    assert "seen.mp4: is there already" in capfd.readouterr().err
    assert main([*command, "--force"]) == 2
    assert "seen.mp4: is there already, is not a film and is not replaced" in capfd.readouterr().err
    assert film.read_text() == "mine"
    film.unlink()
    assert main([*command, "--contact", str(sheet), "--force"]) == 2
    assert "sheet.png: is there already, is not a picture" in capfd.readouterr().err
    for more in ([], ["--force"]):
        (tmp_path / "t.csv").unlink(missing_ok=True)
        assert main([*command, *more]) == 0
        assert len(frames_of(film)) == 6


def test_no_picture_takes_the_place_of_one_of_the_input(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 6)
    photograph = run / "frames" / "0003.jpg"
    before = photograph.read_bytes()
    command = ["track", str(run), "-o", str(tmp_path / "t.csv"), "--contact", str(photograph), "--force"]
    assert main(command) == 2
    assert "0003.jpg: belongs to the input, which stays as it is" in capfd.readouterr().err
    assert photograph.read_bytes() == before


@pytest.mark.parametrize(
    ("option", "place"),
    [
        ("--overlays", "background"),
        ("--contact", "frames/sheet.png"),
        ("--contact", "background/sheet.jpg"),
    ],
)
def test_no_picture_is_drawn_among_the_photographs_of_the_input(
    option: str, place: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 6, background=False)
    assert main(["track", str(run), "-o", str(run / "track.csv"), option, str(run / place)]) == 2
    assert "would lie among the photographs of the input" in capfd.readouterr().err
    if option == "--contact":
        sheet = run / "frames" / "sheet.png"
        folder = [
            "track",
            str(run / "frames"),
            "--anchor",
            "160,220",
            "--px-per-cm",
            "10",
            "-o",
            str(tmp_path / "t.csv"),
        ]
        assert main([*folder, "--contact", str(sheet)]) == 2
        assert f"{sheet}: would lie among the photographs" in capfd.readouterr().err


def test_what_is_no_photograph_may_lie_in_the_input(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 6)
    places = ["-o", str(run / "track.csv"), "--overlays", str(run / "seen"), "--contact", str(run / "seen.png")]
    assert main(["track", str(run), "-q", *places]) == 0


@pytest.mark.parametrize("is_empty", [True, False])
def test_overlays_are_a_new_folder(is_empty: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run", 6)
    seen = tmp_path / "seen"
    seen.mkdir()
    if not is_empty:
        (seen / "note").write_text("mine")
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), "--overlays", str(seen)]) == 2
    assert f"{seen}: is there already; name another folder with --overlays\n" in capfd.readouterr().err


def test_no_track_takes_the_place_of_an_empty_file_of_the_input(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 6)
    lost = run / "frames" / "0003.jpg"
    lost.write_bytes(b"")
    assert main(["track", str(run), "-o", str(lost), "--force"]) == 2
    assert "0003.jpg: belongs to the input, which stays as it is" in capfd.readouterr().err
    assert lost.read_bytes() == b""


@pytest.mark.parametrize("option", ["--overlays", "--contact", "--film", "-o"])
def test_a_place_where_nothing_can_be_made_is_told_before_any_work(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 6)
    monkeypatch.setattr("flora_lab.track.command.open_source", None)
    (tmp_path / "note").write_text("mine")
    suffix = {"--contact": ".png", "--film": ".mp4"}.get(option, "")
    place = tmp_path / "note" / f"seen{suffix}"
    assert main(["track", str(run), "-o", str(tmp_path / "t.csv"), option, str(place)]) == 2
    said = capfd.readouterr().err
    assert f"{place}: cannot be written, {tmp_path / 'note'} is no folder; name another place with {option}" in said


def test_pictures_that_cannot_be_made_leave_only_the_readings(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run", 10, torn=(0, 5))
    command = ["track", str(run), "-o", str(tmp_path / "t.csv"), "--contact", str(tmp_path / "s.png"), "--every"]
    assert main([*command, "5"]) == 2
    said = capfd.readouterr().err
    assert "none of the photographs chosen for it can be used; choose others with --every" in said
    assert sorted(p.name for p in tmp_path.iterdir()) == [".t.csv.part", "run"]
    assert main([*command, "3"]) == 0
    assert "going on after 10 of 10 frames" in capfd.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run", "s.png", "t.csv"]


def test_the_line_is_drawn_where_it_was_found_in_any_view() -> None:
    empty = picture(None)
    draw = DrawReadings(CAMERA, None, None)
    for view in (View((0, 0, *SIZE), 4.0, caption=False), View((100, 80, 220, 230), 3.3, caption=False)):
        blank = Reading(3, "0003.jpg", 0.0, "left", {}, StemReading("no_stem"))
        drawn = changed(draw.drawn(empty, reading(uncertainty_mm=0.1), view), draw.drawn(empty, blank, view))
        place = CropToDrawing(view)
        for x, y in place(LINE[10:50]):
            assert drawn[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2].any()
        away = place(LINE + np.array([12.0, 0.0]))[10:50]
        assert not any(drawn[round(y), round(x)] for x, y in away)


def test_the_band_is_as_wide_as_the_uncertainty() -> None:
    empty, view = picture(None), View((100, 80, 220, 230), 4.0, caption=False)
    draw = DrawReadings(CAMERA, None, None)
    widths = []
    for uncertainty_mm in (1.0, 3.0):
        sure = draw.drawn(empty, reading(uncertainty_mm=0.0), view)
        row = np.flatnonzero((draw.drawn(empty, reading(uncertainty_mm=uncertainty_mm), view) != sure).any(axis=2)[360])
        widths.append(row.max() - row.min())
    expected = [2 * 2 * mm * 0.1 * PX_PER_CM * 4.0 for mm in (1.0, 3.0)]
    assert widths == pytest.approx(expected, abs=3.0)


def test_doubtful_readings_look_different_and_say_why() -> None:
    empty, view = picture(None), whole(SIZE, least_width_px=1280)
    draw = DrawReadings(CAMERA, None, None)
    assert not np.array_equal(draw.drawn(empty, reading(), view), draw.drawn(empty, reading("jumped"), view))
    assert caption_of(reading()) == "0003.jpg  1.50 h  ok  quality 0.90  tip +-1.0 mm"
    assert caption_of(reading("jumped")).endswith("  jumped  quality 0.90  tip +-1.0 mm: for some reason")


def test_views_hold_the_plant_and_stay_in_the_picture() -> None:
    view = plant_view([reading()], CAMERA, longest_px=400, caption=True)
    left, top, right, bottom = view.box
    assert 0 <= left < 140 - 5
    assert 160 + 5 < right <= SIZE[0]
    assert 0 <= top < 120 - 5
    assert 220 < bottom <= SIZE[1]
    assert max(view.size_px) == 400
    assert plant_view([], CAMERA, longest_px=400, caption=True).box[2] <= SIZE[0]
    outside = CameraSection((-500.0, 4000.0), PX_PER_CM, *SIZE)
    x0, y0, x1, y1 = plant_view([], outside, longest_px=400, caption=True).box
    assert 0 <= x0 < x1 <= SIZE[0]
    assert 0 <= y0 < y1 <= SIZE[1]
    assert all(v % 2 == 0 for v in View((0, 0, 321, 241), 1.0).size_px)

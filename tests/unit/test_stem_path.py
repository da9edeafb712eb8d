"""The stem service with the path method: what it says, remembers over a kill, and learns without a background."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from stem_fakes import CAMERA, Box, jpeg

from flora_common.messages import Stem
from flora_common.runs import CameraSection, RunFile, RunFolder
from flora_common.tracks import read_track
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.picture import Picture
from flora_stem.background import LEARN_AT
from flora_stem.record import RECORD_FILE, StemRecord, continued, last_track_row, read_record, write_record


class PathBox(Box):
    METHOD = "path"


@pytest.fixture
def box(tmp_path: Path) -> PathBox:
    made = PathBox(tmp_path)
    made.calibrate()
    return made


class LargeBox(PathBox):
    """Its camera's pictures are four times as wide: 40 px per cm, of which the method wants a half."""

    RUN_FILE = RunFile(camera=CameraSection((641.5, 881.5), 40.0, 1280, 960), rig="test")

    @staticmethod
    def photograph(picture: Picture) -> Picture:
        return np.asarray(cv2.resize(picture, (1280, 960), interpolation=cv2.INTER_CUBIC), dtype=np.uint8)


def board(seed: int = 0) -> Picture:
    """An empty box with a grain that stays, under a little noise that does not."""
    grain = np.random.default_rng(1).normal(34.0, 3.0, (240, 320, 3))
    return np.clip(grain + np.random.default_rng(seed).normal(0.0, 1.5, grain.shape), 0, 255).astype(np.uint8)


def plant(lean_cm: float, height_cm: float, seed: int, *, leaves: bool = True) -> Picture:
    """A stem that bends sideways by ``lean_cm`` at its tip, with two leaves on stalks."""
    picture = board(seed)
    t = np.linspace(0.0, 1.0, 60)
    line = np.column_stack([160 + 10 * lean_cm * t**2, 220 - 10 * height_cm * t])
    if leaves:
        node = line[38]
        for side in (-1, 1):
            end = node + np.array([side * 14.0, -4.0])
            cv2.line(picture, _xy(node), _xy(end), (60, 150, 90), 2, cv2.LINE_AA)
            cv2.ellipse(
                picture,
                _xy(end + np.array([side * 12.0, 4.0])),
                (13, 8),
                20 * side,
                0,
                360,
                (40, 120, 50),
                -1,
                cv2.LINE_AA,
            )
    cv2.polylines(picture, [np.rint(line * 16).astype(np.int32)], False, (110, 190, 160), 4, cv2.LINE_AA, 4)
    return picture


def _xy(place: np.ndarray) -> tuple[int, int]:
    return round(float(place[0])), round(float(place[1]))


def answer(box: Box, tick: int, picture: Picture) -> Stem:
    found = box.core.on_frame(box.frame(tick, jpeg(picture)))
    assert found is not None
    box.track.add(found.row)
    write_record(box.state / RECORD_FILE, box.core.record)
    return found.stem


def calibrated(box: Box) -> None:
    for i, name in enumerate(("left-1", "right-1", "dark-1")):
        (box.run.background / f"{name}.jpg").write_bytes(jpeg(board(100 + i)))
    box.look()


def wait_until_learnt(box: Box) -> None:
    give_up_s = time.monotonic() + 30.0
    while not box.background.refresh():
        assert time.monotonic() < give_up_s
        time.sleep(0.01)  # another thread learns; nothing tells when it is done


def test_stem_and_uncertainty_are_said_and_written(box: PathBox) -> None:
    calibrated(box)
    stem = answer(box, 1, plant(3.0, 12.0, 1))
    assert (stem.outcome, stem.method, stem.folded) == ("ok", "path", False)
    assert len(stem.uncertainty_mm) == 10
    assert np.hypot(stem.points_cm[-1][0] - 3.0, stem.points_cm[-1][1] - 12.0) < 0.25
    track = read_track(box.run.track_csv)
    assert set(track.covariates) == {"quality", "folded", "tip_uncertainty_mm"}
    assert track.covariates["quality"][0] > 0.8
    assert track.covariates["tip_uncertainty_mm"][0] == pytest.approx(stem.uncertainty_mm[-1], abs=1e-3)


def test_killed_after_any_frame_the_run_reads_the_same(box: PathBox, tmp_path: Path) -> None:
    pictures = [plant(0.4 * k, 9.0 + 0.2 * k, k) for k in range(6)]
    (tmp_path / "other").mkdir()
    other = PathBox(tmp_path / "other")
    calibrated(box)
    calibrated(other)
    straight = [answer(box, tick, picture) for tick, picture in enumerate(pictures, start=1)]
    killed = []
    for tick, picture in enumerate(pictures, start=1):
        killed.append(answer(other, tick, picture))
        other.start()
    assert [s.points_cm for s in killed] == [s.points_cm for s in straight]
    assert [s.uncertainty_mm for s in killed] == [s.uncertainty_mm for s in straight]


def test_without_its_record_it_goes_on_from_the_track(box: PathBox) -> None:
    calibrated(box)
    answer(box, 1, plant(3.0, 12.0, 1))
    last = last_track_row(box.run.track_csv)
    assert last is not None
    record = continued(StemRecord("run"), last, CAMERA, PathSettings())
    assert record.path is not None
    assert record.path.line_px[-1] == pytest.approx((190.0, 100.0), abs=2.5)
    assert record.path.length.length_cm == pytest.approx(12.5, abs=0.4)


def test_a_record_of_the_earlier_version_is_read(tmp_path: Path) -> None:
    file = tmp_path / RECORD_FILE
    file.write_bytes(b'{"run":"r","tick":7,"stem":null,"tip_px":[10.0,20.0]}')
    record = read_record(file, run="r")
    assert (record.tick, record.tip_px, record.path) == (7, (10.0, 20.0), None)


def test_without_background_pictures_the_setup_is_learnt_from_the_frames(tmp_path: Path) -> None:
    box = PathBox(tmp_path)
    said = []
    for tick in range(1, LEARN_AT[0] + 1):
        frame = box.frame(tick, jpeg(plant(4.0 - 0.7 * tick, 10.0 + 0.1 * tick, tick, leaves=False)))
        found = box.core.on_frame(frame)
        assert found is not None
        said.append(found.stem)
        box.background.saw(frame)
        box.core.use(box.background.finder, box.background.reason)
    assert {s.outcome for s in said} == {"no_stem"}
    assert "11 are there" in said[-1].reason
    wait_until_learnt(box)
    assert (box.background.made_by, box.background.pictures) == ("frames", LEARN_AT[0])
    box.core.use(box.background.finder, box.background.reason)
    stem = answer(box, LEARN_AT[0] + 1, plant(-4.8, 11.4, 50, leaves=False))
    assert stem.outcome == "ok"
    assert np.hypot(stem.points_cm[-1][0] + 4.8, stem.points_cm[-1][1] - 11.4) < 0.4


@pytest.mark.parametrize("what", ["folder", "list of names", "picture"])
def test_where_the_disk_does_not_give_out_background_pictures_the_frames_must_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    box = PathBox(tmp_path)
    calibrated(box)
    call = {"folder": "stat", "list of names": "scandir", "picture": "open"}[what]
    bad_paths = {"folder": box.run.background, "list of names": box.run.background}
    bad_path, real = bad_paths.get(what, box.run.background / "left-1.jpg"), getattr(os, call)

    def bad(path: Any = ".", *arguments: Any, **keywords: Any) -> Any:
        if isinstance(path, str | Path) and Path(path) == bad_path:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        return real(path, *arguments, **keywords)

    with monkeypatch.context() as patch:
        patch.setattr(os, call, bad)
        for tick in range(1, LEARN_AT[0] + 1):
            frame = box.frame(tick, jpeg(plant(4.0 - 0.7 * tick, 10.0 + 0.1 * tick, tick, leaves=False)))
            box.run.append_frame(frame.path, frame.time_s, frame.light)
        box.start()
        assert box.background.unreadable == f"{bad_path}: cannot be read (Input/output error); check its disk"
        wait_until_learnt(box)
        assert (box.background.made_by, box.background.pictures) == ("frames", LEARN_AT[0])
        assert box.background.unreadable
    if what != "picture":
        box.look()
        assert (box.background.made_by, box.background.unreadable) == ("background", "")


def test_what_was_made_from_background_pictures_holds_when_the_disk_gives_them_out_no_more(
    box: PathBox, monkeypatch: pytest.MonkeyPatch
) -> None:
    calibrated(box)

    def bad(self: RunFolder) -> list[Path]:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "background_pictures", bad)
        assert not box.background.refresh()
        assert "cannot be read (Input/output error)" in box.background.unreadable
    assert (box.background.made_by, box.background.pictures) == ("background", 3)
    assert not box.background.refresh()
    assert box.background.unreadable == ""


def test_a_start_in_the_middle_of_a_run_learns_from_the_frames_that_are_there(tmp_path: Path) -> None:
    box = PathBox(tmp_path)
    for tick in range(1, 2 * LEARN_AT[0] + 3):
        picture = plant(4.0 - 0.35 * tick, 10.0 + 0.1 * tick, tick, leaves=False)
        frame = box.frame(tick, jpeg(picture), light="left" if tick % 2 else "right")
        box.run.append_frame(frame.path, frame.time_s, frame.light)
    for stored in (1, 2):  # at the NAS, and freed here
        (box.run.path / f"frames/{stored:06d}.jpg").unlink()
    box.start()
    learnt_from = []
    for _ in ("left", "right"):  # one after the other
        wait_until_learnt(box)
        learnt_from.append(box.background.pictures)
    assert learnt_from == [LEARN_AT[0], 2 * LEARN_AT[0]]
    box.core.use(box.background.finder, box.background.reason)
    assert answer(box, 50, plant(-4.8, 12.4, 50, leaves=False)).outcome == "ok"


def test_large_pictures_are_read_at_a_part_of_their_size(tmp_path: Path) -> None:
    box = LargeBox(tmp_path)
    for i, name in enumerate(("left-1", "right-1", "dark-1")):
        (box.run.background / f"{name}.jpg").write_bytes(jpeg(box.photograph(board(100 + i))))
    box.look()
    assert box.section.reduction(box.RUN_FILE.camera) == 2
    for tick in (1, 2, 3):  # killed after each
        stem = answer(box, tick, box.photograph(plant(3.0, 12.0 + 0.1 * tick, tick)))
        assert stem.outcome == "ok"
        assert np.hypot(stem.points_cm[-1][0] - 3.0, stem.points_cm[-1][1] - 12.0 - 0.1 * tick) < 0.25
        box.start()
    record = box.core.record
    tip_px = 641.5 + 40 * stem.points_cm[-1][0], 881.5 - 40 * stem.points_cm[-1][1]
    assert record.tip_px == pytest.approx(tip_px, abs=0.5)
    (box.state / RECORD_FILE).unlink()
    box.start()  # from the track
    assert box.core.record.path is not None
    assert box.core.record.path.reduction == 2
    assert box.core.record.tip_px == pytest.approx(tip_px, abs=0.5)
    assert answer(box, 4, box.photograph(plant(3.0, 12.4, 4))).outcome == "ok"


def test_the_setup_is_learnt_from_large_frames_too(tmp_path: Path) -> None:
    box = LargeBox(tmp_path)
    for tick in range(1, LEARN_AT[0] + 1):
        picture = box.photograph(plant(4.0 - 0.7 * tick, 10.0 + 0.1 * tick, tick, leaves=False))
        box.background.saw(box.frame(tick, jpeg(picture)))
    wait_until_learnt(box)
    box.core.use(box.background.finder, box.background.reason)
    stem = answer(box, LEARN_AT[0] + 1, box.photograph(plant(-4.8, 11.4, 50, leaves=False)))
    assert stem.outcome == "ok"
    assert np.hypot(stem.points_cm[-1][0] + 4.8, stem.points_cm[-1][1] - 11.4) < 0.4

"""What the empty setup is learnt from, and what is known of a sequence before any stem is looked for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from drawn_run import ANCHOR, PX_PER_CM, SIZE, make_run, picture, sway
from flora_common.errors import BadInput
from flora_common.runs import CameraSection
from flora_common.vision.paper import PaperSettings
from flora_common.vision.path.settings import PathSettings
from flora_lab.lights import parse_rule
from flora_lab.sources import FolderSource, RunSource
from flora_lab.track import learning
from flora_lab.track.pool import Pool
from flora_lab.track.readings import Span

ALL = Span()
CAMERA = CameraSection(ANCHOR, PX_PER_CM, *SIZE)


def folder_of(tmp_path: Path, lights: list[str]) -> FolderSource:
    for i, light in enumerate(lights):
        cv2.imwrite(str(tmp_path / f"{i:03d}.png"), picture(sway(i), light, number=i))
    return FolderSource(tmp_path)


def test_pictures_of_a_folder_come_as_a_camera_counts_them_and_a_table_beside_them_is_not_passed_over_in_silence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (8, 9, 10, 11, 100):
        cv2.imwrite(str(tmp_path / f"IMG_{number}.png"), picture(None))
    (tmp_path / "._IMG_8.png").write_bytes(b"\0\5\x16\7")
    names = [frame.name for frame in FolderSource(tmp_path).frames()]
    assert names == ["IMG_8.png", "IMG_9.png", "IMG_10.png", "IMG_11.png", "IMG_100.png"]
    assert capsys.readouterr().err == ""
    (tmp_path / "frames.csv").write_text("file,time_s,light\n")
    FolderSource(tmp_path)
    assert "frames.csv is not looked at, for there is no run.toml beside it" in capsys.readouterr().err


def sort(source: FolderSource | RunSource, rule: str = "auto", span: Span = ALL) -> learning.Sorted:
    return learning.sort_frames(source, span, parse_rule(rule), Pool(1), path=True)


def test_a_folder_that_is_called_as_a_picture_is_none(tmp_path: Path) -> None:
    source = folder_of(tmp_path, ["left", "right"])
    (tmp_path / "x.jpg").mkdir()
    assert FolderSource(tmp_path).files() == source.files()


def test_frames_are_put_together_by_what_they_look_like(tmp_path: Path) -> None:
    source = folder_of(tmp_path, (["left"] * 4 + ["right"] * 4 + ["dark"] * 3) * 2)
    found = sort(source)
    groups = [found.alike[i] for i in range(22)]
    assert groups == ([0] * 4 + [1] * 4 + [2] * 3) * 2
    assert [found.lights[i] for i in range(11)] == ["left"] * 4 + ["right"] * 4 + ["dark"] * 3
    assert found.lights_from == "alternation"
    one = sort(source, span=Span(0, 4))
    assert (set(one.lights.values()), one.lights_from) == ({"dark"}, "nothing")
    assert sort(source, "picture", Span(0, 4)).lights == dict.fromkeys(range(4), "left")
    assert sort(source, "right", Span(0, 4)).lights == dict.fromkeys(range(4), "right")


def test_setup_is_learnt_per_appearance_and_small_groups_are_left_out(tmp_path: Path) -> None:
    source = folder_of(tmp_path, ["left"] * 30 + ["dark"] * 2 + ["right"] * 30)
    learnt = learning.path_setup(source, [], CAMERA, PathSettings(), sort(source))
    assert (learnt.made_by, learnt.pictures, learnt.states) == ("frames", 60, 2)


def test_at_most_32_frames_of_a_state_and_bad_ones_are_passed_over(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 100, background=False, empty=-1, torn=(0, 7, 99))
    source = RunSource(run)
    seen: list[int] = []
    learnt = learning.path_setup(source, [], CAMERA, PathSettings(), sort(source), on_frame=lambda: seen.append(1))
    assert (learnt.pictures, learnt.states) == (64, 2)
    assert len(seen) == 64


def test_spread_takes_one_of_each_stretch() -> None:
    members = list(range(100, 200))
    slots = learning._spread(members, 32)
    assert [i for slot in slots for i in slot] == members
    assert len(slots) == 32
    assert {len(s) for s in slots} <= {3, 4}
    assert [len(s) for s in learning._spread(members[:5], 32)] == [1] * 5
    assert {len(s) for s in learning._every_other(members, 60)} == {2}
    assert [s[0] for s in learning._every_other(members, 30)] == members[::4]


def test_too_few_frames_are_told_with_the_lamp(tmp_path: Path) -> None:
    run = RunSource(make_run(tmp_path / "run", 6, background=False))
    with pytest.raises(BadInput, match="with light `left` 3 frames are too few"):
        learning.path_setup(run, [], CAMERA, PathSettings(), sort(run))
    with pytest.raises(BadInput, match="with light `left` 3 frames are too few"):
        learning.paper_setup(run, [], PaperSettings(reduction=1), sort(run))
    (tmp_path / "few").mkdir()
    few = folder_of(tmp_path / "few", ["left", "right"])
    with pytest.raises(BadInput, match="no background pictures, and 2 frames are too few"):
        learning.path_setup(few, [], CAMERA, PathSettings(), sort(few))


def test_frames_that_cannot_be_used_teach_nothing(tmp_path: Path) -> None:
    run = RunSource(make_run(tmp_path / "run", 6, background=False, torn=tuple(range(6))))
    with pytest.raises(BadInput, match="0 frames are too few"):
        learning.path_setup(run, [], CAMERA, PathSettings(), sort(run))
    with pytest.raises(BadInput, match="none of the frames can be used"):
        learning.paper_setup(run, [], PaperSettings(reduction=1), sort(run))


def test_glance_tells_lamp_and_code(tmp_path: Path) -> None:
    source = folder_of(tmp_path, ["left", "right"])
    left, right = (learning.glance_at(frame.picture) for frame in source.frames())
    assert left is not None
    assert right is not None
    assert (left[0], right[0]) == ("left", "right")
    assert left[1].shape == (SIZE[1] // 16, SIZE[0] // 16, 3)
    assert left[1].dtype == np.int16

"""From flash to frame, with a real camera process that does as the test says, and real time that the test moves."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from capture_fakes import Rig, announced, capture_rig, lit, until

from device_fakes import GOOD_METADATA, tiny_jpeg
from flora_capture import store
from flora_common.errors import DiskFull
from flora_common.messages import Flash, Frame, FrameMissed, Lamps


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    with capture_rig(tmp_path, monkeypatch) as rig:
        yield rig


def test_a_photograph_is_on_the_disk_before_it_is_announced(rig: Rig) -> None:
    app = rig.start(Lamps(tick=0, lit="right", commanded="right"))
    app.hear(lit(1))
    frame = announced(app, 1)
    assert isinstance(frame, Frame)
    assert (frame.path, frame.width_px, frame.height_px, frame.light) == ("frames/000001.jpg", 64, 48, "right")
    assert (frame.flash_confirmed, frame.exposure_ok, frame.run) == (True, True, "run")
    assert (app.run.path / frame.path).read_bytes() == tiny_jpeg()
    assert [(r.file, r.light) for r in app.run.read_frames()] == [("frames/000001.jpg", "right")]
    assert app.troubles == {}


def test_light_is_dark_where_nobody_has_told(rig: Rig) -> None:
    app = rig.start()
    app.hear(lit(1))
    assert announced(app, 1).light == "dark"


def test_light_is_dark_where_the_lamps_have_said_nothing_for_long(rig: Rig) -> None:
    app = rig.start(Lamps(tick=1, lit="right", commanded="right"))
    app.clock.advance(750.0)
    app.hear(lit(3))
    assert announced(app, 3).light == "right"
    app.clock.advance(1.0)
    app.hear(lit(4))
    assert announced(app, 4).light == "dark"


def test_a_camera_that_takes_long_does_not_make_the_lamps_old(rig: Rig) -> None:
    app = rig.start(Lamps(tick=1, lit="right", commanded="right"))
    app.clock.advance(750.0)
    app.hear(lit(3))
    app.clock.advance(20.0)
    assert announced(app, 3).light == "right"


def test_a_kept_word_of_yesterdays_lamps_is_not_believed(rig: Rig) -> None:
    app = rig.start(Lamps(tick=1, lit="right", commanded="right", t_mono_ns=1))
    app.clock.advance(86_400.0)
    app.hear(lit(2))
    assert announced(app, 2).light == "dark"


def test_a_folder_that_may_not_be_looked_into_is_a_missed_frame(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    app = rig.start()

    def refuse(*_: object) -> bool:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "exists", refuse)
        app.hear(lit(1))
    missed = announced(app, 1)
    assert (missed.because, "Permission denied" in missed.reason) == ("not_written", True)


def test_a_lit_flash_of_long_ago_that_the_bus_has_kept_is_not_photographed(rig: Rig) -> None:
    app = rig.start(lit(1, t_mono_ns=1))
    assert app.said == []
    app.hear(lit(1, lit=False))
    assert announced(app, 1).because == "camera_gone"  # when flora-flash is there again it says that it is dark
    app.hear(lit(2))
    assert isinstance(announced(app, 2), Frame)
    assert rig.count("asked") == 1


def test_told_twice_it_announces_twice_and_shoots_once(rig: Rig) -> None:
    app = rig.start()
    app.hear(lit(1))
    first = announced(app, 1)
    app.hear(lit(1))
    assert app.said == [first, first]
    assert rig.count("asked") == 1


def test_a_picture_of_the_empty_setup_goes_to_its_own_folder(rig: Rig) -> None:
    app = rig.start()
    app.hear(lit(1, purpose="background", shot="left.jpg"))
    assert announced(app, 1).path == "background/left.jpg"
    assert not app.run.frames_csv.exists()
    app.hear(lit(2, purpose="background", shot="../../etc/x.jpg"))
    missed = announced(app, 2)
    assert (missed.because, rig.count("asked")) == ("not_written", 1)


def test_a_lamp_that_is_not_confirmed_is_photographed_and_marked(rig: Rig) -> None:
    app = rig.start()
    app.hear(lit(1, confirmed=False))
    assert not announced(app, 1).flash_confirmed


def test_another_exposure_is_marked_and_told(rig: Rig) -> None:
    rig.metadata({**GOOD_METADATA, "ExposureTime": 33_000})
    app = rig.start()
    app.hear(lit(1))
    frame = announced(app, 1)
    assert (frame.exposure_ok, frame.exposure_us) == (False, 33_000.0)
    assert "33000" in frame.exposure_note
    assert "exposure" in app.lines


@pytest.mark.parametrize(
    ("error", "because"), [(DiskFull("full"), "disk_full"), (PermissionError(13, "no"), "not_written")]
)
def test_a_disk_that_refuses_is_told_and_the_service_recovers(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, error: Exception, because: str
) -> None:
    def refuse(*_: object) -> None:
        raise error

    app = rig.start()
    with monkeypatch.context() as patch:
        patch.setattr(store, "write_bytes", refuse)
        app.hear(lit(1))
        assert announced(app, 1).because == because
    app.hear(lit(2))
    assert isinstance(announced(app, 2), Frame)
    assert app.troubles == {}
    assert [r.file for r in app.run.read_frames()] == ["frames/000002.jpg"]


def test_a_run_folder_that_is_moved_away_is_not_begun_anew_in_its_place(rig: Rig) -> None:
    app = rig.start()
    app.run.path.rename(rig.folder / "elsewhere")
    app.hear(lit(1))
    missed = announced(app, 1)
    assert (missed.because, "the run folder was moved or removed" in missed.reason) == ("not_written", True)
    assert "disk" in app.troubles
    assert not app.run.path.exists()
    (rig.folder / "elsewhere").rename(app.run.path)
    app.hear(lit(2))
    assert isinstance(announced(app, 2), Frame)
    assert app.troubles == {}


def test_a_link_to_the_run_that_leads_to_another_one_meanwhile_brings_no_photograph_there(rig: Rig) -> None:
    link, first, second = rig.folder / "run", rig.folder / "bean-1", rig.folder / "bean-2"
    first.mkdir()
    link.symlink_to(first)
    app = rig.start()
    shutil.copytree(first, second)
    link.unlink()
    link.symlink_to(second)
    app.hear(lit(1))
    assert "leads to another run than at the start" in announced(app, 1).reason
    assert not list(second.rglob("*.jpg"))
    assert not (second / "frames.csv").exists()


def test_a_table_without_room_is_completed_later(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    app = rig.start()

    def refuse(*_: object) -> None:
        raise DiskFull("full")

    with monkeypatch.context() as patch:
        patch.setattr(app.run, "append_frame", refuse)
        app.hear(lit(1))
        assert isinstance(announced(app, 1), Frame)
        assert "csv" in app.troubles
    app.hear(lit(2))
    announced(app, 2)
    assert [r.time_s for r in app.run.read_frames()] == [0.0, 300.0]
    assert app.troubles == {}


def test_a_start_again_adds_no_second_line_where_the_table_has_rounded_the_time(rig: Rig) -> None:
    app = rig.start()
    app.hear(lit(1, time_s=1200.4283532))
    announced(app, 1)
    app.leave()
    again = rig.start()
    assert [row.file for row in again.run.read_frames()] == ["frames/000001.jpg"]
    again.hear(lit(2, time_s=1500.4151999))
    announced(again, 2)
    assert [row.time_s for row in again.run.read_frames()] == [1200.428, 1500.415]


def test_killed_after_writing_it_announces_what_is_there(rig: Rig) -> None:
    first = rig.start()
    first.hear(lit(1))
    frame = announced(first, 1)
    again = rig.start(lit(1))  # the bus never heard the frame
    assert again.said == [frame, frame]
    assert rig.count("asked") == 1


def test_killed_after_announcing_it_says_the_same_again_when_told_again(rig: Rig) -> None:
    first = rig.start()
    first.hear(lit(1))
    frame = announced(first, 1)
    again = rig.start(frame, lit(1))
    assert [m.sha256 for m in again.said] == [frame.sha256]
    assert rig.count("asked") == 1


def test_killed_between_picture_and_ledger_it_takes_another_name(rig: Rig) -> None:
    app = rig.start()
    app.run.frames.mkdir()
    (app.run.frames / "000001.jpg").write_bytes(b"of the last start")
    app.hear(lit(1))
    assert announced(app, 1).path == "frames/000001-2.jpg"
    assert (app.run.frames / "000001.jpg").read_bytes() == b"of the last start"


def test_a_listed_picture_that_is_damaged_is_not_announced_but_taken_again(rig: Rig) -> None:
    first = rig.start()
    first.hear(lit(1))
    path = first.run.path / announced(first, 1).path
    path.write_bytes(b"rotten")
    again = rig.start(lit(1))
    assert announced(again, 1).path == "frames/000001-2.jpg"


def test_a_flash_that_came_and_went_meanwhile_is_a_missed_frame(rig: Rig) -> None:
    app = rig.start(lit(5, lit=False))
    missed = announced(app, 5)
    assert (missed.because, missed.time_s) == ("camera_gone", 1200.0)


def test_a_tick_that_was_left_dark_meanwhile_is_a_missed_frame_that_says_why(rig: Rig) -> None:
    missed = rig.start(Flash(tick=9, lit=False, confirmed=True, reason="no word of flora-capture")).heard(FrameMissed)[
        0
    ]
    assert (missed.tick, missed.because) == (9, "camera_gone")
    assert "no word of flora-capture" in missed.reason
    assert "was lit" not in missed.reason


def test_no_process_is_left_behind(rig: Rig) -> None:
    app = rig.start()
    until(app, lambda: "camera_open" in app.lines)
    app.leave()
    assert app.readable == {}
    app.pass_real_s(100.0)
    assert app.readable == {}
    rig.apps.remove(app)

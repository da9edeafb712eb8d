"""From flash to frame, with a real camera process that does as the test says, and real time that the test moves."""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from device_fakes import GOOD_METADATA, FakeApp, tiny_jpeg
from flora_capture import process, store
from flora_capture.service import CaptureSection, CaptureService
from flora_capture.store import Store
from flora_common.errors import DiskFull
from flora_common.messages import Flash, Frame, FrameMissed, Lamps
from flora_common.runs import CameraSection

CHILD = """
import os, pathlib, signal, sys
import msgspec
from flora_capture.wire import Answer, pack, read
folder = pathlib.Path(sys.argv[1])
out = sys.stdout.buffer
def say(answer):
    out.write(pack(answer)); out.flush()
read(sys.stdin.buffer)
(folder / "pid").write_text(str(os.getpid()))
with (folder / "starts").open("a") as starts: starts.write("x")
if (folder / "no_camera").exists():
    say(Answer(0, "camera_gone", "no camera at 0")); sys.exit()
say(Answer(0))
while (payload := read(sys.stdin.buffer)) is not None:
    number = msgspec.msgpack.decode(payload)["number"]
    with (folder / "asked").open("a") as asked: asked.write("x")
    what = (folder / "what").read_text()
    if what == "hang": signal.pause()
    if what == "die": sys.exit(3)
    if what == "nonsense": out.write(b"Hello, world!!!!"); out.flush(); signal.pause()
    if what == "ended": say(Answer(number, "film_ended", "old.avi: the film has ended after 3 pictures")); continue
    if what == "gone": say(Answer(number, "camera_gone", "cable pulled")); continue
    jpeg = (folder / "jpeg").read_bytes()
    if what == "torn" or what == "torn_once" and (folder / "asked").stat().st_size % 2 == 1: jpeg = jpeg[:-200]
    say(Answer(number, jpeg=jpeg, metadata=msgspec.json.decode((folder / "metadata").read_bytes())))
"""


class Rig:
    """A capture service over one folder, started as often as the test likes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.apps: list[FakeApp] = []
        (folder / "child.py").write_text(CHILD)
        (folder / "jpeg").write_bytes(tiny_jpeg())
        self.metadata(GOOD_METADATA)
        self.camera("fine")

    def camera(self, what: str) -> None:
        (self.folder / "what").write_text(what)

    def metadata(self, metadata: dict[str, Any]) -> None:
        import json

        (self.folder / "metadata").write_text(json.dumps(metadata))

    def count(self, what: str) -> int:
        return (self.folder / what).stat().st_size if (self.folder / what).exists() else 0

    def start(self, *kept: Any) -> FakeApp:
        app = FakeApp(self.folder, CaptureSection(backend="virtual"))
        self.apps.append(app)
        camera = CameraSection(anchor_px=(1.0, 1.0), px_per_cm=1.0)
        CaptureService(app, Store(app.run), app.config.settings(camera, "ipc:///x"))  # type: ignore[arg-type]
        app.hear(*kept)
        app.ready()
        return app


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    command = (sys.executable, str(tmp_path / "child.py"), str(tmp_path))
    monkeypatch.setitem(process.CameraProcess.__init__.__kwdefaults__, "command", command)
    rig = Rig(tmp_path)
    yield rig
    for app in rig.apps:
        app.leave()


def until(app: FakeApp, condition: Callable[[], bool]) -> None:
    """Serve what the camera process says until a condition holds."""
    end_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end_s, (app.said, app.troubles)
        for descriptor in select.select(list(app.readable), [], [], 0.05)[0]:
            if descriptor in app.readable:
                app.readable[descriptor]()


def lit(tick: int, **changes: Any) -> Flash:
    return Flash(**{"tick": tick, "lit": True, "confirmed": True, "time_s": 300.0 * (tick - 1), **changes})


def announced(app: FakeApp, tick: int) -> Any:
    """What is said of a tick, once it is."""

    def found() -> list[Any]:
        return [m for m in app.said if m.tick == tick]

    until(app, lambda: bool(found()))
    return found()[-1]


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


def test_a_camera_that_hangs_is_killed_within_30_s_and_the_next_tick_is_photographed(rig: Rig) -> None:
    app = rig.start()
    until(app, lambda: rig.count("starts") == 1)
    rig.camera("hang")
    app.hear(lit(1))
    until(app, lambda: rig.count("asked") == 1)
    app.pass_real_s(24.0)
    assert app.said == []
    app.pass_real_s(2.0)
    missed = app.said[-1]
    assert isinstance(missed, FrameMissed)
    assert (missed.tick, missed.because) == (1, "camera_hung")
    rig.camera("fine")
    app.hear(lit(2))
    assert isinstance(announced(app, 2), Frame)
    assert app.troubles == {}
    assert rig.count("starts") == 2


@pytest.mark.parametrize("what", ["die", "nonsense", "gone"])
def test_a_camera_that_is_lost_is_told_at_once_and_comes_back(rig: Rig, what: str) -> None:
    app = rig.start()
    rig.camera(what)
    app.hear(lit(1))
    assert announced(app, 1).because == "camera_gone"
    assert "camera" in app.troubles
    rig.camera("fine")
    app.pass_real_s(1.1)
    until(app, lambda: rig.count("starts") == 2)
    app.hear(lit(2))
    assert isinstance(announced(app, 2), Frame)


def test_the_end_of_a_film_is_told_once_and_lasts(rig: Rig) -> None:
    reason = "old.avi: the film has ended after 3 pictures"
    app = rig.start()
    rig.camera("ended")
    changes = watched(app)
    for tick in range(1, 6):
        app.hear(lit(tick))
        missed = announced(app, tick)
        assert (missed.because, missed.reason) == ("camera_gone", reason)
        app.pass_real_s(300.0)
    assert changes == [("camera", reason)] * 5  # the same words: told by the first, and never withdrawn
    assert app.troubles == {"camera": reason}
    assert (rig.count("starts"), rig.count("asked")) == (1, 1)
    assert app.readable == {}  # no camera process is kept for nothing
    assert app.lines.count("camera_open") == 1


def watched(app: FakeApp) -> list[tuple[str, str]]:
    """From now on, what the service says of the camera: (key, reason)."""
    changes: list[tuple[str, str]] = []
    tell = app.trouble

    def trouble(key: str, reason: str) -> None:
        if key == "camera":
            changes.append((key, reason))
        tell(key, reason)

    app.trouble = trouble  # type: ignore[method-assign]
    return changes


def test_a_start_again_after_the_end_of_the_film_tells_it_again(rig: Rig) -> None:
    rig.camera("ended")
    for tick in (1, 2):
        app = rig.start()
        app.hear(lit(tick))
        assert announced(app, tick).reason.endswith("has ended after 3 pictures")
        app.leave()
        assert app.readable == {}


def test_a_camera_that_opens_and_gives_no_picture_is_not_well_between_ticks(rig: Rig) -> None:
    app = rig.start()
    rig.camera("gone")
    changes = watched(app)
    for tick in (1, 2, 3):
        app.hear(lit(tick))
        assert announced(app, tick).because == "camera_gone"
        starts = rig.count("starts")
        app.pass_real_s(61.0)
        until(app, lambda starts=starts: rig.count("starts") > starts)  # type: ignore[misc]
        until(app, lambda tick=tick: app.lines.count("camera_open") > tick)  # type: ignore[misc]
    assert all(reason for _, reason in changes)
    rig.camera("fine")
    app.hear(lit(4))
    assert isinstance(announced(app, 4), Frame)
    assert app.troubles == {}


def test_a_full_disk_and_a_lost_camera_are_two_troubles(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise DiskFull("full")

    app = rig.start()
    with monkeypatch.context() as patch:
        patch.setattr(store, "write_bytes", refuse)
        app.hear(lit(1))
        announced(app, 1)
    assert set(app.troubles) == {"disk"}
    rig.camera("gone")
    app.hear(lit(2))
    announced(app, 2)
    assert set(app.troubles) == {"disk", "camera"}
    rig.camera("fine")
    app.hear(lit(3))
    announced(app, 3)
    assert app.troubles == {}


def test_a_camera_process_killed_while_idle_is_started_again(rig: Rig) -> None:
    app = rig.start()
    until(app, lambda: "camera_open" in app.lines)
    os.kill(int((rig.folder / "pid").read_text()), signal.SIGKILL)
    until(app, lambda: "camera" in app.troubles)
    assert "signal 9" in app.troubles["camera"]
    app.pass_real_s(1.1)
    until(app, lambda: app.troubles == {})
    assert app.said == []


def test_waits_between_starts_grow(rig: Rig) -> None:
    (rig.folder / "no_camera").touch()
    app = rig.start()
    for starts, wait_s in ((1, 1.0), (2, 2.0), (3, 4.0)):
        until(app, lambda starts=starts: rig.count("starts") == starts and not app.readable)  # type: ignore[misc]
        assert app.troubles["camera"] == "no camera at 0"
        app.pass_real_s(wait_s - 0.5)
        assert not app.readable
        app.pass_real_s(0.6)
        assert app.readable
    app.hear(lit(1))  # the beat does not wait for the next try
    assert announced(app, 1).because == "camera_gone"


def test_a_torn_picture_is_taken_once_more(rig: Rig) -> None:
    rig.camera("torn_once")
    app = rig.start()
    app.hear(lit(1))
    assert isinstance(announced(app, 1), Frame)
    assert rig.count("asked") == 2


def test_a_picture_torn_twice_is_missed_and_never_a_file(rig: Rig) -> None:
    rig.camera("torn")
    app = rig.start()
    app.hear(lit(1))
    missed = announced(app, 1)
    assert (missed.because, rig.count("asked")) == ("bad_picture", 2)
    assert "no end marker" in missed.reason
    assert not app.run.frames.exists()


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


def test_a_beat_that_goes_on_ends_the_shot_before(rig: Rig) -> None:
    app = rig.start()
    rig.camera("hang")
    app.hear(lit(1))
    until(app, lambda: rig.count("asked") == 1)
    app.pass_real_s(20.0)
    rig.camera("fine")
    app.hear(lit(2))
    assert app.said[0].because == "camera_hung"
    app.pass_real_s(20.0)  # the first shot's deadline is not the second's
    assert isinstance(announced(app, 2), Frame)


def test_no_process_is_left_behind(rig: Rig) -> None:
    app = rig.start()
    until(app, lambda: "camera_open" in app.lines)
    app.leave()
    assert app.readable == {}
    app.pass_real_s(100.0)
    assert app.readable == {}
    rig.apps.remove(app)

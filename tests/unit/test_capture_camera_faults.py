"""A camera that hangs, dies, comes to its film's end or tears its pictures: told, and the next tick is photographed."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from capture_fakes import Rig, announced, capture_rig, lit, until

from device_fakes import FakeApp
from flora_capture import store
from flora_common.errors import DiskFull
from flora_common.messages import Frame, FrameMissed


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    with capture_rig(tmp_path, monkeypatch) as rig:
        yield rig


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


def test_however_often_a_camera_is_asked_for_that_cannot_be_started_there_is_one_next_try(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each tick began a row of tries of its own: after a day there were five in every second."""
    app = rig.start()
    until(app, lambda: rig.count("starts") == 1)
    rig.camera("die")
    app.hear(lit(1))
    announced(app, 1)
    tries: list[int] = []

    def no_room(*_: object, **__: object) -> None:
        tries.append(1)
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(subprocess, "Popen", no_room)
    for tick in range(2, 12):
        app.hear(lit(tick))
        announced(app, tick)
        app.pass_real_s(300.0)
    late = len(tries)
    app.pass_real_s(600.0)
    assert 5 <= len(tries) - late <= 15


def test_camera_processes_that_no_signal_ends_do_not_pile_up(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    stuck: list[subprocess.Popen[bytes]] = []
    end = subprocess.Popen.kill

    def no_end(child: subprocess.Popen[bytes]) -> None:
        """As where the kernel hangs in the driver."""
        stuck.append(child)

    monkeypatch.setattr(subprocess.Popen, "kill", no_end)
    app = rig.start()
    rig.camera("hang")
    try:
        for tick in (1, 2):
            app.hear(lit(tick))
            until(app, lambda: rig.count("asked") == tick)  # noqa: B023 - called before the next tick
            app.pass_real_s(26.0)
            assert app.said[-1].because == "camera_hung"
            app.pass_real_s(60.0)
        for tick in (3, 4):
            app.hear(lit(tick))
            missed = announced(app, tick)
            assert missed.because == "camera_gone"
            assert f"{stuck[0].pid}, {stuck[1].pid} were killed and have not ended" in missed.reason
            app.pass_real_s(300.0)
        assert (rig.count("starts"), len(stuck)) == (2, 2)
        rig.camera("fine")
        end(stuck[0])
        stuck[0].wait()
        app.pass_real_s(61.0)
        app.hear(lit(5))
        assert isinstance(announced(app, 5), Frame)
        assert app.troubles == {}
    finally:
        for child in stuck:
            end(child)
            child.wait()
        monkeypatch.setattr(subprocess.Popen, "kill", end)


def test_a_camera_process_for_which_there_is_no_room_is_told_and_tried_again(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(*_: object, **__: object) -> None:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "Popen", no_room)
        app = rig.start()
        assert "cannot be started" in app.troubles["camera"]
        app.hear(lit(1))
        assert announced(app, 1).because == "camera_gone"
        app.pass_real_s(10.0)
    app.pass_real_s(61.0)
    app.hear(lit(2))
    assert isinstance(announced(app, 2), Frame)
    assert app.troubles == {}


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

"""Tick, light, photograph, dark: with a lamp of ours and time that the test moves."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from device_fakes import FakeApp
from fake_clock import FakeClock
from flora_common.clock import NS, LeaderClock
from flora_common.errors import BadInput, DiskFull, FlashDead
from flora_common.messages import Flash, Frame, FrameMissed, Lamps, Setup, Tick
from flora_common.runs import RunFolder
from flora_flash import handshake
from flora_flash.backends import NoLamp
from flora_flash.core import Beat, BeatState, Photographed, Reading
from flora_flash.handshake import FlashSection, FlashService, read_clocks
from flora_flash.main import keep_damaged, read_state
from flora_flash.photographs import last_photographed

SHA = "0" * 64


class FakeLamp:
    excuse = "the bulb stays dark"

    def __init__(self) -> None:
        self.on = False
        self.is_broken = self.is_gone = self.is_closed = False

    def switch(self, on: bool) -> bool:
        if self.is_gone:
            raise FlashDead("no answer")
        self.on = on and not self.is_broken
        return self.on

    def close(self) -> None:
        self.is_closed = True


class Rig:
    """A flash service, and starts of it one after the other over the same state."""

    def __init__(self, folder: Path, **config: Any) -> None:
        self.folder = folder
        self.config = FlashSection(**config)
        self.lamp: Any = FakeLamp()
        self.clock: Any = FakeClock(mono_ns=1000 * NS)
        self.boot, self.is_right = "boot", True

    def start(self, *kept: Any) -> FakeApp:
        app = FakeApp(self.folder, self.config, clock=self.clock)
        now = read_clocks(self.clock, self.boot, lambda: self.is_right)
        beat = Beat(300.0, run="run", state=read_state(app.state_dir / "flash.json", app.run), now=now)
        FlashService(app, self.lamp, beat, boot_id=self.boot, utc_is_right=lambda: self.is_right)  # type: ignore[arg-type]
        app.hear(*kept)
        app.ready()
        return app

    @property
    def number(self) -> int:
        return msgspec.json.decode((self.folder / "state" / "flash.json").read_bytes(), type=BeatState).tick


@pytest.fixture
def rig(tmp_path: Path) -> Callable[..., Rig]:
    return lambda **config: Rig(tmp_path, **config)


def lock_step() -> LeaderClock:
    return LeaderClock(0.0, lambda until_s: (round(until_s * NS), round((1e9 + until_s) * NS)), mono_ns=0, utc_ns=NS)


def frame(tick: int) -> Frame:
    return Frame(
        tick=tick, time_s=0.0, path=f"frames/{tick:06d}.jpg", run="run", sha256=SHA, bytes=1, width_px=1, height_px=1,
        light="dark", flash_confirmed=True, exposure_ok=True,
    )  # fmt: skip


def test_a_tick_from_beginning_to_end(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    tick, flash = app.said
    assert isinstance(tick, Tick)
    assert isinstance(flash, Flash)
    assert (tick.tick, flash.tick, flash.lit, flash.confirmed, r.number) == (1, 1, True, True, 1)
    assert r.lamp.on
    app.hear(frame(1))
    assert not r.lamp.on
    assert (app.said[-1].lit, app.said[-1].confirmed) == (False, True)
    app.pass_s(299.9)
    assert len(app.heard(Tick)) == 1
    app.pass_s(0.2)
    assert [t.tick for t in app.heard(Tick)] == [1, 2]


def test_a_missed_frame_ends_the_light_too(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    app.hear(FrameMissed(tick=1, time_s=0.0, because="camera_hung", reason="x"))
    assert not r.lamp.on
    assert "camera_hung" in app.said[-1].reason


def test_no_word_at_all_ends_the_light_after_the_time_out(rig: Callable[..., Rig]) -> None:
    r = rig(frame_timeout_s=45.0)
    app = r.start()
    app.hear(frame(7))  # of another tick
    app.pass_s(44.0)
    assert r.lamp.on
    app.pass_s(1.5)
    assert not r.lamp.on
    assert "45 s" in app.said[-1].reason
    assert "frame" in app.troubles
    app.pass_s(280.0)
    app.hear(frame(2))
    assert app.troubles == {}


def pass_in_steps(app: FakeApp, seconds: float) -> None:
    """Rig time and real time stay within a second of each other, also where timers set timers."""
    for _ in range(round(seconds)):
        app.pass_s(1.0)


def test_without_flora_capture_the_lamp_stays_dark_after_two_ticks_until_it_is_heard(rig: Callable[..., Rig]) -> None:
    r = rig(frame_timeout_s=45.0)
    app = r.start()
    pass_in_steps(app, 301.0)
    assert r.lamp.on
    pass_in_steps(app, 45.0)
    assert "stays dark" in app.troubles["frame"]
    told = len(app.heard(Flash))
    pass_in_steps(app, 600.0)
    assert [t.tick for t in app.heard(Tick)] == [1, 2, 3, 4]
    left_dark = app.heard(Flash)[told:]
    assert [(f.tick, f.lit, f.confirmed) for f in left_dark] == [(3, False, True), (4, False, True)]
    assert all("flora-capture" in f.reason for f in left_dark)
    # Started, it answers the word of the flash that the bus has kept.
    app.hear(FrameMissed(tick=4, time_s=900.0, because="camera_gone", reason="x"))
    assert app.troubles == {}
    pass_in_steps(app, 260.0)
    assert (app.heard(Flash)[-1].tick, app.heard(Flash)[-1].lit, r.lamp.on) == (5, True, True)


def test_two_time_outs_with_a_word_of_flora_capture_in_between_leave_the_flash(rig: Callable[..., Rig]) -> None:
    r = rig(frame_timeout_s=45.0)
    app = r.start()
    pass_in_steps(app, 50.0)
    app.hear(frame(1))  # late, but there
    pass_in_steps(app, 296.0)
    assert "stays dark" not in app.troubles["frame"]
    pass_in_steps(app, 255.0)
    assert (app.heard(Flash)[-1].tick, r.lamp.on) == (3, True)


def test_lock_step_does_not_wait_for_the_photograph_of_a_tick_that_is_left_dark(rig: Callable[..., Rig]) -> None:
    r = rig(frame_timeout_s=45.0)
    r.clock = lock_step()
    app = r.start()
    for tick in (1, 2):
        app.hear(Lamps(tick=tick, lit="left", commanded="left"))
        app.pass_real_s(46.0)
    assert [t.tick for t in app.heard(Tick)] == [1, 2, 3]
    assert not r.lamp.on
    app.hear(Lamps(tick=3, lit="left", commanded="left"))
    app.pass_real_s(0.0)
    assert [t.tick for t in app.heard(Tick)] == [1, 2, 3, 4]


def test_a_step_of_a_setup_run_that_was_left_dark_is_tried_when_the_lamps_confirm_again(
    rig: Callable[..., Rig],
) -> None:
    r = rig(frame_timeout_s=45.0)
    app = r.start()
    pass_in_steps(app, 346.0)
    for _ in range(2):
        app.hear(setup(1), setup_lamps(1))
    shots = [t.tick for t in app.heard(Tick) if t.purpose == "background"]
    assert (shots, r.lamp.on) == ([3, 4], False)
    app.hear(FrameMissed(tick=4, time_s=0.0, because="camera_gone", reason="x", purpose="background", shot="left.jpg"))
    app.hear(setup(1), setup_lamps(1))
    assert (app.heard(Tick)[-1].tick, r.lamp.on) == (5, True)


def test_a_rig_without_a_lamp_goes_on_asking_for_photographs(rig: Callable[..., Rig]) -> None:
    r = rig(backend="none", frame_timeout_s=45.0)
    r.lamp = NoLamp()
    app = r.start()
    pass_in_steps(app, 346.0)
    assert "stays dark" not in app.troubles["frame"]
    pass_in_steps(app, 300.0)
    assert [(f.tick, f.lit) for f in app.heard(Flash)][-2:] == [(3, True), (3, False)]


@pytest.mark.parametrize("fault", ["is_broken", "is_gone"])
def test_a_lamp_that_does_not_light_is_told_and_the_tick_goes_on(rig: Callable[..., Rig], fault: str) -> None:
    r = rig()
    setattr(r.lamp, fault, True)
    app = r.start()
    flash = app.said[-1]
    assert (flash.lit, flash.confirmed) == (True, False)
    assert flash.reason
    assert "lamp" in app.troubles
    setattr(r.lamp, fault, False)
    app.hear(frame(1))
    assert app.troubles == {}


def test_a_lamp_that_does_not_go_dark_is_told_again_and_again(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    r.lamp.is_gone = True
    app.hear(frame(1))
    assert (app.said[-1].lit, app.said[-1].confirmed) == (False, False)
    r.lamp.is_gone = False
    assert r.lamp.on
    app.pass_s(6.0)
    assert not r.lamp.on


def test_a_rig_without_a_lamp_is_not_degraded(rig: Callable[..., Rig]) -> None:
    r = rig(backend="none")
    r.lamp = NoLamp()
    app = r.start()
    assert (app.said[-1].confirmed, app.troubles) == (False, {})
    assert "no flash lamp" in app.said[-1].reason


def test_dark_however_it_ends(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    assert r.lamp.on
    app.leave()
    assert not r.lamp.on
    assert r.lamp.is_closed


def test_the_number_is_on_the_disk_before_it_is_said(rig: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    real = handshake.write_text
    monkeypatch.setattr(handshake, "write_text", lambda p, t: (order.append("written"), real(p, t)))
    monkeypatch.setattr(FakeApp, "publish", lambda self, m: order.append(type(m).__name__))
    rig().start()
    assert order == ["written", "Tick", "Flash"]


@pytest.mark.parametrize("error", [DiskFull("full"), OSError(errno.EROFS, "read-only")])
def test_a_full_disk_does_not_stop_the_beat(
    rig: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def refuse(*_: object) -> None:
        raise error

    r = rig()
    app = r.start()
    app.hear(frame(1))
    with monkeypatch.context() as patch:
        patch.setattr(handshake, "write_text", refuse)
        app.pass_s(300.0)
    assert [t.tick for t in app.heard(Tick)] == [1, 2]
    assert "state" in app.troubles
    app.hear(frame(2))
    again = r.start(*[app.heard(kind)[-1] for kind in (Tick, Flash)], frame(2))  # the bus knows what the file does not
    assert again.heard(Tick) == []
    again.pass_s(299.0)
    assert again.heard(Tick) == []
    again.pass_s(2.0)
    assert [(t.tick, t.time_s) for t in again.heard(Tick)] == [(3, pytest.approx(600.0, abs=2.0))]


def test_killed_before_it_was_announced_the_tick_is_announced(rig: Callable[..., Rig]) -> None:
    r = rig()
    r.start()
    r.clock.advance(2.0)
    again = r.start()  # the bus has kept nothing
    assert [(t.tick, t.time_s, t.late_s) for t in again.heard(Tick)] == [(1, 2.0, 2.0)]
    assert again.heard(Flash)[-1].lit


def test_a_tick_from_long_ago_is_not_taken_up_again(rig: Callable[..., Rig]) -> None:
    r = rig()
    r.start()
    r.clock.advance(86_400.0)
    again = r.start()
    assert [(t.tick, t.time_s) for t in again.heard(Tick)] == [(2, 86_400.0)]


def test_killed_before_the_lamp_was_lit_it_is_lit(rig: Callable[..., Rig]) -> None:
    r = rig()
    first = r.start()
    again = r.start(first.heard(Tick)[0])
    assert again.heard(Tick) == []
    assert again.heard(Flash)[-1].lit


def test_killed_while_the_photograph_was_taken_it_waits_in_the_dark(rig: Callable[..., Rig]) -> None:
    r = rig()
    first = r.start()
    r.lamp.on = False  # as ExecStopPost leaves it
    again = r.start(*first.said)
    assert [f.lit for f in again.heard(Flash)] == [False]
    assert again.heard(Tick) == []
    again.hear(frame(1))
    again.pass_s(300.0)
    assert [t.tick for t in again.heard(Tick)] == [2]


def test_killed_after_the_photograph_it_goes_on_with_the_next_tick(rig: Callable[..., Rig]) -> None:
    r = rig()
    first = r.start()
    r.clock.advance(100.0)
    again = r.start(*first.said, frame(1))
    assert again.said == []
    again.pass_s(199.0)
    assert again.said == []
    again.pass_s(2.0)
    assert [t.tick for t in again.heard(Tick)] == [2]


def test_lock_step_moves_on_when_the_lamps_have_answered(rig: Callable[..., Rig]) -> None:
    r = rig()
    r.clock = lock_step()
    app = r.start()
    app.hear(frame(1))
    app.pass_real_s(1.0)
    assert len(app.heard(Tick)) == 1
    app.hear(Lamps(tick=0, lit="left", commanded="left"))
    app.pass_real_s(1.0)
    assert len(app.heard(Tick)) == 1
    app.hear(Lamps(tick=1, lit="left", commanded="left"))
    app.pass_real_s(0.0)
    assert [t.time_s for t in app.heard(Tick)] == [0.0, 300.0]


def test_lock_step_waits_for_both_lamps_and_photograph(rig: Callable[..., Rig]) -> None:
    r = rig()
    r.clock = lock_step()
    app = r.start()
    app.hear(Lamps(tick=1, lit="left", commanded="left"))
    app.pass_real_s(1.0)
    assert len(app.heard(Tick)) == 1
    app.hear(frame(1))
    app.pass_real_s(0.0)
    assert len(app.heard(Tick)) == 2


def test_lock_step_goes_on_with_a_warning_when_nobody_answers(rig: Callable[..., Rig]) -> None:
    r = rig(answer_timeout_s=60.0)
    r.clock = lock_step()
    app = r.start()
    app.hear(frame(1))
    app.pass_real_s(59.0)
    assert len(app.heard(Tick)) == 1
    app.pass_real_s(1.5)
    assert len(app.heard(Tick)) == 2
    assert "answer" in app.troubles
    app.hear(frame(2), Lamps(tick=2, lit="left", commanded="left"))
    assert app.troubles == {}


def test_lock_step_killed_while_it_waits_for_the_lamps(rig: Callable[..., Rig]) -> None:
    r = rig()
    r.clock = lock_step()
    first = r.start()
    first.hear(frame(1))
    again = r.start(*[first.heard(k)[-1] for k in (Tick, Flash)], frame(1))
    again.pass_real_s(1.0)
    assert [t.tick for t in again.heard(Tick)] == []
    again.hear(Lamps(tick=1, lit="left", commanded="left"))
    again.pass_real_s(0.0)
    assert [t.tick for t in again.heard(Tick)] == [2]


def test_a_box_that_does_not_answer_is_asked_again(rig: Callable[..., Rig]) -> None:
    r = rig()
    answers: list[bool] = [False, True]

    def wait(until_s: float) -> tuple[int, int]:
        if not answers.pop(0):
            raise FlashDead("gone")
        return round(until_s * NS), NS

    r.clock = LeaderClock(0.0, wait, mono_ns=0, utc_ns=NS)
    app = r.start()
    app.hear(frame(1), Lamps(tick=1, lit="left", commanded="left"))
    app.pass_real_s(0.5)
    assert "clock" in app.troubles
    app.pass_real_s(1.0)
    assert app.troubles == {}
    assert len(app.heard(Tick)) == 2


def setup(step: int, *, active: bool = True, shot: str = "left.jpg", session: str = "0000000a") -> Setup:
    return Setup(active=active, step=step, steps=2, lamps="left", shot=shot, session=session)


def setup_lamps(step: int) -> Lamps:
    return Lamps(lit="left", commanded="left", setup_step=step)


def background(tick: int) -> Frame:
    return msgspec.structs.replace(frame(tick), purpose="background", path="background/left.jpg")


def test_a_setup_run_gets_one_picture_per_step_and_the_beat_rests(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    app.hear(setup(1), setup_lamps(1))
    assert len(app.heard(Tick)) == 1  # the tick that is under way ends first
    app.hear(frame(1))
    assert (app.heard(Tick)[-1].tick, app.heard(Tick)[-1].purpose, app.heard(Flash)[-1].shot) == (
        2,
        "background",
        "left.jpg",
    )
    app.hear(background(2), setup(1), setup_lamps(1))  # told again: done once
    assert len(app.heard(Tick)) == 2
    app.hear(setup(2, shot="right.jpg"), setup_lamps(1))
    assert len(app.heard(Tick)) == 2  # these lamps are the last step's
    app.hear(setup_lamps(2))
    assert app.heard(Tick)[-1].shot == "right.jpg"
    app.hear(background(3))
    for _ in range(40):
        app.pass_s(30.0)
        app.hear(setup(2, shot="right.jpg"))
    assert len(app.heard(Tick)) == 3
    app.hear(setup(0, active=False))
    app.pass_real_s(0.0)
    assert (app.heard(Tick)[-1].purpose, app.heard(Tick)[-1].skipped) == ("run", 3)


def test_a_setup_run_that_has_died_is_over_after_a_minute(rig: Callable[..., Rig]) -> None:
    app = rig().start()
    app.hear(setup(1), frame(1))
    app.pass_s(300.0)
    assert [t.tick for t in app.heard(Tick)] == [1, 2]


def test_a_step_whose_picture_failed_is_tried_when_the_lamps_confirm_again(rig: Callable[..., Rig]) -> None:
    app = rig().start(setup(1), setup_lamps(1))
    assert [t.purpose for t in app.heard(Tick)] == ["background"]
    app.hear(FrameMissed(tick=1, time_s=0.0, because="disk_full", reason="x", purpose="background", shot="left.jpg"))
    app.pass_real_s(5.0)
    assert len(app.heard(Tick)) == 1
    app.hear(setup_lamps(1))
    assert [t.tick for t in app.heard(Tick)] == [1, 2]


def test_a_restart_does_not_take_a_steps_picture_twice(rig: Callable[..., Rig]) -> None:
    r = rig()
    first = r.start(setup(1), setup_lamps(1))
    first.hear(background(1))
    again = r.start(*[first.heard(k)[-1] for k in (Tick, Flash)], background(1), setup(1), setup_lamps(1))
    assert again.heard(Tick) == []


def test_a_restart_does_not_light_a_picture_of_the_empty_setup_without_a_setup_run(rig: Callable[..., Rig]) -> None:
    r = rig(wait_for_background=True)
    first = r.start(setup(1), setup_lamps(1))
    first.hear(
        FrameMissed(tick=1, time_s=0.0, because="camera_gone", reason="x", purpose="background", shot="left.jpg")
    )
    r.clock.advance(86_400.0)
    again = r.start()  # after a power cut the bus has kept nothing
    again.pass_s(1000.0)
    assert (again.said, r.lamp.on) == ([], False)


def test_a_live_setup_run_gets_its_picture_after_a_restart_as_a_new_tick(rig: Callable[..., Rig]) -> None:
    r = rig()
    first = r.start(setup(1), setup_lamps(1))
    again = r.start(first.heard(Tick)[-1], setup(1), setup_lamps(1))  # killed before the lamp was lit
    assert [(t.tick, t.purpose) for t in again.heard(Tick)] == [(2, "background")]
    assert [(f.tick, f.lit) for f in again.heard(Flash)] == [(2, True)]


def test_the_beat_can_wait_for_pictures_of_the_empty_setup(rig: Callable[..., Rig], tmp_path: Path) -> None:
    app = rig(wait_for_background=True).start()
    app.pass_s(1000.0)
    assert app.said == []
    (tmp_path / "run" / "background").mkdir()
    (tmp_path / "run" / "background" / "dark.jpg").write_bytes(b"x")
    app.pass_s(1.0)
    assert app.heard(Tick)[0].time_s == 0.0


def test_a_run_that_has_begun_goes_on_without_its_background(rig: Callable[..., Rig], tmp_path: Path) -> None:
    picture = tmp_path / "run" / "background" / "dark.jpg"
    picture.parent.mkdir(parents=True)
    picture.write_bytes(b"x")
    r = rig(wait_for_background=True)
    app = r.start()
    app.hear(frame(1))
    picture.unlink()
    app.pass_s(301.0)
    assert [t.tick for t in app.heard(Tick)] == [1, 2]
    app.leave()
    again = r.start(frame(2))
    again.pass_s(301.0)
    assert again.heard(Tick)[-1].tick == 3


def test_a_damaged_state_file_is_one_clear_line_where_it_cannot_be_put_aside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "rename", refused)
    file = tmp_path / "flash.json"
    file.write_text('{"tick": -3}')
    assert keep_damaged(file) == ""
    with pytest.raises(BadInput, match=r"flash\.json: damaged .*remove it"):
        read_state(file, RunFolder(tmp_path / "run"))


@pytest.mark.parametrize("damage", [b"", b"\0" * 100, b'{"tick": -3}', b"[" * 9999])
def test_a_damaged_state_file_is_kept_aside_and_numbers_go_on_after_the_photographs(
    tmp_path: Path, damage: bytes
) -> None:
    file, run = tmp_path / "flash.json", RunFolder(tmp_path / "run")
    run.frames.mkdir(parents=True)
    (run.frames / "000007.jpg").write_bytes(b"x")
    run.append_frame("frames/000007.jpg", 1800.0, "dark")
    file.write_bytes(damage)

    said = keep_damaged(file)

    (aside,) = tmp_path.glob("flash.json.damaged-*")
    assert str(aside) in said
    assert aside.read_bytes() == damage
    state = read_state(file, run)
    assert state is not None
    assert state.tick == 7
    assert keep_damaged(file) == ""


def test_without_a_state_file_numbers_go_on_after_the_photographs(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    app.run.frames.mkdir()
    for number in (1, 2, 3):
        (app.run.frames / f"{number:06d}.jpg").write_bytes(b"x")
        app.run.append_frame(f"frames/{number:06d}.jpg", 300.0 * (number - 1), "dark")
    (app.state_dir / "flash.json").unlink()
    again = r.start(frame(3))
    again.pass_s(0.0)
    assert [(t.tick, t.time_s) for t in again.heard(Tick)] == [(4, 900.0)]


def test_a_power_cut_of_eight_hours_is_told_once_when_the_clock_has_been_set(rig: Callable[..., Rig]) -> None:
    r = rig()
    r.start().hear(frame(1))
    r.clock, r.boot, r.is_right = FakeClock(mono_ns=20 * NS, utc_ns=r.clock.utc_ns() + 120 * NS), "another", False
    app = r.start(frame(1))
    app.pass_s(60.0)
    r.clock.jump_utc(8 * 3600.0)
    r.is_right = True
    app.pass_s(121.0)
    tick = app.heard(Tick)[-1]
    assert (tick.tick, tick.time_s, tick.skipped) == (2, pytest.approx(300.0 + 8 * 3600.0, abs=2.0), 96)
    app.hear(frame(2))
    app.pass_s(300.0)
    assert [t.skipped for t in app.heard(Tick)] == [96, 0]
    assert [line for line in app.lines if "absence" in line] == ["absence_was_longer"]


def test_whether_the_clock_is_right_is_asked_before_it_is_read() -> None:
    clock = FakeClock()
    before_ns = clock.utc_ns()

    def is_right() -> bool:
        clock.jump_utc(3600.0)
        return False

    assert read_clocks(clock, "boot", is_right).utc_ns == before_ns + 3600 * NS


def photographs(folder: Path, ticks: range) -> RunFolder:
    """A run with photographs and both tables, one tick 300 s after the other from run time 0."""
    run = RunFolder(folder / "run")
    run.frames.mkdir(parents=True, exist_ok=True)
    lines = []
    for tick in ticks:
        (run.frames / f"{tick:06d}.jpg").touch()
        run.append_frame(f"frames/{tick:06d}.jpg", 300.0 * (tick - 1), "dark")
        lines.append(f'{{"tick":{tick},"time_s":{300.0 * (tick - 1)},"purpose":"run"}}\n')
    run.frames_log.write_text("".join(lines))
    return run


def test_photographs_that_a_stale_state_file_does_not_know_of_are_not_numbered_again(
    rig: Callable[..., Rig], tmp_path: Path
) -> None:
    r = rig()
    r.start().hear(frame(1))
    photographs(tmp_path, range(1, 41))  # state_dir could not be written meanwhile, and then power was cut
    r.clock.advance(40 * 300.0 - 100.0)
    again = r.start()
    again.pass_s(99.0)
    assert again.said == []
    again.pass_s(2.0)
    assert [(t.tick, t.time_s) for t in again.heard(Tick)] == [(41, pytest.approx(12_000.0, abs=2.0))]


def test_the_state_file_holds_where_it_is_further_than_the_photographs(rig: Callable[..., Rig], tmp_path: Path) -> None:
    r = rig()
    first = r.start()
    first.hear(FrameMissed(tick=1, time_s=0.0, because="disk_full", reason="x"))
    first.pass_s(300.0)
    first.hear(FrameMissed(tick=2, time_s=300.0, because="disk_full", reason="x"))
    photographs(tmp_path, range(1, 2))
    written = (tmp_path / "state" / "flash.json").read_bytes()
    assert read_state(tmp_path / "state" / "flash.json", RunFolder(tmp_path / "run")) == msgspec.json.decode(
        written, type=BeatState
    )


def test_a_state_file_of_another_run_gives_its_number_but_none_below_the_photographs(tmp_path: Path) -> None:
    file, run = tmp_path / "flash.json", photographs(tmp_path, range(1, 8))
    for tick, expected in ((5, 7), (90, 90)):
        file.write_bytes(msgspec.json.encode(BeatState(tick=tick, run="older", begun=True, time_s=9e5, due_s=9e5)))
        state = read_state(file, run)
        assert state is not None
        assert (state.tick, state.run, state.time_s) == (expected, "run", 1800.0)


def test_a_state_file_of_another_run_gives_its_number_alone_where_nothing_is_photographed(tmp_path: Path) -> None:
    file = tmp_path / "flash.json"
    file.write_bytes(msgspec.json.encode(BeatState(tick=5, run="older", begun=True, time_s=9e5, due_s=9e5)))
    state = read_state(file, RunFolder(tmp_path / "run"))
    tick = Beat(300.0, run="run", state=state, now=Reading(NS, NS, "boot")).next(Reading(NS, NS, "boot"))
    assert (tick.tick, tick.time_s) == (6, 0.0)


def test_pictures_of_the_empty_setup_count_by_the_ledger_and_set_no_time(tmp_path: Path) -> None:
    run = photographs(tmp_path, range(1, 4))
    with run.frames_log.open("a") as ledger:
        ledger.write('{"tick":9,"time_s":5000.0,"purpose":"background"}\n')
    assert last_photographed(run) == Photographed(tick=9, time_s=600.0)


def test_what_a_power_cut_tore_does_not_hide_the_lines_before_it(tmp_path: Path) -> None:
    run = photographs(tmp_path, range(1, 4))
    for table, torn in ((run.frames_log, b'\0\0\0\n{"tick":77,"ti'), (run.frames_csv, b"x,nan,dark\nframes/0000,99")):
        with table.open("ab") as file:
            file.write(torn)
    assert last_photographed(run) == Photographed(tick=3, time_s=600.0)


@pytest.mark.parametrize("lost", ["frames", "frames.jsonl", "frames.csv"])
def test_any_two_of_names_and_tables_are_enough(tmp_path: Path, lost: str) -> None:
    run = photographs(tmp_path, range(1, 4))
    (tmp_path / "run" / lost).rename(tmp_path / "lost")
    assert last_photographed(run) == Photographed(tick=3, time_s=600.0)


def test_long_tables_are_read_at_their_ends(tmp_path: Path) -> None:
    run = photographs(tmp_path, range(1, 1))
    run.frames_log.write_text("".join(f'{{"tick":{n},"time_s":{n}.0}}\n' for n in [9_999_999, *range(1, 5000)]))
    run.frames_csv.write_text("file,time_s,light\n" + "".join(f"{n}.jpg,{n}.0,dark\n" for n in range(1, 20_000)))
    assert last_photographed(run) == Photographed(tick=4999, time_s=19_999.0)


def test_photographs_that_cannot_be_looked_at_are_one_clear_line(tmp_path: Path) -> None:
    run = photographs(tmp_path, range(1, 2))
    run.frames_log.unlink()
    run.frames_log.mkdir()
    with pytest.raises(BadInput, match=r"frames\.jsonl: cannot be read"):
        read_state(tmp_path / "flash.json", run)

"""Tick, light, photograph, dark: with a lamp of ours and time that the test moves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from flash_fakes import Rig, frame, lock_step, pass_in_steps

from flora_common.clock import NS, LeaderClock
from flora_common.errors import FlashDead
from flora_common.messages import Flash, FrameMissed, Lamps, Tick
from flora_flash.backends import NoLamp


@pytest.fixture
def rig(tmp_path: Path) -> Callable[..., Rig]:
    return lambda **config: Rig(tmp_path, **config)


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


def test_stopped_in_the_middle_of_a_tick_it_says_that_it_is_dark(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    app.leave()
    last = app.said[-1]
    assert isinstance(last, Flash)
    assert (last.tick, last.lit, last.confirmed) == (1, False, True)
    assert "has been stopped" in last.reason
    again = r.start(*app.said)
    assert [flash.lit for flash in again.heard(Flash)] == [False]
    again.hear(frame(1))
    said = list(again.said)
    again.leave()
    assert again.said == said  # between ticks there is nothing to say


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

"""Commands in, bytes out, and what is really lit said: with the real driver class, and time that the test moves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from device_fakes import FakeApp
from flora_common.errors import LampsDead
from flora_common.messages import Lamps, LightCommand, Setup, Tick
from flora_common.open_loop import OpenLoopSection
from flora_led.backends.neopixel import NeoPixelStrips
from flora_led.core import BYTES_PER_STRIP
from flora_led.service import LedSection, LedService


class WatchedStrips(NeoPixelStrips):
    """The real driver; what it sent is kept, and it can be made to fail."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.is_broken = False
        super().__init__("D18", agnostic=True)

    def _transmitted(self, grb: bytes) -> None:
        if self.is_broken:
            raise OSError(5, "no bus")
        self.sent.append(grb)
        super()._transmitted(grb)


@pytest.fixture
def start(tmp_path: Path) -> Callable[..., tuple[FakeApp, WatchedStrips]]:
    def start(*kept: Any, **config: Any) -> tuple[FakeApp, WatchedStrips]:
        app, strips = FakeApp(tmp_path, LedSection(**config)), WatchedStrips()
        LedService(app, strips)  # type: ignore[arg-type]
        app.hear(*kept)
        app.ready()
        return app, strips

    return start


Start = Callable[..., tuple[FakeApp, WatchedStrips]]


def command(light: str, tick: int = 1, **changes: Any) -> LightCommand:
    return LightCommand(tick=tick, light=light, **changes)  # type: ignore[arg-type]


def test_a_command_is_written_read_back_and_confirmed(start: Start) -> None:
    app, strips = start()
    app.hear(command("left", 3))
    assert strips.sent[-1] == bytes((60, 90, 255)) * 144 + bytes(BYTES_PER_STRIP)
    lamps = app.said[-1]
    assert (lamps.tick, lamps.lit, lamps.commanded, lamps.fallback, lamps.scale) == (3, "left", "left", False, 1.0)
    assert lamps.current_a == pytest.approx(0.288 + 144 * 0.016 * (60 + 90 + 255) / 255)


def test_the_same_command_again_is_confirmed_again(start: Start) -> None:
    app, _ = start()
    app.hear(command("left", 3), command("left", 3))
    assert [m.tick for m in app.said] == [0, 3, 3]


def test_the_cap_dims_and_says_so(start: Start) -> None:
    app, strips = start(colour=(255, 255, 255), current_cap_a=3.0)
    app.hear(command("both"))
    lamps = app.said[-1]
    assert lamps.current_a <= 3.0
    assert lamps.scale == pytest.approx((3.0 - 0.288) / 13.824)
    assert max(strips.sent[-1]) == int(255 * lamps.scale)


def test_a_colour_of_nothing_is_reported_as_dark(start: Start) -> None:
    app, _ = start(colour=(0, 0, 0))
    app.hear(command("left"))
    assert (app.said[-1].lit, app.said[-1].commanded) == ("dark", "left")


def test_strips_are_dark_before_the_bus_has_spoken_and_then_show_what_it_kept(start: Start) -> None:
    app, strips = start(command("right", 9))
    assert [any(grb) for grb in strips.sent] == [False, True]
    assert [(m.tick, m.lit) for m in app.said] == [(9, "right")]


def test_an_old_kept_command_does_not_shine(start: Start) -> None:
    app, strips = start(command("right", 9, t_mono_ns=1))
    assert not any(strips.sent[-1])
    assert app.said[-1].fallback


def test_the_fallback_comes_by_itself_and_is_told(start: Start) -> None:
    app, strips = start(lease_s=900.0, fallback="dark")
    app.hear(command("left", 5))
    app.pass_s(899.0)
    assert any(strips.sent[-1])
    app.pass_s(32.0)
    assert not any(strips.sent[-1])
    lamps = app.said[-1]
    assert (lamps.lit, lamps.commanded, lamps.fallback, lamps.tick) == ("dark", "left", True, 5)
    assert "lease" in app.troubles
    app.hear(command("right", 6))
    assert app.troubles == {}


def test_without_commands_the_open_loop_goes_on_by_itself_and_is_told(start: Start) -> None:
    app, _ = start(fallback="open-loop", open_loop=OpenLoopSection(hours=1.0, first="right"))
    began_ns = app.clock.mono_ns()
    app.hear(Tick(tick=5, time_s=0.0, t_mono_ns=began_ns), command("left", 5, t_mono_ns=began_ns))
    seen = ["left"]
    for _ in range(80):
        app.pass_s(120.0)
        if app.said[-1].lit != seen[-1]:
            seen.append(app.said[-1].lit)
    assert seen == ["left", "right", "left", "right"]  # the command, then the schedule of the run: hours 0, 1 and 2
    assert "fallback right" in app.troubles["lease"]


def test_the_beat_looks_at_the_lease_too(start: Start) -> None:
    app, _ = start()
    app.hear(command("left", 5))
    app.clock.advance(1000.0)  # no real time: a lock-step world
    app.hear(Tick(tick=9, time_s=0.0))
    assert app.said[-1].fallback
    count = len(app.said)
    app.hear(Tick(tick=10, time_s=0.0))  # told once more, so that it does not look like silence
    assert len(app.said) == count + 1
    assert app.said[-1].tick == 5  # never taken for the answer to the new tick


def test_a_fresh_command_is_not_told_again_by_the_beat(start: Start) -> None:
    app, _ = start()
    app.hear(command("left", 5), Tick(tick=6, time_s=0.0))
    assert len(app.heard(Lamps)) == 2


def test_a_light_that_goes_on_without_commands_is_told_with_each_tick(start: Start) -> None:
    app, strips = start()
    app.hear(command("left", 5), Tick(tick=6, time_s=0.0))
    count, written = len(app.heard(Lamps)), len(strips.sent)
    app.hear(Tick(tick=7, time_s=300.0))  # tick 6 brought no command
    assert len(app.heard(Lamps)) == count + 1
    assert (app.said[-1].tick, app.said[-1].lit, app.said[-1].fallback) == (5, "left", False)
    assert len(strips.sent) == written + 1
    app.hear(setup(1, "both"))
    count = len(app.heard(Lamps))
    app.hear(Tick(tick=8, time_s=300.0, purpose="background", shot="x.jpg"))
    assert len(app.heard(Lamps)) == count


def setup(step: int, lamps: str, *, active: bool = True) -> Setup:
    return Setup(active=active, step=step, steps=4, lamps=lamps, shot="x.jpg")  # type: ignore[arg-type]


def test_a_setup_run_is_answered_and_then_the_command_shines_again(start: Start) -> None:
    app, strips = start()
    app.hear(command("left", 5), setup(1, "both"))
    assert (app.said[-1].lit, app.said[-1].setup_step, app.said[-1].tick) == ("both", 1, 0)
    app.hear(command("right", 6))
    assert app.said[-1].setup_step == 1  # nothing new shines
    app.hear(setup(0, "dark", active=False))
    assert (app.said[-1].lit, app.said[-1].tick, app.said[-1].setup_step) == ("right", 6, 0)
    assert any(strips.sent[-1])


def test_a_setup_run_that_has_died_is_over_after_a_minute(start: Start) -> None:
    app, _ = start()
    app.hear(command("left", 5), setup(1, "both"))
    app.pass_s(50.0)
    app.hear(setup(1, "both"))
    app.pass_s(59.0)
    assert app.said[-1].lit == "both"
    app.pass_s(2.0)
    assert (app.said[-1].lit, app.said[-1].setup_step) == ("left", 0)


def test_strips_that_cannot_be_written_are_told_and_tried_again(start: Start) -> None:
    app, strips = start()
    count = len(app.said)
    strips.is_broken = True
    app.hear(command("left", 5))
    assert len(app.said) == count  # nothing is confirmed that did not happen
    assert "no bus" in app.troubles["strips"]
    app.pass_s(6.0)
    strips.is_broken = False
    app.pass_s(6.0)
    assert (app.said[-1].lit, app.said[-1].tick) == ("left", 5)
    assert app.troubles == {}


def test_strips_that_cannot_be_written_at_the_start_end_it(tmp_path: Path) -> None:
    strips = WatchedStrips()
    strips.is_broken = True
    with pytest.raises(LampsDead):
        LedService(FakeApp(tmp_path, LedSection()), strips)  # type: ignore[arg-type]


def test_dark_however_it_ends(start: Start) -> None:
    app, strips = start()
    app.hear(command("both"))
    app.leave()
    assert not any(strips.sent[-1])


def test_its_last_word_is_that_it_is_dark(start: Start) -> None:
    app, _ = start()
    app.hear(command("left", 5))
    app.leave()
    last = app.heard(Lamps)[-1]
    assert (last.lit, last.commanded, last.tick, last.fallback) == ("dark", "left", 0, True)


def test_a_failure_on_leaving_is_told_and_hides_nothing(start: Start) -> None:
    app, strips = start()
    strips.is_broken = True
    app.leave()
    assert "strips_not_dark" in app.lines


def test_a_pin_that_does_not_exist_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from flora_led.backends import neopixel

    monkeypatch.setattr(neopixel, "AGNOSTIC_PIN", "D999")
    with pytest.raises(LampsDead, match="no such pin"):
        NeoPixelStrips("D999")

"""Pictures of the empty setup: one per step of a setup run, while the beat rests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from flash_fakes import Rig, frame, pass_in_steps

from flora_common.messages import Flash, Frame, FrameMissed, Lamps, Setup, Tick


@pytest.fixture
def rig(tmp_path: Path) -> Callable[..., Rig]:
    return lambda **config: Rig(tmp_path, **config)


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

"""What the service makes of what it hears: rows kept once, runs told apart, looks when they are due, words once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from flora_common.messages import ControllerState, Departure, Frame, Lamps, Recording, Stem
from flora_common.runs import Light
from flora_common.tracks import read_track
from flora_lab.serve.watching import Looked, Watch

SHA = "{:064x}"
POINTS = tuple((0.25 * i, 1.0 * i) for i in range(10))


def frame(tick: int, run: str = "bean-07") -> Frame:
    return Frame(
        tick=tick,
        time_s=300.0 * (tick - 1),
        path=f"frames/{tick:06d}.jpg",
        run=run,
        sha256=SHA.format(tick),
        bytes=1,
        width_px=640,
        height_px=480,
        light="left",
        flash_confirmed=True,
        exposure_ok=True,
    )


def stem(tick: int, *, outcome: Any = "ok", light: Light = "left", sha256: str | None = None) -> Stem:
    return Stem(
        tick=tick,
        time_s=300.0 * (tick - 1),
        outcome=outcome,
        points_cm=POINTS if outcome in ("ok", "occluded", "jumped") else (),
        light=light,
        frame_sha256=SHA.format(tick) if sha256 is None else sha256,
    )


def hears(watch: Watch, ticks: range, run: str = "bean-07") -> None:
    for tick in ticks:
        watch.on_frame(frame(tick, run))
        watch.on_stem(stem(tick))


def looked(hours: int, departed_at: int | None) -> Looked:
    return Looked({"hours": hours}, hours, departed_at, (3.0, -4.0), 2.5, True, f"after {hours} h")


@pytest.fixture
def watch(tmp_path: Path) -> Watch:
    return Watch(tmp_path / "box1")


def test_nothing_is_kept_before_a_photograph_says_which_run_it_is(watch: Watch) -> None:
    assert not watch.on_stem(stem(1))
    assert watch.look("sim") is None
    assert watch.to_say is None


def test_ticks_are_kept_once_in_order_and_survive_a_restart(watch: Watch) -> None:
    hears(watch, range(1, 4))
    hears(watch, range(1, 4))
    watch.on_frame(frame(6))
    assert watch.on_stem(stem(6))
    assert watch.on_stem(stem(5))  # late
    assert not watch.on_stem(stem(5))
    again = Watch(watch.folder)
    assert again.run == "bean-07"
    assert again.heard is not None
    assert [row.tick for row in again.heard.rows] == [1, 2, 3, 5, 6]
    assert not again.on_stem(stem(6))


def test_a_line_that_was_torn_by_a_power_cut_is_heard_again(watch: Watch) -> None:
    hears(watch, range(1, 4))
    rows = watch.folder / "bean-07" / "heard.jsonl"
    rows.write_bytes(rows.read_bytes()[:-30])
    again = Watch(watch.folder)
    assert again.on_stem(stem(3))
    assert [row.tick for row in Watch(watch.folder).heard.rows] == [1, 2, 3]  # type: ignore[union-attr]


def test_stems_that_are_no_stems_tell_the_lamp_alone(watch: Watch) -> None:
    hears(watch, range(1, 3))
    watch.on_lamps(Lamps(tick=2, lit="right", commanded="right"))
    watch.on_stem(stem(3, outcome="no_frame", light="dark", sha256=""))
    watch.on_stem(stem(4, outcome="no_frame", light="dark", sha256=""))
    watch.on_frame(frame(5))
    watch.on_stem(stem(5, outcome="jumped", light="right"))
    assert watch.heard is not None
    assert [(row.light, len(row.points_cm)) for row in watch.heard.rows[2:]] == [("right", 0), (None, 0), ("right", 0)]


def test_a_look_is_due_when_an_hour_has_ended_and_none_can_be_late(watch: Watch) -> None:
    hears(watch, range(1, 15))
    assert watch.look("sim") is None
    hears(watch, range(15, 17))
    look = watch.look("sim")
    assert look is not None
    assert (look.run, look.hours, look.watched) == ("bean-07", 1, None)
    assert [row.tick for row in look.rows] == list(range(1, 16))
    watch.take(look, looked(1, None), "sim")
    assert watch.look("sim") is None
    assert Watch(watch.folder).look("sim") is None
    other = watch.look("another simulator")
    assert other is not None
    assert (other.hours, other.watched) == (1, None)
    hears(watch, range(17, 29))
    further = Watch(watch.folder).look("sim")
    assert further is not None
    assert (further.hours, further.watched) == (2, {"hours": 1})


def test_hours_missed_while_the_service_was_away_are_one_look(watch: Watch) -> None:
    hears(watch, range(1, 20))
    hears(watch, range(60, 80))
    look = watch.look("sim")
    assert look is not None
    assert look.hours == 6
    assert len(look.rows) == 19 + 16


def test_it_is_said_once_when_a_plant_departs_and_once_when_it_returns(watch: Watch) -> None:
    hears(watch, range(1, 100))
    said: list[Departure] = []
    for hours, departed_at in ((1, None), (2, 2), (3, 2), (4, 2), (5, None), (6, None)):
        look = watch.look("sim")
        assert look is not None
        watch.take(look, looked(hours, departed_at), "sim")
        if watch.to_say is not None:
            said.append(watch.to_say)
            watch.said()
        watch = Watch(watch.folder)  # killed and started again: nothing is lost, nothing is said twice
        hears(watch, range(100 + 12 * hours, 112 + 12 * hours))
    assert [(d.is_departed, d.hours) for d in said] == [(True, 2), (False, 5)]
    assert (said[0].run, said[0].tip_error_mm, said[0].right_mm, said[0].up_mm) == ("bean-07", 5.0, 3.0, -4.0)
    assert (said[0].expected_mm, said[0].compared_with, said[0].sentence) == (2.5, "watched", "after 2 h")
    assert said[0].tick == 123


def test_what_was_not_said_before_a_kill_is_still_to_be_said(watch: Watch) -> None:
    hears(watch, range(1, 20))
    look = watch.look("sim")
    assert look is not None
    watch.take(look, looked(1, 1), "sim")
    again = Watch(watch.folder)
    assert again.to_say is not None
    assert again.to_say.is_departed
    again.said()
    assert Watch(watch.folder).to_say is None


def test_another_run_begins_anew_and_a_look_at_the_old_one_comes_too_late(watch: Watch) -> None:
    hears(watch, range(1, 20))
    look = watch.look("sim")
    assert look is not None
    watch.on_controller(ControllerState(controller="x", run_over=True))
    assert watch.is_over
    assert watch.on_frame(frame(1, "bean-08"))
    assert not watch.is_over
    watch.take(look, looked(1, 1), "sim")
    assert watch.to_say is None
    assert not watch.on_stem(stem(19))  # kept by the bus, of the run before
    assert watch.on_stem(stem(1))
    assert Watch(watch.folder).run == "bean-08"


def test_a_run_that_is_begun_anew_under_the_same_name_is_another_one(watch: Watch) -> None:
    hears(watch, range(1, 20))
    for tick in (1, 2, 3):
        assert watch.on_stem(stem(tick, sha256=SHA.format(1000 + tick)))
    assert watch.heard is not None
    assert len(watch.heard) == 3
    assert sorted(path.name for path in watch.folder.iterdir()) == ["bean-07", "bean-07.1"]
    assert len(read_track(watch.folder / "bean-07.1" / "track.csv").time_s) == 19


def test_what_was_heard_becomes_a_track_and_another_one_if_the_run_goes_on(watch: Watch) -> None:
    hears(watch, range(1, 5))
    watch.finish()
    path = watch.folder / "bean-07" / "track.csv"
    track = read_track(path)
    assert track.time_s.tolist() == [0.0, 300.0, 600.0, 900.0]
    assert track.points_cm[0].tolist() == [list(point) for point in POINTS]
    before = path.stat()
    watch.finish()
    assert path.stat().st_ino == before.st_ino
    hears(watch, range(5, 7))
    watch.finish()
    assert len(read_track(path).time_s) == 6


def test_the_recorder_tells_the_end_unless_it_only_begins_another_file(watch: Watch) -> None:
    hears(watch, range(1, 3))
    watch.on_recording(Recording(path="bus/1.mcap", closed=True))
    assert watch.is_over
    watch.on_recording(Recording(path="bus/2.mcap"))
    assert not watch.is_over
    watch.on_controller(ControllerState(controller="x", run_over=True))
    watch.on_recording(Recording(path="bus/2.mcap", messages=9))
    assert watch.is_over


def test_what_another_version_kept_is_begun_anew(watch: Watch) -> None:
    hears(watch, range(1, 20))
    (watch.folder / "bean-07" / "watched.json").write_bytes(b'{"hours": "many"}')
    look = Watch(watch.folder).look("sim")
    assert look is not None
    assert look.watched is None


def test_photographs_of_the_empty_setup_are_no_run(watch: Watch) -> None:
    watch.on_frame(msgspec.structs.replace(frame(0), purpose="background"))
    assert watch.run == ""

"""Killed at any moment, after a power cut, with a damaged state file: the beat goes on, and numbers with it."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from flash_fakes import Rig, frame, lock_step

from device_fakes import FakeApp
from fake_clock import FakeClock
from flora_common.clock import NS
from flora_common.errors import BadInput, DiskFull
from flora_common.messages import Flash, FrameMissed, Lamps, Tick
from flora_common.runs import RunFolder
from flora_flash import handshake
from flora_flash.core import Beat, BeatState, Photographed, Reading
from flora_flash.handshake import read_clocks
from flora_flash.main import keep_damaged, read_state
from flora_flash.photographs import last_photographed


@pytest.fixture
def rig(tmp_path: Path) -> Callable[..., Rig]:
    return lambda **config: Rig(tmp_path, **config)


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


def test_on_a_full_disk_and_a_bus_that_was_started_again_too_no_number_is_given_out_twice(
    rig: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch
) -> None:
    """flora-capture, which runs on, has counted them: it would not photograph them once more."""

    def refuse(*_: object) -> None:
        raise DiskFull("full")

    def missed(tick: int) -> FrameMissed:
        return FrameMissed(tick=tick, time_s=300.0 * (tick - 1), because="disk_full", reason="full")

    r = rig()
    app = r.start()
    app.hear(frame(1))
    with monkeypatch.context() as patch:
        patch.setattr(handshake, "write_text", refuse)
        for tick in (2, 3, 4):
            app.pass_s(300.0)
            app.hear(missed(tick))
    again = r.start(missed(4))  # all that the new bus knows, from flora-capture
    again.pass_s(299.0)
    assert again.heard(Tick) == []
    again.pass_s(2.0)
    assert [(t.tick, t.time_s, t.skipped) for t in again.heard(Tick)] == [(5, pytest.approx(1200.0, abs=2.0), 0)]


def test_a_photograph_of_the_run_before_that_the_bus_has_kept_gives_its_number_and_no_time(
    rig: Callable[..., Rig],
) -> None:
    old = FrameMissed(tick=900, time_s=260_000.0, because="disk_full", reason="full")
    app = rig().start(old)
    assert [(t.tick, t.time_s) for t in app.heard(Tick)] == [(901, 0.0)]


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


@pytest.mark.parametrize("kept", ["nothing", "pictures of the empty setup"])
def test_a_new_run_under_an_old_name_begins_at_time_0_with_the_next_number(
    rig: Callable[..., Rig], tmp_path: Path, kept: str
) -> None:
    r = rig()
    app = r.start()
    photographs(tmp_path, range(1, 2))
    app.hear(frame(1))
    app.pass_s(300.0)
    (tmp_path / "run").rename(tmp_path / "run-of-march")
    r.clock.advance(86_400.0)
    if kept != "nothing":
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "frames.jsonl").write_text('{"tick":1,"time_s":0.0,"purpose":"background"}\n')
    again = r.start(*[app.heard(kind)[-1] for kind in (Tick, Flash)], frame(1))
    again.pass_s(1.0)
    assert [(t.tick, t.time_s) for t in again.heard(Tick)] == [(3, 0.0)]


def test_a_run_that_only_lost_its_first_photographs_goes_on(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    for tick in (1, 2):
        app.hear(FrameMissed(tick=tick, time_s=300.0 * (tick - 1), because="camera_gone", reason="x"))
        app.pass_s(300.0)
    assert [(t.tick, t.time_s) for t in app.heard(Tick)][-1] == (3, 600.0)
    again = r.start(*[app.heard(kind)[-1] for kind in (Tick, Flash)])
    again.hear(FrameMissed(tick=3, time_s=600.0, because="camera_gone", reason="x"))
    again.pass_s(300.0)
    assert [(t.tick, t.time_s) for t in again.heard(Tick)] == [(4, 900.0)]


def test_a_run_whose_photographs_are_kept_elsewhere_goes_on(rig: Callable[..., Rig]) -> None:
    r = rig()
    app = r.start()
    app.hear(frame(1))  # of a camera that is not ours: no such file is in the run folder
    again = r.start(*[app.heard(kind)[-1] for kind in (Tick, Flash)], frame(1))
    again.pass_s(300.0)
    assert [(t.tick, t.time_s) for t in again.heard(Tick)] == [(2, 300.0)]


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

"""The beat: numbers, due times, run time."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flora_common.clock import NS
from flora_common.messages import Tick
from flora_flash.core import Beat, BeatState, Photographed, Reading, caught_up, recovered

INTERVAL_S = 300.0


def reading(seconds: float, *, utc_s: float | None = None, boot: str = "a") -> Reading:
    return Reading(round(seconds * NS), round((1e9 + (seconds if utc_s is None else utc_s)) * NS), boot)


def fresh(now: Reading) -> Beat:
    return Beat(INTERVAL_S, run="bean", state=None, now=now)


def test_the_first_tick_is_due_at_once_and_is_time_0_of_the_run() -> None:
    beat = fresh(reading(5000.0))
    assert beat.due_ns == 0
    tick = beat.next(reading(5010.0))
    assert (tick.tick, tick.time_s, tick.late_s, tick.skipped) == (1, 0.0, 0.0, 0)
    assert beat.due_ns == 5310 * NS


def test_due_times_do_not_drift() -> None:
    beat = fresh(reading(0.0))
    beat.next(reading(0.0))
    tick = beat.next(reading(304.0))
    assert (tick.late_s, beat.due_ns) == (4.0, 600 * NS)


def test_hopelessly_late_is_told_and_not_made_up_for() -> None:
    beat = fresh(reading(0.0))
    beat.next(reading(0.0))
    tick = beat.next(reading(3000.0 + 40.0))
    assert (tick.tick, tick.skipped, tick.late_s) == (2, 9, 40.0)
    assert beat.due_ns == 3300 * NS


def test_a_restart_in_the_same_boot_goes_by_the_monotonic_clock() -> None:
    beat = fresh(reading(0.0))
    beat.next(reading(0.0))
    again = Beat(INTERVAL_S, run="bean", state=beat.state, now=reading(100.0, utc_s=-1e8))
    assert again.due_ns == 300 * NS
    assert again.next(reading(300.0, utc_s=5e8)).time_s == 300.0


def test_a_reboot_goes_by_the_wall_clock() -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    again = Beat(INTERVAL_S, run="bean", state=beat.state, now=reading(20.0, utc_s=9700.0, boot="b"))
    tick = again.next(reading(20.0, utc_s=9700.0, boot="b"))
    assert (tick.tick, tick.time_s, tick.skipped) == (2, 700.0, 1)


@pytest.mark.parametrize("utc_s", [-5e8, 8e7])
def test_a_wall_clock_that_cannot_be_right_counts_as_one_interval(utc_s: float) -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    again = Beat(INTERVAL_S, run="bean", state=beat.state, now=reading(20.0, utc_s=utc_s, boot="b"))
    assert again.next(reading(20.0, utc_s=utc_s, boot="b")).time_s == 300.0


def test_another_run_begins_at_0_with_numbers_that_go_on() -> None:
    beat = fresh(reading(0.0))
    beat.next(reading(0.0))
    other = Beat(INTERVAL_S, run="other", state=beat.state, now=reading(50.0))
    tick = other.next(reading(60.0))
    assert (tick.tick, tick.time_s) == (2, 0.0)


def test_pictures_of_the_empty_setup_take_numbers_and_leave_the_grid_alone() -> None:
    beat = fresh(reading(0.0))
    shot = beat.background(reading(10.0), shot="left.jpg", setup="s:1:left.jpg")
    assert (shot.tick, shot.time_s, shot.purpose, shot.shot) == (1, 0.0, "background", "left.jpg")
    assert beat.next(reading(70.0)).time_s == 0.0
    beat.background(reading(100.0), shot="right.jpg", setup="s:2:right.jpg")
    assert beat.again(reading(100.0)).time_s == 30.0
    assert beat.due_ns == 370 * NS
    assert beat.next(reading(370.0)).tick == 4


def test_a_number_that_the_bus_has_heard_is_not_given_out_again() -> None:
    beat = fresh(reading(0.0))
    beat.heard(Tick(tick=41, time_s=0.0))
    assert beat.next(reading(0.0)).tick == 42


def test_without_its_file_the_beat_goes_on_after_the_photographs() -> None:
    state = recovered("bean", last_tick=7, last_time_s=1800.0)
    tick = Beat(INTERVAL_S, run="bean", state=state, now=reading(3.0)).next(reading(3.0))
    assert (tick.tick, tick.time_s) == (8, 2100.0)


def test_photographs_beyond_the_file_move_number_and_due_time_on_and_leave_clocks_and_grid() -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    state = caught_up(beat.state, Photographed(tick=11, time_s=3004.5), interval_s=INTERVAL_S)
    again = Beat(INTERVAL_S, run="bean", state=state, now=reading(12_100.0))
    assert again.due_ns == 12_300 * NS
    tick = again.next(reading(12_300.0))
    assert (tick.tick, tick.time_s, tick.late_s) == (12, 3300.0, 0.0)


@pytest.mark.parametrize("utc_s", [9600.0, -5e8])
def test_a_wall_clock_behind_the_photographs_does_not_set_the_run_back(utc_s: float) -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    state = caught_up(beat.state, Photographed(tick=11, time_s=3000.0), interval_s=INTERVAL_S)
    now = reading(20.0, utc_s=utc_s, boot="b")
    again = Beat(INTERVAL_S, run="bean", state=state, now=now)
    assert again.due_ns == now.mono_ns
    tick = again.next(now)
    assert (tick.tick, tick.time_s, tick.skipped) == (12, 3300.0, 0)


def test_photographs_that_the_file_knows_of_change_nothing() -> None:
    beat = fresh(reading(0.0))
    beat.background(reading(0.0), shot="left.jpg", setup="s:1:left.jpg")
    assert caught_up(beat.state, Photographed(tick=1, time_s=None), interval_s=INTERVAL_S) == beat.state


steps = st.lists(
    st.one_of(
        st.tuples(st.just("pass"), st.floats(0.0, 5000.0)),
        st.tuples(st.just("jump"), st.floats(-1e9, 1e9)),
        st.tuples(st.just("restart"), st.floats(0.0, 100.0)),
        st.tuples(st.just("reboot"), st.floats(0.0, 4000.0)),
        st.tuples(st.just("background"), st.floats(0.0, 10.0)),
    ),
    max_size=40,
)


@given(steps)
def test_whatever_happens_numbers_never_repeat_time_increases_and_beats_never_burst(
    steps: list[tuple[str, float]],
) -> None:
    mono_s, offset_s, boot = 500.0, 0.0, 0

    def now() -> Reading:
        return Reading(round(mono_s * NS), max(0, round((1e9 + mono_s + offset_s) * NS)), f"boot{boot}")

    beat = fresh(now())
    numbers, times = [], []
    started_s = None
    for what, amount in steps:
        if what == "pass":
            mono_s += amount
            if beat.due_ns <= now().mono_ns:
                tick = beat.next(now())
                numbers.append(tick.tick)
                times.append(tick.time_s)
                assert tick.late_s <= INTERVAL_S / 2 + 1e-6
                if started_s is not None:
                    assert mono_s - started_s >= INTERVAL_S / 2 - 1e-6
                started_s = mono_s
        elif what == "jump":
            offset_s += amount
        elif what == "background":
            numbers.append(beat.background(now(), shot="a.jpg", setup="x").tick)
        else:
            mono_s += amount
            if what == "reboot":
                boot, mono_s, offset_s, started_s = boot + 1, amount, offset_s + mono_s, None
            kept = msgspec.json.decode(msgspec.json.encode(beat.state), type=BeatState)
            beat = Beat(INTERVAL_S, run="bean", state=kept, now=now())
    assert numbers == sorted(set(numbers))
    assert all(later > earlier for earlier, later in pairwise(times))

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


def reading(seconds: float, *, utc_s: float | None = None, boot: str = "a", is_right: bool = True) -> Reading:
    return Reading(round(seconds * NS), round((1e9 + (seconds if utc_s is None else utc_s)) * NS), boot, is_right)


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


def restarted(beat: Beat, now: Reading) -> Beat:
    """The next start, by what is on the disk."""
    kept = msgspec.json.decode(msgspec.json.encode(beat.state), type=BeatState)
    return Beat(INTERVAL_S, run="bean", state=kept, now=now)


def next_tick(beat: Beat, now: Reading) -> tuple[float, Tick]:
    """By how much an absence was longer, and the tick, as the service asks for them."""
    return beat.measure_absence(now), beat.next(now)


def test_eight_hours_without_power_are_made_up_for_once_the_wall_clock_is_right() -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    cut_s, off_s = 9100.0, 8 * 3600.0  # the Pi's clock goes on at the power cut; 40 s after the start NTP sets it
    again = restarted(beat, reading(20.0, utc_s=cut_s + 20.0, boot="b", is_right=False))
    due = reading(200.0, utc_s=cut_s + 200.0 + off_s, boot="b")
    longer_s, tick = next_tick(again, due)
    assert longer_s == pytest.approx(off_s)
    assert (tick.tick, tick.time_s, tick.skipped) == (2, pytest.approx(300.0 + off_s), 96)
    assert next_tick(again, reading(500.0, utc_s=cut_s + 500.0 + off_s, boot="b"))[0] == 0.0
    assert again.state.absence is None


def test_an_absence_is_measured_by_a_service_that_was_started_again_meanwhile() -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    again = restarted(beat, reading(20.0, utc_s=-5e8, boot="b", is_right=False))
    assert next_tick(again, reading(20.0, utc_s=-5e8, boot="b", is_right=False))[1].time_s == INTERVAL_S
    third = restarted(again, reading(100.0, utc_s=-5e8 + 80.0, boot="b", is_right=False))
    longer_s, tick = next_tick(third, reading(320.0, utc_s=16_300.0, boot="b"))
    assert (longer_s, tick.time_s) == (pytest.approx(6700.0), pytest.approx(7300.0))


def test_two_power_cuts_before_the_clock_is_right_are_measured_together() -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    second = restarted(beat, reading(20.0, utc_s=9020.0, boot="b", is_right=False))
    next_tick(second, reading(300.0, utc_s=9300.0, boot="b", is_right=False))
    third = restarted(second, reading(20.0, utc_s=9320.0, boot="c", is_right=False))
    longer_s, tick = next_tick(third, reading(300.0, utc_s=29_000.0, boot="c"))
    assert longer_s > 0.0
    assert tick.time_s == pytest.approx(20_000.0)


@pytest.mark.parametrize(
    ("utc_s", "why"), [(9110.0, "shorter"), (9000.0 + 31 * 86_400.0, "implausible"), (0.0, "past")]
)
def test_an_absence_that_was_not_longer_or_cannot_be_leaves_the_run_time_alone(utc_s: float, why: str) -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    again = restarted(beat, reading(20.0, utc_s=9200.0, boot="b", is_right=False))
    longer_s, tick = next_tick(again, reading(120.0, utc_s=utc_s, boot="b"))
    assert (longer_s, tick.time_s) == (0.0, 300.0), why
    assert again.state.absence is None


def test_a_wall_clock_that_was_not_right_before_the_power_cut_measures_nothing() -> None:
    """It may have been days behind: that would be no absence."""
    beat = fresh(reading(9000.0, is_right=False))
    beat.next(reading(9000.0, is_right=False))
    again = restarted(beat, reading(20.0, utc_s=9200.0, boot="b", is_right=False))
    longer_s, tick = next_tick(again, reading(120.0, utc_s=9e5, boot="b"))
    assert (longer_s, tick.time_s) == (0.0, 300.0)


def test_a_clock_that_was_set_stays_right_for_its_boot_though_its_time_server_is_gone() -> None:
    beat = fresh(reading(0.0))
    beat.next(reading(0.0))
    beat.next(reading(300.0, is_right=False))
    again = restarted(beat, reading(20.0, utc_s=400.0, boot="b", is_right=False))
    assert next_tick(again, reading(220.0, utc_s=9300.0, boot="b"))[1].time_s == pytest.approx(9300.0)


def test_without_power_cuts_nothing_is_measured_however_often_the_wall_clock_is_set() -> None:
    beat = fresh(reading(0.0, is_right=False))
    beat.next(reading(0.0, is_right=False))
    again = restarted(beat, reading(100.0, is_right=False))
    assert next_tick(again, reading(300.0, utc_s=5e6))[0] == 0.0


def test_a_tick_that_the_bus_heard_after_an_absence_was_measured_tells_the_run_time() -> None:
    beat = fresh(reading(9000.0))
    beat.next(reading(9000.0))
    unmeasured = reading(20.0, utc_s=9020.0, boot="b", is_right=False)
    second = restarted(beat, unmeasured)
    next_tick(second, reading(300.0, utc_s=9300.0, boot="b", is_right=False))
    third = restarted(second, reading(700.0, utc_s=30_000.0, boot="b"))  # tick 3 is measured, and the disk was full
    third.heard(Tick(tick=3, time_s=20_900.0, late_s=20.0, t_mono_ns=600 * NS))
    assert third.due_ns == 880 * NS


def test_a_state_file_of_before_loads_and_one_with_nothing_to_measure_has_no_new_field() -> None:
    old = b'{"tick":7,"run":"bean","begun":true,"time_s":1.0,"due_s":0.0,'
    old += b'"mono_ns":5,"utc_ns":6,"boot_id":"a","purpose":"run","shot":"","setup":""}'
    state = msgspec.json.decode(old, type=BeatState)
    assert (state.tick, state.absence, state.utc_is_right) == (7, None, True)
    assert msgspec.json.decode(msgspec.json.encode(state)).keys() <= msgspec.json.decode(old).keys()


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
        st.tuples(st.just("told"), st.floats(0.0, 1e5)),
        st.tuples(st.just("untold"), st.just(0.0)),
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
    mono_s, offset_s, boot, is_right = 500.0, 0.0, 0, True

    def now() -> Reading:
        return Reading(round(mono_s * NS), max(0, round((1e9 + mono_s + offset_s) * NS)), f"boot{boot}", is_right)

    beat = fresh(now())
    numbers, times = [], []
    started_s = None
    for what, amount in steps:
        if what == "pass":
            mono_s += amount
            if beat.due_ns <= now().mono_ns:
                _, tick = next_tick(beat, now())
                numbers.append(tick.tick)
                times.append(tick.time_s)
                assert tick.late_s <= INTERVAL_S / 2 + 1e-6
                if started_s is not None:
                    assert mono_s - started_s >= INTERVAL_S / 2 - 1e-6
                started_s = mono_s
        elif what == "jump":
            offset_s += amount
        elif what in ("told", "untold"):
            offset_s, is_right = offset_s + amount, what == "told"
        elif what == "background":
            numbers.append(beat.background(now(), shot="a.jpg", setup="x").tick)
        else:
            mono_s += amount
            if what == "reboot":
                boot, mono_s, offset_s, started_s = boot + 1, amount, offset_s + mono_s, None
                is_right = False
            beat = restarted(beat, now())
    assert numbers == sorted(set(numbers))
    assert all(later > earlier for earlier, later in pairwise(times))

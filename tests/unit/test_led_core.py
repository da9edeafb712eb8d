"""Bytes, amperes and the lease."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flora_common.clock import NS
from flora_common.messages import LightCommand, Setup, Tick
from flora_common.open_loop import OpenLoopSection
from flora_led.core import BYTES_PER_STRIP, CHAIN_BYTES, DARK, Lease, current_a, lit, shown

LIGHTS = ("dark", "left", "right", "both")
COLOUR = (90, 60, 255)


def chain(left: tuple[int, int, int], right: tuple[int, int, int]) -> bytes:
    """What the driver makes of two colours: green first."""
    return b"".join(bytes((c[1], c[0], c[2])) * 144 for c in (left, right))


@pytest.mark.parametrize("light", LIGHTS)
def test_what_is_shown_is_what_is_read_back(light: str) -> None:
    left, right, scale = shown(light, COLOUR, 8.0)  # type: ignore[arg-type]
    assert lit(chain(left, right)) == light
    assert scale == 1.0
    assert (left == COLOUR, right == COLOUR) == (light in ("left", "both"), light in ("right", "both"))


def test_current_of_full_white_is_the_papers() -> None:
    one_strip_a = current_a(b"\xff" * BYTES_PER_STRIP + bytes(BYTES_PER_STRIP)) - current_a(bytes(CHAIN_BYTES))
    assert one_strip_a == pytest.approx(144 * 0.24 / 5.0)  # 6.9 A
    assert current_a(bytes(CHAIN_BYTES)) == pytest.approx(0.288)


levels = st.integers(0, 255)


@given(st.sampled_from(LIGHTS), st.tuples(levels, levels, levels), st.floats(0.5, 100.0))
def test_the_cap_holds_for_every_colour(light: str, colour: tuple[int, int, int], cap_a: float) -> None:
    left, right, scale = shown(light, colour, cap_a)  # type: ignore[arg-type]
    grb = chain(left, right)
    assert current_a(grb) <= cap_a + 1e-9
    assert 0.0 <= scale <= 1.0
    if scale == 1.0:
        assert {left, right} <= {colour, DARK}
    else:  # no more than rounding is given away
        assert current_a(grb) > cap_a - 2 * 144 * 3 * 0.016 / 255


def command(light: str, at_s: float, tick: int = 1) -> LightCommand:
    return LightCommand(tick=tick, light=light, t_mono_ns=round(at_s * NS))  # type: ignore[arg-type]


def ns(seconds: float) -> int:
    return round(seconds * NS)


def test_a_command_holds_until_its_lease_is_over() -> None:
    lease = Lease(900.0, "dark")
    lease.command(command("left", 100.0), ns(110.0))
    assert lease.wanted(ns(1000.0)).light == "left"
    over = lease.wanted(ns(1000.1))
    assert (over.light, over.commanded, over.fallback, over.tick) == ("dark", "left", True, 1)
    assert "900 s" in over.reason


def test_before_the_first_command_the_fallback_shines() -> None:
    wanted = Lease(900.0, "both").wanted(0)
    assert (wanted.light, wanted.commanded, wanted.fallback, wanted.tick) == ("both", "both", True, 0)


def test_hold_keeps_the_last_light_and_says_that_it_is_old() -> None:
    lease = Lease(900.0, "hold")
    assert lease.wanted(0).light == "dark"
    lease.command(command("right", 0.0), 0)
    wanted = lease.wanted(ns(5000.0))
    assert (wanted.light, wanted.fallback) == ("right", True)


def test_a_command_heard_late_does_not_live_longer() -> None:
    lease = Lease(900.0, "dark")
    lease.command(command("left", 0.0), ns(2000.0))
    assert lease.wanted(ns(2000.0)).fallback


def test_a_command_from_the_future_does_not_live_for_ever() -> None:
    lease = Lease(900.0, "dark")
    lease.command(command("left", 1e8), ns(10.0))
    assert lease.wanted(ns(911.0)).fallback


def test_where_photographs_are_rare_a_command_holds_until_after_the_next() -> None:
    lease = Lease(900.0, "dark")
    for tick in (1, 2):
        lease.beat(Tick(tick=tick, time_s=1800.0 * tick, t_mono_ns=ns(1800.0 * tick)))
    lease.command(command("left", 3600.0, tick=2), ns(3600.0))
    assert lease.until_ns == ns(3600.0 + 2.5 * 1800.0)
    assert lease.wanted(ns(5400.0)).light == "left"
    assert "4500 s" in lease.wanted(ns(9000.0)).reason


@pytest.mark.parametrize(
    "beats",
    [
        [(1, 300.0, 0), (2, 600.0, 0), (9, 2700.0, 0)],  # six were not heard
        [(1, 300.0, 0), (9, 2700.0, 7)],  # seven were left out
        [(1, 0.0, 0), (2, 3600.0, 0), (3, 0.0, 0), (4, 300.0, 0)],  # a run before had one an hour
        [(1, 0.0, 0), (2, 3600.0, 0), (3, 0.0, 0)],
    ],
)
def test_beats_that_were_not_heard_or_are_of_another_run_make_no_lease_longer(
    beats: list[tuple[int, float, int]],
) -> None:
    lease = Lease(900.0, "dark")
    for tick, time_s, skipped in beats:
        lease.beat(Tick(tick=tick, time_s=time_s, skipped=skipped, t_mono_ns=ns(tick * 1.0)))
    lease.command(command("left", 50.0), ns(50.0))
    assert lease.until_ns == ns(950.0)


def test_a_beat_that_came_late_or_was_told_twice_makes_no_lease_shorter() -> None:
    lease = Lease(900.0, "dark")
    for tick, time_s, late_s in (
        (1, 600.0, 0.0),
        (2, 1200.0, 0.0),
        (3, 2090.0, 290.0),
        (3, 2095.0, 295.0),
        (4, 2400.0, 0.0),
    ):
        lease.beat(Tick(tick=tick, time_s=time_s, late_s=late_s, t_mono_ns=ns(time_s)))
    lease.command(command("left", 2400.0, tick=4), ns(2400.0))
    assert lease.until_ns == ns(2400.0 + 2.5 * 600.0)


def test_a_setup_run_goes_before_commands() -> None:
    lease = Lease(900.0, "dark")
    lease.command(command("left", 0.0, tick=4), 0)
    lease.setup(Setup(active=True, step=2, steps=4, lamps="both"))
    wanted = lease.wanted(ns(5000.0))
    assert (wanted.light, wanted.setup_step, wanted.tick, wanted.fallback) == ("both", 2, 0, False)
    lease.setup(Setup(active=False))
    assert (lease.wanted(ns(10.0)).light, lease.wanted(ns(10.0)).tick) == ("left", 4)


def test_the_open_loop_is_that_of_the_run_whose_last_tick_was_heard() -> None:
    lease = Lease(900.0, "open-loop")
    lease.beat(Tick(tick=70, time_s=5.9 * 3600.0, t_mono_ns=ns(100_000.0)))
    assert (lease.wanted(ns(100_000.0)).light, lease.wanted(ns(100_000.0)).fallback) == ("left", True)
    assert lease.wanted(ns(100_000.0 + 0.2 * 3600.0)).light == "right"
    assert lease.wanted(ns(100_000.0 + 6.2 * 3600.0)).light == "left"


def test_a_command_goes_before_the_open_loop_and_a_setup_run_before_both() -> None:
    lease = Lease(900.0, "open-loop", OpenLoopSection(hours=1.0, first="left"))
    lease.command(command("right", 0.0), 0)
    assert lease.wanted(ns(10.0)).light == "right"
    assert lease.wanted(ns(1000.0)).light == "left"
    lease.setup(Setup(active=True, step=1, steps=4, lamps="both"))
    assert lease.wanted(ns(1000.0)).light == "both"


def test_before_the_first_tick_the_open_loop_counts_from_the_start_of_the_clock() -> None:
    lease = Lease(900.0, "open-loop", OpenLoopSection(hours=2.0, first="right"))
    assert [lease.wanted(ns(hours * 3600.0)).light for hours in (0.0, 1.9, 2.1, 4.1)] == [
        "right",
        "right",
        "left",
        "right",
    ]


def test_a_picture_of_the_empty_setup_does_not_move_the_schedule() -> None:
    lease = Lease(900.0, "open-loop")
    lease.beat(Tick(tick=1, time_s=5.0 * 3600.0, t_mono_ns=0))
    lease.beat(Tick(tick=2, time_s=0.0, t_mono_ns=0, purpose="background", shot="left.jpg"))
    assert lease.wanted(ns(2.0 * 3600.0)).light == "right"

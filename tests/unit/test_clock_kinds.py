"""The four clocks: the machine's, a test's, one that follows the bus, one that leads the world."""

from __future__ import annotations

import pytest

from fake_clock import FakeClock
from flora_common.clock import NS, FollowerClock, LeaderClock, SystemClock, unix_seconds


class Real:
    """Real nanoseconds, moved by the test."""

    def __init__(self) -> None:
        self.ns = 1_000

    def __call__(self) -> int:
        return self.ns

    def advance(self, seconds: float) -> None:
        self.ns += round(seconds * NS)


def follower(rate: float) -> tuple[FollowerClock, Real]:
    real = Real()
    return FollowerClock(rate, mono_ns=100 * NS, utc_ns=5000 * NS, real_ns=real), real


def test_lock_step_time_stands_still_between_messages() -> None:
    clock, real = follower(0.0)
    real.advance(3600)
    assert (clock.mono_ns(), clock.utc_ns()) == (100 * NS, 5000 * NS)
    clock.observe(400 * NS, 5300 * NS)
    assert (clock.mono_ns(), clock.utc_ns()) == (400 * NS, 5300 * NS)
    assert clock.real_s_until(10_000 * NS) == 0.0


def test_time_runs_on_at_the_worlds_rate() -> None:
    clock, real = follower(60.0)
    real.advance(2.0)
    assert clock.mono_ns() == 220 * NS
    assert clock.utc_ns() == 5120 * NS
    assert clock.real_s_until(340 * NS) == pytest.approx(2.0)
    assert clock.real_s_until(0) == 0.0


@pytest.mark.parametrize("rate", [0.0, 60.0])
def test_a_follower_never_goes_back(rate: float) -> None:
    clock, real = follower(rate)
    real.advance(1.0)
    before = clock.mono_ns()
    clock.observe(50 * NS, 1 * NS)
    assert clock.mono_ns() == before
    clock.move_to(10_000 * NS)
    assert clock.mono_ns() == before


def test_the_leader_asks_the_world_to_move_on() -> None:
    asked: list[float] = []

    def wait(until_s: float) -> tuple[int, int]:
        asked.append(until_s)
        return round(until_s * NS), 9000 * NS

    clock = LeaderClock(0.0, wait, mono_ns=0, utc_ns=0)
    clock.move_to(300 * NS)
    assert asked == [300.0]
    assert (clock.mono_ns(), clock.utc_ns()) == (300 * NS, 9000 * NS)


def test_fake_clock_moves_only_by_hand_and_utc_can_jump() -> None:
    clock = FakeClock()
    clock.observe(10**15, 10**15)
    assert clock.mono_ns() == 0
    clock.advance(1.5)
    clock.jump_utc(-3600.0)
    assert clock.mono_ns() == round(1.5 * NS)
    assert clock.utc_ns() == 1_700_000_000 * NS + round(1.5 * NS) - 3600 * NS
    assert clock.real_s_until(4 * NS) == 2.5
    clock.move_to(4 * NS)
    assert clock.mono_ns() == 4 * NS


def test_system_clock_goes_forward_and_ignores_the_bus() -> None:
    clock = SystemClock()
    first = clock.mono_ns()
    clock.observe(2**62, 2**62)
    clock.move_to(2**62)
    second = clock.mono_ns()
    assert first <= second < first + 60 * NS
    assert clock.real_s_until(second + 2 * NS) <= 2.0
    assert clock.real_s_until(first) == 0.0


@pytest.mark.parametrize(
    ("utc_ns", "text"),
    [(0, b"0.000000"), (1_732_105_956_123_456_789, b"1732105956.123456"), (1_000_000_001, b"1.000000")],
)
def test_unix_seconds_are_decimal_text(utc_ns: int, text: bytes) -> None:
    assert unix_seconds(utc_ns) == text

"""Swings among noise of the track's own making: found, with periods that hold, and in noise alone hardly ever."""

from __future__ import annotations

import numpy as np
import pytest
from rhythm_tracks import forgetting, noise, swing, tip

from flora_lab.rhythm.cycles import cycles
from flora_lab.rhythm.judgement import cannot_tell, judge, said
from flora_lab.rhythm.lattice import drawn, lattice, periodogram
from flora_lab.rhythm.search import LEVEL, find

FEW = 59
"""Records of noise, so that the test is quick: 3 of 60 are 5 %."""


def everywhere(steps: int) -> np.ndarray:
    return np.ones(steps, dtype=bool)


def test_what_is_expected_of_noise_is_what_drawn_noise_has() -> None:
    grid = lattice(160)
    rng = np.random.default_rng(3)
    for k in (0, 5, len(grid.noise) // 2, len(grid.noise) - 1):
        records = drawn(np.broadcast_to(grid.noises[k], (3000, len(grid.fine))), 160, rng)
        assert periodogram(records).mean(axis=0) == pytest.approx(grid.noise[k], rel=0.12)


@pytest.mark.parametrize("cases", [60, pytest.param(200, marks=pytest.mark.slow)])
def test_noise_alone_is_called_a_swing_about_as_rarely_as_stated(cases: int) -> None:
    alarms = 0
    for seed in range(cases):
        rng = np.random.default_rng(7000 + seed)
        steps = (100, 140, 180)[seed % 3]
        found = find(noise(rng, steps, seed), known=everywhere(steps), seed=seed, count=FEW)
        alarms += found.p <= LEVEL
    assert 0.01 * cases <= alarms <= 0.10 * cases


@pytest.mark.parametrize("cases", [30, pytest.param(50, marks=pytest.mark.slow)])
def test_swings_are_found_and_their_intervals_hold(cases: int) -> None:
    claimed, held, sizes_held, wrong_by = 0, 0, 0, []
    for seed in range(cases):
        rng = np.random.default_rng(400 + seed)
        steps = int(rng.integers(150, 260))
        period = float(np.exp(rng.uniform(np.log(12.0), np.log(steps / 4.0))))
        size = float(rng.uniform(0.7, 3.0))
        drift = (0.0, 0.03, 0.06)[seed % 3]
        values = swing(rng, steps, period, size, drift) + 0.5 * forgetting(rng, steps, steps / 4.0)
        values = values + 0.05 * rng.standard_normal(steps)
        found = find(values, known=everywhere(steps), seed=seed, count=FEW)
        if found.p > LEVEL:
            continue
        claimed += 1
        held += found.low_per_sample <= 1.0 / period <= found.high_per_sample
        wrong_by.append(abs(found.per_sample * period - 1.0))
        low, high = cycles(values, everywhere(steps), found).amplitude_interval
        sizes_held += low <= size <= high
    assert claimed >= 0.9 * cases
    assert held >= 0.85 * claimed
    assert sizes_held >= 0.7 * claimed
    assert np.median(wrong_by) < 0.04


def test_a_swing_that_grows_is_told_from_one_that_does_not() -> None:
    rng = np.random.default_rng(5)
    steps, period = 300, 30.0
    steady = swing(rng, steps, period, 1.0, 0.0) + 0.03 * rng.standard_normal(steps)
    growing = steady * np.exp(np.linspace(-1.5, 1.5, steps))
    for values, grows in ((steady, False), (growing, True)):
        judged = judge(tip(values))
        assert judged.swings
        assert any(line.startswith("it grows") for line in said(judged)) is grows
    assert judged.cycles.growth_per_cycle == pytest.approx(np.exp(3.0 * period / steps), rel=0.1)


def test_peaks_and_cycles_are_where_they_are() -> None:
    steps, period = 240, 40.0
    rng = np.random.default_rng(1)
    values = np.cos(2.0 * np.pi * (np.arange(steps) - 25.0) / period) + 0.02 * rng.standard_normal(steps)
    judged = judge(tip(values))
    assert judged.cycles.peaks == pytest.approx([25.0, 65.0, 105.0, 145.0, 185.0], abs=1.0)
    assert judged.cycles.clear_periods == pytest.approx([period] * 4, abs=1.0)
    assert judged.cycles.amplitude == pytest.approx(1.0, rel=0.1)


def test_gaps_do_not_hide_a_swing() -> None:
    rng = np.random.default_rng(8)
    values = swing(rng, 240, 24.0, 1.0, 0.02) + 0.1 * forgetting(rng, 240, 40.0)
    known = rng.uniform(size=240) > 0.2
    at = np.arange(240)
    bridged = np.interp(at, at[known], values[known])
    found = find(bridged, known=known, count=FEW)
    assert found.p <= LEVEL
    assert found.low_per_sample < 1.0 / 24.0 < found.high_per_sample


def test_no_swing_is_said_to_be_none_and_where_it_was_looked_for() -> None:
    judged = judge(tip(forgetting(np.random.default_rng(2), 200, 20.0)))
    assert not judged.swings
    assert said(judged)[0].startswith("no swing of 8 to 80 frames")


def test_lamps_that_alternate_with_the_swing_are_told() -> None:
    rng = np.random.default_rng(4)
    values = swing(rng, 240, 40.0, 1.0, 0.0) + 0.05 * rng.standard_normal(240)
    with_it = np.where(np.arange(240) % 40 < 20, 1.0, -1.0)
    slower = np.where(np.arange(240) % 200 < 100, 1.0, -1.0)
    assert "the lamps alternate with this period too" in cannot_tell(judge(tip(values, right_share=with_it)))[0]
    assert not any("lamps alternate" in line for line in cannot_tell(judge(tip(values, right_share=slower))))
    assert "nothing is known of them" in cannot_tell(judge(tip(values)))[0]


def test_what_a_bare_tip_leaves_open_is_said() -> None:
    rng = np.random.default_rng(6)
    x = swing(rng, 200, 50.0, 1.0, 0.0) + 0.02 * rng.standard_normal(200)
    judged = judge(tip(x, -0.3 * x**2 + 0.002 * rng.standard_normal(200)))
    told = "\n".join(cannot_tell(judged))
    for word in ("hours:", "--px-per-cm", "camera", "growth, stiffening", "4.0 cycles"):
        assert word in told
    assert "half as long" in "\n".join(said(judged))

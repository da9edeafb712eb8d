"""Swings of the tip: found where there are some, in noise alone hardly ever, and not where lamps make the tip swing."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from diagnose_runs import red_noise
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_common.arrays import Array
from flora_lab.diagnose.explanation import FIRST, THIRD
from flora_lab.diagnose.rhythm import (
    BAND_H,
    Spectrum,
    Swing,
    Swings,
    best_swing,
    improbability,
    is_plausible,
    spectrum,
    usual,
)

STEP_H = 1 / 12
STEPS = 48 * 12
NOISE_SEEDS = range(1000, 1009)
TIME_H = np.arange(STEPS) * STEP_H


def noise(seed: int) -> Array:
    """What is left of a tip where nothing swings: slow errors, and those of measuring."""
    rng = np.random.default_rng(seed)
    return 0.25 * red_noise(rng, STEPS, 6.0) + 0.04 * red_noise(rng, STEPS, 1.0) + 0.02 * rng.standard_normal(STEPS)


def none_moves() -> Spectrum:
    return spectrum(0.0 * noise(1) + 1e-3 * np.random.default_rng(0).standard_normal(STEPS), STEP_H)


@functools.cache
def healthy() -> Swings:
    return usual([spectrum(noise(seed), STEP_H) for seed in NOISE_SEEDS], [none_moves()] * len(NOISE_SEEDS))


def looked(runs: list[Array]) -> Swing:
    left = [spectrum(run, STEP_H) for run in runs]
    return best_swing(left, [healthy().expectations(none_moves())] * len(left))


@pytest.mark.parametrize(("period_h", "amplitude_cm"), [(1.3, 0.3), (1.64, 0.3), (1.64, 1.5), (2.0, 0.5), (2.45, 0.6)])
def test_a_swing_is_found_with_period_and_amplitude(period_h: float, amplitude_cm: float) -> None:
    runs = [noise(seed) + amplitude_cm * np.sin(2.0 * np.pi * TIME_H / period_h + seed) for seed in (1, 2)]
    found = looked(runs)
    assert found.evidence > THIRD
    assert is_plausible(found)
    assert found.period_h == pytest.approx(period_h, rel=0.03)
    assert found.amplitude_cm == pytest.approx(amplitude_cm, rel=0.2)
    low, high = found.amplitude_interval_cm
    assert 0.0 <= low < found.amplitude_cm < high
    assert found.period_interval_h[0] <= found.period_h <= found.period_interval_h[1]


@pytest.mark.parametrize("seed", [1, 11, 21])
def test_a_faint_swing_is_believed_of_several_runs_and_a_plain_one_of_one_among_them(seed: int) -> None:
    """Some plants waver more than others: what one of three shows alone takes more."""

    def evidence(*amplitudes_cm: float) -> float:
        swings = (a * np.sin(2.0 * np.pi * TIME_H / 1.64 + seed + k) for k, a in enumerate(amplitudes_cm))
        return looked([noise(seed + k) + swing for k, swing in enumerate(swings)]).evidence

    assert evidence(0.06, 0.0, 0.0) < FIRST < evidence(0.06, 0.06, 0.06)
    assert evidence(0.3, 0.0, 0.0) > FIRST


def test_a_swing_whose_phase_drifts_is_found_too() -> None:
    runs = []
    for seed in (3, 4, 5):
        rng = np.random.default_rng(seed)
        drift = np.cumsum(rng.normal(0.0, np.sqrt(2.0 * STEP_H / 12.0), STEPS))
        runs.append(noise(seed) + 0.5 * np.sin(2.0 * np.pi * TIME_H / 1.8 + drift))
    found = looked(runs)
    assert found.evidence > THIRD
    assert found.period_h == pytest.approx(1.8, rel=0.05)
    assert found.amplitude_cm == pytest.approx(0.5, rel=0.3)


def test_noise_alone_hardly_ever_swings() -> None:
    """Forty times two runs: three claims would be rare (1 in 20) even if one in 50 were made."""
    claims = 0
    for seed in range(40):
        found = looked([noise(2 * seed), noise(2 * seed + 1)])
        claims += found.evidence > FIRST and is_plausible(found)
    assert claims <= 2


def test_a_tip_that_lamps_make_swing_is_no_swing() -> None:
    """A law that is wrong by a fifth leaves a fifth of what lamps do every two hours; reference runs tell that."""
    lamps = np.where(TIME_H // 1.0 % 2 == 0, 1.0, -1.0)
    tip = np.convolve(lamps, np.exp(-np.arange(24) / 8.0), mode="same")
    tip = 1.5 * tip / np.abs(tip).max()
    moved = spectrum(tip, STEP_H)
    wrong = np.random.default_rng(5).uniform(0.7, 1.3, 12)
    left = [spectrum(noise(seed) + 0.2 * share * tip, STEP_H) for seed, share in zip(range(12), wrong, strict=True)]
    swings = usual(left[:10], [moved] * 10)
    assert 0.5 * 0.2**2 < swings.follows < 2.0 * 0.2**2  # of the power; tried in steps of a half
    forewarned = best_swing(left[10:], [swings.expectations(moved)] * 2)
    naive = best_swing(left[10:], [healthy().expectations(none_moves())] * 2)
    assert naive.evidence > THIRD
    assert naive.period_h == pytest.approx(2.0, rel=0.03)
    assert forewarned.evidence < FIRST
    assert healthy().expected(none_moves()).max() < 2.0 * healthy().power.max()


def test_a_spectrum_is_of_the_power_that_is_there() -> None:
    for amplitude, period_h in ((0.5, 1.5), (1.0, 2.2)):
        swing = spectrum(amplitude * np.sin(2.0 * np.pi * TIME_H / period_h), STEP_H)
        spacing = swing.per_hour[1] - swing.per_hour[0]
        assert 4.0 * swing.power.sum() * spacing == pytest.approx(amplitude**2, rel=0.1)
        assert 1.0 / swing.per_hour[np.argmax(swing.power)] == pytest.approx(period_h, rel=0.04)
    white = spectrum(0.1 * np.random.default_rng(4).standard_normal(20 * STEPS), STEP_H)
    fast = white.per_hour > 0.6
    assert white.power[fast].mean() == pytest.approx(0.1**2 * STEP_H, rel=0.1)
    assert white.per_hour.min() >= 1.0 / BAND_H[1]
    assert white.per_hour.max() <= 1.0 / BAND_H[0]


def test_slow_errors_do_not_leak_into_the_band() -> None:
    """A tip that goes to one side by 5 cm, and back: 1000 times the power of a swing of 3 mm."""
    there_and_back = 5.0 * np.sin(np.pi * TIME_H / TIME_H[-1])
    assert spectrum(there_and_back, STEP_H).power.max() < 0.1 * spectrum(0.3 * np.sin(4.0 * TIME_H), STEP_H).power.max()


def test_gaps_are_bridged() -> None:
    run = noise(1) + 0.6 * np.sin(2.0 * np.pi * TIME_H / 1.7)
    run[100:130] = np.nan
    run[:3] = run[-5:] = np.nan
    found = looked([run])
    assert found.period_h == pytest.approx(1.7, rel=0.03)
    assert found.amplitude_cm == pytest.approx(0.6, rel=0.25)


@settings(max_examples=20, deadline=None)
@given(st.integers(30, 120), st.integers(0, 2**31))
def test_short_runs_have_a_spectrum(rows: int, seed: int) -> None:
    own = spectrum(np.random.default_rng(seed).standard_normal(rows), STEP_H)
    assert own.per_hour.shape == own.power.shape
    assert np.isfinite(own.power).all()
    assert own.hours == rows * STEP_H


def test_what_is_expected_is_what_makes_spectra_most_probable() -> None:
    own, wanted = spectrum(noise(7), STEP_H), healthy().expected(none_moves())
    assert (wanted > 0.0).all()
    assert improbability(own, wanted) < min(improbability(own, 5.0 * wanted), improbability(own, 0.2 * wanted))


@pytest.mark.parametrize(
    ("period_h", "amplitude_cm", "wanted"),
    [(1.64, 0.5, True), (1.11, 0.5, False), (2.79, 0.5, False), (1.64, 0.01, False)],
)
def test_a_swing_at_the_edge_or_of_no_size_is_none(period_h: float, amplitude_cm: float, wanted: bool) -> None:
    assert is_plausible(Swing(period_h, amplitude_cm, 6.0, 99.0, (1.0, 3.0), (0.0, 1.0))) == wanted


def test_of_a_swing_across_a_leaning_tip_only_a_part_is_sideways() -> None:
    spectra = [spectrum(noise(seed) + 0.5 * np.sin(2.0 * np.pi * TIME_H / 1.64 + seed), STEP_H) for seed in (1, 2, 3)]
    expectations = [healthy().expectations(none_moves())] * 3
    upright, leaning = (best_swing(spectra, expectations, share) for share in (None, [0.64] * 3))
    assert leaning.amplitude_cm == pytest.approx(upright.amplitude_cm / 0.8)
    assert leaning.period_h == upright.period_h


@pytest.mark.parametrize("period_h", [1.4, 1.66, 2.3])
def test_a_swing_is_told_from_what_else_is_wrong_in_all_of_the_band(period_h: float) -> None:
    """A lamp that follows the tip switches with it: overtones, and errors of many times the usual size everywhere."""
    runs = []
    for seed in (1, 2, 3):
        turn = 2.0 * np.pi * TIME_H / period_h + seed
        runs.append(6.0 * noise(seed) + 0.9 * np.sin(turn) + 0.3 * np.sin(2.0 * turn))
    found = looked(runs)
    assert found.evidence > THIRD
    assert found.period_h == pytest.approx(period_h, rel=0.02)
    alone = looked([6.0 * noise(seed) for seed in (1, 2, 3)])
    assert alone.evidence < FIRST

"""What the lamps of the hours before tell of a simulator's errors, where it forgets them and where nobody remembers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnose_runs import red_noise, turns
from simulator_fakes import Forgetful, half_as_often

from flora_common.arrays import FloatArray
from flora_lab.diagnose.forgotten import forgotten
from flora_lab.simulator.interface import Covariates
from flora_lab.simulator.measured import MeasuredRun

STEP_S = 300.0
FIRST_CM, GROWTH_CM_H = 8.0, 0.08
ALONG = np.linspace(0.0, 1.0, 10) ** 2
BACK_PER_H, AWAY_CM_H = 0.15, 0.8


class Forgets(Forgetful):
    """The tip goes to the lit lamp and back to the middle, at once and for ever alike."""

    def step(
        self, state: FloatArray, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[FloatArray, FloatArray]:
        hours = dt_s / 3600.0
        after = state.copy()
        pull = AWAY_CM_H * (light[:, 1] - light[:, 0])[:, None] - BACK_PER_H * state[:, -1:, 0]
        after[..., 0] += hours * ALONG * pull
        return after, after


def plant(seed: int, *, memory_h: float, hours: float = 72.0, wander: float = 0.4, turns_h: float = 6.0) -> MeasuredRun:
    """A run of a plant that goes as :class:`Forgets` says, but by the light that it remembers, and by chance besides.

    Args:
        seed: of chance.
        memory_h: time constant of what it remembers; 0 for nothing.
        hours: of the run.
        wander: of the drive that comes by chance and lasts for hours, cm/h.
        turns_h: how long a lamp shines.
    """
    rng = np.random.default_rng([seed, 5])
    light = turns(hours, turns_h, "left" if seed % 2 else "right")
    besides = wander * red_noise(rng, len(light), 5.0)
    kept = np.exp(-STEP_S / 3600.0 / memory_h) if memory_h else 0.0
    tip_cm, seen, tips = 0.0, 0.0, [0.0]
    for side, chance in zip(light[:, 1] - light[:, 0], besides, strict=True):
        seen = kept * seen + (1.0 - kept) * side
        tip_cm += STEP_S / 3600.0 * (AWAY_CM_H * seen - BACK_PER_H * tip_cm + chance)
        tips.append(tip_cm)
    time_s = np.arange(len(tips)) * STEP_S
    heights_cm = np.linspace(0.0, 1.0, 10) * (FIRST_CM + GROWTH_CM_H * time_s[:, None] / 3600.0)
    points = np.stack([ALONG * np.array(tips)[:, None], heights_cm], axis=-1)
    points[:, 1:] += 0.05 * rng.standard_normal((len(tips), 9, 2))
    return MeasuredRun(f"bean{seed}", f"bean{seed}", "0" * 64, points, light, time_s, STEP_S, {})


def plants(seed: int, **how: Any) -> list[MeasuredRun]:
    return [plant(3 * seed + i, **how) for i in range(3)]


@pytest.mark.parametrize("memory_h", [0.5, 1.0, 3.0])
def test_what_plants_remember_and_a_simulator_forgets_is_found(memory_h: float) -> None:
    found = [forgotten(Forgets(), plants(seed, memory_h=memory_h)) for seed in range(10)]
    assert sum(one is not None and one.p_value <= 0.01 for one in found) >= 9
    if memory_h <= 1.0:  # what lasts for longer is partly taken for a slow course
        held = [one is not None and one.interval_h[0] < memory_h < one.interval_h[1] for one in found]
        assert sum(held) >= 8
    assert all(one is not None and 0.0 < one.by_chance < one.share < 1.0 for one in found)


def test_where_nobody_remembers_nothing_is_told() -> None:
    """A plant's chance lasts for hours, and measuring makes each step go back: neither is a memory of lamps."""
    p_values = [one.p_value for seed in range(30) if (one := forgotten(Forgets(), plants(seed, memory_h=0.0)))]
    assert len(p_values) == 30
    assert sum(p <= 0.01 for p in p_values) <= 1
    assert sum(p <= 0.1 for p in p_values) <= 7
    assert 0.3 < np.median(p_values) < 0.7


def test_rows_of_other_steps_and_gaps_tell_the_same() -> None:
    whole = plants(1, memory_h=1.0)
    for run in whole:
        run.points_cm[100:130] = np.nan
    often, seldom = (forgotten(Forgets(), runs) for runs in (whole, [half_as_often(run) for run in whole]))
    assert often is not None
    assert seldom is not None
    assert seldom.share == pytest.approx(often.share, abs=0.1)
    assert seldom.p_value <= 0.01


def test_of_a_lamp_that_stays_or_a_day_nothing_can_be_told() -> None:
    assert forgotten(Forgets(), plants(1, memory_h=1.0, turns_h=1000.0)) is None
    assert forgotten(Forgets(), [plant(1, memory_h=1.0, hours=24.0)]) is None
    assert forgotten(Forgets(), plants(1, memory_h=1.0, hours=12.0)) is None
    assert forgotten(Forgets(), [plant(1, memory_h=1.0)]) is not None


def test_rounding_decides_nothing() -> None:
    """Draws whose signs are all alike leave the errors as they are, to rounding."""
    runs = plants(0, memory_h=1.0, hours=24.0)
    other = [replace(run, points_cm=run.points_cm * (1.0 + 1e-13)) for run in runs]
    one, two = (forgotten(Forgets(), some) for some in (runs, other))
    assert one is not None
    assert two is not None
    assert (one.p_value, one.time_constant_h) == (two.p_value, two.time_constant_h)
    assert one.share == pytest.approx(two.share, rel=1e-6)

"""A stem under its own weight bends, within minutes, until the bend is that of the shape that it has."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.simulator.law import Stems, standing
from flora_lab.simulator.rod import CAPACITY, jit
from flora_lab.simulator.sag import SETTLING_H, SOFTNESS_CM, elastic_bends
from flora_lab.simulator.terms import NEUTRAL, PUSH, SAG, WIND, Driven, ExtendedLaw, Seen
from flora_lab.simulator.terms import SETTLING_H as SETTLING_TERM
from flora_lab.simulator.tropism_traits import NAMES, prior_mean

STEP_H = 1.0 / 12.0
LAW = ExtendedLaw(LampsSection())


@jit
def bends(length: Array, angle: Array, n: int, sag: float, wind: float, out: Array) -> None:
    elastic_bends(length, angle, n, sag, wind, SOFTNESS_CM, out)


def elastic(stems: Stems, sag: float, wind: float = 0.0) -> Array:
    """Angles that a load gives a stem of this shape, rad, foot to tip."""
    n, out = int(stems.count[0]), np.zeros(CAPACITY)
    bends(stems.length[0], stems.angle[0], n, sag, wind, out)
    return np.cumsum(out[:n])


def pushed(
    sag: float,
    hours: float = 12.0,
    *,
    wind: float = 0.0,
    push: float = 0.004,
    growth_cm_per_day: float = 1e-4,
    settling_h: float = SETTLING_H,
    stems: Stems | None = None,
) -> Stems:
    """A stem that feels nothing, bent to the right by a steady push; upright, and hardly growing, if not told."""
    traits = prior_mean().copy()
    for name in ("growth_early_cm_per_day", "growth_late_cm_per_day"):
        traits[NAMES.index(name)] = np.log(growth_cm_per_day)
    for name in ("graviception_per_cm_h", "photoception_per_cm_h", "proprioception_per_h"):
        traits[NAMES.index(name)] = np.log(1e-9)
    terms = NEUTRAL.copy()
    terms[PUSH], terms[SAG], terms[SETTLING_TERM], terms[WIND] = push, sag, settling_h, wind
    stems = stems or standing(LAW, (np.linspace(0.0, 18.0, 10)[:, None] * np.array([0.0, 1.0]))[None])
    still = np.zeros((round(hours / STEP_H), 1))
    driven = Driven(np.zeros((len(still), 1, 2)), still, still, still + 1.0, still + 1.0, still)
    out = np.empty((len(still), 1, 10, 2))
    LAW.advance_with(stems, traits[None], terms[None], driven, Seen(still, np.ones(1)), STEP_H, 1, out)
    return stems


@pytest.mark.parametrize("sag", [0.002, 0.01, 0.015])
def test_a_stem_comes_to_rest_in_the_bend_of_its_own_shape(sag: float) -> None:
    """Also where weight bends it much farther than growth has: what the bend adds to itself is counted."""
    light, heavy = pushed(0.0), pushed(sag)
    n = int(light.count[0])
    assert heavy.count[0] == n
    by_weight = heavy.angle[0, :n] - light.angle[0, :n]
    assert by_weight[-1] > 0.0
    assert by_weight == pytest.approx(elastic(heavy, sag), rel=0.02, abs=1e-3)


def test_what_the_bend_adds_to_itself_is_much() -> None:
    light, heavy = pushed(0.0), pushed(0.015)
    n = int(light.count[0])
    assert heavy.angle[0, n - 1] - light.angle[0, n - 1] > 1.3 * elastic(light, 0.015)[-1]


def test_it_is_softest_at_the_tip() -> None:
    stems = pushed(0.0)
    n, out = int(stems.count[0]), np.zeros(CAPACITY)
    straight = np.full(CAPACITY, 0.3)
    bends(stems.length[0], straight, n, 1e-3, 0.0, out)
    above_cm = 18.0 - np.cumsum(stems.length[0, :n]) + stems.length[0, :n]
    # A straight stem that leans: the moment of what is above goes with the square of its length.
    share = out[1:n] / (above_cm[1:] ** 2 * np.exp(-above_cm[1:] / SOFTNESS_CM))
    assert share == pytest.approx(np.full(n - 1, share[0]), rel=0.02)


def test_what_grows_and_is_cut_in_two_sags_no_less() -> None:
    """Joints before and after a segment is cut are others; what weight has bent stays bent."""
    light, heavy = (pushed(sag, 24.0, growth_cm_per_day=6.0, push=0.002) for sag in (0.0, 0.01))
    n = int(light.count[0])
    assert n == heavy.count[0] >= pushed(0.0).count[0] + 5
    by_weight = heavy.angle[0, :n] - light.angle[0, :n]
    assert by_weight[-1] > 0.1
    assert by_weight == pytest.approx(elastic(heavy, 0.01), rel=0.02, abs=2e-3)


@pytest.mark.parametrize("settling_h", [0.05, 0.2])
def test_a_bend_is_come_to_with_its_time_constant(settling_h: float) -> None:
    """One that adds little to itself: what is left of it falls e-fold."""
    bent = pushed(1e-4)
    bent.memory[:] = 0.0
    straight = bent.copy()
    by_growth = float(straight.angle[0, int(straight.count[0]) - 1])

    def tip_rad(hours: float, sag: float) -> float:
        # At rest with next to no weight, so that the bend that is remembered is none.
        stems = pushed(1e-9, STEP_H, push=0.0, settling_h=settling_h, stems=straight.copy())
        now = pushed(sag, hours, push=0.0, settling_h=settling_h, stems=stems)
        return float(now.angle[0, int(now.count[0]) - 1]) - by_growth

    whole = tip_rad(24.0 * settling_h, 1e-4)
    left = [1.0 - tip_rad(steps * STEP_H, 1e-4) / whole for steps in (1, 2)]
    expected = np.exp(-np.array([1, 2]) * STEP_H / settling_h)
    assert left == pytest.approx(expected, rel=0.1, abs=0.01)


def test_a_stem_that_another_one_s_bends_are_remembered_of_is_at_rest() -> None:
    """Where a record begins anew, the stem is what was measured there, and what was remembered was of another one."""
    bent, other = pushed(0.01), pushed(0.0, push=0.006)
    swapped = Stems(other.length.copy(), other.angle.copy(), other.count.copy(), bent.memory.copy())
    fresh = Stems(other.length.copy(), other.angle.copy(), other.count.copy(), np.zeros_like(bent.memory))
    after = [pushed(0.01, 1.0, push=0.0, stems=stems).angle[0] for stems in (swapped, fresh)]
    assert after[0].tobytes() == after[1].tobytes()
    assert after[0][:20] == pytest.approx(other.angle[0][:20], abs=0.02)


@pytest.mark.parametrize("wind", [-0.002, 0.001, 0.002])
def test_wind_that_rises_bends_a_stem_to_its_side_until_the_bend_is_that_of_its_shape(wind: float) -> None:
    calm = pushed(1e-9, push=0.0)
    upright = calm.angle[0].copy()
    blown = pushed(1e-9, wind=wind, push=0.0, stems=calm)
    n = int(blown.count[0])
    by_wind = blown.angle[0, :n] - upright[:n]
    assert np.sign(by_wind[-1]) == np.sign(wind)
    assert by_wind == pytest.approx(elastic(blown, 0.0, wind), rel=0.02, abs=1e-3)


def test_a_stem_that_is_found_in_the_wind_stands_as_that_bends_it_and_more_as_it_grows() -> None:
    seedling = np.linspace(0.0, 6.0, 10)[:, None] * np.array([0.0, 1.0])
    found, grown = (
        pushed(0.0, wind=0.001, push=0.0, growth_cm_per_day=rate, hours=48.0, stems=standing(LAW, seedling[None]))
        for rate in (1e-4, 6.0)
    )
    assert np.abs(found.angle[0, : found.count[0]]).max() < 1e-3
    assert grown.angle[0, grown.count[0] - 1] > 0.05


def test_the_moment_of_wind_is_that_of_all_that_stands_above() -> None:
    """Of an upright stem: the load on each cm, times how far above the joint it acts."""
    stems, wind = pushed(0.0, push=0.0), 1e-4
    n, out = int(stems.count[0]), np.zeros(CAPACITY)
    length = stems.length[0]
    bends(length, np.zeros(CAPACITY), n, 0.0, wind, out)
    top_cm = float(length[:n].sum())
    foot_cm = np.cumsum(length[:n]) - length[:n]
    by_height = out[:n] / np.exp(-(top_cm - foot_cm - 0.5 * length[:n]) / SOFTNESS_CM)
    whole = slice(1, n - 1)  # the ends' joints stand for half a segment
    expected = wind * length[:n] * 0.5 * (top_cm - foot_cm) ** 2
    assert by_height[whole] == pytest.approx(expected[whole], rel=0.15)


def test_weight_and_wind_together_bend_as_far_as_both() -> None:
    stems = pushed(0.0)
    both, by_weight, by_wind = (elastic(stems, sag, wind) for sag, wind in ((1e-3, 1e-3), (1e-3, 0.0), (0.0, 1e-3)))
    assert both == pytest.approx(by_weight + by_wind)

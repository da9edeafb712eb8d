"""The growing rod and the law of tropisms: kinematics, symmetry, and cases that can be worked out on paper."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from flora_common.arrays import Array
from flora_common.geometry import resample_by_height
from flora_common.runs import LampsSection
from flora_lab.simulator.law import Stems, advanced, standing
from flora_lab.simulator.rod import CAPACITY, LONG_SEGMENT_CM, along, elongate, jit, length_of, points_lane, split
from flora_lab.simulator.shape import points_of, rods_through
from flora_lab.simulator.tropism import LIGHT_HALF, TropismLaw
from flora_lab.simulator.tropism_traits import NAMES, prior_mean
from flora_twin.runs import dataset_runs

numba.set_num_threads(1)


STEP_H = 1.0 / 12.0
LAMPS = LampsSection(35.0, 30.0)
LAW = TropismLaw(LAMPS)
DARK, LEFT, RIGHT, BOTH = (0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)
NEVER = 1e-9  # of a constant that is left out
SOFT = {"stiffening_cm": 1e9, "mature_cm": 1e9}
STILL = {"growth_early_cm_per_day": NEVER, "growth_late_cm_per_day": NEVER}
ALONE = {
    "photoception_per_cm_h": NEVER,
    "graviception_per_cm_h": NEVER,
    "proprioception_per_h": NEVER,
    "photo_latency_min": NEVER,
}


def traits(**constants: float) -> Array:
    """Of one plant: typical but for some constants, shape (1, 9)."""
    values = dict(zip(NAMES, np.exp(prior_mean()), strict=True))
    assert set(constants) <= set(values)
    return np.log([[float({**values, **constants}[name]) for name in NAMES]])


def chain(angles: npt.ArrayLike, segment_cm: float = 0.1) -> Stems:
    """A stem of equal segments."""
    told = np.asarray(angles, dtype=np.float64)
    length, angle = np.zeros((1, CAPACITY)), np.zeros((1, CAPACITY))
    length[0, : len(told)], angle[0, : len(told)] = segment_cm, told
    return Stems(length, angle, np.array([len(told)]), np.zeros((1, *LAW.memory_shape)))


def after(
    stems: Stems, steps: int, light: tuple[float, float], *, bias: float = 0.0, growth: float = 1.0, **constants: float
) -> Stems:
    """A stem after steps of five minutes."""
    levels = np.tile(light, (steps, 1, 1)).astype(np.float64)
    pushes, shares = np.full((steps, 1), bias), np.full((steps, 1), growth)
    return advanced(LAW, stems, traits(**constants), levels, pushes, shares, STEP_H)


def tip_angle(stems: Stems) -> float:
    return float(stems.angle[0, stems.count[0] - 1])


# Kinematics


@st.composite
def rods(draw: st.DrawFn) -> tuple[Array, Array, int]:
    """Lengths and angles (CAPACITY,) of a rod, and its number of segments."""
    n = draw(st.integers(2, CAPACITY))
    length, angle = np.zeros(CAPACITY), np.zeros(CAPACITY)
    length[:n] = draw(arrays(np.float64, n, elements=st.floats(0.01, 1.5)))
    bends = draw(arrays(np.float64, n, elements=st.floats(-0.4, 0.4)))
    angle[:n] = np.cumsum(bends)
    return length, angle, n


def corners(length: Array, angle: Array, n: int) -> Array:
    """Of the chain, shape (n + 1, 2)."""
    steps = length[:n, None] * np.stack([np.sin(angle[:n]), np.cos(angle[:n])], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


@jit
def grow(length: Array, n: int, zone_cm: float, grown_cm: float) -> None:
    arc, reach = np.empty(CAPACITY), np.empty(CAPACITY)
    total_cm = along(length, n, arc, reach)
    elongate(length, n, arc, total_cm, zone_cm, grown_cm)


@settings(deadline=None, max_examples=80)
@given(rods(), st.floats(0.0, 1.0), st.floats(0.5, 12.0))
def test_a_stem_grows_by_what_is_asked_for_and_only_below_its_tip(
    rod: tuple[Array, Array, int], grown_cm: float, zone_cm: float
) -> None:
    length, _, n = rod
    before, total_cm = length.copy(), float(length.sum())
    from_tip_cm = np.concatenate([np.cumsum(before[:n][::-1])[::-1], [0.0]])
    assert length_of(length, n) == pytest.approx(total_cm)
    grow(length, n, zone_cm, grown_cm)
    assert length.sum() - total_cm == pytest.approx(grown_cm, abs=1e-9)
    assert (length >= before).all()
    assert (length[n:] == 0.0).all()
    middle_cm = 0.5 * (from_tip_cm[:-1] + from_tip_cm[1:])
    if (middle_cm < zone_cm).any():
        assert (length - before)[:n][middle_cm > zone_cm + 6.0].sum() <= 1e-3 * grown_cm


@settings(deadline=None, max_examples=80)
@given(rods())
def test_joints_stand_for_all_of_a_stem_but_half_of_its_last_segment(rod: tuple[Array, Array, int]) -> None:
    length, _, n = rod
    arc, reach = np.full(CAPACITY, np.nan), np.full(CAPACITY, np.nan)
    total_cm = along(length, n, arc, reach)
    assert total_cm == length_of(length, n)
    assert arc[:n] == pytest.approx(np.cumsum(length[:n]) - length[:n], abs=1e-12)
    assert reach[0] == length[0]
    assert reach[:n].sum() == pytest.approx(length.sum() - 0.5 * length[n - 1] + 0.5 * length[0], abs=1e-12)


def test_what_stands_beyond_the_last_segment_does_not_matter() -> None:
    light = np.tile(RIGHT, (36, 1, 1)).astype(np.float64)
    bias, whole = np.full((36, 1), 0.02), np.ones((36, 1))
    for n in (1, 7, 8, 9, 40):
        clean = chain(np.full(n, 0.2), 0.4)
        other = clean.copy()
        other.length[0, n:], other.angle[0, n:] = np.nan, np.inf
        one, two = (advanced(LAW, stems, traits(), light, bias, whole, STEP_H) for stems in (clean, other))
        used = one.count[0]
        assert two.count[0] == used
        assert one.length[0, :used].tobytes() == two.length[0, :used].tobytes()
        assert one.angle[0, :used].tobytes() == two.angle[0, :used].tobytes()
        assert one.points_cm.tobytes() == two.points_cm.tobytes()


@settings(deadline=None, max_examples=80)
@given(rods())
def test_splitting_changes_neither_shape_nor_length(rod: tuple[Array, Array, int]) -> None:
    length, angle, n = rod
    line = corners(length, angle, n)
    new_length, new_angle = length.copy(), angle.copy()
    count = split(new_length, new_angle, n)
    assert count == min(CAPACITY, n + int((length > LONG_SEGMENT_CM).sum()))
    assert new_length.sum() == pytest.approx(length.sum(), abs=1e-12)
    finer = corners(new_length, new_angle, count)
    away = np.abs(finer[:, None] - line[None]).max(axis=2).min(axis=0)
    assert away.max() < 1e-9  # all the old corners are there
    assert finer[-1] == pytest.approx(line[-1], abs=1e-9)


@settings(deadline=None, max_examples=150)
@given(rods())
def test_ten_points_are_those_of_the_tracks_convention(rod: tuple[Array, Array, int]) -> None:
    out = np.empty((10, 2))
    points_lane(*rod, out)
    assert np.abs(out - resample_by_height(corners(*rod))).max() < 1e-6


def test_rods_run_through_measured_stems_within_a_tenth_of_a_millimetre() -> None:
    for one in dataset_runs(5, open_loops=1, closed_loops=1, random_loops=1, hours=72.0):
        points = one.track.points_cm[::4]
        again = points_of(*rods_through(points))
        assert np.hypot(*np.moveaxis(again - points, -1, 0)).max() < 0.01
        assert again[:, -1] == pytest.approx(points[:, -1], abs=1e-9)


@pytest.mark.parametrize("turn_deg", [-170, -120, 90, 120, 150, 170])
@pytest.mark.parametrize("length_cm", [8.0, 25.0])
def test_rods_run_through_stems_that_fold_back(turn_deg: float, length_cm: float) -> None:
    along = np.linspace(0.0, 1.0, 400)
    angle = np.radians(turn_deg) * np.clip((along - 0.4) / 0.6, 0.0, 1.0)
    line = np.concatenate([np.zeros((1, 2)), np.cumsum(np.stack([np.sin(angle), np.cos(angle)], axis=1), axis=0)])
    points = resample_by_height(line * length_cm / 400)[None]
    length, angles, count = rods_through(points)
    assert np.abs(np.diff(angles[0, : count[0]])).max() < np.pi  # no jump by a whole turn
    assert np.abs(points_of(length, angles, count) - points).max() < 0.02


def test_a_stem_that_uses_up_its_segments_goes_on_growing() -> None:
    points = np.linspace(0.0, 1.0, 10)[:, None] * np.array([3.0, 55.0])
    stems = standing(LAW, np.stack([points, 0.1 * points]))
    assert stems.count[0] == CAPACITY - 1
    light = np.tile(RIGHT, (7 * 288, 2, 1)).astype(np.float64)
    pushes, whole = np.zeros(light.shape[:2]), np.ones(light.shape[:2])
    grown = advanced(LAW, stems, np.repeat(traits(), 2, axis=0), light, pushes, whole, STEP_H)
    assert grown.count[0] == CAPACITY
    assert grown.length_cm[0] - stems.length_cm[0] == pytest.approx(7 * 7.0, rel=1e-6)
    assert np.isfinite(grown.points_cm).all()


# Symmetry


def test_mirrored_stems_and_lamps_give_mirrored_plants() -> None:
    runs = dataset_runs(3, open_loops=1, closed_loops=1, hours=30.0)
    points = np.stack([one.track.points_cm[row] for one in runs for row in (0, -1)])
    rng = np.random.default_rng(1)
    light = rng.choice([0.0, 0.4, 1.0], size=(288, 4, 2))
    constants = prior_mean() + 0.3 * rng.normal(size=(4, 9))
    bias, whole = 0.05 * rng.normal(size=(288, 4)), np.ones((288, 4))
    flip = np.array([-1.0, 1.0])
    one = advanced(LAW, standing(LAW, points), constants, light, bias, whole, STEP_H)
    other = advanced(LAW, standing(LAW, points * flip), constants, light[..., ::-1], -bias, whole, STEP_H)
    assert np.abs(one.points_cm[:, -1] - points[:, -1]).min() > 0.1
    assert np.abs(other.points_cm - one.points_cm * flip).max() < 1e-9


# The law, on paper


def test_in_the_dark_a_tilted_stem_rises() -> None:
    stems, angles = chain(np.full(80, 0.6)), [0.6]
    for _ in range(24):
        stems = after(stems, 6, DARK, **STILL)
        angles.append(tip_angle(stems))
    assert (np.diff(angles[:5]) < 0.0).all()
    assert abs(angles[-1]) < 0.05


def test_a_stem_bends_to_the_lamp_that_shines_and_stays_upright_between_two() -> None:
    upright = chain(np.zeros(80))
    right, left, both, dark = (after(upright, 36, lamp, **STILL) for lamp in (RIGHT, LEFT, BOTH, DARK))
    assert tip_angle(right) > 0.3
    assert tip_angle(left) == pytest.approx(-tip_angle(right), abs=1e-12)
    assert both.angle.tobytes() == dark.angle.tobytes() == upright.angle.tobytes()
    # lamps on both sides are light from above
    pulled = after(chain(np.full(80, 0.4)), 12, BOTH, **STILL, **(ALONE | {"photoception_per_cm_h": 0.3}))
    assert 0.0 < tip_angle(pulled) < 0.4


@pytest.mark.parametrize("gamma_per_h", [0.2, 0.7, 1.5])
def test_proprioception_alone_straightens_exponentially(gamma_per_h: float) -> None:
    bends = 0.02 * np.random.default_rng(2).normal(size=60)
    stems = chain(np.cumsum(bends))
    straighter = after(stems, 24, DARK, **STILL, **SOFT, **(ALONE | {"proprioception_per_h": gamma_per_h}))
    told = np.diff(straighter.angle[0, :60], prepend=0.0)
    # each step takes the share gamma dt: the exponential up to its order
    assert told == pytest.approx(bends * (1.0 - gamma_per_h * STEP_H) ** 24, abs=1e-9)
    assert told == pytest.approx(bends * np.exp(-2.0 * gamma_per_h), rel=0.1 * gamma_per_h**2 + 0.01)


def test_graviception_bends_by_the_sine_and_less_where_tissue_is_stiff() -> None:
    beta, stiff_cm, tilt = 0.4, 3.0, 0.5
    stems = chain(np.full(90, tilt))
    constants = STILL | ALONE | {"graviception_per_cm_h": beta, "stiffening_cm": stiff_cm, "mature_cm": 1e9}
    bent = after(stems, 1, DARK, **constants)
    turned = bent.angle[0, :90] - tilt
    from_tip_cm = 9.0 - 0.1 * np.arange(90)  # of each segment's lower end
    expected = -beta * np.sin(tilt) * STEP_H * stiff_cm * (np.exp(-from_tip_cm / stiff_cm) - np.exp(-9.0 / stiff_cm))
    a_segment = beta * np.sin(tilt) * STEP_H * 0.1 * np.exp(-from_tip_cm / stiff_cm)
    assert (np.abs(turned - expected) < 1.1 * a_segment).all()
    assert turned[-1] == pytest.approx(expected[-1], rel=0.05)


@pytest.mark.parametrize("level", [1.0, 0.5, 0.1, 0.01])
def test_light_acts_by_its_direction_and_the_logarithm_of_its_brightness(level: float) -> None:
    nu = 0.3
    short = chain(np.zeros(5))  # so short that all of it is as far from the lamp as the anchor
    constants = STILL | SOFT | ALONE | {"photoception_per_cm_h": nu}
    bent = after(short, 1, (0.0, level), **constants)
    across = 35.0 / np.hypot(35.0, 30.0)
    size = np.log1p(level / LIGHT_HALF) / np.log1p(1.0 / LIGHT_HALF)
    assert tip_angle(bent) == pytest.approx(nu * size * across * STEP_H * 0.5, rel=0.03)
    # a stem that points at the lamp is not bent by it
    at_lamp = chain(np.full(5, np.arctan2(35.0, 30.0)))
    assert tip_angle(after(at_lamp, 1, (0.0, level), **constants)) == pytest.approx(tip_angle(at_lamp), abs=1e-9)


@pytest.mark.parametrize("latency_min", [10.0, 20.0, 60.0])
def test_the_answer_to_light_lags_by_the_latency(latency_min: float) -> None:
    stems, missing_min, seen = chain(np.zeros(20)), 0.0, 0.0
    for k in range(round(12 * latency_min / 5.0)):
        missing_min += 5.0 * (1.0 - seen)
        stems = after(stems, 1, RIGHT, **STILL, photo_latency_min=latency_min)
        seen, stages = float(stems.memory[0, 1, 1]), 5.0 * (k + 1) / (latency_min / 2.0)
        assert seen == pytest.approx(1.0 - (1.0 + stages) * np.exp(-stages), abs=0.25)
    assert missing_min == pytest.approx(latency_min, abs=5.0)
    assert stems.memory[0, :, 0].tolist() == [0.0, 0.0]  # nothing is seen of the other lamp


def test_mature_tissue_keeps_its_shape() -> None:
    stems = chain(0.03 * np.arange(60), segment_cm=0.33)  # 19.8 cm
    mature_cm = 3.0
    bent = after(stems, 144, LEFT, bias=0.2, mature_cm=mature_cm, **STILL)
    fixed = int((19.8 - mature_cm - 10.0) / 0.33)
    assert fixed > 15
    assert bent.angle[0, :fixed].tobytes() == stems.angle[0, :fixed].tobytes()
    assert tip_angle(bent) < tip_angle(stems) - 0.5
    # the same tissue, still soft, gives way
    assert np.abs(after(stems, 144, LEFT, bias=0.2, mature_cm=40.0, **STILL).angle[0, 10:fixed] - 0.3).min() > 0.01


def test_length_follows_the_two_rates() -> None:
    rates = {"growth_early_cm_per_day": 3.0, "growth_late_cm_per_day": 7.0}
    for start_cm, per_day in ((4.0, 3.0), (30.0, 7.0)):
        stems = chain(np.zeros(40), start_cm / 40)
        grown = after(stems, 72, DARK, **rates).length_cm - start_cm
        assert grown == pytest.approx(per_day / 4.0, rel=1e-9)
    # between: dL/dt = a + b (L - 6.5 cm), solved
    b = (7.0 - 3.0) / (22.0 - 6.5)
    grown_cm = float(after(chain(np.zeros(40), 8.0 / 40), 288, DARK, **rates).length_cm[0])
    expected_cm = 6.5 + (1.5 + 3.0 / b) * np.exp(b) - 3.0 / b
    assert grown_cm == pytest.approx(expected_cm, rel=2e-3)


def test_growth_by_chance_is_a_share_and_never_shrinks() -> None:
    stems = chain(np.zeros(40), 0.2)
    whole, half, none, less = (after(stems, 1, DARK, growth=x).length_cm[0] - 8.0 for x in (1.0, 0.5, 0.0, -2.0))
    assert half == pytest.approx(0.5 * whole, rel=1e-9)
    assert none == less == pytest.approx(0.0, abs=1e-12)


def test_longer_steps_are_taken_in_parts() -> None:
    stems = chain(np.full(60, 0.2), 0.15)
    levels, still, whole = np.array([[RIGHT]]), np.zeros((1, 1)), np.ones((1, 1))
    at_once = advanced(LAW, stems, traits(), levels, still, whole, 12 * STEP_H)
    assert at_once.points_cm == pytest.approx(after(stems, 12, RIGHT).points_cm, abs=1e-12)


def test_stems_are_told_as_often_as_is_asked() -> None:
    light, still, whole = np.tile(RIGHT, (24, 1, 1)).astype(np.float64), np.zeros((24, 1)), np.ones((24, 1))
    out = np.full((4, 1, 10, 2), np.nan)
    stems = chain(np.full(60, 0.2), 0.15)
    LAW.advance(stems.copy(), traits(), light, still, whole, STEP_H, 6, out)
    for k in range(4):
        assert out[k] == pytest.approx(after(stems, 6 * (k + 1), RIGHT).points_cm, abs=1e-12)

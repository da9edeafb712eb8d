"""The law in another form than it is written: what each number changes, by how much, and where it changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.simulator import terms
from flora_lab.simulator.law import standing
from flora_lab.simulator.rod import EARLY_CM, LATE_CM
from flora_lab.simulator.terms import NEUTRAL, Driven, ExtendedLaw, Seen
from flora_lab.simulator.tropism import (
    GROWTH_EARLY,
    GROWTH_LATE,
    GROWTH_ZONE,
    LIGHT_HALF,
    MATURE,
    MATURE_EDGE_CM,
    STIFFENING,
    TropismLaw,
)
from flora_lab.simulator.tropism_traits import prior_mean

STEP_H = 1.0 / 12.0
DARK, LEFT, RIGHT = (0.0, 0.0), (1.0, 0.0), (0.0, 1.0)
LAW = ExtendedLaw(LampsSection())
EVEN = prior_mean()
"""A plant whose tissue all bends alike, up to where it is mature."""
EVEN[STIFFENING], EVEN[MATURE] = np.log(100.0), np.log(8.0)


def stem(length_cm: float, lean_deg: float = 0.0) -> Array:
    lean = np.radians(lean_deg)
    return np.linspace(0.0, length_cm, 10)[:, None] * np.array([np.sin(lean), np.cos(lean)])


def grown(
    first_cm: Array, lamps: tuple[float, float], hours: float, bias: float = 0.0, gradient: float = 0.0, **form: float
) -> tuple[Array, Array]:
    """A plant that is used to its light, after some hours: ten points as they are shown (10, 2), and all angles."""
    steps = round(hours / STEP_H)
    own = NEUTRAL.copy()
    for name, value in form.items():
        own[getattr(terms, name.upper())] = value
    stems = standing(LAW, first_cm[None])
    stems.memory[0, :2] = np.log1p(np.array(lamps) / LIGHT_HALF) / np.log1p(1.0 / LIGHT_HALF)
    out = np.empty((steps, 1, 10, 2))
    still = np.zeros((steps, 1))
    driven = Driven(np.tile(lamps, (steps, 1, 1)), still + bias, still + gradient, still + 1.0, still + 1.0, still)
    LAW.advance_with(stems, EVEN[None], own[None], driven, Seen(still, np.ones(1)), STEP_H, 1, out)
    return out[-1, 0], stems.angle[0, : stems.count[0]]


def stretched(first_cm: Array, plant: Array, **form: float) -> Array:
    """By what share the segments of a stem have become longer in a step in the dark."""
    own = NEUTRAL.copy()
    for name, value in form.items():
        own[getattr(terms, name.upper())] = value
    stems = standing(LAW, first_cm[None])
    count, before = int(stems.count[0]), stems.length[0].copy()
    still = np.zeros((1, 1))
    driven = Driven(np.zeros((1, 1, 2)), still, still, still + 1.0, still + 1.0, still)
    LAW.advance_with(stems, plant[None], own[None], driven, Seen(still, np.ones(1)), STEP_H, 1, np.empty((1, 1, 10, 2)))
    assert stems.count[0] == count
    return np.asarray(stems.length[0, :count] / before[:count] - 1.0)


def bent(first_cm: Array, lamps: tuple[float, float], hours: float, **form: float) -> Array:
    """By how much a straight stem has bent at its joints, rad, but at the foot, where one that leans is bent before."""
    return np.diff(grown(first_cm, lamps, hours, **form)[1])


def test_as_it_is_written_it_is_the_plain_law_to_the_bit() -> None:
    first, light = stem(7.0, 10.0), np.tile(RIGHT, (36, 1, 1))
    plain, stems = np.empty((36, 1, 10, 2)), standing(TropismLaw(LampsSection()), first[None])
    stems.memory[0, :, 1] = 1.0
    still = np.zeros((36, 1))
    TropismLaw(LampsSection()).advance(stems, EVEN[None], light, still, still + 1.0, STEP_H, 1, plain)
    assert grown(first, RIGHT, 3.0)[0].tobytes() == plain[-1, 0].tobytes()


def test_a_gradient_bends_the_upper_half_of_the_zone_one_way_and_the_lower_half_the_other() -> None:
    first = stem(12.0)
    stems = standing(LAW, first[None])
    from_tip_cm = 12.0 - np.cumsum(stems.length[0, : stems.count[0]])[:-1]
    even, sloped = bent(first, DARK, STEP_H, bias=0.1), bent(first, DARK, STEP_H, gradient=0.1)
    assert sloped / even == pytest.approx(np.maximum(1.0 - from_tip_cm / 4.0, -1.0), abs=0.1)
    assert (sloped / even).min() == pytest.approx(-1.0, rel=1e-6)


@pytest.mark.parametrize("lean_deg", [0.0, 40.0])
def test_what_pushes_sideways_acts_across_the_stem(lean_deg: float) -> None:
    first = stem(7.0, lean_deg)
    plain, turned, pushed = (bent(first, DARK, STEP_H, **one) for one in ({}, {"push": 0.1}, {"sideways": 0.1}))
    assert pushed - plain == pytest.approx((turned - plain) * np.cos(np.radians(lean_deg)), rel=0.01)


@pytest.mark.parametrize("level", [0.5, 0.25])
def test_light_pulls_with_a_power_of_its_brightness_beyond_the_logarithm(level: float) -> None:
    """Seen in a dim lamp, before the stem has turned: in first order about a full one."""
    dim, more = (0.0, level), 0.1
    plain, beyond = (bent(stem(2.0), dim, STEP_H, brightness_more=value).sum() for value in (0.0, more))
    below_full = np.log1p(level / LIGHT_HALF) - np.log1p(1.0 / LIGHT_HALF)
    assert beyond / plain == pytest.approx(1.0 + more * below_full, rel=0.02)
    assert beyond / plain == pytest.approx(level**more, rel=0.03)


def test_the_pull_of_light_never_turns_about() -> None:
    assert bent(stem(7.0), (0.0, 0.05), 2.0, brightness_more=0.8).sum() > 0.0


@pytest.mark.parametrize(("lean_deg", "factor"), [(60.0, 1.5), (30.0, 1.0), (5.0, 0.7576)])
def test_gravity_pulls_beyond_the_sine(lean_deg: float, factor: float) -> None:
    first = stem(7.0, lean_deg)
    plain, beyond = (bent(first, DARK, STEP_H, lean_more=value) for value in (0.0, 1.0))
    assert plain.sum() < 0.0
    assert beyond == pytest.approx(factor * plain, rel=1e-3)


def test_mature_tissue_begins_gradually() -> None:
    """Half way at the same place; beyond it tissue turns more, before it less."""
    wider, first = 1.2, stem(20.0)
    stems = standing(LAW, first[None])
    length = stems.length[0, : stems.count[0]]
    beyond_cm = 20.0 - np.cumsum(length)[:-1] - 8.0
    plain, wide = (bent(first, RIGHT, STEP_H, edge_more=value) for value in (0.0, wider))
    little, much = (1.0 / (1.0 + np.exp(beyond_cm / (MATURE_EDGE_CM * np.exp(value)))) for value in (0.0, wider))
    near = np.abs(beyond_cm) < 2.5
    assert wide[near] / plain[near] == pytest.approx((much / little)[near], rel=0.05)
    assert ((wide > plain) == (beyond_cm > 0.0))[near].all()


@pytest.mark.parametrize(
    ("length_cm", "factor"), [(EARLY_CM - 1.0, 1.0), (0.5 * (EARLY_CM + LATE_CM), 1.2), (LATE_CM + 1.0, 1.0)]
)
def test_stems_of_middle_length_grow_faster(length_cm: float, factor: float) -> None:
    plain, faster = (
        grown(stem(length_cm), DARK, STEP_H, spurt_more=value)[0][-1, 1] - length_cm for value in (0.0, 0.2)
    )
    assert faster / plain == pytest.approx(factor, rel=0.005)


def growth_cm(length_cm: float, hours: float, **form: float) -> float:
    return float(grown(stem(length_cm), DARK, hours, **form)[0][-1, 1]) - length_cm


@pytest.mark.parametrize("spurt_more", [0.0, 1.0])
@pytest.mark.parametrize("hours", [36.0, 72.0])
def test_growth_that_follows_the_hours_is_the_same_for_short_and_long_stems(hours: float, spurt_more: float) -> None:
    """The integral of the course from its early to its late rate, by hand."""
    early, late = np.exp(EVEN[[GROWTH_EARLY, GROWTH_LATE]]) / 24.0
    share = (np.arange(hours * 20.0) + 0.5) / (72.0 * 20.0)
    course = (early + (late - early) * share) * (1.0 + 4.0 * spurt_more * share * (1.0 - share))
    told = [growth_cm(length, hours, by_hours=1.0, spurt_more=spurt_more) for length in (EARLY_CM, LATE_CM)]
    assert told == pytest.approx([course.mean() * hours] * 2, rel=0.005)
    by_length = [growth_cm(length, hours, spurt_more=spurt_more) for length in (EARLY_CM, LATE_CM)]
    assert by_length[0] != pytest.approx(by_length[1], rel=0.02)


def test_growth_that_follows_the_hours_ends_its_course_at_its_late_rate() -> None:
    late = np.exp(EVEN[GROWTH_LATE])
    in_a_day = growth_cm(EARLY_CM, 96.0, by_hours=1.0) - growth_cm(EARLY_CM, 72.0, by_hours=1.0)
    assert in_a_day == pytest.approx(late, rel=0.005)


def test_a_stem_that_leans_to_the_camera_looks_longer() -> None:
    short, long = (grown(stem(length), DARK, STEP_H, nearer=0.1)[0][-1, 1] for length in (EARLY_CM - 0.5, LATE_CM))
    plain = grown(stem(LATE_CM), DARK, STEP_H)[0][-1, 1]
    assert short < EARLY_CM
    assert short == pytest.approx(grown(stem(EARLY_CM - 0.5), DARK, STEP_H)[0][-1, 1])
    assert long - plain == pytest.approx(0.1 * 0.5 * (LATE_CM - EARLY_CM), rel=0.05)


def test_where_the_apex_alone_senses_light_all_tissue_turns_as_the_apex_does() -> None:
    first = stem(12.0)
    pushed = bent(first, DARK, STEP_H, push=0.1)
    each, apical, half = (bent(first, RIGHT, STEP_H, apical=share) / pushed for share in (0.0, 1.0, 0.5))
    assert each.max() > 1.2 * each.min()
    assert apical == pytest.approx(np.full(len(apical), each[-1]), rel=1e-2)
    assert half == pytest.approx((each + apical) / 2.0, rel=1e-3)


@pytest.mark.parametrize("h_per_cm", [0.2, 0.4])
def test_the_apex_is_answered_the_later_the_farther_below_it(h_per_cm: float) -> None:
    """Of two stems in the light from the left one is lit from the right at last."""
    first, hours, changed_h = stem(12.0), 3.0, 1.0
    own = NEUTRAL.copy()
    own[[terms.APICAL, terms.SIGNAL_H_PER_CM]] = 1.0, h_per_cm
    stems, steps = standing(LAW, np.stack([first, first])), round(hours / STEP_H)
    light = np.tile(LEFT, (steps, 2, 1))
    light[steps - round(changed_h / STEP_H) :, 1] = RIGHT
    still = np.zeros((steps, 2))
    driven = Driven(light, still, still, still + 1.0, still + 1.0, still)
    seen = Seen(still, np.ones(2))
    LAW.advance_with(
        stems, np.tile(EVEN, (2, 1)), np.tile(own, (2, 1)), driven, seen, STEP_H, 1, np.empty((steps, 2, 10, 2))
    )
    joints = np.diff(stems.angle[:, : stems.count[0]], axis=1)
    from_tip_cm = stems.length[0, : stems.count[0]].sum() - np.cumsum(stems.length[0, : stems.count[0]])[:-1]
    turned = np.abs(joints[1] - joints[0])
    reached = from_tip_cm[turned > 1e-3 * turned.max()].max()
    assert reached == pytest.approx(changed_h / h_per_cm, abs=0.6)
    assert (turned[from_tip_cm > reached] == 0.0).any()


def test_a_signal_that_takes_no_time_is_the_apex_itself() -> None:
    at_once, soon = (bent(stem(12.0), RIGHT, 2.0, apical=1.0, signal_h_per_cm=value) for value in (0.0, 1e-9))
    assert soon == pytest.approx(at_once, rel=1e-6)


def test_of_tissue_that_matures_by_age_a_fast_stem_keeps_a_longer_zone() -> None:
    """Of the plant, 8 cm are young where it grows at the mean of its early and its late rate."""
    early, late = np.exp(EVEN[[GROWTH_EARLY, GROWTH_LATE]])
    mean = (early + late) / 2.0
    for length_cm, rate in ((EARLY_CM, early), (0.5 * (EARLY_CM + LATE_CM), mean), (LATE_CM, late)):
        first = stem(length_cm)
        stems = standing(LAW, first[None])
        from_tip_cm = length_cm - np.cumsum(stems.length[0, : stems.count[0]])[:-1]
        aged, ever_young = bent(first, DARK, STEP_H, push=0.1, by_age=1.0), bent(first, DARK, STEP_H, push=0.1)
        is_young = aged > 0.5 * ever_young.max()
        assert from_tip_cm[is_young].max() == pytest.approx(8.0 * rate / mean, abs=0.5)
        if rate == mean:
            assert aged == pytest.approx(ever_young, rel=1e-9)


@pytest.mark.parametrize("length_cm", [EARLY_CM, LATE_CM])
def test_of_tissue_that_matures_by_age_a_fast_stem_grows_over_a_longer_zone(length_cm: float) -> None:
    early, late = np.exp(EVEN[[GROWTH_EARLY, GROWTH_LATE]])
    rate = early if length_cm == EARLY_CM else late
    zones = []
    for zone_cm, by_age in ((1.0, 1.0), (2.0 * rate / (early + late), 0.0)):
        plant = EVEN.copy()
        plant[GROWTH_ZONE] = np.log(zone_cm)
        zones.append(stretched(stem(length_cm), plant, by_age=by_age))
    assert zones[0].max() > 100.0 * zones[0].min()
    assert zones[0] == pytest.approx(zones[1], rel=1e-6, abs=1e-12)

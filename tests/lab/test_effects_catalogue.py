"""The catalogue of effects: names, numbers and words, and that each does something, but nothing where it is none."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from diagnose_runs import LAMPS, QUIET, STEP_S, TYPICAL, change_of, run_of, scene_of, still, turns
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.scene import Lanes, Scene
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.effects.effect import Change, Effect, Parameter
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.terms import NEUTRAL, ExtendedLaw

WANTED = [
    "circumnutation",
    "phototropic_latency",
    "adaptation",
    "lamp_asymmetry",
    "lamp_ageing",
    "diurnal_growth",
    "temperature_growth",
    "growth_rate",
    "stiffening",
    "gravitropism",
    "proprioception",
    "phototropic_gain",
    "sag",
    "draught",
    "camera_roll",
    "camera_scale",
    "camera_drift",
    "clock_offset",
    "clock_skew",
    "time_scale",
    "memory",
]
PARAMETERS = [pytest.param(p, id=f"{e.name}.{p.name}") for e in CATALOGUE for p in e.parameters]
FORMS = [(e.name, form) for e in CATALOGUE for form in range(len(e.forms))]
HOURS = 18.0
WARM_C = 22.0 + 4.0 * np.sin(2.0 * np.pi * np.arange(round(HOURS * 3600.0 / STEP_S)) / 288.0)
SCENE = still(turns(HOURS, 4.0), warm_c=WARM_C)


def features(change: Change, scene: Scene = SCENE) -> np.ndarray:
    return scene.simulated(Lanes((TYPICAL + change.traits)[None], np.zeros((1, 2)), [change]))[0]


def starts(effect: Effect) -> list[dict[str, float]]:
    """Values from which a search sets out; half way to the far end of what is plausible where none are told."""
    told = [p.starts or (p.value(0.5 * (p.centre + p.coordinate(p.low))),) for p in effect.parameters]
    return [dict(zip(effect.names, values, strict=True)) for values in itertools.product(*told)]


def test_every_cause_of_the_list_is_there_once() -> None:
    assert [effect.name for effect in CATALOGUE] == WANTED
    assert list(BY_NAME) == WANTED
    assert [effect.name for effect in CATALOGUE if not effect.forms] == ["memory"]  # only a learned simulator lacks it
    assert len({effect.title for effect in CATALOGUE}) == len(CATALOGUE)


def test_parameters_are_named_with_their_units() -> None:
    wanted = {
        "circumnutation": ("period_h", "amplitude_cm"),
        "phototropic_latency": ("delay_h",),
        "adaptation": ("time_constant_h", "floor"),
        "lamp_asymmetry": ("right_to_left",),
        "diurnal_growth": ("amplitude", "peak_h"),
        "temperature_growth": ("per_degree",),
        "camera_roll": ("angle_deg",),
        "camera_drift": ("angle_deg",),
        "clock_offset": ("offset_h",),
    }
    assert {name: BY_NAME[name].names for name in wanted} == wanted
    for effect in CATALOGUE:
        assert len(set(effect.names)) == len(effect.names)
        if effect.forms:
            assert sum(p.none is not None for p in effect.parameters) == 1, "one number says how strong it is"
        assert 0.0 < effect.prior <= 1.0
        for p in effect.parameters:
            assert p.meaning
            assert p.source


@pytest.mark.parametrize(("name", "form"), FORMS)
def test_an_effect_of_no_size_changes_no_bit(name: str, form: int) -> None:
    effect, nothing = BY_NAME[name], features(Change())
    kinds = [[p.none] if p.none is not None else [p.low, p.high, *p.starts] for p in effect.parameters]
    for values in itertools.product(*kinds):
        told = dict(zip(effect.names, values, strict=True))
        coordinates = np.array([p.coordinate(told[p.name]) for p in effect.parameters])
        change = Hypothesis((Cause(effect, form),)).change(coordinates)
        assert features(change).tobytes() == nothing.tobytes()
        assert change.rhythm_cm == 0.0


@pytest.mark.parametrize(("name", "form"), FORMS)
def test_each_form_changes_a_run_wherever_a_search_sets_out(name: str, form: int) -> None:
    effect, nothing = BY_NAME[name], features(Change())
    for values in starts(effect):
        change = change_of({name: values}, {name: form})
        if name == "circumnutation":  # of an unknown phase: it is no part of a typical plant's run
            assert change.rhythm_cm == values["amplitude_cm"] > 0.0
            assert change.rhythm_h == values["period_h"]
        else:
            assert np.abs(features(change) - nothing).max() > 0.01


@pytest.mark.parametrize("name", [e.name for e in CATALOGUE if len(e.forms) > 1])
def test_forms_are_not_the_same_thing_twice(name: str) -> None:
    values = starts(BY_NAME[name])[0]
    told = [features(change_of({name: values}, {name: form})) for form in range(len(BY_NAME[name].forms))]
    assert np.abs(told[0] - told[1]).max() > 0.01


@pytest.mark.parametrize("p", PARAMETERS)
def test_ranges_are_sane(p: Parameter) -> None:
    assert p.low < p.high
    low, high = p.reach
    assert low <= p.coordinate(p.low) < p.coordinate(p.high) <= high
    assert low <= p.centre <= high
    assert 0.0 < p.spread < math.inf
    if p.scale == "day":
        assert (p.low, p.high) == (0.0, 24.0)
        assert p.none is None
    elif p.none is not None:
        none = p.coordinate(p.none)
        assert p.centre == none
        assert max(abs(p.coordinate(end) - none) for end in (p.low, p.high)) == pytest.approx(2.0 * p.spread)
        # what lies on one side of no effect is never looked for on the other
        assert low >= none or p.low < p.none
        assert high <= none or p.high > p.none
    assert all(p.low <= value <= p.high for value in p.starts)


@given(st.data())
def test_coordinates_come_back_as_the_values_that_they_stand_for(data: st.DataObject) -> None:
    effect = data.draw(st.sampled_from([effect for effect in CATALOGUE if effect.forms]))
    p = data.draw(st.sampled_from(effect.parameters))
    value = data.draw(st.floats(p.low, p.high))
    assert p.value(p.coordinate(value)) == pytest.approx(value, rel=1e-12, abs=1e-12)
    assert p.coordinate(p.low) <= p.coordinate(value) <= p.coordinate(p.high)


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_plants_stay_plants_as_far_as_a_search_goes(data: st.DataObject) -> None:
    effect = data.draw(st.sampled_from([effect for effect in CATALOGUE if effect.forms]))
    form = data.draw(st.integers(0, len(effect.forms) - 1))
    ends = [p.reach if math.isfinite(p.reach[0]) else (-30.0, 30.0) for p in effect.parameters]
    coordinates = np.array([data.draw(st.floats(low, high)) for low, high in ends])
    told = features(Hypothesis((Cause(effect, form),)).change(coordinates))
    assert np.isfinite(told).all()


@given(st.data())
def test_sentences_are_words_of_one_line(data: st.DataObject) -> None:
    effect = data.draw(st.sampled_from([effect for effect in CATALOGUE if effect.forms]))
    values = {p.name: data.draw(st.one_of(st.floats(p.low, p.high), st.just(p.low))) for p in effect.parameters}
    text = effect.sentence(values)
    assert text
    assert text[0].islower() or text[0].isdigit()
    assert text == text.strip()
    assert not text.endswith(".")
    assert not {"\n", "nan", "inf", "{", "None"} & {part for part in ("\n", "nan", "inf", "{", "None") if part in text}


def test_sides_are_told_rightly() -> None:
    assert "to the right" in BY_NAME["draught"].sentence({"drive_per_cm_h": 0.1})
    assert "to the left" in BY_NAME["draught"].sentence({"drive_per_cm_h": -0.1})
    for name in ("camera_roll", "camera_drift"):
        assert " anticlockwise" in BY_NAME[name].sentence({"angle_deg": 2.0})
        assert " clockwise" in BY_NAME[name].sentence({"angle_deg": -2.0})
    # a picture turned anticlockwise shows an upright stem as one that leans to the left, where x is negative
    in_the_dark = still(np.zeros((216, 2)))
    for name in ("camera_roll", "camera_drift"):
        change = change_of({name: {"angle_deg": 8.0}})
        tip_x_cm = features(change, in_the_dark)[::5]
        assert (np.diff(tip_x_cm) < 0.0).all()  # rolled, it leant to the right when it seemed upright; it rights itself
        assert tip_x_cm[-1] < -0.1


def test_what_is_the_same_as_what_is_told_of_both() -> None:
    for effect in CATALOGUE:
        for other, what in effect.same_as.items():
            assert other in BY_NAME
            assert other != effect.name
            assert what
    both = [("phototropic_latency", "clock_offset"), ("diurnal_growth", "temperature_growth")]
    for one, other in both:
        assert other in BY_NAME[one].same_as
        assert one in BY_NAME[other].same_as
    assert "growth_rate" in BY_NAME["camera_scale"].same_as
    for effect in CATALOGUE:
        for other in effect.exactly:
            assert other in effect.same_as
            assert effect.name in BY_NAME[other].exactly


def test_late_clocks_and_slow_answers_are_the_same_indeed() -> None:
    delayed = features(change_of({"phototropic_latency": {"delay_h": 0.5}}))
    late = features(change_of({"clock_offset": {"offset_h": 0.5}}))
    assert np.abs(delayed - features(Change())).max() > 0.1
    assert np.abs(delayed - late).max() < 1e-6


def test_effects_come_together_in_any_order() -> None:
    told = {
        "lamp_asymmetry": {"right_to_left": 0.7},
        "camera_roll": {"angle_deg": 3.0},
        "camera_drift": {"angle_deg": 2.0},
        "gravitropism": {"factor": 1.4},
        "clock_skew": {"per_hour": 0.01},
        "clock_offset": {"offset_h": 0.3},
    }
    there, back = change_of(told), change_of(dict(reversed(list(told.items()))))
    assert features(there) == pytest.approx(features(back), abs=1e-9)
    alone = [np.abs(features(change_of({name: values})) - features(there)).max() for name, values in told.items()]
    assert min(alone) > 0.05


def test_a_change_as_made_changes_nothing_and_is_nobody_elses() -> None:
    one, other = Change(), Change()
    one.terms[0], one.traits[0] = 1.0, 1.0
    assert other.terms.tolist() == NEUTRAL.tolist()
    assert not other.traits.any()
    with pytest.raises(ValueError, match="not in"):
        one.times("hope", 2.0)


def test_temperature_acts_where_it_is_told() -> None:
    change = change_of({"temperature_growth": {"per_degree": 0.07}})
    unknown = still(turns(HOURS, 4.0))
    assert SCENE.has_temperature
    assert not unknown.has_temperature
    assert features(change, unknown).tobytes() == features(Change(), unknown).tobytes()
    constant = run_of(1, hours=12.0, chance=QUIET, warm_c=np.full(144, 26.0))
    run = MeasuredRun(
        "", "", "", constant.points_cm, constant.light, constant.time_s, STEP_S, constant.covariates, LAMPS
    )
    assert not Scene(run, ExtendedLaw(LAMPS), 22.0).has_temperature  # which is no news about growth
    assert scene_of(1, hours=12.0, warm_c=WARM_C[:144]).has_temperature
